"""A family of force elements in one file with one registration has all that families of the package have."""

import copy
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from magnet import Magnet, MagnetSet

import warpcontact as wc
from warpcontact.forces import registry
from warpcontact.forces.force_element import ForceElement, ForceTarget
from warpcontact.scene.scene_element import PointPair
from warpcontact.usd.serialize import element_calls

FILE = Path(__file__).with_name("magnet.py")
DOCS = FILE.parents[2] / "docs"

EXPERIMENT = {
    "envs": 3,
    "duration": 0.02,
    "dt": 1e-3,
    "gravity": [0.0, 0.0, 0.0],
    "body": [{"name": "ball", "mass": 1.0, "inertia": [1.0, 1.0, 1.0], "position": [0.0, 0.0, 1.0]}],
    "point": [
        {"name": "base", "position": [0.0, 0.0, 0.0]},
        {"name": "pole", "body": "ball", "position": [0.0, 0.0, 0.0]},
    ],
    "force_element": [{"type": "Magnet", "name": "magnet", "point_a": "base", "point_b": "pole", "strength": 2.0}],
    "variation": {"magnet.strength": {"values": [1.0, 2.0, 3.0]}},
    "outcome": {"pull": {"type": "Max", "of": "magnet.force"}},
    "record": {"sensors": ["magnet.force", "magnet.peak"]},
}


@pytest.fixture(autouse=True)
def magnet_only(monkeypatch):
    """Registers only the magnet of this process, without those of files that tests load."""
    monkeypatch.setattr(registry, "_REGISTERED", {Magnet: registry._REGISTERED[Magnet]})


def magnet_scene():
    """A ball 1 m above a pole in the world."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    ball = scene.add_body(1.0, (1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0), name="ball")
    points = {
        "point_a": scene.add_point(None, (0.0, 0.0, 0.0), name="base"),
        "point_b": scene.add_point(ball, (0.0, 0.0, 0.0), name="pole"),
    }
    scene.add_force_element(Magnet, **points, strength=2.0, name="magnet")
    return scene


def magnet_model(device, envs=3, precision="float32"):
    model = magnet_scene().build(envs, device, precision)
    model["magnet.strength"] = np.arange(1.0, envs + 1.0)
    return model


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_registered_element_acts_on_bodies(precision, device):
    model = magnet_model(device, precision=precision)
    np.testing.assert_array_equal(model["magnet.strength"], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(model.sensor("magnet.force"), [1.0, 2.0, 3.0], rtol=1e-6)
    np.testing.assert_allclose(model.sensor("ball.force")[:, 2], [-1.0, -2.0, -3.0], rtol=1e-6)
    np.testing.assert_allclose(model.sensor("magnet.force_a")[:, 2], [1.0, 2.0, 3.0], rtol=1e-6)
    wc.Simulation(model, dt=1e-3).step()
    np.testing.assert_allclose(model.sensor("ball.linear_velocity")[:, 2], [-1e-3, -2e-3, -3e-3], rtol=1e-6)


def test_registered_element_has_parameter_and_sensors(device):
    model = magnet_model(device)
    assert "magnet.strength" in model
    assert {name for name in model.sensor_names if name.startswith("magnet.")} == {
        "magnet.force",
        "magnet.peak",
        "magnet.force_a",
        "magnet.force_b",
    }
    sensor = model.find_sensor("magnet.peak")
    assert (sensor.unit, sensor.meaning) == ("N", "largest attraction since reset, as of the last step")
    with pytest.raises(ValueError, match=r"magnet\.strength\[1\] must be at least 0, got -1 N·m²"):
        model["magnet.strength"] = [1.0, -1.0, 1.0]


def test_history_advances_with_accepted_steps_and_is_reset(device):
    model = magnet_model(device)
    sim = wc.Simulation(model, dt=1e-3)
    recording = sim.run(0.02, ["magnet.force", "magnet.peak"], every=1e-3)
    assert recording["magnet.peak"].attrs["units"] == "N"
    forces = recording["magnet.force"].values
    # The peak of a step is that of the state from which it started.
    np.testing.assert_array_equal(recording["magnet.peak"].values[1:], np.maximum.accumulate(forces)[:-1])
    model.evaluate()
    np.testing.assert_array_equal(model.sensor("magnet.peak"), recording["magnet.peak"].values[-1])
    sim.reset([True, False, True])
    peak = model.sensor("magnet.peak")
    assert peak[0] == peak[2] == 0.0
    assert peak[1] > 2.0


def test_checkpoint_restores_parameters_and_history(tmp_path, device):
    sims = [wc.Simulation(magnet_model(device), dt=1e-3) for _ in range(2)]
    whole, resumed = sims
    whole.step(10)
    whole.save(tmp_path / "saved.npz")
    resumed.model["magnet.strength"] = 5.0
    resumed.load(tmp_path / "saved.npz")
    for sim in sims:
        np.testing.assert_array_equal(sim.model["magnet.strength"], [1.0, 2.0, 3.0])
        sim.step(10)
    for name in ("magnet.peak", "magnet.force", "ball.position"):
        np.testing.assert_array_equal(whole.model.sensor(name), resumed.model.sensor(name), err_msg=name)
    assert (whole.model.sensor("magnet.peak") > [1.0, 2.0, 3.0]).all()


def test_memory_estimate_includes_arrays_and_parameters(device):
    model = magnet_model(device)
    assert model.memory().bytes_for("magnets") == 3 * 2 * 8
    shared = magnet_scene().build(3, device).memory()
    assert model.memory().bytes_for("parameters") > shared.bytes_for("parameters")


def test_models_on_several_devices_and_gpu_schedule_are_equal(device):
    sims = [wc.Simulation(magnet_model(where), dt=1e-3, threads=2) for where in (device, [device] * 2)]
    for sim in sims:
        sim.step(20)
    for name in ("magnet.peak", "ball.position"):
        np.testing.assert_array_equal(*(sim.model.sensor(name) for sim in sims), err_msg=name)


@pytest.mark.parametrize("integrator", [wc.integrators.SemiImplicitEuler(), wc.integrators.MoreauJean()])
def test_registered_element_acts_with_contact(integrator, device):
    scene = magnet_scene()
    ball, (_, pole) = scene.bodies[0], scene.points
    rigid = isinstance(integrator, wc.integrators.MoreauJean)
    law = wc.laws.Rigid(restitution=0.0) if rigid else wc.laws.KelvinVoigt(stiffness=1e4, damping=50.0)
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)), position=(0.0, 0.0, 0.8))
    scene.add_contact(pole, ground, wc.ContactMaterial(law=law), radius=0.1, name="touch")
    sim = wc.Simulation(scene.build(device=device), dt=1e-3, integrator=integrator)
    sim.step(2000)
    force = sim.model.sensor("magnet.force")
    np.testing.assert_allclose(sim.model.sensor("touch.normal_force"), force, rtol=1e-3)
    np.testing.assert_allclose(force, 2.0 / 0.9**2, rtol=1e-2)
    assert np.abs(sim.model.sensor(f"{ball.name}.linear_velocity")).max() < 1e-4


def test_event_driven_simulation_includes_registered_element():
    model = magnet_model("cpu", envs=1, precision="float64")
    wc.unilateral.EventDriven(model).run(0.1)
    # 1/2 z'² = 1/z − 1
    height, speed = (model.sensor(f"ball.{key}")[0, 2] for key in ("position", "linear_velocity"))
    np.testing.assert_allclose(0.5 * speed**2, 1.0 / height - 1.0, rtol=1e-6)


def test_event_driven_simulation_refuses_forces_it_does_not_include(device, monkeypatch):
    model = magnet_model("cpu", envs=1)

    class Other(ForceElement):
        family, target = "wind", ForceTarget.BODIES

    monkeypatch.setattr(model, "force_elements", (*model.force_elements, Other()))
    with pytest.raises(ValueError, match="forces of wind are not included in event-driven simulation"):
        wc.unilateral.EventDriven(model)


def test_scene_checks_arguments():
    scene = magnet_scene()
    base, pole = scene.points
    points = {"point_a": base, "point_b": pole}
    assert scene.add_force_element(Magnet, **points, strength=1.0).name == "magnet_2"
    for arguments, error, message in (
        ({**points, "strength": -1.0}, ValueError, r"m\.strength must be at least 0, got -1 N·m²"),
        ({**points, "strength": "x"}, ValueError, r"m\.strength must be a number, got 'x'"),
        (points, TypeError, r"m\.strength is missing"),
        (
            {**points, "strenght": 1.0},
            TypeError,
            r"unexpected keyword argument 'strenght'; did you mean 'strength'",
        ),
        (
            {"point_a": base, "point_b": base, "strength": 1.0},
            ValueError,
            r"m: point_a and point_b are both fixed",
        ),
        (
            {"point_a": base, "point_b": "pole", "strength": 1.0},
            ValueError,
            r"m\.point_b must be Points of this scene",
        ),
        (
            {"point_a": base, "point_b": None, "strength": 1.0},
            ValueError,
            r"m\.point_b must be Points of this scene",
        ),
    ):
        with pytest.raises(error, match=message):
            scene.add_force_element(Magnet, name="m", **arguments)
    with pytest.raises(TypeError, match="kind must be a class derived from SceneElement or PointPair"):
        scene.add_force_element(MagnetSet, **points)
    assert len(scene.force_elements) == 2


def test_element_of_unregistered_class_is_refused():
    class Loose(PointPair):
        """A class that no family was registered for."""

    scene = magnet_scene()
    scene.add_force_element(Loose, point_a=scene.points[0], point_b=scene.points[1])
    with pytest.raises(TypeError, match="Loose is not a registered family of force elements"):
        scene.build(device="cpu")


def test_switch_is_a_parameter_per_environment(device):
    class Gated(PointPair):
        """Attraction that can be switched off."""

        strength: float = wc.parameter("N·m²", "force at a distance of 1 m", default=2.0, at_least=0.0)
        active: bool = True

    class GatedSet(MagnetSet):
        family, kind = "gated", Gated

        def force_launches(self, plan, state, step, status, *, by_cluster=False):
            return []

    registry.register(Gated, GatedSet.declare)
    scene = magnet_scene()
    scene.add_force_element(Gated, point_a=scene.points[0], point_b=scene.points[1], name="gate")
    model = scene.build(2, device)
    model["gate.active"] = [True, False]
    (gates,) = model.of_family("gated")
    assert gates.settings.numpy()["active"][:, 0].tolist() == [1, 0]
    with pytest.raises(ValueError, match=r"gate\.active\[0, 0\] must be 0 or 1"):
        model["gate.active"] = 0.5


def test_experiment_file_declares_varies_and_records(tmp_path):
    shutil.copy(FILE, tmp_path)
    content = copy.deepcopy(EXPERIMENT)
    content["force_element"][0]["type"] = "magnet.py:Magnet"
    experiment = wc.Experiment.from_dict(content, folder=tmp_path)
    run = experiment.run(tmp_path / "run")
    assert (tmp_path / "run" / "magnet.py").read_bytes() == FILE.read_bytes()
    assert 'type = "magnet.py:Magnet"' in (tmp_path / "run" / "experiment.toml").read_text()
    sim = wc.Simulation(magnet_model("cpu"), dt=1e-3)
    expected = sim.run(0.02, ["magnet.force", "magnet.peak"], every=1e-3)
    for name in ("magnet.force", "magnet.peak"):
        values = run.series[name].transpose("time", "env")[:: run.series.sizes["time"] // 20]
        np.testing.assert_array_equal(values, expected[name])
    np.testing.assert_array_equal(run.params["magnet.strength"], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(run.outcome["pull"], expected["magnet.force"].max("time"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strength": -1.0}, ".strength must be at least 0, got -1 N·m²"),
        ({"strength": "x"}, ".strength must be a number [N·m²], got 'x'"),
        ({"point_a": "nowhere"}, ".point_a must be the name of a point, got 'nowhere'; there are: base, pole"),
        ({"streng": 1.0}, ".streng is not known; did you mean 'strength'?"),
        ({"type": "Magnett"}, "did you mean 'Magnet'?"),
        ({"type": "magnet.py:MagnetSet"}, ".type: 'MagnetSet' in magnet.py is no class derived from SceneElement"),
        ({"type": "magnet.py:PointPair"}, ".type: PointPair in magnet.py is not registered"),
        ({"strength": None}, ".strength is missing: force at a distance of 1 m [N·m²]"),
        ({"type": None}, ".type is missing: one of Magnet"),
    ],
)
def test_experiment_file_with_invalid_element_is_refused(change, message, tmp_path):
    shutil.copy(FILE, tmp_path)
    content = copy.deepcopy(EXPERIMENT)
    entry = content["force_element"][0] | change
    content["force_element"][0] = {key: value for key, value in entry.items() if value is not None}
    with pytest.raises(
        wc.ExperimentError, match=re.escape("force_element[0] ('magnet')") + ".*" + re.escape(message)
    ):
        wc.Experiment.from_dict(content, folder=tmp_path)


def test_exported_stage_restores_element(tmp_path, monkeypatch):
    pytest.importorskip("pxr", reason="USD stages need the package usd-core")
    model = magnet_scene().build(device="cpu")
    recording = wc.Simulation(model, dt=1e-3).run(0.01)
    path = wc.export_usd(recording, tmp_path / "magnets.usda")
    scene = wc.Scene.from_usd(path)
    (magnet,) = scene.force_elements
    assert type(magnet) is Magnet
    assert (magnet.name, float(magnet.strength), magnet.point_b.name) == ("magnet", 2.0, "pole")
    assert [call.name for call in element_calls(scene)] == [call.name for call in element_calls(model.scene)]
    monkeypatch.setattr(registry, "_REGISTERED", {})
    with pytest.raises(wc.UsdError, match="type must be a registered force element"):
        wc.Scene.from_usd(path)


@pytest.mark.skipif(not DOCS.is_dir(), reason="the site is in a checkout, not in an installed package")
def test_documentation_contains_the_family(monkeypatch):
    blocks = re.findall(r"^```python\n(.*?)^```", (DOCS / "architecture.md").read_text(), re.DOTALL | re.MULTILINE)
    assert blocks[0] == FILE.read_text()
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(str(DOCS))
    reference = pytest.importorskip("reference")
    lines = reference.force_elements()
    families = re.findall(r"\*\*(.+)\*\*", "\n".join(lines))
    assert families == [*(family.name for family in registry.FAMILIES), "magnet"]
    assert "   .. autoclass:: magnet.Magnet" in lines
    text = []
    reference.describe(None, "class", "magnet.Magnet", Magnet, None, text)
    assert ":param strength: force at a distance of 1 m [N·m²], ≥ 0" in text
    assert ":param point_a: Points" in text


def test_every_family_has_a_name_and_a_home():
    for family in registry.FAMILIES:
        module = __import__(family.home, fromlist=["declare"])
        assert callable(module.declare), family.name
        kinds = [
            kind for kind in vars(module).values() if isinstance(kind, type) and hasattr(kind, "force_launches")
        ]
        assert family.name in {getattr(kind, "family", "") for kind in kinds}, family.name
