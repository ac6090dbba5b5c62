"""Names of earlier versions raise errors that name the present ones."""

import pytest
from warpcontact.kernels.catalogue.keywords import keywords_of
from warpcontact.kernels.catalogue.names import RENAMED, suggestion

import warpcontact as wc
from warpcontact.experiment.schema import SECTIONS, Settings

MATERIAL = wc.ContactMaterial(law=wc.laws.Rigid())
FUNCTIONS = (
    wc.Scene.add_contact,
    wc.Scene.add_shape_contact,
    wc.Scene.add_particle_contact,
    wc.Scene.from_usd,
    wc.Simulation,
)


@pytest.fixture(scope="module")
def simulation():
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((1.0, 1.0)), name="ground")
    ball = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), name="ball")
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, MATERIAL, name="touch")
    return wc.Simulation(scene.build(device="cpu"), dt=1e-3, integrator=wc.integrators.MoreauJean())


@pytest.mark.parametrize("old", RENAMED)
def test_earlier_name_raises_an_error_with_the_present_name(old, simulation):
    new = RENAMED[old]
    model, scene = simulation.model, simulation.model.scene
    owners = [wc, wc.compare, scene, model, simulation, wc.meshes.grid((1.0, 1.0)).report]
    found = 0
    for owner in owners:
        if new in getattr(owner, "__all__", dir(owner)):
            found += 1
            with pytest.raises(AttributeError, match=rf"\.{old} is now [\w.]+\.{new}$"):
                getattr(owner, old)
    for function in FUNCTIONS:
        if new in keywords_of(function):
            found += 1
            with pytest.raises(TypeError, match=rf"\(\): the keyword '{old}' is now '{new}'$"):
                function(None, None, None, **{old: None})
    if f"scene.{new}" in model.sensor_names:
        found += 1
        with pytest.raises(KeyError, match=rf"no sensor 'scene\.{old}'; it is now 'scene\.{new}'"):
            model.sensor(f"scene.{old}")
    if new in Settings.model_fields:
        found += 1
        with pytest.raises(wc.ExperimentError, match=f"{old} is now {new}"):
            wc.Experiment.from_dict({old: []})
    found += new in ("sensors",)
    assert found


def test_earlier_keys_of_an_experiment_file_are_named():
    assert "contact" in SECTIONS
    with pytest.raises(wc.ExperimentError) as raised:
        wc.Experiment.from_dict({"record": {"readings": []}, "contact": [{"rim": "off", "template": "rubber"}]})
    for line in ("record.readings is now record.sensors", "contact[0].rim is now contact[0].boundary"):
        assert line in str(raised.value)


def test_other_unknown_names_are_not_renamed():
    assert suggestion("template", ["mass"]) == ""
    with pytest.raises(AttributeError, match="'Scene' object has no attribute 'nothing'"):
        _ = wc.Scene().nothing
