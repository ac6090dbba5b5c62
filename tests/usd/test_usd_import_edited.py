"""Exported stages that were edited: additions are rejected with a list, or skipped with a remark."""

import all_elements_scene
import numpy as np
import pytest
from physics_stages import BODY, body, prim, stage
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

import warpcontact as wc

GRAVITY = (0.0, 0.0, -3.7)


@pytest.fixture(scope="module")
def recording():
    scene = wc.Scene(gravity=GRAVITY)
    plate = scene.add_shape(None, wc.shapes.Plane(), name="plate")
    law = wc.laws.HuntCrossley(stiffness=1e4, restitution=0.7)
    rubber = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.4))
    ball = scene.add_body(0.5, (2e-4,) * 3, (0, 0, 0.3), name="ball-1", motion=wc.motions.Slider(axis=(0, 0, 1)))
    scene.add_shape_contact(scene.add_shape(ball, wc.shapes.Sphere(0.05), name="skin"), plate, rubber)
    box = scene.add_body(1.0, (1e-2,) * 3, (1, 0, 0.3), name="box")
    hull = scene.add_surface(wc.meshes.box((0.2, 0.2, 0.2)), body=box, name="hull")
    floor = scene.add_surface(wc.meshes.grid((4.0, 4.0)), name="floor")
    scene.add_surface_contact(hull, floor, rubber, samples="vertices")
    scene.add_contact(scene.add_points(box, [(0, 0, 0), (0.1, 0, 0)]), floor, rubber, radius=0.05, name="pair")
    return wc.Simulation(scene.build(2, "cpu"), dt=1e-4).run(2e-4)


@pytest.fixture
def path(recording, tmp_path):
    return wc.export_usd(recording, tmp_path / "ours.usda")


def edit(path, change):
    """Changes the stage; returns the problems of its import."""
    opened = Usd.Stage.Open(str(path))
    change(opened)
    opened.GetRootLayer().Save()
    # Read in this process, because a reader process takes longer than the import.
    with pytest.raises(wc.UsdError) as raised:
        wc.Scene.from_usd(path, trusted=True)
    scene = wc.Scene.from_usd(path, skip_unsupported=True, trusted=True)
    assert [one.name for one in scene.bodies] == ["ball-1", "box"]
    assert len(scene.import_warnings) == len(raised.value.problems)
    assert all(remark.startswith("omitted: ") for remark in scene.import_warnings)
    return raised.value.problems


@pytest.mark.parametrize(
    "options", [{}, {"spacing": (3.0, 0.0)}, {"clip_frames": 1}, {"envs": [1], "ensemble": True}]
)
def test_unchanged_export_is_imported_without_warnings(recording, tmp_path, options):
    path = wc.export_usd(recording, tmp_path / "ours.usdc", **options)
    assert wc.Scene.from_usd(path, trusted="clip_frames" in options).import_warnings == ()


def test_export_with_varied_environments_is_imported_without_warnings(tmp_path):
    scene = all_elements_scene.contact_scene()
    model = scene.build(3, "cpu")
    model["scene.gravity"] = np.linspace((0, 0, -1.0), (1, 0, -9.0), 3)
    path = wc.export_usd(wc.Simulation(model, dt=1e-5).run(2e-5), tmp_path / "ours.usdc")
    assert wc.Scene.from_usd(path).import_warnings == ()


def added(opened, path):
    prim = UsdGeom.Sphere.Define(opened, path).GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(prim)
    UsdPhysics.CollisionAPI.Apply(prim)


@pytest.mark.parametrize("place", ["/World/more", "/World/env_0/more", "/World/Surfaces/more", "/more"])
def test_added_body_is_reported(path, place):
    problems = edit(path, lambda opened: added(opened, place))
    assert problems == tuple(
        f"{place}: {what}, missing in the description (not supported)" for what in ("a rigid body", "a collider")
    )


def test_added_collider_is_reported(path):
    def change(opened):
        UsdPhysics.CollisionAPI.Apply(UsdGeom.Cube.Define(opened, "/World/env_1/box/bump").GetPrim())

    (problem,) = edit(path, change)
    assert problem.startswith("/World/env_1/box/bump: a collider")


def test_copied_element_is_reported_under_any_name(path):
    def change(opened):
        layer = opened.GetRootLayer()
        assert Sdf.CopySpec(layer, "/World/Prototype/box", layer, "/World/env_0/box_2")
        assert Sdf.CopySpec(layer, "/World/Surfaces/floor", layer, "/World/env_0/ball_1/floor")

    problems = edit(path, change)
    assert {problem.partition(":")[0] for problem in problems} >= {
        "/World/env_0/box_2",
        "/World/env_0/box_2/hull",
        "/World/env_0/ball_1/floor",
    }


def test_surface_made_a_body_and_added_joint_are_reported(path):
    def change(opened):
        UsdPhysics.RigidBodyAPI.Apply(opened.GetPrimAtPath("/World/Surfaces/floor"))
        UsdPhysics.FixedJoint.Define(opened, "/World/env_0/joints/weld")

    problems = edit(path, change)
    assert [problem.partition(",")[0] for problem in sorted(problems)] == [
        "/World/Surfaces/floor: a rigid body",
        "/World/env_0/joints/weld: a joint",
    ]


@pytest.mark.parametrize("value", [9.81, 0.0, -1.0, float("nan")])
def test_changed_gravity_is_reported(path, value):
    def change(opened):
        UsdPhysics.Scene(opened.GetPrimAtPath("/World/PhysicsScene")).GetGravityMagnitudeAttr().Set(value)

    (problem,) = edit(path, change)
    assert problem.startswith("/World/PhysicsScene: a gravity of [")


def test_changed_gravity_direction_is_reported(path):
    def change(opened):
        scene = UsdPhysics.Scene(opened.GetPrimAtPath("/World/PhysicsScene"))
        scene.GetGravityDirectionAttr().Set(Gf.Vec3f(1, 0, 0))

    (problem,) = edit(path, change)
    assert "a gravity of [3.7, 0.0, 0.0] m/s²" in problem


def test_referenced_export_with_other_bodies_reports_them(path, tmp_path):
    ball = prim("Sphere", "other", BODY.replace("PhysicsMassAPI", "PhysicsCollisionAPI"), "double radius = 1")
    outer = stage(tmp_path, prim("Xform", "run", "prepend references = @ours.usda@") + ball + body("third"))
    with pytest.raises(wc.UsdError) as raised:
        wc.Scene.from_usd(outer)
    assert {problem.partition(",")[0] for problem in raised.value.problems} == {
        "/other: a rigid body",
        "/other: a collider",
        "/third: a rigid body",
    }
    assert len(wc.Scene.from_usd(outer, skip_unsupported=True).import_warnings) == 3


def test_added_non_physics_prims_are_allowed(path):
    opened = Usd.Stage.Open(str(path))
    UsdGeom.Sphere.Define(opened, "/World/env_0/ball_1/look")
    opened.GetRootLayer().Save()
    assert wc.Scene.from_usd(path).import_warnings == ()
