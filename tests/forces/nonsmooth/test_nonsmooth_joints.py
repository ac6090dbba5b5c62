"""Nonsmooth contact of bodies with joints: joint constraints hold exactly, and joints share each impact."""

import numpy as np
import pytest
from nonsmooth_scenes import HARD, G, rigid
from scenes import square

import warpcontact as wc

WALL = {"orientation": (0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4))}  # outer side along +x


def test_nonsmooth_pendulum_bounces_off_a_wall(device):
    """A compound pendulum whose end hits the wall when it hangs straight down: ω⁺ = −e ω⁻ at every impact."""
    mass, inertia, length, reach, e = 2.0, 0.05, 0.5, 0.8, 0.6
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    wall = scene.add_surface(square(2.0), name="wall", **WALL)
    angle = 0.3
    arm = scene.add_body(
        mass,
        (0.03, inertia, 0.02),
        position=length * np.array([np.sin(angle), 0.0, -np.cos(angle)]),
        orientation=(0.0, -np.sin(angle / 2), 0.0, np.cos(angle / 2)),
        motion=wc.motions.Hinge(axis=(0.0, 1.0, 0.0), anchor=(0.0, 0.0, 0.0)),
        name="arm",
    )
    end = scene.add_point(arm, (0.0, 0.0, length - reach))
    scene.add_contact(end, wall, rigid(e), name="touch")
    model = scene.build(device=device, precision="float64")
    dt = 1e-4
    data = wc.Simulation(model, dt, HARD).run(2.0, ["arm.angular_velocity", "touch.impulse", "arm.position"])
    rate = data["arm.angular_velocity"].values[:, 0, 1]
    impulse = data["touch.impulse"].values[:, 0, 0]
    hits = np.flatnonzero(impulse)
    about = inertia + mass * length**2
    falls = np.sqrt(2.0 * mass * G * length * (1.0 - np.cos(angle)) / about)
    assert np.abs(rate[hits[0] - 1]) == pytest.approx(falls, rel=1e-3)
    for hit in hits[:3]:
        assert rate[hit] == pytest.approx(-e * rate[hit - 1], rel=1e-3)
        # The angular impulse of the wall about the axis equals the change of angular momentum.
        assert impulse[hit] * reach == pytest.approx(about * abs(rate[hit] - rate[hit - 1]), rel=1e-3)
    place = data["arm.position"].values[:, 0]
    assert np.linalg.norm(place, axis=1) == pytest.approx(length, rel=1e-14)


def test_nonsmooth_prismatic_and_planar_joints_hold_their_constraints(device):
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(10.0), name="ground")
    motions = {
        "slider": wc.motions.Slider(axis=(1.0, 0.0, -1.0)),
        "planar": wc.motions.Planar(normal=(0.0, 1.0, 0.0)),
        "translation": wc.motions.Translation(),
    }
    for number, (name, motion) in enumerate(motions.items()):
        spin = (0.0, float(name == "planar"), 0.0)
        place = (0.0, 2.0 * number, 1.0)
        body = scene.add_body(
            1.0, (0.1, 0.2, 0.3), position=place, angular_velocity=spin, motion=motion, name=name
        )
        point = scene.add_point(body, (0.1, 0.3, -0.5))
        scene.add_contact(point, ground, rigid(0.5, 0.2), name=f"{name}_touch")
    model = scene.build(device=device, precision="float64")
    names = [f"{name}.{key}" for name in motions for key in ("position", "linear_velocity", "angular_velocity")]
    touches = [f"{name}_touch.impulse" for name in motions]
    data = wc.Simulation(model, 1e-3, HARD).run(2.0, [*names, *touches])
    away = data["slider.position"].values[:, 0] - [0.0, 0.0, 1.0]
    assert np.abs(np.cross(away, [1.0, 0.0, -1.0])).max() < 1e-15
    assert np.ptp(data["planar.position"].values[:, 0, 1]) == 0.0
    assert np.abs(data["planar.angular_velocity"].values[:, 0, [0, 2]]).max() == 0.0
    assert np.abs(data["translation.angular_velocity"].values[:, 0]).max() == 0.0
    # Along the normal, the slider separates with the speed of Newton's law.
    hit = np.flatnonzero(data["slider_touch.impulse"].values[:, 0, 2])[0]
    v = data["slider.linear_velocity"].values[:, 0]
    assert v[hit, 2] == pytest.approx(-0.5 * v[hit - 1, 2], rel=1e-8)  # tolerance of the solver
    # Without rotation, the contact impulse and gravity are the only changes of momentum.
    hit = np.flatnonzero(data["translation_touch.impulse"].values[:, 0, 2])[0]
    v, p = data["translation.linear_velocity"].values[:, 0], data["translation_touch.impulse"].values[:, 0]
    assert v[hit] - v[hit - 1] + [0.0, 0.0, G * 1e-3] == pytest.approx(p[hit], abs=1e-14)


def test_nonsmooth_spherical_joint_hits_floor_and_keeps_its_length(device):
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    floor = scene.add_surface(square(10.0, -0.45), name="floor")
    body = scene.add_body(
        1.0,
        (0.02, 0.03, 0.04),
        position=(0.6, 0.0, 0.0),
        angular_velocity=(1.0, 0.0, 2.0),
        motion=wc.motions.Ball(anchor=(0.0, 0.0, 0.0)),
        name="bob",
    )
    scene.add_contact(scene.add_point(body, (0.0, 0.0, 0.0)), floor, rigid(0.8, 0.1), radius=0.05, name="touch")
    model = scene.build(device=device, precision="float64")
    names = [
        "bob.position",
        "bob.linear_velocity",
        "touch.impulse",
        "scene.kinetic_energy",
        "scene.potential_energy",
    ]
    data = wc.Simulation(model, 5e-4, HARD).run(3.0, names)
    place, v = data["bob.position"].values[:, 0], data["bob.linear_velocity"].values[:, 0]
    assert np.linalg.norm(place, axis=1) == pytest.approx(0.6, rel=1e-14)
    hit = np.flatnonzero(data["touch.impulse"].values[:, 0, 2])[0]
    assert v[hit, 2] == pytest.approx(-0.8 * v[hit - 1, 2], rel=1e-2)
    total = data["scene.kinetic_energy"].values[:, 0] + data["scene.potential_energy"].values[:, 0]
    assert np.diff(total).max() < 1e-4 * np.ptp(total)


def test_nonsmooth_block_on_shaken_plate_sticks_or_slips(device):
    """A plate oscillates along x: the block sticks to it below μ g, and slips above."""
    rate = 10.0
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    shaking = wc.motions.Harmonic(direction=(1.0, 0.0, 0.0), amplitude=0.02, frequency=rate / (2.0 * np.pi))
    plate = scene.add_body(1.0, (1.0, 1.0, 1.0), motion=shaking, name="plate")
    top = scene.add_surface(square(5.0), plate, name="top")
    block = scene.add_body(1.0, (1.0, 1.0, 1.0), position=(0.0, 0.0, 0.1), name="block")
    feet = scene.add_points(block, [(x, y, -0.1) for x in (-0.2, 0.2) for y in (-0.2, 0.2)], name="feet")
    scene.add_contact(feet, top, rigid(mu=0.4), name="touch")
    model = scene.build(envs=2, device=device, precision="float64")
    model["touch.friction.mu"] = [[0.4], [0.1]]
    data = wc.Simulation(model, 1e-3, HARD).run(
        2.0, ["block.linear_velocity", "plate.linear_velocity", "block.force"]
    )
    slip = (data["block.linear_velocity"] - data["plate.linear_velocity"]).values[200:, :, 0]
    assert 0.02 * rate**2 < 0.4 * G
    assert np.abs(slip[:, 0]).max() < 1e-9
    assert np.abs(slip[:, 1]).max() > 0.05
    assert np.abs(data["block.force"].values[200:, 1, 0]).max() == pytest.approx(0.1 * G, rel=1e-6)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_nonsmooth_force_on_vertically_shaken_plate_matches_its_acceleration(device, restitution):
    rate, amplitude = 25.0, 0.01
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    shaking = wc.motions.Harmonic(
        direction=(0.0, 0.0, 1.0), amplitude=amplitude, frequency=rate / (2.0 * np.pi), phase=0.0
    )
    plate = scene.add_body(1.0, (1.0, 1.0, 1.0), motion=shaking, name="plate")
    top = scene.add_surface(square(5.0), plate, name="top")
    speed = amplitude * rate
    place, velocity = (0, 0, 0.1 - 1e-6), (0, 0, speed)
    rider = scene.add_body(1.0, (0.1,) * 3, position=place, linear_velocity=velocity, name="rider")
    scene.add_contact(scene.add_point(rider, (0, 0, 0)), top, rigid(restitution), radius=0.1, name="touch")
    model = scene.build(device=device, precision="float64")
    errors = []
    for dt in (1e-3, 2.5e-4):
        model.reset()
        force = wc.Simulation(model, dt, HARD).run(1.0, ["touch.normal_force"])["touch.normal_force"]
        middle = force["time"].values[1:] - 0.5 * dt
        expected = G - amplitude * rate**2 * np.sin(rate * middle)
        errors.append(np.abs(force.values[1:, 0] - expected)[3:].max())
    # The mean over a step equals the value at its middle to second order.
    assert errors[0] < amplitude * rate**4 * 1e-6
    assert errors[1] < 0.1 * errors[0]
