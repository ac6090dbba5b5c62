"""Joints against closed forms: pendulum, cone, rotor, slope, collision; and absence of drift."""

import numpy as np
import pytest
from scenes import square
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

import warpcontact as wc

G = 9.81
MASS, LENGTH, INERTIA = 2.0, 0.5, 0.04  # pendulum: kg, m from the axis, kg·m² about its center of mass
ABOUT_AXIS = INERTIA + MASS * LENGTH**2
ANCHOR = np.array([0.3, -0.2, 1.0])


def pendulum(angle=0.0, rate=0.0, anchor=ANCHOR, **options):
    """A pendulum on a revolute joint along y, at ``angle`` from hanging down."""
    scene = wc.Scene(gravity=(0, 0, -G))
    scene.add_body(
        MASS,
        (0.03, INERTIA, 0.02),
        position=anchor + LENGTH * np.array([-np.sin(angle), 0, -np.cos(angle)]),
        angular_velocity=(0, rate, 0),
        motion=wc.motions.Hinge(axis=(0, 3, 0), anchor=tuple(anchor)),
        name="arm",
    )
    return scene.build(**{"precision": "float64", **options})


def energy(recording, name="arm"):
    return (recording[f"{name}.kinetic_energy"] + recording[f"{name}.potential_energy"]).values[:, 0]


def test_pendulum_keeps_period_and_energy_over_a_thousand_periods(device):
    start = 2.0  # rad
    period = 4.0 * np.sqrt(ABOUT_AXIS / (MASS * G * LENGTH)) * ellipk(np.sin(start / 2.0) ** 2)
    model = pendulum(start, device=device)
    ahead, swing = [], []
    for steps in (200, 400):
        model.reset()
        sim = wc.Simulation(model, dt=period / steps)
        names = ["arm.kinetic_energy", "arm.potential_energy"]
        first = energy(sim.run(2 * period, names))
        sim.step(998 * steps - steps // 4)
        # A quarter of a period earlier the pendulum hangs straight down: the angle from there gives the phase.
        hanging = np.remainder(model.sensor("arm.angle")[0] + start + np.pi, 2 * np.pi) - np.pi
        # After a start from rest, the scheme is half a step ahead.
        ahead.append((hanging / model.sensor("arm.angle_rate")[0] - 0.5 * sim.dt) / (1000 * period))
        last = energy(sim.run(2 * period, names))
        np.testing.assert_allclose([last.min(), last.max()], [first.min(), first.max()], atol=2e-3 * np.ptp(first))
        swing.append(np.ptp(first))
    # The scheme is conjugate to a second-order one. The period is off by dt²: 0.04 of a period after a thousand
    # periods of 200 steps. The energy oscillates by dt.
    assert abs(ahead[0]) < 1e-4
    np.testing.assert_allclose(ahead[0] / ahead[1], 4.0, rtol=0.05)
    np.testing.assert_allclose(swing[0] / swing[1], 2.0, rtol=0.05)


def test_revolute_joint_reaction_matches_closed_form(device):
    """Along the arm m g cos φ + m l ω², across it m g sin φ (1 − m l²/I)."""
    angle, rate = 0.7, 3.0
    model = pendulum(angle, rate, device=device)
    force = model.sensor("arm.reaction_force")[0]
    inwards, across = np.array([np.sin(angle), 0, np.cos(angle)]), np.array([np.cos(angle), 0, -np.sin(angle)])
    np.testing.assert_allclose(force @ inwards, MASS * (G * np.cos(angle) + LENGTH * rate**2), rtol=1e-13)
    share = 1.0 - MASS * LENGTH**2 / ABOUT_AXIS
    np.testing.assert_allclose(force @ across, -MASS * G * np.sin(angle) * share, rtol=1e-12)
    np.testing.assert_allclose(model.sensor("arm.reaction_torque")[0], 0.0, atol=1e-13)


def test_unbalanced_rotor_reaction_matches_closed_form(device):
    """A product of inertia I_xz needs the moment I_xz ω² across the axis, which rotates with the rotor."""
    scene = wc.Scene(gravity=(0, 0, 0))
    tensor = [[0.3, 0, 0.05], [0, 0.3, 0], [0.05, 0, 0.4]]
    hinge = wc.motions.Hinge(axis=(0, 0, 1), anchor=(0, 0, 0))
    scene.add_body(1.0, tensor, angular_velocity=(0, 0, 4.0), motion=hinge, name="rotor")
    model = scene.build(device=device, precision="float64")
    np.testing.assert_allclose(model.sensor("rotor.reaction_torque")[0], (0, 0.05 * 16, 0), atol=1e-14)
    dt = 1e-3
    wc.Simulation(model, dt).step(1000)
    turned = Rotation.from_rotvec((0, 0, 4.0)).apply((0, 0.05 * 16, 0))
    np.testing.assert_allclose(model.sensor("rotor.reaction_torque")[0], turned, atol=1e-12)
    # There is no torque about the axis, so the rate is bitwise constant.
    assert model.sensor("rotor.angle_rate")[0] == 4.0
    np.testing.assert_allclose(model.sensor("rotor.angle"), 4.0 - 2 * np.pi, rtol=1e-12)


def cone(device):
    """A symmetric body on a spherical joint in steady precession: Ω² = m g l/((A − C) cos θ)."""
    tilt = 0.6
    across, along = 0.03, 0.01
    speed = np.sqrt(MASS * G * LENGTH / ((across + MASS * LENGTH**2 - along) * np.cos(tilt)))
    scene = wc.Scene(gravity=(0, 0, -G))
    scene.add_body(
        MASS,
        (across, across, along),
        position=ANCHOR + LENGTH * np.array([np.sin(tilt), 0, -np.cos(tilt)]),
        orientation=Rotation.from_rotvec((0, -tilt, 0)).as_quat(),
        angular_velocity=(0, 0, speed),
        motion=wc.motions.Ball(anchor=tuple(ANCHOR)),
        name="bob",
    )
    return scene.build(device=device, precision="float64"), tilt, speed


@pytest.mark.slow
def test_conical_pendulum_matches_closed_form(device):
    model, tilt, speed = cone(device)
    force = model.sensor("bob.reaction_force")[0]
    np.testing.assert_allclose(
        force, (-MASS * speed**2 * LENGTH * np.sin(tilt), 0, MASS * G), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(model.sensor("bob.reaction_torque")[0], 0.0, atol=1e-13)
    off = []
    for steps in (1000, 2000):
        model.reset()
        wc.Simulation(model, dt=2 * np.pi / speed / steps).step(3 * steps)
        displacement = model.sensor("bob.position")[0] - ANCHOR
        np.testing.assert_allclose(np.linalg.norm(displacement), LENGTH, rtol=1e-14)
        # Steady precession amplifies the error of the first half step: first order in dt.
        off.append(np.linalg.norm(displacement - LENGTH * np.array([np.sin(tilt), 0, -np.cos(tilt)])))
    assert off[0] < 0.01 * LENGTH
    np.testing.assert_allclose(off[0] / off[1], 2.0, rtol=0.2)


def test_prismatic_planar_and_cartesian_joints_match_closed_form(device):
    slope, dt = 0.5, 1e-3
    down = np.array([np.cos(slope), 0, -np.sin(slope)])
    scene = wc.Scene(gravity=(0, 0, -G))
    bodies = {
        "cart": (wc.motions.Slider(axis=tuple(2 * down)), 0.5 * down, (0, 0, 0)),
        "disc": (wc.motions.Planar(normal=(0, 5, 0)), (1, 0, 2), (0, 3, 0)),
        "stone": (wc.motions.Translation(), (1, 2, 0), (0, 0, 0)),
        "post": (wc.motions.Fixed(), (0, 0, 0), (0, 0, 0)),
    }
    for name, (motion, linear, angular) in bodies.items():
        scene.add_body(
            MASS, (0.1, 0.2, 0.15), linear_velocity=linear, angular_velocity=angular, motion=motion, name=name
        )
    model = scene.build(device=device, precision="float64")
    np.testing.assert_allclose(
        model.sensor("cart.reaction_force")[0],
        MASS * G * np.cos(slope) * np.array([np.sin(slope), 0, np.cos(slope)]),
    )
    wc.Simulation(model, dt).step(1000)
    # Semi-implicit Euler falls by ½ a t² (1 + dt/t).
    fallen = 0.5 * G * (1.0 + dt)
    np.testing.assert_allclose(model.sensor("cart.displacement"), 0.5 + fallen * np.sin(slope), rtol=1e-12)
    np.testing.assert_allclose(model.sensor("cart.displacement_rate"), 0.5 + G * np.sin(slope), rtol=1e-12)
    np.testing.assert_allclose(model.sensor("disc.position")[0], (1, 0, 2 - fallen), rtol=1e-12)
    np.testing.assert_allclose(model.sensor("disc.angle"), 3.0, rtol=1e-12)
    np.testing.assert_allclose(model.sensor("stone.position")[0], (1, 2, -fallen), rtol=1e-12)
    np.testing.assert_array_equal(model.sensor("post.position")[0], (0, 0, 0))
    np.testing.assert_allclose(model.sensor("post.reaction_force")[0], (0, 0, MASS * G), rtol=1e-13)


def test_joints_do_not_drift_in_100000_steps_of_float32(device):
    """Joint constraints hold to one rounding; components along world axes are bitwise exact."""
    scene = wc.Scene(gravity=(1.0, 2.0, -G))
    tilted = Rotation.from_rotvec((0.4, -0.3, 0.8))
    place = (0.7, 0.1, 0.4)
    axis = tilted.apply((0, 0, 1))
    anchor = (0.31, -0.17, 0.93)
    motions = {
        "hinge": wc.motions.Hinge(axis=tuple(axis), anchor=anchor),
        "ball": wc.motions.Ball(anchor=anchor),
        "slider": wc.motions.Slider(axis=(0, 0, 1)),
        "plane": wc.motions.Planar(normal=(0, 1, 0)),
        "rail": wc.motions.Slider(axis=tuple(axis)),
    }
    for name, motion in motions.items():
        scene.add_body(
            1.0, (0.1, 0.12, 0.09), position=place, orientation=tilted.as_quat(), motion=motion, name=name
        )
    model = scene.build(device=device)
    model["hinge.angular_velocity"] = 7.0 * axis
    start = model.sensor("slider.orientation")[0], model.sensor("rail.orientation")[0]
    wc.Simulation(model, dt=1e-4).step(100_000)
    lengths = {name: np.linalg.norm(model.sensor(f"{name}.position")[0] - anchor) for name in ("hinge", "ball")}
    expected = np.linalg.norm(np.subtract(place, anchor))
    for name, length in lengths.items():
        # A position has a remainder, so the error is below one rounding of float32.
        np.testing.assert_allclose(length, expected, rtol=1e-12, err_msg=name)
    # The fixed point of the body as used by contacts, from its orientation in float32.
    for name in ("hinge", "ball"):
        turn = Rotation.from_quat(model.sensor(f"{name}.orientation")[0].astype(np.float64))
        pinned = model.sensor(f"{name}.position")[0] + turn.apply(tilted.inv().apply(np.subtract(anchor, place)))
        np.testing.assert_allclose(pinned, anchor, atol=2e-7)
    along = model.sensor("hinge.position")[0] @ axis
    np.testing.assert_allclose(along, np.dot(place, axis), rtol=1e-12)
    assert model.sensor("slider.position")[0, 2] < -400.0
    first = scene.build(device=device)
    for name in ("slider", "plane"):
        held = [0, 1] if name == "slider" else [1]
        now, then = model.sensor(f"{name}.position")[0, held], first.sensor(f"{name}.position")[0, held]
        np.testing.assert_array_equal(now, then, err_msg=name)
    np.testing.assert_array_equal(model.sensor("slider.orientation")[0], start[0])
    np.testing.assert_array_equal(model.sensor("rail.orientation")[0], start[1])
    displacement = model.sensor("rail.position")[0] - place
    across = displacement - (displacement @ axis) * axis
    # Displacement of 490 m in float64; the remainder is accurate to this bound.
    assert np.linalg.norm(across) < 1e-11 * np.linalg.norm(displacement)


def struck_door(law, device, precision="float64"):
    """A ball hits a door on a revolute joint along z, 0.8 m from the axis."""
    scene = wc.Scene(gravity=(0, 0, 0))
    hinge = wc.motions.Hinge(axis=(0, 0, 1), anchor=(0, 0, 0))
    door = scene.add_body(3.0, (0.5, 0.3, 0.4), position=(0.5, 0, 0), motion=hinge, name="door")
    face = scene.add_surface(
        square(0.5), door, orientation=Rotation.from_rotvec((np.pi / 2, 0, 0)).as_quat(), name="face"
    )
    ball = scene.add_body(0.7, (1e-3,) * 3, position=(0.8, -0.11, 0), linear_velocity=(0, 2.0, 0), name="ball")
    scene.add_contact(
        scene.add_point(ball, (0, 0, 0)), face, wc.ContactMaterial(law=law), radius=0.1, name="touch"
    )
    return scene.build(device=device, precision=precision)


@pytest.mark.parametrize("restitution", [1.0, 0.5])
def test_ball_bounces_off_a_door_with_its_effective_mass(restitution, device):
    """m* = I/d² of the door. Angular momentum about the axis is conserved, and with a spring also the energy."""
    law = (
        wc.laws.Hooke(stiffness=1e6)
        if restitution == 1.0
        else wc.laws.KelvinVoigt(stiffness=1e6, restitution=restitution)
    )
    model = struck_door(law, device)
    wc.Simulation(model, dt=1e-6).step(15_000)
    assert model.sensor("touch.gap")[0] > 0.0
    inertia, arm = 0.4 + 3.0 * 0.5**2, 0.8
    mass = 1.0 / (1.0 / 0.7 + arm**2 / inertia)
    impulse = (1.0 + restitution) * mass * 2.0
    # About 1500 steps of contact, first-order error. The door rotates by 0.001 rad meanwhile.
    np.testing.assert_allclose(model.sensor("ball.linear_velocity")[0, 1], 2.0 - impulse / 0.7, atol=4e-3)
    np.testing.assert_allclose(model.sensor("door.angle_rate"), arm * impulse / inertia, rtol=4e-3)
    if restitution == 1.0:
        np.testing.assert_allclose(model.sensor("scene.kinetic_energy"), 0.5 * 0.7 * 4.0, rtol=1e-4)


def test_revolute_joint_far_from_the_origin_moves_as_at_the_origin(device):
    """At 1 km in float32, because positions are stored as differences."""
    trajectories = []
    for far in (0.0, 1000.0):
        anchor = np.array([far, -far, far])
        model = pendulum(1.0, anchor=anchor, precision="float32", device=device)
        wc.Simulation(model, dt=1e-3).step(2000)
        trajectories.append(model.sensor("arm.position")[0] - anchor)
    # The orientation determines the error, which is 6e-8 per step in both.
    np.testing.assert_allclose(trajectories[0], trajectories[1], atol=1e-6)
    exact = pendulum(1.0)
    wc.Simulation(exact, dt=1e-3).step(2000)
    # 2000 roundings of an angle, 3e-8 each, with mixed signs.
    np.testing.assert_allclose(trajectories[0], exact.sensor("arm.position")[0] - ANCHOR, atol=1e-5)
