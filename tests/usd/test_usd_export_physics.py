"""UsdPhysics in exports, for other simulators: friction, restitution, joints, gravity, and colliders."""

import numpy as np
import pytest
import scenes
from pxr import Gf, UsdGeom, UsdLux, UsdPhysics, UsdShade
from recorded_usd_scene import export
from scipy.spatial.transform import Rotation

import warpcontact as wc

STIFF = wc.laws.HuntCrossley(stiffness=1e4, restitution=0.6)


def bound_material(stage, path):
    """Static friction, dynamic friction and restitution of the physics material bound to a prim."""
    found, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path)).ComputeBoundMaterial("physics")
    api = UsdPhysics.MaterialAPI(found.GetPrim())
    assert found.GetPrim().HasAPI(UsdPhysics.MaterialAPI), path
    names = ("StaticFriction", "DynamicFriction", "Restitution")
    return [getattr(api, f"Get{name}Attr")().Get() for name in names]


def balls(device, materials, **parameters):
    scene = wc.Scene()
    ground = scene.add_surface(scenes.square(5.0), name="ground")
    for number, material in enumerate(materials):
        body = scene.add_body(1.0, (1, 1, 1), position=(number, 0, 1), name=f"ball_{number}")
        point = scene.add_point(body, (0, 0, 0))
        scene.add_contact(point, ground, material, radius=0.1, name=f"touch_{number}")
    model = scene.build(3, device)
    for name, values in parameters.items():
        model[name.replace("__", ".")] = values
    return wc.Simulation(model, 1e-3).run(2e-3)


@pytest.mark.parametrize(
    ("friction", "static", "dynamic"),
    [
        (wc.friction.Tanh(mu=0.3, velocity_scale=0.01), 0.3, 0.3),
        (wc.friction.Stribeck(mu_static=0.5, mu_dynamic=0.4), 0.5, 0.4),
        (None, 0.0, 0.0),
    ],
)
def test_both_sides_of_a_contact_have_its_usd_material(device, tmp_path, friction, static, dynamic):
    stage = export(balls(device, [wc.ContactMaterial(law=STIFF, friction=friction)]), tmp_path)
    for path in ("/World/env_2/ball_0/touch_0", "/World/Surfaces/ground"):
        assert bound_material(stage, path) == pytest.approx([static, dynamic, 0.6])
    assert wc.check_usd(tmp_path / "stage.usda") == []


def test_varied_friction_is_written_per_environment(device, tmp_path):
    material = wc.ContactMaterial(law=STIFF, friction=wc.friction.Tanh(mu=0.3, velocity_scale=0.01))
    recording = balls(device, [material], touch_0__friction__mu=[0.1, 0.2, 0.7])
    stage = export(recording, tmp_path)
    assert not stage.GetPrimAtPath("/World/Surfaces/ground")
    for env, mu in enumerate((0.1, 0.2, 0.7)):
        for path in ("ball_0/touch_0", "Surfaces/ground"):
            assert bound_material(stage, f"/World/env_{env}/{path}") == pytest.approx([mu, mu, 0.6])
    assert wc.check_usd(tmp_path / "stage.usda") == []


def test_friction_set_for_all_environments_overrides_the_scene(device, tmp_path):
    material = wc.ContactMaterial(law=STIFF, friction=wc.friction.Tanh(mu=0.3, velocity_scale=0.01))
    recording = balls(device, [material], touch_0__friction__mu=0.8, touch_0__law__restitution=0.5)
    stage = export(recording, tmp_path)
    assert bound_material(stage, "/World/Surfaces/ground") == pytest.approx([0.8, 0.8, 0.5])


def test_bodies_in_different_contacts_have_different_usd_materials(device, tmp_path):
    materials = [
        wc.ContactMaterial(law=STIFF, friction=wc.friction.Tanh(mu=m, velocity_scale=0.01)) for m in (0.2, 0.9)
    ]
    stage = export(balls(device, materials), tmp_path)
    found = [bound_material(stage, f"/World/env_0/ball_{number}/touch_{number}")[0] for number in (0, 1)]
    assert found == pytest.approx([0.2, 0.9])
    assert [prim.GetName() for prim in stage.GetPrimAtPath("/World/PhysicsMaterials").GetChildren()] == [
        "touch_0",
        "touch_1",
    ]


def test_usd_shapes_have_materials_and_convex_meshes(device, tmp_path):
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 1), name="egg")
    shape = scene.add_shape(body, wc.shapes.Ellipsoid((0.2, 0.1, 0.15)), name="shell")
    friction = wc.friction.Tanh(mu=0.4, velocity_scale=0.01)
    scene.add_shape_contact(shape, floor, wc.ContactMaterial(law=STIFF, friction=friction), name="touch")
    stage = export(wc.Simulation(scene.build(2, device), 1e-3).run(2e-3), tmp_path)
    for path in ("/World/env_1/egg/shell", "/World/Surfaces/floor"):
        assert bound_material(stage, path) == pytest.approx([0.4, 0.4, 0.6])
    shell = UsdPhysics.MeshCollisionAPI(stage.GetPrimAtPath("/World/env_1/egg/shell"))
    assert shell.GetApproximationAttr().Get() == "convexHull"


def test_unchanged_masses_equal_those_of_the_scene(device, tmp_path):
    scene = wc.Scene()
    for name in ("one", "other"):
        scene.add_body(2.0, (1.0, 1.5, 2.0), name=name)
    model = scene.build(2, device)
    model["other.mass"] = [3.0, 4.0]
    poses = [f"{body}.{key}" for body in ("one", "other") for key in ("position", "orientation")]
    stage = export(wc.Simulation(model, 1e-3).run(2e-3, poses, poses=False), tmp_path)
    mass = UsdPhysics.MassAPI(stage.GetPrimAtPath("/World/env_1/one"))
    assert mass.GetMassAttr().Get() == 2.0
    assert mass.GetDiagonalInertiaAttr().Get() == Gf.Vec3f(1.0, 1.5, 2.0)
    # It was varied but not recorded.
    assert not UsdPhysics.MassAPI(stage.GetPrimAtPath("/World/env_1/other")).GetMassAttr().HasAuthoredValue()


JOINTS = {
    "hinge": (wc.motions.Hinge(axis=(0, 1, 1), anchor=(0, 0, 2)), "PhysicsRevoluteJoint"),
    "slider": (wc.motions.Slider(axis=(1, 2, 1)), "PhysicsPrismaticJoint"),
    "ball": (wc.motions.Ball(anchor=(0.5, 0, 2)), "PhysicsSphericalJoint"),
    "planar": (wc.motions.Planar(normal=(0, 1, 0)), "PhysicsJoint"),
    "translation": (wc.motions.Translation(), "PhysicsJoint"),
}


@pytest.fixture(scope="module")
def joined(device):
    scene = wc.Scene()
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_quat()
    for name, (motion, _) in JOINTS.items():
        scene.add_body(1.0, (1.0, 1.2, 1.5), (0.2, 0.1, 1.0), turn, motion=motion, name=name)
    scene.add_body(1.0, (1, 1, 1), motion=wc.motions.Fixed(), name="fixed")
    scene.add_body(1.0, (1, 1, 1), motion=wc.motions.Prescribed(), linear_velocity=(1, 0, 0), name="driven")
    return wc.Simulation(scene.build(2, device, "float64"), 1e-3).run(0.3, every=0.01)


def joint_frame(stage, path, side, code):
    """Origin and rotation (3, 3), in the world, of the frame of a joint on one of its sides."""
    joint = UsdPhysics.Joint(stage.GetPrimAtPath(path))
    place = np.array(getattr(joint, f"GetLocalPos{side}Attr")().Get(), dtype=float)
    q = getattr(joint, f"GetLocalRot{side}Attr")().Get()
    turn = Rotation.from_quat([*q.GetImaginary(), q.GetReal()]).as_matrix()
    targets = getattr(joint, f"GetBody{side}Rel")().GetTargets()
    if not targets:
        return place, turn
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath(targets[0])))
    body = matrix[:3, :3].T
    return body @ place + matrix[3, :3], body @ turn


@pytest.mark.parametrize("spacing", [(0, 0), (3, 2)])
@pytest.mark.parametrize("name", JOINTS)
def test_usd_joint_frames_coincide_at_all_times(joined, tmp_path, name, spacing):
    stage = export(joined, tmp_path, spacing=spacing)
    path = f"/World/env_1/joints/{name}"
    assert stage.GetPrimAtPath(path).GetTypeName() == JOINTS[name][1]
    moved = turned = 0.0
    for code in (0, 11, 30):
        (p0, r0), (p1, r1) = (joint_frame(stage, path, side, code) for side in (0, 1))
        shift, rest = r0.T @ (p1 - p0), r0.T @ r1
        # Joint frames are in single precision.
        if name in ("hinge", "ball"):
            np.testing.assert_allclose(shift, 0.0, atol=2e-6)
        if name == "slider":
            np.testing.assert_allclose(shift[1:], 0.0, atol=2e-6)
        if name == "planar":
            np.testing.assert_allclose(shift[0], 0.0, atol=2e-6)
        if name in ("hinge", "planar"):
            np.testing.assert_allclose(rest[:, 0], (1, 0, 0), atol=2e-6)
        if name in ("slider", "translation"):
            np.testing.assert_allclose(rest, np.eye(3), atol=2e-6)
        moved, turned = max(moved, np.abs(shift).max()), max(turned, np.abs(rest - np.eye(3)).max())
    assert max(moved, turned) > 0.01, "it must have moved"


def test_usd_joints_lock_the_constrained_axes(joined, tmp_path):
    stage = export(joined, tmp_path)
    locked = {"planar": {"transX", "rotY", "rotZ"}, "translation": {"rotX", "rotY", "rotZ"}}
    for name, freedoms in locked.items():
        prim = stage.GetPrimAtPath(f"/World/env_0/joints/{name}")
        limits = UsdPhysics.LimitAPI.GetAll(prim)
        assert {limit.GetLowAttr().GetName().split(":")[1] for limit in limits} == freedoms
        assert all(limit.GetLowAttr().Get() > limit.GetHighAttr().Get() for limit in limits)
    for name in ("fixed", "driven"):
        body = UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath(f"/World/env_0/{name}"))
        assert body.GetKinematicEnabledAttr().Get()
        assert not stage.GetPrimAtPath(f"/World/env_0/joints/{name}")
    assert wc.check_usd(tmp_path / "stage.usda") == []


def test_gravity_is_written_per_environment(device, tmp_path):
    scene = wc.Scene()
    scene.add_body(1.0, (1, 1, 1), name="ball")
    model = scene.build(2, device)
    model["scene.gravity"] = (0, 0, -1.62)
    stage = export(wc.Simulation(model, 1e-3).run(2e-3), tmp_path)
    gravity = UsdPhysics.Scene(stage.GetPrimAtPath("/World/PhysicsScene"))
    assert gravity.GetGravityMagnitudeAttr().Get() == pytest.approx(1.62)
    model["scene.gravity"] = [(0, 0, -9.81), (3, 0, 4)]
    stage = export(wc.Simulation(model, 1e-3).run(2e-3), tmp_path)
    assert not stage.GetPrimAtPath("/World/PhysicsScene")
    body = UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath("/World/env_1/ball"))
    (owner,) = body.GetSimulationOwnerRel().GetTargets()
    own = UsdPhysics.Scene(stage.GetPrimAtPath(owner))
    assert own.GetGravityMagnitudeAttr().Get() == 5.0
    assert own.GetGravityDirectionAttr().Get() == Gf.Vec3f(0.6, 0, 0.8)
    assert wc.check_usd(tmp_path / "stage.usda") == []


@pytest.mark.parametrize("spacing", [(0, 0), (3, 2)])
def test_usd_camera_frames_all_bodies_and_the_stage_is_lit(joined, tmp_path, spacing):
    stage = export(joined, tmp_path, spacing=spacing)
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/Camera")).GetCamera()
    frustum = camera.frustum
    for code in range(0, 31, 5):
        cache = UsdGeom.XformCache(code)
        for env in (0, 1):
            for name in JOINTS:
                place = cache.GetLocalToWorldTransform(stage.GetPrimAtPath(f"/World/env_{env}/{name}"))
                assert frustum.Intersects(place.ExtractTranslation()), (name, code)
    assert [
        prim.IsA(UsdLux.BoundableLightBase) or prim.IsA(UsdLux.NonboundableLightBase)
        for prim in stage.GetPrimAtPath("/World/Lights").GetChildren()
    ] == [True, True]
    for path in ("/World", "/World/env_0", "/World/env_0/hinge"):
        low, high = stage.GetPrimAtPath(path).GetAttribute("extentsHint").Get()
        assert all(a <= b for a, b in zip(low, high, strict=True))


def test_stage_custom_data_describes_the_export(joined, tmp_path):
    stage = export(joined, tmp_path)
    notes = stage.GetRootLayer().customLayerData["warpcontact"]
    assert notes["schema"] == 1
    assert notes["source"] == f"warpcontact {wc.__version__}"


def test_solids_have_the_usd_material_of_their_entry_in_a_table(device, tmp_path):
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor", physics_material="steel")
    solids = [floor]
    for number, name in enumerate(("steel", "rubber")):
        body = scene.add_body(1.0, (1, 1, 1), position=(2 * number, 0, 0.1), name=f"body_{number}")
        solids.append(scene.add_shape(body, wc.shapes.RoundedBox((0.1,) * 3), physics_material=name, name=name))
    law = wc.laws.KelvinVoigt(stiffness=1e4, restitution=0.5)
    table = {
        pair: wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=mu, velocity_scale=0.01))
        for pair, mu in {("steel", "steel"): 0.2, ("rubber", "steel"): 0.6}.items()
    }
    scene.add_body_contact(solids, table, name="bin")
    model = scene.build(2, device)
    # The pairs are steel and floor, rubber and floor, rubber and steel.
    model["bin.friction.mu"] = [[0.2, 0.6, 0.6], [0.3, 0.8, 0.8]]
    stage = export(wc.Simulation(model, 1e-3).run(2e-3), tmp_path)
    for env, values in enumerate(((0.2, 0.6), (0.3, 0.8))):
        for number, (name, mu) in enumerate(zip(("steel", "rubber"), values, strict=True)):
            found = bound_material(stage, f"/World/env_{env}/body_{number}/{name}")
            assert found == pytest.approx([mu, mu, 0.5])
    assert wc.check_usd(tmp_path / "stage.usda") == []
