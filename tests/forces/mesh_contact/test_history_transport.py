"""History vectors follow the surface normal, and each model of a contact has separate history."""

import custom_law
import numpy as np
import pytest
from scenes import dropped_sphere, square
from scipy.spatial.transform import Rotation

import warpcontact as wc

pytestmark = pytest.mark.usefixtures("write_step_outputs")

F = wc.friction


def history_along(path, device, precision="float64", friction=None):
    """Moves a point along ``path`` (steps, 3) on a randomly rotated box about the origin, with a spring friction.

    Returns force, normal and velocity of every step in the axes of the box.
    """
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    scene = wc.Scene(gravity=(0, 0, 0))
    box = scene.add_surface(wc.meshes.box((1.0, 1.0, 1.0)), orientation=turn.as_quat())
    body = scene.add_body(1e15, (1e15, 1e15, 1e15), name="body")
    friction = friction or F.CundallStrack(mu_static=1e3, mu_dynamic=1e3, stiffness=1e3)
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4), friction=friction)
    scene.add_contact(scene.add_point(body, (0, 0, 0)), box, material, name="touch")
    model = scene.build(device=device, precision=precision)
    sim = wc.Simulation(model, dt=1e-3)
    found = []
    for i in range(len(path)):
        step = (path[i] - path[max(i - 1, 0)]) / 1e-3
        sim.state.body_position.assign(turn.apply(path[i])[None, None].astype(precision))
        sim.state.body_linear_velocity.assign(turn.apply(step)[None, None].astype(precision))
        sim.step()
        c = model.arrays.contacts
        found.append([turn.inv().apply(v.numpy()[0, 0]) for v in (c.friction_force, c.normal)])
    return np.array(found)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_history_vector_turns_with_the_normal_over_an_edge(precision, device):
    """Over an edge of a box, a force towards the edge turns down the side; a force along it is unchanged."""
    top = np.linspace((0.40, 0.0, 0.499), (0.43, 0.02, 0.499), 10)
    side = np.array([[0.499, 0.02, 0.45]])
    found = history_along(np.concatenate([top, side, side]), device, precision)
    before, after = found[9], found[11]
    np.testing.assert_allclose(before[1], (0, 0, 1), atol=1e-6)
    np.testing.assert_allclose(after[1], (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(before[0], (-30, -20, 0), rtol=1e-3, atol=1e-2)
    # The path down the side adds its own slip: the path jumped from z to x, and its slip on the side was −49 mm.
    slip = history_along(np.array([[0.499, 0.02, 0.499], *side]), device, precision)[1][0]
    np.testing.assert_allclose(after[0] - slip, (0, -20, 30), atol=0.5)
    assert abs(after[0][0]) < 1e-4 * np.linalg.norm(after[0])


def test_history_vector_is_cleared_if_the_normal_reverses(device):
    """From the top of a thin plate to its underside the direction is undefined."""
    top = np.linspace((0.0, 0.0, 0.499), (0.03, 0.0, 0.499), 10)
    found = history_along(np.concatenate([top, [[0.03, 0.0, -0.499]] * 2]), device)
    np.testing.assert_allclose(found[9][0], (-30, 0, 0), atol=1e-2)
    np.testing.assert_allclose(found[11][1], (0, 0, -1), atol=1e-9)
    np.testing.assert_allclose(found[11][0], 0.0, atol=1e-6)


def test_history_vector_follows_a_curved_surface(device):
    """Along 60° of a great circle of a fine sphere: the force opposes the path and has constant size."""
    scene = wc.Scene(gravity=(0, 0, 0))
    globe = scene.add_surface(wc.meshes.icosphere(1.0, 5))
    body = scene.add_body(1e15, (1e15, 1e15, 1e15), name="body")
    friction = F.CundallStrack(mu_static=1e3, mu_dynamic=1e3, stiffness=1e3)
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4), friction=friction)
    scene.add_contact(scene.add_point(body, (0, 0, 0)), globe, material, name="touch")
    model = scene.build(device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-3)
    across, start = np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.0, 0.0])
    force = None
    for angle in np.linspace(0, np.pi / 3, 400):
        place = 0.99 * (np.cos(angle) * start + np.sin(angle) * across)
        tangent = -np.sin(angle) * start + np.cos(angle) * across
        # Slip occurs in the first tenth only; the rest of the path has no slip.
        speed = 0.3 if angle < np.pi / 30 else 0.0
        sim.state.body_position.assign(place[None, None])
        sim.state.body_linear_velocity.assign((speed * tangent)[None, None])
        sim.step()
        force = model.arrays.contacts.friction_force.numpy()[0, 0]
        if speed:
            stretched = np.linalg.norm(force)
    assert stretched > 5.0
    np.testing.assert_allclose(np.linalg.norm(force), stretched, rtol=1e-3)
    # Facets of 2° turn the force slightly; smallest rotations preserve its angle to the great circle.
    np.testing.assert_allclose(force / stretched, -tangent, atol=0.03)


# History of all models


def stuck(device, **parts):
    """A ball pressed on a plate with springs in every model, rotated and displaced a little; of large mass."""
    spring = F.CundallStrack(mu_static=5.0, mu_dynamic=5.0, stiffness=1e4)
    scene = wc.Scene(gravity=(0, 0, 0))
    carrier = scene.add_body(1e15, (1e15, 1e15, 1e15), position=(0, 0, -1), name="carrier")
    plate = scene.add_surface(square(), carrier, position=(0, 0, 1), orientation=(0, 0, 0, 1))
    ball = scene.add_body(
        1e15, (1e15, 1e15, 1e15), position=(0, 0, 0.099), linear_velocity=(0.01, 0, 0),
        angular_velocity=(0, 0.2, 0.3), name="ball",
    )  # fmt: skip
    material = wc.ContactMaterial(
        law=custom_law.Clock(stiffness=1e4),
        friction=parts.get("friction", spring),
        rolling=parts.get("rolling", spring),
        torsion=spring,
    )
    scene.add_contact(
        scene.add_point(ball, (0, 0, 0)), plate, material, radius=0.1, torsion_radius=0.05, name="touch"
    )
    model = scene.build(device=device, precision="float64")
    return model, wc.Simulation(model, dt=1e-3)


def test_friction_rolling_and_torsion_have_separate_history(device):
    model, sim = stuck(device)
    sim.step(11)
    # 10 ms (no time has elapsed at the start) of rolling at 0.02 m/s and of spinning at 0.015 m/s.
    np.testing.assert_allclose(model.sensor("touch.rolling.spring")[0], (2.0e-4, 0, 0), atol=1e-9)
    np.testing.assert_allclose(model.sensor("touch.torsion.spring")[0], (0, 0, 1.5e-4), atol=1e-9)
    torque = model.arrays.contacts.torque.numpy()[0, 0]
    np.testing.assert_allclose(torque, (0, -0.2, -0.075), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(model.sensor("touch.law.age")[0], 0.010, rtol=1e-9)
    assert np.linalg.norm(model.sensor("touch.friction.spring")[0]) > 1e-6


def test_history_of_all_parts_is_cleared_at_release(device):
    model, sim = stuck(device)
    sim.step(11)
    held = sim.state.body_position.numpy().copy()
    away = held.copy()
    away[:, 1, 2] += 1.0
    sim.state.body_position.assign(away)
    sim.step(2)
    sim.state.body_position.assign(held)
    sim.state.body_linear_velocity.zero_()
    sim.state.body_angular_velocity.zero_()
    sim.step()
    for name in ("friction.spring", "rolling.spring", "torsion.spring"):
        np.testing.assert_array_equal(model.sensor(f"touch.{name}"), 0.0, err_msg=name)
    # The contact did not begin by penetration, so the time of contact within the step is undefined.
    np.testing.assert_allclose(model.sensor("touch.law.age")[0], 1e-3)


def test_history_of_all_parts_starts_at_the_instant_of_contact(device):
    """If a contact is detected 0.3 steps after it began, the age of all its models is 0.3 steps."""
    model, sim = stuck(device)
    state = sim.state.body_position.numpy().copy()
    state[:, 1, 2] = 0.1 + 0.7e-3
    sim.state.body_position.assign(state)
    speed = np.array([[[0, 0, 0], [0.01, 0, -1.0]]])
    sim.state.body_linear_velocity.assign(speed)
    sim.step(2)
    np.testing.assert_allclose(model.sensor("touch.law.age")[0], 0.3e-3, rtol=1e-6)
    np.testing.assert_allclose(
        model.sensor("touch.rolling.spring")[0], (0.3e-3 * 0.02, 0, 0), rtol=1e-6, atol=1e-12
    )
    np.testing.assert_allclose(model.sensor("touch.torsion.spring")[0][2], 0.3e-3 * 0.015, rtol=1e-6)


def test_torsion_history_rotates_with_the_bodies(device):
    """Twisted, then carried by a plate that rotates about a tilted axis: the torque remains along the normal."""
    model, sim = stuck(device)
    sim.step(11)
    spin = np.array([0.8, -0.5, 0.6])
    centre, place = np.array([0, 0, -1.0]), sim.state.body_position.numpy()[0, 1].copy()
    sim.state.body_angular_velocity.fill_(model.types.vec3(*spin))
    arm = place - centre
    for _ in range(800):
        turned = Rotation.from_quat(model.sensor("carrier.orientation")[0])
        at = centre + turned.apply(arm)
        sim.state.body_position.assign(np.array([[centre, at]]))
        sim.state.body_linear_velocity.assign(np.array([[np.zeros(3), np.cross(spin, at - centre)]]))
        sim.step()
    normal = turned.apply((0, 0, 1))
    spring = turned.inv().apply(model.arrays.contacts.torque.numpy()[0, 0])
    np.testing.assert_allclose(spring, (0, -0.2, -0.075), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(turned.inv().apply(normal), (0, 0, 1), atol=1e-12)


def test_rolling_velocity_is_relative_to_the_plate(device):
    """A ball at rest on a plate that rotates about a tangent axis rolls backwards relative to it."""
    model, sim = stuck(device, rolling=F.Viscous(drag=0.1))
    sim.state.body_angular_velocity.assign(np.array([[[0, 0.2, 0], [0, 0, 0]]], dtype=float))
    sim.state.body_linear_velocity.zero_()
    normal = model.sensor("touch.normal_force")[0]
    # v_r = R (ω₁ − ω₂) × n = −0.02 m/s; M = R n × F, F = −β N v_r.
    np.testing.assert_allclose(
        model.sensor("touch.torque")[0], (0, 0.1 * 0.1 * normal * 0.02, 0), rtol=1e-9, atol=1e-12
    )


def test_anisotropic_friction_can_be_used_for_rolling(device):
    rolling = F.Elliptic(mu_1=0.4, mu_2=0.1, velocity_scale=1e-9)
    model, sim = stuck(device, rolling=rolling)
    sim.state.body_angular_velocity.assign(np.array([[[0, 0, 0], [-1.0, 1.0, 0]]], dtype=float))
    normal = model.sensor("touch.normal_force")[0]
    # Rolling at equal speeds along x and y: F ∝ μ₁², μ₂²; M = R n × F.
    force = -np.array([0.16, 0.01]) / np.hypot(0.4, 0.1) * normal
    np.testing.assert_allclose(
        model.sensor("touch.torque")[0], (-0.1 * force[1], 0.1 * force[0], 0), rtol=1e-6, atol=1e-9
    )


def test_surface_y_axis_is_the_tangent_reference_if_its_x_axis_is_normal(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    wall = scene.add_surface(wc.meshes.box((2.0, 2.0, 2.0)))
    body = scene.add_body(1.0, (1, 1, 1), position=(0.999, 0, 0), linear_velocity=(0, 1.0, 1.0), name="body")
    friction = F.Elliptic(mu_1=0.4, mu_2=0.1, velocity_scale=1e-9)
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4), friction=friction)
    scene.add_contact(scene.add_point(body, (0, 0, 0)), wall, material, name="touch")
    model = scene.build(device=device, precision="float64")
    expected = -10.0 * np.array([0.0, 0.16, 0.01]) / np.hypot(0.4, 0.1)
    np.testing.assert_allclose(model.sensor("touch.friction_force")[0], expected, rtol=1e-9)


def test_law_with_initial_jump_gets_its_missed_impulse(device):
    """A dashpot that weakens with age: contacts that begin late or early in a step lose the same energy."""
    phases = np.linspace(0.02, 0.98, 25)
    model = dropped_sphere(
        custom_law.Tiring(damping=200.0, time=2e-3), velocity=(0, 0, -1), envs=25, device=device, precision="float64",
    )  # fmt: skip
    position = np.zeros((25, 3))
    position[:, 2] = 0.1 + 1e-4 * phases
    model["ball.position"] = position
    wc.Simulation(model, dt=1e-4).step(300)
    speed = -model.sensor("ball.linear_velocity")[:, 2]
    # Without the missed impulse, the spread is that of one step, c dt/m = 2 % of 0.67 m/s.
    assert np.ptp(speed) < 0.001


# Declarations
