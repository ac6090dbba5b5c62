"""Stages of export_usd contain the recorded values: read with pxr and compared."""

import numpy as np
import pytest
import scenes
from pxr import Gf, Kind, Usd, UsdGeom, UsdPhysics
from recorded_usd_scene import (
    CORNERS,
    ENVS,
    RADII,
    SENSORS,
    TILT,
    arrows,
    export,
    findings,
    simulate,
    value,
    world,
)
from scipy.spatial.transform import Rotation

import warpcontact as wc

pytestmark = pytest.mark.installed


@pytest.fixture(scope="module")
def recording(device):
    return simulate(device)


@pytest.fixture(scope="module")
def stage(recording, tmp_path_factory):
    return export(recording, tmp_path_factory.mktemp("usd"), ".usdc")


@pytest.mark.smoke
def test_usd_stage_metadata_is_complete(recording, stage):
    layer = stage.GetRootLayer()
    assert stage.GetDefaultPrim().GetPath() == "/World"
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    assert (layer.startTimeCode, layer.endTimeCode) == (0, recording.sizes["time"] - 1)
    assert (layer.timeCodesPerSecond, layer.framesPerSecond) == (100.0, 100.0)
    notes = layer.customLayerData["warpcontact"]
    assert (notes["version"], notes["device"]) == (wc.__version__, recording.attrs["device"])
    assert (notes["precision"], notes["dt"], list(notes["environments"])) == ("float32", 1e-3, [0, 1, 2, 3])
    physics = UsdPhysics.Scene(stage.GetPrimAtPath("/World/PhysicsScene"))
    assert physics.GetGravityDirectionAttr().Get() == Gf.Vec3f(0, 0, -1)
    assert physics.GetGravityMagnitudeAttr().Get() == pytest.approx(9.81)
    kinds = {path: Usd.ModelAPI(stage.GetPrimAtPath(path)).GetKind() for path in ("/World", "/World/env_1/ball")}
    assert kinds == {"/World": Kind.Tokens.assembly, "/World/env_1/ball": Kind.Tokens.component}


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_usd_stage_passes_all_validators(recording, tmp_path, suffix):
    stage = export(recording, tmp_path, suffix)
    assert [error.GetErrorAsString() for error in findings(stage)] == []
    stage.GetRootLayer().ClearDefaultPrim()
    assert findings(stage), "a stage without default prim must not pass"


@pytest.mark.parametrize("body", ["ball", "cube"])
def test_usd_bodies_move_as_recorded(recording, stage, body):
    for env in range(ENVS):
        for frame in range(recording.sizes["time"]):
            rotation, translation = world(stage, f"/World/env_{env}/{body}", frame)
            at = {"time": frame, "env": env}
            np.testing.assert_array_equal(translation, recording[f"{body}.position"].isel(at).values)
            expected = Rotation.from_quat(recording[f"{body}.orientation"].isel(at).values).as_matrix()
            np.testing.assert_allclose(rotation, expected, atol=1e-9)
    # A program that ignores time shows the first record.
    start = world(stage, f"/World/env_1/{body}", Usd.TimeCode.Default())[1]
    np.testing.assert_array_equal(start, recording[f"{body}.position"].values[0, 1])


def test_usd_spheres_have_the_radius_of_their_environment(recording, stage, tmp_path):
    for env, radius in enumerate(RADII):
        sphere = UsdGeom.Sphere(stage.GetPrimAtPath(f"/World/env_{env}/ball/touch"))
        assert sphere.GetRadiusAttr().Get() == radius
        np.testing.assert_allclose(sphere.GetExtentAttr().Get(), [[-radius] * 3, [radius] * 3], rtol=1e-6)
        assert sphere.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
        np.testing.assert_array_equal(sphere.GetDisplayColorAttr().Get(), [[1, 0, 0]])
    translation = world(stage, "/World/env_2/ball/touch", 20)[1]
    body = world(stage, "/World/env_2/ball", 20)
    np.testing.assert_allclose(translation, body[1] + body[0] @ [0, 0, 0.01], atol=1e-12)
    nominal = export(recording.drop_vars("touch.radius"), tmp_path, scene=recording.scene)
    assert value(nominal, "/World/env_3/ball/touch", "radius") == 0.05


def test_usd_spheres_of_a_set_have_the_radius_of_their_item(recording, tmp_path):
    radii = np.linspace(0.01, 0.02, 2 * ENVS).reshape(ENVS, 2)
    changed = recording.assign({"pin.radius": (("env", "pin.item"), radii)})
    stage = export(changed, tmp_path, scene=recording.scene)
    found = [
        [value(stage, f"/World/env_{e}/FixedPoints/pin/item_{i}", "radius") for i in (0, 1)] for e in range(ENVS)
    ]
    np.testing.assert_array_equal(found, radii)
    np.testing.assert_array_equal(world(stage, "/World/env_1/FixedPoints/pin/item_1", 3)[1], [0, 0, 9])


def test_usd_point_set_is_drawn_as_points(stage):
    points = UsdGeom.Points(stage.GetPrimAtPath("/World/env_1/cube/cube_floor"))
    np.testing.assert_allclose(points.GetPointsAttr().Get(), CORNERS, rtol=1e-6)
    (width,) = points.GetWidthsAttr().Get()
    assert 0.0 < width < 0.1
    np.testing.assert_allclose(np.array(points.GetExtentAttr().Get())[1], CORNERS[-1] + width / 2, rtol=1e-6)


def test_usd_sphere_of_two_contacts_is_drawn_once(device, tmp_path):
    model = scenes.dropped_sphere(wc.laws.Hooke(stiffness=1e4), device=device)
    scene = model.scene
    wall = scene.add_surface(scenes.square(), name="wall")
    for name, radius in (("again", 0.1), ("larger", 0.2)):
        scene.add_contact(scene.points[0], wall, scenes.oracle_law(), radius=radius, name=name)
    stage = export(wc.Simulation(scene.build(device=device), dt=1e-3).run(duration=1e-3), tmp_path)
    spheres = stage.GetPrimAtPath("/World/env_0/ball").GetChildren()
    found = {prim.GetName(): list(prim.GetCustomDataByKey("warpcontact:contacts")) for prim in spheres}
    assert found == {"touch": ["touch", "again"], "larger": ["larger"]}


def test_usd_surface_equals_its_mesh(recording, stage):
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Surfaces/floor"))
    surface = recording.scene.surfaces[0]
    np.testing.assert_array_equal(mesh.GetPointsAttr().Get(), surface.mesh.vertices.astype(np.float32))
    np.testing.assert_array_equal(mesh.GetFaceVertexIndicesAttr().Get(), surface.mesh.faces.reshape(-1))
    np.testing.assert_array_equal(mesh.GetFaceVertexCountsAttr().Get(), [3, 3])
    np.testing.assert_array_equal(mesh.GetExtentAttr().Get(), [[-5, -5, 0], [5, 5, 0]])
    assert (mesh.GetSubdivisionSchemeAttr().Get(), mesh.GetOrientationAttr().Get()) == ("none", "rightHanded")
    assert mesh.GetDoubleSidedAttr().Get()
    assert mesh.GetPrim().HasAPI(UsdPhysics.MeshCollisionAPI)
    colors = mesh.GetDisplayColorPrimvar()
    assert colors.GetInterpolation() == "uniform"
    np.testing.assert_allclose(colors.ComputeFlattened(), [[0.8, 0.6, 0.4], [0.32, 0.24, 0.16]], rtol=1e-6)
    active = UsdGeom.Subset(stage.GetPrimAtPath("/World/Surfaces/floor/active"))
    assert (list(active.GetIndicesAttr().Get()), active.GetElementTypeAttr().Get()) == ([0], "face")
    np.testing.assert_array_equal(world(stage, "/World/Surfaces/floor", 0)[1], [0.1, 0.2, -0.02])
    assert UsdGeom.Imageable(mesh).ComputeVisibility() == "inherited"


def test_invisible_surface_is_hidden_and_oriented_in_usd(stage):
    hidden = UsdGeom.Imageable(stage.GetPrimAtPath("/World/Surfaces/hidden"))
    assert hidden.ComputeVisibility() == "invisible"
    rotation = world(stage, "/World/Surfaces/hidden", 0)[0]
    np.testing.assert_allclose(rotation, Rotation.from_quat(TILT).as_matrix(), atol=1e-7)


def test_usd_surface_of_a_body_follows_it(recording, stage):
    vertices = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/World/env_2/cube/hull")).GetPointsAttr().Get())
    at = {"time": 25, "env": 2}
    turn = Rotation.from_quat(recording["cube.orientation"].isel(at).values)
    hull = recording.scene.surfaces[2].mesh.vertices + np.array([0.1, 0, 0])
    expected = turn.apply(hull) + recording["cube.position"].isel(at).values
    assert abs(turn.as_rotvec()).max() > 0.1, "the cube must have turned"
    rotation, translation = world(stage, "/World/env_2/cube/hull", 25)
    np.testing.assert_allclose(vertices @ rotation.T + translation, expected, atol=1e-6)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_sensors_are_usd_attributes(recording, device, tmp_path, precision):
    if precision != "float32":
        recording = simulate(device, precision)
    stage = export(recording, tmp_path)
    names = ("gap", "normalForce", "frictionForce", "normal", "point", "status", "slipSpeed")
    for contact, prim in (("touch", "touch"), ("cube-floor", "cube_floor")):
        for sensor, name in zip(SENSORS, names, strict=True):
            data = recording[f"{contact}.{sensor}"].values
            for frame in (0, 17, 30):
                found = value(stage, f"/World/env_3/contacts/{prim}", f"warpcontact:{name}", frame)
                np.testing.assert_array_equal(found, data[frame, 3], err_msg=f"{contact}.{sensor} {frame}")
    assert recording["touch.normal_force"].values.any(), "the ball must have touched"
    energy = value(stage, "/World/env_1", "warpcontact:kineticEnergy", 9)
    assert energy == recording["scene.kinetic_energy"].values[9, 1]
    attribute = stage.GetPrimAtPath("/World/env_3/contacts/touch").GetAttribute("warpcontact:normalForce")
    assert attribute.GetTypeName() == {"float32": "float", "float64": "double"}[precision]
    assert attribute.GetDocumentation() == "normal force [N]"
    assert attribute.GetCustomDataByKey("warpcontact:unit") == "N"
    status = stage.GetPrimAtPath("/World/env_0/contacts/touch").GetAttribute("warpcontact:status")
    assert "1 CONTACT" in status.GetDocumentation()


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_gap_of_disabled_contact_is_nan_in_usd(recording, tmp_path, suffix):
    stage = export(recording, tmp_path, suffix)
    assert np.isnan(value(stage, "/World/env_0/contacts/pin", "warpcontact:gap", 5)).all()


def test_usd_arrows_equal_the_force_on_the_body(recording, stage, tmp_path):
    scaled = export(recording, tmp_path, force_scale=0.01)
    scale = stage.GetRootLayer().customLayerData["warpcontact"]["forceScale"]
    longest = 0.0
    for env in range(ENVS):
        for body, contact, sensor in (("ball", "touch", "touch"), ("cube", "cube_floor", "cube-floor")):
            path = f"/World/env_{env}/contacts/{contact}/force"
            for frame in range(recording.sizes["time"]):
                starts, vectors = arrows(scaled, path, frame)
                force = recording[f"{body}.force"].values[frame, env]
                np.testing.assert_allclose(np.nansum(vectors, axis=0) / 0.01, force, rtol=1e-3, atol=1e-3)
                acts = recording[f"{sensor}.normal_force"].values[frame, env].reshape(-1) > 0.0
                np.testing.assert_array_equal(np.isfinite(starts[:, 0]), acts)
                points = recording[f"{sensor}.point"].values[frame, env].reshape(-1, 3)
                np.testing.assert_allclose(starts[acts], points[acts], atol=1e-6)
                extent = value(scaled, path, "extent", frame)
                assert (extent[0] < starts[acts]).all()
                assert (starts[acts] + vectors[acts] < extent[1]).all()
                _, automatic = arrows(stage, path, frame)
                longest = max(longest, np.linalg.norm(automatic[acts], axis=1).max(initial=0.0))
                np.testing.assert_allclose(vectors / 0.01, automatic / scale, atol=0.02)
    # The vertices of the cube are farthest from its center.
    assert longest == pytest.approx(1.5 * 2 * np.linalg.norm(CORNERS[0]), rel=0.2)
    np.testing.assert_array_equal(value(stage, f"{path}/head", "primvars:displayColor"), [[0, 1, 0]])
    assert "0.01 m for 1 N" in scaled.GetPrimAtPath(path).GetDocumentation()


def test_invisible_contact_is_hidden_in_usd(recording, stage):
    assert UsdGeom.Imageable(stage.GetPrimAtPath("/World/env_0/contacts/pin")).ComputeVisibility() == "invisible"
    assert UsdGeom.Imageable(stage.GetPrimAtPath("/World/env_0/contacts/touch")).ComputeVisibility() == "inherited"


def test_usd_bodies_have_mass_only_if_recorded(recording, tmp_path):
    bare = recording.drop_vars(["cube.mass", "cube.inertia"])
    stage = export(bare, tmp_path, scene=recording.scene)
    mass = UsdPhysics.MassAPI(stage.GetPrimAtPath("/World/env_0/cube"))
    assert stage.GetPrimAtPath("/World/env_0/cube").HasAPI(UsdPhysics.RigidBodyAPI)
    assert mass.GetCenterOfMassAttr().Get() == Gf.Vec3f(0)
    assert not mass.GetMassAttr().HasAuthoredValue()
    assert not mass.GetDiagonalInertiaAttr().HasAuthoredValue()
    axes = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()
    tensors = np.array([factor * axes @ np.diag([1.0, 2.0, 2.5]) @ axes.T for factor in (1, 2, 3, 4)])
    dims = ("env", "row", "column")
    with_mass = recording.assign({"cube.mass": ("env", [1.0, 2.0, 3.0, 4.0]), "cube.inertia": (dims, tensors)})
    stage = export(with_mass, tmp_path, scene=recording.scene)
    mass = UsdPhysics.MassAPI(stage.GetPrimAtPath("/World/env_2/cube"))
    assert mass.GetMassAttr().Get() == 3.0
    quaternion = mass.GetPrincipalAxesAttr().Get()
    turn = Rotation.from_quat([*quaternion.imaginary, quaternion.real]).as_matrix()
    found = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
    np.testing.assert_allclose(found, tensors[2], atol=1e-5)


def test_usd_angular_velocities_are_in_degrees(recording, stage):
    body = UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath("/World/env_1/cube"))
    expected = np.degrees(recording["cube.angular_velocity"].values[11, 1].astype(np.float64))
    np.testing.assert_allclose(body.GetAngularVelocityAttr().Get(11), expected, rtol=1e-6)
    np.testing.assert_array_equal(body.GetVelocityAttr().Get(11), recording["cube.linear_velocity"].values[11, 1])


def test_usd_environments_collide_with_themselves_and_shared_surfaces_only(recording, stage, tmp_path):
    def table(stage):
        groups = UsdPhysics.CollisionGroup.ComputeCollisionGroupTable(stage)
        return [[groups.IsCollisionEnabled(a, b) for b in groups.GetGroups()] for a in groups.GetGroups()]

    shared = np.eye(ENVS + 1, dtype=bool)
    shared[0] = shared[:, 0] = True
    np.testing.assert_array_equal(table(stage), shared)
    np.testing.assert_array_equal(table(export(recording, tmp_path, spacing=(3, 3))), np.eye(ENVS))


def test_surfaces_that_vary_are_written_per_environment(device, tmp_path):
    scene = wc.Scene()
    ground = scene.add_surface([scenes.square(), wc.meshes.box()], active_faces=[[0], None], name="ground")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 2), name="cube")
    carried = scene.add_surface(wc.meshes.box(), body, name="hull")
    shared = scene.add_surface(scenes.square(), position=(0, 0, -3), name="shared")
    for surface, points in ((ground, body), (carried, None), (shared, body)):
        scene.add_contact(scene.add_point(points, (0, 0, 0)), surface, scenes.oracle_law())
    model = scene.build(envs=3, device=device)
    model["ground.mesh"] = [0, 1, 0]
    model["ground.scale"] = [1.0, 2.0, 0.5]
    model["ground.position"] = [(0, 0, 0), (1, 0, 0), (0, 2, 0)]
    model["hull.scale"] = [1.0, 1.0, 3.0]
    model["shared.position"] = (0, 0, -4)
    stage = export(wc.Simulation(model, dt=1e-3).run(duration=2e-3), tmp_path)
    size = UsdGeom.BBoxCache(0, ["default"])
    for env, (low, high) in enumerate(
        (((-1, -1, 0), (1, 1, 0)), ((0, -1, -1), (2, 1, 1)), ((-0.5, 1.5, 0), (0.5, 2.5, 0)))
    ):
        bound = size.ComputeWorldBound(
            stage.GetPrimAtPath(f"/World/env_{env}/Surfaces/ground")
        ).ComputeAlignedRange()
        np.testing.assert_allclose([bound.GetMin(), bound.GetMax()], [low, high], atol=1e-6)
        hull = size.ComputeWorldBound(stage.GetPrimAtPath(f"/World/env_{env}/cube/hull")).ComputeAlignedRange()
        np.testing.assert_allclose(hull.GetSize(), [(1.0, 1.0, 3.0)[env]] * 3, rtol=1e-5)
    assert UsdGeom.Subset(stage.GetPrimAtPath("/World/env_0/Surfaces/ground/active"))
    assert not stage.GetPrimAtPath("/World/env_1/Surfaces/ground/active")
    np.testing.assert_array_equal(world(stage, "/World/Surfaces/shared", 0)[1], [0, 0, -4])
    assert not stage.GetPrimAtPath("/World/Surfaces/ground")
    assert [error.GetErrorAsString() for error in findings(stage)] == []


@pytest.mark.parametrize("radius", [0.0, 0.05])
def test_usd_points_of_a_surface_follow_it_in_each_environment(radius, device, tmp_path):
    scene = wc.Scene()
    ground = scene.add_surface(scenes.square(5.0), name="ground")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 2), name="cube")
    skin = scene.add_surface(wc.meshes.box(), body, orientation=TILT, name="skin")
    corners, centre = (
        scene.add_points(skin, CORNERS, name="corners"),
        scene.add_point(skin, (0, 0, 0.5), name="top"),
    )
    own = scene.add_points(body, [(0.1, 0, 0), (0, 0, 0)], name="own")
    for points in (corners, centre, own):
        name = f"{points.name}_ground"
        scene.add_contact(
            points, ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3)), radius=radius, name=name
        )
    model = scene.build(envs=3, device=device, precision="float64")
    model["skin.scale"] = scale = np.array([1.0, 2.0, 0.5])
    model["skin.position"] = places = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 0.1)])
    model["own.position"] = shifted = np.array([(0.2, 0, 0), (0, 0.3, 0)])[None]
    stage = export(wc.Simulation(model, dt=1e-3).run(duration=2e-3), tmp_path)

    def drawn(env, name, count):
        path = f"/World/env_{env}/cube/{name}_ground"
        prims = [path] if count == 1 else [f"{path}/item_{item}" for item in range(count)]
        origin = world(stage, f"/World/env_{env}/cube", 0)[1]
        if radius:
            return [world(stage, prim, 0)[1] - origin for prim in prims]
        return value(stage, path, "points")

    for env in range(3):
        turn = Rotation.from_quat(TILT)
        for name, points in (("corners", CORNERS), ("top", np.array([[0, 0, 0.5]]))):
            expected = turn.apply(scale[env] * points) + places[env]
            np.testing.assert_allclose(drawn(env, name, len(points)), expected, atol=1e-6)
        np.testing.assert_allclose(drawn(env, "own", 2), shifted[0], atol=1e-6)
    if not radius:
        extent = value(stage, "/World/env_1/cube/corners_ground", "extent")
        found = value(stage, "/World/env_1/cube/corners_ground", "points")
        assert (extent[0] < found.min(axis=0)).all()
        assert (extent[1] > found.max(axis=0)).all()
    assert [error.GetErrorAsString() for error in findings(stage)] == []


def test_usd_arrow_length_is_relative_to_body_size(device, tmp_path):
    """Relative to the largest mesh in any environment."""
    longest = {}
    for factor in (1.0, 4.0):
        scene = wc.Scene()
        ground = scene.add_surface(scenes.square(5.0), name="ground")
        body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 0.499), name="cube")
        scene.add_surface([wc.meshes.box(), wc.meshes.box((2, 2, 2))], body, name="skin")
        point = scene.add_point(body, (0, 0, -0.5))
        scene.add_contact(point, ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3)), name="touch")
        model = scene.build(envs=2, device=device)
        model["skin.scale"] = [1.0, factor]
        model["skin.mesh"] = [0, 1]
        record = [f"touch.{key}" for key in ("normal_force", "normal", "point")]
        stage = export(wc.Simulation(model, dt=1e-3).run(2e-3, record), tmp_path)
        longest[factor] = np.linalg.norm(arrows(stage, "/World/env_0/contacts/touch/force", 0)[1])
    # 1.5 times the diameter about the center of mass: a box of 2 m, times the factor.
    np.testing.assert_allclose([longest[1.0], longest[4.0]], 1.5 * np.sqrt(12) * np.array([1.0, 4.0]), rtol=0.05)
