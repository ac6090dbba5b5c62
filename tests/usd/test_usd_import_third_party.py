"""Scenes of third parties that come with Newton: each runs or is rejected with a list."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import warpcontact as wc

SPEC = importlib.util.find_spec("newton")
ROOT = Path(SPEC.origin).parent if SPEC and SPEC.origin else None
# Content without a counterpart in a scene, or None if the scene runs. Scenes without UsdPhysics are excluded.
SCENES = {
    "examples/assets/axis_cube.usda": None,
    "examples/assets/palletizer_scene.usda": None,
    "tests/assets/cube_cylinder.usda": None,
    "tests/assets/negative_scale_cube.usda": None,
    "tests/assets/negative_scale_mesh_pair.usda": None,
    "tests/assets/negative_scale_sphere.usda": None,
    "tests/assets/kamino/basics/box_on_plane.usda": None,
    "tests/assets/kamino/testing/geoms/test_geom_box.usda": None,
    "tests/assets/kamino/testing/geoms/test_geom_capsule.usda": None,
    "tests/assets/kamino/testing/geoms/test_geom_cone.usda": None,
    "tests/assets/kamino/testing/geoms/test_geom_cylinder.usda": None,
    "tests/assets/kamino/testing/geoms/test_geom_ellipsoid.usda": None,
    "tests/assets/kamino/testing/geoms/test_geom_sphere.usda": None,
    "examples/assets/ant.usda": "/ant/joints/front_left_leg: a joint, PhysicsRevoluteJoint",
    "examples/assets/boxes_fourbar.usda": "/boxes_fourbar/Joints/joint_1: a joint, PhysicsRevoluteJoint",
    "examples/assets/cartpole.usda": "/cartPole: an articulation",
    "examples/assets/humanoid.usda": "/nv_humanoid/torso: an articulation",
    "examples/assets/mpm_sand.usda": "/World/Sand: a deformable body",
    "examples/assets/sensor_contact_scene.usda": "/env/Hinge: a joint, PhysicsRevoluteJoint",
    "tests/assets/actuator_test.usda": "/World/Robot/Joint1Actuator: NewtonActuator, a type of another program",
    "tests/assets/deformables_mixed.usda": "/World/CableA: PhysicsDeformableBodyAPI",
    "tests/assets/kamino/basics/box_pendulum.usda": "/box_pendulum/Joints/grounding: a joint",
    "tests/assets/kamino/testing/joints/test_joint_fixed.usda": "a joint, PhysicsFixedJoint",
}

pytestmark = [
    pytest.mark.skipif(ROOT is None, reason="the scenes come with newton, which is not installed"),
    pytest.mark.slow,
]


def scene_file(name):
    path = ROOT / name
    if not path.is_file():
        pytest.skip(f"this version of newton has no {name}")
    return path


@pytest.mark.parametrize("name", [name for name, reason in SCENES.items() if reason is None])
def test_third_party_usd_scene_runs(name, device):
    scene = wc.Scene.from_usd(scene_file(name))
    model = scene.build(device=device)
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(100)
    assert np.isfinite(sim.state.body_position.numpy()).all()
    assert not len(model.health().frozen)


@pytest.mark.parametrize("name", [name for name, reason in SCENES.items() if reason is not None])
def test_unsupported_third_party_usd_scene_is_refused_with_a_list(name):
    with pytest.raises(wc.UsdError) as raised:
        wc.Scene.from_usd(scene_file(name))
    assert any(SCENES[name] in problem for problem in raised.value.problems), raised.value


def test_third_party_box_comes_to_rest_on_its_plate(device):
    scene = wc.Scene.from_usd(scene_file("tests/assets/kamino/basics/box_on_plane.usda"))
    model = scene.build(device=device, precision="float64")
    sim = wc.Simulation(model, dt=2e-4)
    sim.step(5000)
    # The penetration is at most g (T/π)² for a contact time T of 0.01 s.
    assert sim.state.body_position.numpy()[0, 0, 2] == pytest.approx(0.1, abs=1.1e-4)
    assert scene.body_contacts[0].material.friction.mu_static == pytest.approx(0.5 * (0.78 + 0.5))
