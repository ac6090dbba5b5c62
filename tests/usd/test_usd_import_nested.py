"""Rigid bodies below rigid bodies: each has separate pose, mass and colliders."""

import numpy as np
import pytest
from physics_stages import BODY, COLLIDER, body, contact_pairs, moved, prim, stage
from pxr import Usd, UsdGeom, UsdPhysics
from scipy.spatial.transform import Rotation

import warpcontact as wc

pytestmark = pytest.mark.installed

RESET = '"!resetXformStack!", "xformOp:translate"'
NESTED = "is nested in the rigid body /outer without !resetXformStack!"


def cube(name, content=""):
    return prim("Cube", name, COLLIDER, f"double size = 1\n{content}")


def read(tmp_path, content, **options):
    # Trusted: avoids the start of a process, which takes a second.
    return wc.Scene.from_usd(stage(tmp_path, content), trusted=True, **options)


def nested(tmp_path, *, reset, more="", inner=""):
    """A body of 1 kg rotated by 90° about y, and one of 2 kg below its prim."""
    pose = moved(2, 0, 0)
    pose = pose.replace('"xformOp:translate"', RESET) if reset else pose
    own = body("inner", f"float physics:mass = 2\n{inner}{cube('inner_box')}", pose)
    outer = body("outer", f"float physics:mass = 1\n{cube('outer_box')}{own}", moved(0, 0, 1, turn=(0, 90, 0)))
    return read(tmp_path, outer + more)


@pytest.mark.parametrize("reset", [True, False])
def test_nested_body_has_its_own_pose_mass_and_colliders(tmp_path, reset):
    scene = nested(tmp_path, reset=reset)
    outer, inner = scene.bodies
    assert (outer.name, inner.name) == ("outer", "inner")
    assert [float(one.mass) for one in (outer, inner)] == [1.0, 2.0]
    # For cubes of 1 m about their centers: no body has the collider of the other.
    for one in (outer, inner):
        np.testing.assert_allclose(one.inertia, one.mass / 6.0 * np.eye(3), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(outer.position, (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(inner.position, (2, 0, 0) if reset else (0, 0, -1), atol=1e-12)
    turn = np.zeros(3) if reset else (0, np.pi / 2, 0)
    np.testing.assert_allclose(Rotation.from_quat(inner.orientation).as_rotvec(), turn, atol=1e-12)
    assert [(one.name, one.body) for one in scene.shapes] == [("outer_box", outer), ("inner_box", inner)]
    # They are not fixed to each other, so they can be in contact.
    assert contact_pairs(scene) == [("outer_box", "inner_box")]
    assert sum(NESTED in remark for remark in scene.import_warnings) == (not reset)


def test_one_warning_counts_all_nested_bodies(tmp_path):
    content = cube("box_4")
    for i in (3, 2, 1):
        content = cube(f"box_{i}") + body(f"link_{i}", content, moved(2, 0, 0))
    scene = read(tmp_path, body("outer", content))
    assert len(scene.bodies) == 4
    (remark,) = [one for one in scene.import_warnings if "nested" in one]
    assert remark.startswith(f"/outer/link_1: the rigid body {NESTED} and 2 more: ")


def test_velocity_of_nested_body_is_in_the_frame_of_the_outer_prim(tmp_path):
    velocity = "vector3f physics:velocity = (1, 0, 0)\n"
    for reset, expected in ((False, (0, 0, -1)), (True, (1, 0, 0))):
        (tmp_path / str(reset)).mkdir()
        _, inner = nested(tmp_path / str(reset), reset=reset, inner=velocity).bodies
        np.testing.assert_allclose(inner.linear_velocity, expected, atol=1e-12)


def test_filtered_pair_of_outer_body_does_not_filter_nested_body(tmp_path):
    floor = prim("Plane", "floor", COLLIDER, 'uniform token axis = "Z"\nrel physics:filteredPairs = </outer>\n')
    scene = nested(tmp_path, reset=False, more=floor)
    assert contact_pairs(scene) == [("outer_box", "inner_box"), ("inner_box", "floor")]


def test_colliders_of_a_skipped_body_are_skipped(tmp_path):
    led = body(
        "led",
        "bool physics:kinematicEnabled = 1\n" + cube("led_box") + body("inner", cube("inner_box")),
        "double3 xformOp:translate.timeSamples = {0: (0,0,0), 1: (1,0,0)}\n"
        'uniform token[] xformOpOrder = ["xformOp:translate"]',
    )
    with pytest.raises(wc.UsdError, match="/led/led_box: part of the rigid body /led, which is omitted"):
        read(tmp_path, led)
    scene = read(tmp_path, led, skip_unsupported=True)
    assert [(one.name, one.body.name) for one in scene.shapes] == [("inner_box", "inner")]


def test_disabled_body_is_part_of_the_outer_body(tmp_path):
    inner = body("inner", "bool physics:rigidBodyEnabled = 0\n" + cube("inner_box"), moved(2, 0, 0))
    scene = read(tmp_path, body("outer", cube("outer_box") + inner))
    assert [one.name for one in scene.bodies] == ["outer"]
    assert float(scene.bodies[0].mass) == pytest.approx(2000.0)


def test_check_accepts_nested_bodies_that_reset_their_transform(tmp_path):
    path = tmp_path / "nested.usda"
    usd = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(usd, "Z")
    UsdGeom.SetStageMetersPerUnit(usd, 1.0)
    prims = [UsdGeom.Xform.Define(usd, where) for where in ("/outer", "/outer/inner")]
    usd.SetDefaultPrim(prims[0].GetPrim())
    for one in prims:
        UsdPhysics.RigidBodyAPI.Apply(one.GetPrim())
    usd.Save()
    assert any("must not be a rigid body in the rigid body /outer" in found for found in wc.check_usd(path))
    prims[1].SetResetXformStack(True)
    usd.Save()
    assert wc.check_usd(path) == []


@pytest.mark.parametrize("name", ["kinematicEnabled", "rigidBodyEnabled", "mass", "centerOfMass", "principalAxes"])
def test_blocked_attribute_counts_as_not_given(tmp_path, name):
    kinds = {"mass": "float", "centerOfMass": "point3f", "principalAxes": "quatf"}
    content = f"{kinds.get(name, 'bool')} physics:{name} = None\n{cube('box')}"
    (one,) = read(tmp_path, body("outer", content, apis=BODY)).bodies
    assert float(one.mass) == pytest.approx(1000.0)
