"""All environments as instances: positions, colors, and no duplicates."""

import matplotlib as mpl
import numpy as np
import pytest
import scenes
import xarray as xr
from pxr import UsdGeom, UsdPhysics
from recorded_usd_scene import RADII, export, simulate, value
from scipy.spatial.transform import Rotation

import warpcontact as wc


@pytest.fixture(scope="module")
def recording(device):
    return simulate(device)


@pytest.fixture(scope="module")
def stage(recording, tmp_path_factory):
    energies = "scene.kinetic_energy"
    return export(recording, tmp_path_factory.mktemp("usd"), ".usdc", envs=[1, 3], color_by=energies)


def instances(stage, name, code):
    """Matrices (n, 4, 4) of all instances, masked or not, for row vectors."""
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(f"/World/Ensemble/{name}"))
    ignored, own = UsdGeom.PointInstancer.IgnoreMask, UsdGeom.PointInstancer.ExcludeProtoXform
    return np.array(instancer.ComputeInstanceTransformsAtTime(code, code, own, ignored))


@pytest.mark.parametrize("body", ["ball", "cube"])
def test_usd_instances_are_at_body_poses_of_all_environments(recording, stage, body):
    for frame in (0, 17, 30):
        found = instances(stage, body, frame)
        at = recording.isel(time=frame)
        np.testing.assert_allclose(found[:, 3, :3], at[f"{body}.position"].values, rtol=1e-6, atol=1e-6)
        turns = Rotation.from_quat(at[f"{body}.orientation"].values).as_matrix()
        scales = np.linalg.norm(found[:, 0, :3], axis=1)[:, None, None]
        np.testing.assert_allclose(found[:, :3, :3] / scales, turns.transpose(0, 2, 1), atol=1e-6)


def test_usd_instance_ids_are_environments_and_drawn_ones_are_masked(stage):
    for body in ("ball", "cube"):
        np.testing.assert_array_equal(value(stage, f"/World/Ensemble/{body}", "ids"), [0, 1, 2, 3])
        np.testing.assert_array_equal(value(stage, f"/World/Ensemble/{body}", "invisibleIds"), [1, 3])
    assert list(stage.GetPrimAtPath("/World/Ensemble").GetCustomDataByKey("warpcontact:environments")) == [
        0,
        1,
        2,
        3,
    ]


def test_usd_instances_have_the_size_of_their_environment(recording, tmp_path):
    """One radius per body gives scaled copies of one sphere. A cube of constant size has one prototype per size."""
    stage = export(recording, tmp_path, envs=0, ensemble=True)
    first = UsdGeom.Sphere(stage.GetPrimAtPath("/World/Ensemble/ball/look_0/touch_0")).GetRadiusAttr().Get()
    if stage.GetPrimAtPath("/World/Ensemble/ball/look_1"):
        numbers = value(stage, "/World/Ensemble/ball", "protoIndices")
        paths = [f"/World/Ensemble/ball/look_{n}/touch_0" for n in numbers]
        found = [value(stage, path, "radius") for path in paths]
    else:
        found = first * value(stage, "/World/Ensemble/ball", "scales")[:, 0]
    np.testing.assert_allclose(found, RADII, rtol=1e-6)
    assert not stage.GetPrimAtPath("/World/Ensemble/cube/look_1")
    hull = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Ensemble/cube/look_0/hull"))
    np.testing.assert_allclose(hull.GetPointsAttr().Get(), recording.scene.surfaces[2].mesh.vertices, rtol=1e-6)


def test_common_size_ratio_is_an_instance_scale(device, tmp_path):
    scene = wc.Scene()
    ground = scene.add_surface(scenes.square(5.0), name="ground")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 2), name="ball")
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, scenes.oracle_law(), radius=0.1, name="touch")
    model = scene.build(envs=3, device=device)
    model["touch.radius"] = [0.1, 0.2, 0.05]
    stage = export(wc.Simulation(model, 1e-3).run(2e-3), tmp_path, envs=0)
    assert not stage.GetPrimAtPath("/World/Ensemble/ball/look_1")
    np.testing.assert_allclose(value(stage, "/World/Ensemble/ball", "scales")[:, 0], [1.0, 2.0, 0.5], rtol=1e-6)


def test_usd_instance_colors_follow_a_sensor_over_time(recording, stage):
    energies = recording["scene.kinetic_energy"].values.astype(np.float64)
    low, high = energies.min(), energies.max()
    root = stage.GetPrimAtPath("/World/Ensemble")
    custom_data = {
        key: root.GetCustomDataByKey(f"warpcontact:{key}") for key in ("colorBy", "unit", "low", "high")
    }
    assert custom_data == {"colorBy": "scene.kinetic_energy", "unit": "J", "low": low, "high": high}
    for frame in (0, 9, 30):
        np.testing.assert_array_equal(
            value(stage, "/World/Ensemble/ball", "primvars:warpcontact:scene:kineticEnergy", frame),
            energies[frame],
        )
        expected = mpl.colormaps["viridis"]((energies[frame] - low) / (high - low))[:, :3]
        found = value(stage, "/World/Ensemble/cube", "primvars:displayColor", frame)
        np.testing.assert_allclose(found, expected, atol=1e-6)
    primvar = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/World/Ensemble/ball")).GetPrimvar("displayColor")
    assert primvar.GetInterpolation() == "vertex"
    # A color of the prototype would override that of the instance.
    for prim in stage.GetPrimAtPath("/World/Ensemble/cube/look_0").GetChildren():
        assert not prim.GetAttribute("primvars:displayColor").HasAuthoredValue()


def test_outcome_colors_environments_with_a_value(recording, tmp_path):
    outcome = xr.DataArray([5.0, 1.0, np.nan], dims="env", coords={"env": [2, 0, 3]}, name="stop_distance")
    stage = export(recording, tmp_path, envs=1, color_by=outcome)
    values = value(stage, "/World/Ensemble/ball", "primvars:warpcontact:stopDistance")
    np.testing.assert_array_equal(values, [1.0, np.nan, 5.0, np.nan])
    colors = value(stage, "/World/Ensemble/ball", "primvars:displayColor")
    np.testing.assert_allclose(colors[[0, 2]], mpl.colormaps["viridis"]([0.0, 1.0])[:, :3], atol=1e-6)
    np.testing.assert_allclose(colors[[1, 3]], 0.5)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("stop_distance", "stopDistance"),
        ("a.b_c", "a:bC"),
        ("_", "_"),
        ("__", "__"),
        ("_1", "_1"),
        ("a..b", "a:_:b"),
        ("π", "__"),
        ("颜色", "______"),
    ],
)
def test_color_source_gets_a_valid_usd_name(recording, tmp_path, name, expected):
    outcome = xr.DataArray([1.0, 2.0], dims="env", coords={"env": [0, 1]}, name=name)
    stage = export(recording.isel(time=[0, 1]), tmp_path, scene=recording.scene, envs=1, color_by=outcome)
    values = value(stage, "/World/Ensemble/ball", f"primvars:warpcontact:{expected}")
    np.testing.assert_array_equal(values[:2], [1.0, 2.0])
    assert stage.GetPrimAtPath("/World/Ensemble").GetCustomDataByKey("warpcontact:colorBy") == name


def test_usd_instances_without_color_source_have_body_colors(recording, tmp_path):
    stage = export(recording, tmp_path, envs=1)
    ball = value(stage, "/World/Ensemble/ball/look_0/touch_0", "primvars:displayColor")
    np.testing.assert_array_equal(ball, [[1, 0, 0]])
    assert not stage.GetPrimAtPath("/World/Ensemble/ball").GetAttribute("primvars:displayColor")


def test_usd_instances_have_no_collision(stage):
    for prim in stage.GetPrimAtPath("/World/Ensemble").GetAllChildren():
        for one in (prim, *prim.GetAllChildren()):
            apis = (UsdPhysics.RigidBodyAPI, UsdPhysics.CollisionAPI, UsdPhysics.MassAPI)
            assert not any(one.HasAPI(api) for api in apis), one.GetPath()


def test_usd_instances_exist_if_environments_are_omitted(recording, tmp_path):
    assert not export(recording, tmp_path).GetPrimAtPath("/World/Ensemble")
    assert not export(recording, tmp_path, envs=0, ensemble=False).GetPrimAtPath("/World/Ensemble")
    assert not export(recording, tmp_path, envs=0, spacing=(1, 1)).GetPrimAtPath("/World/Ensemble")
    assert export(recording, tmp_path, ensemble=True).GetPrimAtPath("/World/Ensemble")


def test_environment_with_non_finite_poses_is_omitted(recording, tmp_path):
    bad = recording.copy(deep=True)
    bad["cube.position"].values[7:, 2] = np.nan
    stage = export(bad, tmp_path, scene=recording.scene, envs=0)
    np.testing.assert_array_equal(value(stage, "/World/Ensemble/ball", "ids"), [0, 1, 3])
    assert list(stage.GetPrimAtPath("/World/Ensemble").GetCustomDataByKey("warpcontact:leftOut")) == [2]
    assert wc.check_usd(tmp_path / "stage.usda") == []


def test_bodies_of_a_set_have_separate_instance_ids(device, tmp_path):
    scene = wc.Scene()
    places = [(x, 0.0, 1.0) for x in range(3)]
    grains = scene.add_bodies(places, mass=1.0, inertia=(1, 1, 1), name="grains")
    scene.add_shape(grains, [wc.shapes.Sphere(r) for r in (0.1, 0.2, 0.3)], name="sizes")
    recording = wc.Simulation(scene.build(4, device), 1e-3).run(2e-3)
    stage = export(recording, tmp_path, envs=2)
    ids = value(stage, "/World/Ensemble/grains", "ids")
    np.testing.assert_array_equal(ids, np.arange(12))
    np.testing.assert_array_equal(value(stage, "/World/Ensemble/grains", "invisibleIds"), [6, 7, 8])
    envs = value(stage, "/World/Ensemble/grains", "primvars:warpcontact:environment")
    np.testing.assert_array_equal(envs, np.repeat(np.arange(4), 3))
    np.testing.assert_allclose(instances(stage, "grains", 0)[:, 3, :3], places * 4, atol=1e-6)
    scales = value(stage, "/World/Ensemble/grains", "scales")[:, 0]
    first = value(stage, "/World/Ensemble/grains/look_0/sizes", "radius")
    np.testing.assert_allclose(first * scales, [0.1, 0.2, 0.3] * 4, rtol=1e-6)
    assert wc.check_usd(tmp_path / "stage.usda") == []


def test_shape_can_have_the_name_of_body_set_points(device, tmp_path):
    scene = wc.Scene()
    grains = scene.add_bodies([(0, 0, 1), (1, 0, 1)], mass=1.0, inertia=(1, 1, 1), name="grains")
    scene.add_shape(grains, wc.shapes.Sphere(0.1), name="centres")
    stage = export(wc.Simulation(scene.build(2, device), 1e-3).run(2e-3), tmp_path, envs=0)
    grains = stage.GetPrimAtPath("/World/env_0/grains")
    below = {prim.GetName(): prim.GetTypeName() for prim in grains.GetChildren()}
    assert below == {"centres": "Points", "centres_1": "PointInstancer"}
    shape = stage.GetPrimAtPath("/World/env_0/grains/centres_1")
    assert shape.GetCustomDataByKey("warpcontact:name") == "centres"


def test_contact_sphere_name_does_not_collide_with_elements(device, tmp_path):
    scene = wc.Scene()
    ground = scene.add_surface(scenes.square(5.0), name="ground")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 2), name="body")
    scene.add_surface(wc.meshes.box((0.4, 0.3, 0.2)), body=body, name="touch_0")
    scene.add_shape(body, wc.shapes.Cylinder(0.1, 0.2), name="touch_0_1")
    scene.add_contact(scene.add_point(body, (0, 0, 0.5)), ground, scenes.oracle_law(), radius=0.1, name="touch")
    stage = export(wc.Simulation(scene.build(2, device), 1e-3).run(2e-3), tmp_path, envs=0)
    look = stage.GetPrimAtPath("/World/Ensemble/body/look_0")
    found = {prim.GetName(): prim.GetTypeName() for prim in look.GetChildren()}
    assert found == {"touch_0": "Mesh", "touch_0_1": "Cylinder", "touch_0_2": "Sphere"}


def test_many_environments_are_subsampled_evenly(recording, tmp_path, monkeypatch):
    monkeypatch.setattr("warpcontact.drawing.ensemble.MAX_POSES", 2 * 31 * 2)
    stage = export(recording, tmp_path, envs=1)
    np.testing.assert_array_equal(value(stage, "/World/Ensemble/ball", "ids"), [0, 3])
    np.testing.assert_array_equal(
        value(export(recording, tmp_path, envs=1, ensemble=True), "/World/Ensemble/ball", "ids"), [0, 1, 2, 3]
    )


def test_parameter_of_a_set_is_a_color_source_if_its_items_are_equal(recording, tmp_path):
    friction = xr.DataArray(
        [[0.1] * 3, [0.4] * 3, [0.2] * 3, [np.nan] * 3],
        dims=("env", "item"),
        coords={"env": recording["env"]},
        name="feet.friction.mu",
    )
    stage = export(recording, tmp_path, envs=1, color_by=friction)
    numbers = value(stage, "/World/Ensemble/ball", "primvars:warpcontact:feet:friction:mu")
    np.testing.assert_array_equal(numbers, [0.1, 0.4, 0.2, np.nan])
    friction[1, 2] = 0.5
    with pytest.raises(ValueError, match="of float64 along env, item; items of a set must agree"):
        export(recording, tmp_path, envs=1, color_by=friction)


def test_color_source_with_reserved_name_is_refused(recording, tmp_path):
    number = xr.DataArray(np.arange(4.0), coords={"env": recording["env"]}, name="environment")
    with pytest.raises(ValueError, match="another name than 'environment', which is reserved"):
        export(recording, tmp_path, color_by=number)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"ensemble": "all"}, ValueError, "ensemble must be True, False or 'auto', got 'all'"),
        ({"ensemble": True, "spacing": (1, 0)}, ValueError, "in place: leave spacing 0"),
        ({"color_by": "touch.gab"}, ValueError, "recorded, got 'touch.gab'; did you mean 'touch.gap'\\?"),
        ({"color_by": "ball.position"}, ValueError, "one number for each environment, got 'ball.position' of"),
        ({"color_by": 3}, TypeError, "name or an xarray.DataArray, got int"),
    ],
)
def test_invalid_color_source_is_refused(recording, tmp_path, options, error, message):
    with pytest.raises(error, match=message):
        wc.export_usd(recording, tmp_path / "a.usda", **options)
