"""A scene written to a stage and read again is equal: argument by argument, and step by step."""

import dataclasses

import all_elements_scene as scenes
import numpy as np
import pytest
from pxr import Usd, UsdGeom

import warpcontact as wc
from warpcontact.usd.author import identifiers
from warpcontact.usd.description import write_description
from warpcontact.usd.importing.restore import restore_scene
from warpcontact.usd.importing.stage import read_records
from warpcontact.usd.serialize import LIBRARY, element_calls

SCENES = {"contacts": scenes.contact_scene, "shapes": scenes.shape_scene, "custom law": scenes.custom_law_scene}


def written(scene):
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    write_description(stage, scene, identifiers(scene.element_names()))
    return stage


def read_description(stage, custom_types=()):
    records = read_records(stage)
    return None if records is None else restore_scene(records, custom_types)


def reread(stage, tmp_path, suffix):
    path = str(tmp_path / f"scene{suffix}")
    stage.GetRootLayer().Export(path)
    return Usd.Stage.Open(path)


def flat(value):
    """Returns the content of a value in a form for bitwise comparison."""
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, type):
        return value.__name__
    if isinstance(value, wc.Mesh):
        groups = {name: flat(np.asarray(own)) for name, own in value.groups.items()}
        return ("mesh", value.name, flat(value.vertices), flat(value.faces), groups)
    if isinstance(value, list | tuple):
        return [flat(one) for one in value]
    if dataclasses.is_dataclass(value) and not hasattr(value, "name"):
        return (type(value).__name__, {f.name: flat(getattr(value, f.name)) for f in dataclasses.fields(value)})
    if isinstance(value, dict):
        return {key: flat(one) for key, one in value.items()}
    return getattr(value, "name", value)


def as_calls(scene):
    words = [
        (one.kind, one.name, {key: flat(value) for key, value in one.arguments.items()})
        for one in element_calls(scene)
    ]
    return [flat(scene.gravity), scene.max_speed, scene.max_distance, *words]


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
@pytest.mark.parametrize("name", SCENES)
def test_scene_description_round_trips_every_argument(name, suffix, tmp_path):
    scene = SCENES[name]()
    found = read_description(reread(written(scene), tmp_path, suffix), custom_types=[scenes.Cubic])
    assert as_calls(found) == as_calls(scene)
    assert found.element_names() == scene.element_names()
    for key in ("bodies", "surfaces", "points", "contacts", "couplings", "contact_couplings", "shapes"):
        assert [one.name for one in getattr(found, key)] == [one.name for one in getattr(scene, key)]


def test_test_scenes_cover_every_kind_of_element():
    from warpcontact.usd.serialize import ADDERS

    assert {one.kind for make in SCENES.values() for one in element_calls(make())} == set(ADDERS)


def history(scene, precision, device):
    model = scene.build(envs=2, device=device, precision=precision)
    parameters = {name: np.array(model[name]) for name in model}
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(200)
    state = sim.state
    after = [array.numpy() for array in (state.body_position, state.body_orientation, state.body_linear_velocity)]
    return parameters, after


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", SCENES)
def test_scene_read_from_description_moves_bitwise_identically(name, precision, device, tmp_path):
    scene = SCENES[name]()
    found = read_description(reread(written(scene), tmp_path, ".usdc"), custom_types=[scenes.Cubic])
    first, second = (history(one, precision, device) for one in (scene, found))
    assert first[0].keys() == second[0].keys()
    for key, values in first[0].items():
        np.testing.assert_array_equal(second[0][key], values, err_msg=key)
    for one, other in zip(first[1], second[1], strict=True):
        assert one.tobytes() == other.tobytes()
    start = np.concatenate([np.atleast_2d(body.position) for body in scene.bodies])
    assert np.abs(first[1][0][0] - start).max() > 1e-3, "nothing moved"


@pytest.mark.parametrize("kind", [kind for kinds in LIBRARY.values() for kind in kinds], ids=lambda k: k.__name__)
def test_every_class_parameter_has_a_unique_usd_name(kind):
    names = [field.name for field in dataclasses.fields(kind)]
    assert identifiers(names) == {name: name for name in names}


def test_colliding_usd_names_get_the_next_free_number():
    found = identifiers(["a-b", "a.b", "a_b_2", "a b", "c"], reserved=["a_b", "c_1", "c"])
    assert found == {"a_b_2": "a_b_2", "c": "c_2", "a-b": "a_b_1", "a.b": "a_b_3", "a b": "a_b_4"}


def test_stage_without_description_returns_none():
    assert read_description(Usd.Stage.CreateInMemory()) is None


def test_stage_with_description_passes_all_validators():
    from recorded_usd_scene import findings

    stage = written(scenes.contact_scene())
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    assert [error.GetErrorAsString() for error in findings(stage)] == []


def test_scene_description_is_not_drawn():
    stage = written(scenes.shape_scene())
    assert not [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Gprim)]


def changed(name, path, value):
    """The stage of a scene with one attribute changed, added or (``None``) removed."""
    stage = written(SCENES[name]())
    place, _, key = path.rpartition(".")
    prim = stage.GetPrimAtPath("/".join(("/World/Description", *place.split())))
    if value is None:
        prim.RemoveProperty(key)
    elif isinstance(value, list):
        prim.GetRelationship(key).SetTargets(value)
    else:
        prim.GetAttribute(key).Set(value)
    return stage


ELEMENTS = "/World/Description/Elements"


@pytest.mark.parametrize(
    ("name", "path", "value", "message"),
    [
        ("contacts", "Elements/ball.warpcontact:mass", float("nan"), "Elements/ball: ball.mass must be"),
        ("contacts", "Elements/ball.warpcontact:mass", -1.0, "got -1"),
        ("contacts", "Elements/ball.warpcontact:mass", None, "Elements/ball: mass is missing"),
        ("contacts", "Elements/ball.warpcontact:name", "a b", "name of a body must be letters"),
        ("contacts", "Elements/ball.warpcontact:kind", "build", "kind must be one of body, bodies"),
        ("contacts", "Elements/touch_1.warpcontact:entry", "all", "touch-1.entry must be one of"),
        ("contacts", "Elements/touch_1.warpcontact:points", [f"{ELEMENTS}/ball"], "must come from add_point"),
        ("contacts", "Elements/touch_1.warpcontact:points", [f"{ELEMENTS}/nobody"], "must be earlier prims"),
        ("contacts", "Elements/touch_1.warpcontact:points", [], "points must have one target, got 0"),
        ("contacts", "Materials/material_0/law.warpcontact:type", "os.system", "there is no law 'os.system'"),
        ("contacts", "Materials/material_0/law.warpcontact:type", "Formula", "there is no law 'Formula'"),
        ("contacts", "Materials/material_0/law.warpcontact:stiffness", -5.0, "stiffness must be greater than 0"),
        ("contacts", ".warpcontact:schema", 99, "which is newer"),
        ("contacts", ".warpcontact:elements", [f"{ELEMENTS}/ball"], "must be all its elements once"),
    ],
)  # fmt: skip
def test_changed_description_is_refused_with_the_attribute(name, path, value, message):
    with pytest.raises(wc.UsdError) as raised:
        read_description(changed(name, path, value))
    assert message in str(raised.value)


def test_custom_law_class_must_be_passed_to_the_reader():
    stage = written(scenes.custom_law_scene())
    with pytest.raises(
        wc.UsdError, match=r"Materials/material_0: 'Cubic' is a law not in the library.*custom_types=\[Cubic\]"
    ):
        read_description(stage)
    with pytest.raises(TypeError, match="custom_types must be classes derived from"):
        read_description(stage, custom_types=[dict])


def test_normalized_quaternion_is_unchanged_by_normalization():
    from warpcontact.validation.checks import unit_quaternions

    given = np.random.default_rng(3).normal(size=(100000, 4))
    given /= np.linalg.norm(given, axis=1, keepdims=True) * 1.0001
    once = unit_quaternions("q", given)
    np.testing.assert_array_equal(unit_quaternions("q", once), once)


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_exported_scene_is_read_and_simulated_identically(suffix, device, tmp_path):
    def fall(scene):
        sim = wc.Simulation(scene.build(envs=2, device=device), dt=5e-4)
        return sim.run(duration=0.2, record=["ball.position", "contact.normal_force"], every=0.01)

    scene = scenes.custom_law_scene()
    first = fall(scene)
    found = wc.Scene.from_usd(wc.export_usd(first, tmp_path / f"recorded{suffix}"), custom_types=[scenes.Cubic])
    assert as_calls(found) == as_calls(scene)
    second = fall(found)
    for name in first.data_vars:
        np.testing.assert_array_equal(second[name], first[name])
    assert (first["contact.normal_force"] > 0).any()


def test_stage_with_a_description_of_an_earlier_schema_is_imported_as_usd_physics(device, tmp_path):
    simulation = wc.Simulation(scenes.contact_scene().build(device=device), dt=1e-4)
    path = wc.export_usd(simulation.run(1e-3, record=["ball.position", "ball.orientation"]), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(path))
    for name, value in (("schema", 1), ("version", "0.0.1")):
        stage.GetPrimAtPath("/World/Description").GetAttribute(f"warpcontact:{name}").Set(value)
    assert read_description(stage) is None
    stage.GetRootLayer().Save()
    scene = wc.Scene.from_usd(path, skip_unsupported=True)
    assert [
        warning for warning in scene.import_warnings if "in schema 1; the stage is imported as one of" in warning
    ] == [
        "/World/Description: written by warpcontact 0.0.1 in schema 1; the stage is imported as one of UsdPhysics"
    ]
