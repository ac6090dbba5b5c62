"""Prescribed motion: bodies that follow functions of time, or velocities that the user sets."""

from typing import Any

import numpy as np
import pytest
import warp as wp
from scenes import square
from scipy.interpolate import Akima1DInterpolator
from scipy.spatial.transform import Rotation

import warpcontact as wc

G = 9.81
START = np.array([1.5, -0.4, 0.7])
TURNED = Rotation.from_rotvec((0.3, 0.1, -0.6))
EPSILON = {"float32": 2.0**-24, "float64": 2.0**-53}


class Helix(wc.Motion):
    """Motion along a helix about z, rotating about ``axis``."""

    radius: float = wc.parameter("m", "radius", above=0.0)
    rate: float = wc.parameter("rad/s", "angular frequency")
    rise: float = wc.parameter("m/s", "rise", default=0.1)
    axis: tuple[float, float, float] = wc.parameter("-", "axis", shape=(3,), direction=True)
    normal: tuple[float, float, float] | None = wc.parameter("-", "left out: zero", shape=(3,), default=None)

    @wp.func
    def displacement(p: Any, t: Any):
        angle = p.rate * t
        return wp.vec3d(p.radius * (wp.cos(angle) - wp.float64(1.0)), p.radius * wp.sin(angle), p.rise * t)

    @wp.func
    def rotation(p: Any, t: Any):
        return p.rate * t * p.axis + p.normal


TIMES = (0.0, 0.02, 0.05, 0.06, 0.09)
PATHS = ((0, 0, 0), (0.1, 0, 0), (0.1, 0.2, 0), (0.1, 0.2, -0.1), (0, 0, 0))
TURNS = ((0, 0, 0), (0.1, 0, 0), (0.1, 0.7, 0), (0.4, 0.2, 0), (0, 3.5, 0))
PIVOT = (0.2, 0.1, 0.3)


def helix(t):
    angle = 9.0 * t
    return np.array([0.3 * (np.cos(angle) - 1.0), 0.3 * np.sin(angle), 0.1 * t]), np.array([0, 0, angle])


def swing(t):
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    turn = 0.8 * np.sin(2 * np.pi * 3.0 * t + 0.4) * axis
    return (Rotation.from_rotvec(turn).apply(START - PIVOT) - (START - PIVOT)), turn


def table(t):
    at = np.clip(2.0 * t, TIMES[0], TIMES[-1])
    return tuple(0.5 * Akima1DInterpolator(TIMES, rows, method="makima")(at) for rows in (PATHS, TURNS))


FOLLOWED = {
    "helix": (Helix(radius=0.3, rate=9.0, axis=(0, 0, 2)), helix),
    "swing": (wc.motions.Harmonic(direction=(1, 2, 2), angle=0.8, frequency=3.0, phase=0.4, anchor=PIVOT), swing),
    "table": (wc.motions.Table(times=TIMES, displacements=PATHS, rotations=TURNS, scale=0.5, rate=2.0), table),
}


@pytest.fixture(scope="module", params=["float32", "float64"])
def prescribed_bodies(request, device):
    """A free body, and one body for each prescribed motion."""
    scene = wc.Scene(gravity=(0, 0, -G))
    for name, (motion, _) in FOLLOWED.items():
        scene.add_body(
            2.0, (0.1, 0.2, 0.15), position=START, orientation=TURNED.as_quat(), motion=motion, name=name
        )
    return scene.build(device=device, precision=request.param)


def pose_error(model, name, function, t):
    """Errors of position [m] and orientation [rad] relative to the function at ``t``."""
    way, turn = function(t)
    orientation = Rotation.from_quat(model.sensor(f"{name}.orientation")[0].astype(np.float64))
    turned = (Rotation.from_rotvec(turn) * TURNED).inv() * orientation
    return np.abs(model.sensor(f"{name}.position")[0] - START - way).max(), turned.magnitude()


def test_prescribed_motion_is_tracked_exactly_over_a_long_run(prescribed_bodies):
    model = prescribed_bodies
    model.reset()
    sim = wc.Simulation(model, dt=1e-3)
    for steps in (0, 1, 1, 43, 555, 100_000):
        sim.step(steps)
        t = model.arrays.time.numpy()[0]
        for name, (_, function) in FOLLOWED.items():
            place, angle = pose_error(model, name, function, t)
            # Positions have a remainder; a phase of 900 rad is rounded to 1e-13.
            assert place < 1e-12, (name, steps)
            assert angle < 4 * EPSILON[model.precision] + 1e-12, (name, steps)


def test_prescribed_motion_uses_the_recorded_time(device):
    """A clock that sums steps in float32, with a relative error of 5e-8, is off by 3e-4 rad of 50 Hz after 20 s."""
    scene = wc.Scene()
    shake = wc.motions.Harmonic(direction=(0, 0, 1), amplitude=0.1, frequency=49.7)
    scene.add_body(1.0, (0.1, 0.1, 0.1), motion=shake, name="table")
    model = scene.build(2, device, "float32")
    recording = wc.Simulation(model, 1.0e-3).run(20.0, every=0.5)
    time = recording["time"].values
    expected = 0.1 * np.sin(2.0 * np.pi * 49.7 * time)
    # A sum of 20 000 times up to 20 s is off by at most 3.6e-11 s, at 31 m/s.
    np.testing.assert_allclose(recording["table.position"].values[:, 0, 2], expected, rtol=0, atol=1.2e-9)


def test_prescribed_velocity_is_the_mean_over_the_step(prescribed_bodies):
    model = prescribed_bodies
    model.reset()
    rounding = 4 * EPSILON[model.precision]
    for name, (_, function) in FOLLOWED.items():
        if name == "table":
            continue  # constant before its first time: half the derivative
        h = 1e-4
        slope = (function(h)[0] - function(-h)[0]) / (2 * h)
        # Central difference over 2e-6 s, accurate to 1e-9 in float64; the joint's own difference is of order h².
        np.testing.assert_allclose(model.sensor(f"{name}.linear_velocity")[0], slope, atol=2e-4, err_msg=name)
    dt = 1e-3
    sim = wc.Simulation(model, dt=dt)
    sim.step(20)
    for name, (_, function) in FOLLOWED.items():
        before = model.arrays.time.numpy()[0]
        sim.step()
        after = model.arrays.time.numpy()[0]
        (old_way, old_turn), (new_way, new_turn) = function(before), function(after)
        mean = (new_way - old_way) / (after - before)
        turn = (Rotation.from_rotvec(new_turn) * Rotation.from_rotvec(old_turn).inv()).as_rotvec()
        velocities = [model.sensor(f"{name}.{key}_velocity")[0] for key in ("linear", "angular")]
        # Differences of about 1 m in a step of 1 ms.
        for velocity, expected in zip(velocities, (mean, turn / (after - before)), strict=True):
            allowed = rounding * np.abs(expected).max() + 1e-12
            np.testing.assert_allclose(velocity, expected, atol=allowed, err_msg=name)


def test_prescribed_motion_reaction_equals_driving_force(prescribed_bodies):
    """F = m (a − g) with the acceleration at this time."""
    model = prescribed_bodies
    model.reset()
    wc.Simulation(model, dt=1e-3).step(100)
    angle = 9.0 * model.arrays.time.numpy()[0]
    acceleration = -0.3 * 81.0 * np.array([np.cos(angle), np.sin(angle), 0])
    # Second differences over 2e-5 s: accurate to 1e-6 m/s² in float64, and to (ω h)²/12 of the function.
    expected = 2.0 * (acceleration + np.array([0, 0, G]))
    np.testing.assert_allclose(model.sensor("helix.reaction_force")[0], expected, atol=2e-5)


def test_kinematic_body_moves_with_its_constant_velocity(device):
    scene = wc.Scene(gravity=(0, 0, -G))
    velocity = (0.5, 0.0, -0.25)
    body = scene.add_body(
        1.0,
        (0.1, 0.3, 0.2),
        linear_velocity=velocity,
        angular_velocity=(0, 0, 2.0),
        motion=wc.motions.Prescribed(),
        name="plate",
    )
    ground = scene.add_surface(square(), body, name="top")
    ball = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 0.09), name="ball")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=0.1)
    model = scene.build(envs=2, device=device, precision="float64")
    sim = wc.Simulation(model, dt=0.125)
    sim.step(8)
    # Gravity, contact and inertia do not change these velocities. Steps are powers of two and add without
    # rounding.
    np.testing.assert_array_equal(model.sensor("plate.linear_velocity"), [velocity] * 2)
    np.testing.assert_array_equal(model.sensor("plate.position"), [velocity] * 2)
    turn = Rotation.from_quat(model.sensor("plate.orientation")[0]).as_rotvec()
    np.testing.assert_allclose(turn, (0, 0, 2.0), rtol=1e-14)
    sim.state.body_linear_velocity.assign(np.array([[[0, 0, 1], [0, 0, 0]], [[1, 0, 0], [0, 0, 0]]]))
    sim.step(8)
    expected = np.add([velocity] * 2, [(0, 0, 1), (1, 0, 0)])
    np.testing.assert_array_equal(model.sensor("plate.position"), expected)


@pytest.mark.slow
def test_swept_contact_detects_a_prescribed_surface_jump(device):
    """Motion bounds use poses: a plate at rest for a long time rises by 0.4 m in two steps."""
    scene = wc.Scene(gravity=(0, 0, 0))
    jump = wc.motions.Table(
        times=(0.0, 0.0998, 0.1, 0.102, 0.1022, 0.3),
        displacements=tuple((0, 0, z) for z in (0, 0, 0, 0.4, 0.4, 0.4)),
    )
    plate = scene.add_surface(square(), scene.add_body(1.0, (1, 1, 1), motion=jump, name="carrier"), name="plate")
    stone = scene.add_body(1.0, (1, 1, 1), position=(0.1, 0.2, 0.3), name="stone")
    point = scene.add_point(stone, (0, 0, 0))
    scene.add_contact(point, plate, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3)), swept=True, name="touch")
    model = scene.build(device=device, precision="float64")
    speeds = []
    for cached in (True, False):
        model.reset()
        wc.Simulation(model, dt=1e-3, distance_cache=cached).step(200)
        assert model.sensor("touch.crossings")[0] == 1
        speeds.append(model.sensor("stone.linear_velocity")[0, 2])
    assert speeds[0] == speeds[1]
    # Contact starts at 0.1 m penetration at rest, except for the motion of the plate; ejected at δ √(k/m).
    np.testing.assert_allclose(speeds[0], 0.1 * np.sqrt(1e3), rtol=0.1)


def test_contact_of_prescribed_and_fixed_body_has_finite_force(device):
    """Laws that divide by the effective mass get a finite value."""
    scene = wc.Scene(gravity=(0, 0, 0))
    post = scene.add_body(1.0, (1, 1, 1), motion=wc.motions.Fixed(), name="post")
    ram = scene.add_body(
        1.0,
        (1, 1, 1),
        position=(0, 0, 0.09),
        linear_velocity=(0, 0, -0.01),
        motion=wc.motions.Prescribed(),
        name="ram",
    )
    face = scene.add_surface(square(), post)
    law = wc.laws.KelvinVoigt(stiffness=1e4, damping=50.0)
    material = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.3))
    scene.add_contact(scene.add_point(ram, (0, 0, 0)), face, material, radius=0.1, name="touch")
    model = scene.build(device=device, precision="float64")
    wc.Simulation(model, dt=0.125).step(4)
    force = 1e4 * (0.01 + 0.5 * 0.01) + 50.0 * 0.01
    np.testing.assert_allclose(model.sensor("touch.normal_force"), force, rtol=1e-9)
    np.testing.assert_allclose(model.sensor("ram.reaction_force")[0], (0, 0, -force), rtol=1e-9)
    np.testing.assert_allclose(model.sensor("post.reaction_force")[0], (0, 0, force), rtol=1e-9)
    assert model.health().frozen.size == 0


def test_shaker_throws_ball_at_closed_form_time(device):
    """z = −a cos ω t: separation at a ω² cos ω t = −g, at a different time in each environment."""
    amplitude, frequency = 0.02, np.array([5.0, 6.0, 8.0])
    mass, stiffness, radius = 0.2, 2e6, 0.05
    scene = wc.Scene(gravity=(0, 0, -G))
    motion = wc.motions.Harmonic(direction=(0, 0, 1), amplitude=amplitude, frequency=1.0, phase=-np.pi / 2)
    shaker = scene.add_body(1.0, (1, 1, 1), motion=motion, name="shaker")
    plate = scene.add_surface(square(), shaker, name="plate")
    ball = scene.add_body(mass, (1e-3,) * 3, name="ball")
    law = wc.laws.KelvinVoigt(stiffness=stiffness, restitution=0.1)
    touch = scene.add_point(ball, (0, 0, 0))
    scene.add_contact(touch, plate, wc.ContactMaterial(law=law), radius=radius, name="touch")
    model = scene.build(envs=3, device=device, precision="float64")
    model["shaker.motion.frequency"] = frequency
    pace = 2 * np.pi * frequency
    pressed = mass * (G + amplitude * pace**2) / stiffness
    model["ball.position"] = np.stack([0 * pressed, 0 * pressed, radius - amplitude - pressed], axis=1)
    np.testing.assert_allclose(model.sensor("touch.penetration"), pressed, rtol=1e-9)
    dt = 2e-5
    recording = wc.Simulation(model, dt).run(
        0.1, ["touch.normal_force", "shaker.position", "touch.approach_speed"]
    )
    force = recording["touch.normal_force"].values
    np.testing.assert_allclose(
        recording["shaker.position"].values[:, :, 2],
        -amplitude * np.cos(pace * recording.time.values[:, None]),
        atol=1e-14,
    )
    gone = recording.time.values[np.argmax(force == 0.0, axis=0)]
    # The last 2e-5 m of spring travel take a twentieth of its period of 2 ms.
    np.testing.assert_allclose(gone, np.arccos(-G / (amplitude * pace**2)) / pace, atol=2e-4)
    # The ball has the velocity of the shaker: the mean over the step.
    riding = recording["touch.approach_speed"].sel(time=0.01, method="nearest").values
    assert (np.abs(riding) < 1e-3 * amplitude * pace).all()
