"""Sleeping in nonsmooth contact: bodies at rest are bitwise constant, and steps without change are skipped."""

import numpy as np
import pytest
import warp as wp
from nonsmooth_rows import DT, HALF, SOLVERS, UP, Row, Step, tower
from nonsmooth_scenes import HARD, G, block, rigid
from scenes import square
from warpcontact.kernels.types import WORLD

import warpcontact as wc

SENSORS = ("position", "orientation", "linear_velocity", "angular_velocity")
SPEEDS = np.stack([np.linspace(0.0, 1.0, 7), np.linspace(0.3, -0.2, 7), np.zeros(7)], axis=1)
EPSILON = {"float32": 1.2e-7, "float64": 2.3e-16}
# Number of environments in which rounding may leave the box balanced on two points; one of these speeds, in
# float32.
FEW = {"float32": 1, "float64": 0}


def sliding(precision, device, *, stack=True, threads=None, **watched):
    """Simulation of a box with eight contact points, and one more box on it, that slide and come to rest.

    They come to rest within 0.6 s, except boxes balanced on two points, whose settling depends on rounding.
    """
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    below = scene.add_surface(square(20.0), name="ground")
    feet = [(x, y, -0.09) for x in (-0.2, 0.2) for y in (-0.2, -0.1, 0.1, 0.2)]
    for number in range(2 if stack else 1):
        place = (0.0, 0.0, 0.1 + 0.2 * number)
        body = scene.add_body(20.0, (0.5, 0.5, 0.8), position=place, name=f"box{number}")
        points = scene.add_points(body, feet, name=f"points{number}")
        scene.add_contact(points, below, rigid(mu=0.4), radius=0.01, name=f"feet{number}")
        below = scene.add_surface(wc.meshes.box((0.5, 0.5, 0.2)), body, name=f"top{number}")
    model = scene.build(envs=len(SPEEDS), device=device, precision=precision)
    for number in range(2 if stack else 1):
        model[f"box{number}.linear_velocity"] = SPEEDS
    return wc.Simulation(model, 2e-3, HARD, threads=threads, **watched)


def all_sensors(sim):
    return {name: sim.model.sensor(name) for name in sim.model.sensor_names}


@pytest.mark.parametrize("precision", EPSILON)
def test_sleeping_body_does_not_creep(precision, device):
    sim = sliding(precision, device)
    sim.step(300)
    speed = np.linalg.norm(sim.model.sensor("box1.linear_velocity"), axis=-1)
    assert np.count_nonzero(speed) <= FEW[precision]
    # At most the part of the velocity of gravity in a step that the tolerance leaves.
    assert speed.max() < 1e-4 * G * sim.dt
    for _ in range(8):
        sim.step(100)
    before = {name: sim.model.sensor(f"box1.{name}") for name in SENSORS}
    assert not before["linear_velocity"].any()
    assert not before["angular_velocity"].any()
    sim.step(1)
    sim.step(200)
    for name, values in before.items():
        np.testing.assert_array_equal(sim.model.sensor(f"box1.{name}"), values)
    # Rounding in sums of several impulses of the weight.
    assert sim.model.sensor("scene.solve_residual").max() < 32 * EPSILON[precision]
    assert not sim.model.sensor("scene.solve_iterations").any()


@pytest.mark.parametrize("precision", EPSILON)
@pytest.mark.parametrize("stack", [False, True])
def test_skipped_steps_of_sleeping_bodies_would_change_nothing(precision, stack, device):
    """A call of ``step`` with one step skips none."""
    together, alone = (
        sliding(precision, device, stack=stack, threads=2),
        sliding(precision, device, stack=stack, threads=1),
    )
    together.step(321)
    together.step(80)
    for _ in range(401):
        alone.step(1)
    calm = together.model.nonsmooth.statistics.unchanged_steps.numpy() == 2
    moves = [together.model.sensor(f"box{number}.linear_velocity").any(axis=-1) for number in range(1 + stack)]
    np.testing.assert_array_equal(calm, ~np.any(moves, axis=0))
    assert np.count_nonzero(~calm) <= FEW[precision]
    assert not (alone.model.nonsmooth.statistics.unchanged_steps.numpy() == 2).any()
    expected = all_sensors(alone)
    for name, values in all_sensors(together).items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)
    np.testing.assert_array_equal(together.model.arrays.time.numpy(), alone.model.arrays.time.numpy())


@pytest.mark.parametrize("precision", EPSILON)
@pytest.mark.parametrize("every", [1, 3, 4])
def test_body_with_zero_velocity_in_the_air_does_not_sleep(precision, every, device):
    """All sums are exact here: at the apex velocity is zero, and there is no contact and no row to solve."""
    scene = wc.Scene(gravity=(0.0, 0.0, -8.0))
    ground = scene.add_surface(square(20.0))
    ball = scene.add_body(1.0, (0.1, 0.1, 0.1), position=(0.0, 0.0, 1.0), name="ball")
    scene.add_contact(scene.add_points(ball, [(0.0, 0.0, 0.0)]), ground, rigid(mu=0.4), radius=0.1)
    model = scene.build(device=device, precision=precision)
    model["ball.linear_velocity"] = (0.0, 0.0, 12 / 16)
    wc.Simulation(model, 1 / 128, HARD).run(24 / 128, ["ball.position"], every=every / 128)
    np.testing.assert_array_equal(model.sensor("ball.linear_velocity"), [[0.0, 0.0, -12 / 16]])
    np.testing.assert_array_equal(model.sensor("ball.position"), [[0.0, 0.0, 1.0]])


def test_sleeping_body_wakes_after_a_parameter_change(device):
    sim = sliding("float64", device, stack=False)
    sim.step(400)
    position = sim.model.sensor("box0.position")
    gravity = np.tile([0.0, 0.0, -G], (len(SPEEDS), 1))
    gravity[3] = G * np.sin(0.5), 0.0, -G * np.cos(0.5)
    sim.model["scene.gravity"] = gravity
    sim.step(100)
    moved = np.linalg.norm(sim.model.sensor("box0.position") - position, axis=1)
    # Half of acceleration times time squared, first-order accurate in the step.
    assert moved[3] == pytest.approx(0.5 * G * (np.sin(0.5) - 0.4 * np.cos(0.5)) * 0.2**2, rel=0.02)
    assert not np.delete(moved, 3).any()


def test_sleeping_body_falls_after_its_position_is_set(device):
    sim = sliding("float64", device, stack=False)
    sim.step(400)
    state = sim.state.body_position.numpy()
    state[2, 0, 2] += 0.5
    sim.state.body_position.assign(state)
    sim.step(50)
    speed = sim.model.sensor("box0.linear_velocity")[:, 2]
    assert speed[2] == pytest.approx(-G * 0.1, rel=1e-12)
    assert not np.delete(speed, 2).any()


def test_monitored_steps_are_not_skipped(device):
    watched = sliding(
        "float64", device, stack=False, outcomes={"held": wc.outcomes.Integral("feet0.normal_force")}
    )
    watched.step(400)
    held = np.asarray(watched.outcomes()["held"]).sum(axis=-1)
    # The weight over 0.8 s, except for the first steps, in which the box falls onto its points.
    np.testing.assert_allclose(held, 20.0 * G * 0.8, rtol=0.01)


@pytest.mark.parametrize("precision", EPSILON)
def test_body_standing_on_its_center_of_mass_is_rotated_by_a_torque(precision, device):
    """For any lever arm of the contact, however small."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(20.0))
    top = scene.add_body(1.0, (0.1, 0.1, 0.1), name="top")
    scene.add_contact(scene.add_points(top, [(0.0, 0.0, 0.0)]), ground, rigid(mu=0.4), radius=0.0)
    model = scene.build(device=device, precision=precision)
    sim = wc.Simulation(model, 1e-3, HARD)
    sim.step(100)
    assert not model.sensor("top.linear_velocity").any()
    model["top.external_torque"] = (0.0, 0.0, 0.05)
    sim.step(500)
    turning = model.sensor("top.angular_velocity")[0]
    np.testing.assert_allclose(turning, (0.0, 0.0, 0.25), rtol=500 * EPSILON[precision], atol=1e-9)


@pytest.mark.parametrize("load", [0.999, 1.001])
def test_block_at_the_friction_limit_stands_below_and_slides_above(load):
    """At the boundary of the cone, standing needs slightly more friction than there is."""
    slope = np.arctan(0.5 * load)
    model = block(0.5, slope=slope, height=-1e-3)
    sim = wc.Simulation(model, 1e-3, HARD)
    sim.step(1000)
    speed = model.sensor("block.linear_velocity")[0, 0]
    expected = max(0.0, G * (np.sin(slope) - 0.5 * np.cos(slope)))
    assert speed == pytest.approx(expected, rel=0.01, abs=1e-9)


def test_tower_is_stopped_in_one_iteration_from_a_fair_guess():
    step = tower([1.0, 3.0, 0.5])
    step.guess([[0.0, 0.0, G * DT * weight / 4.1] for weight in (4.5, 3.5, 0.5) for _ in range(4)])
    result = step.solve("gauss_seidel", tolerance=1e-8)
    assert result.iterations == 1
    assert not result.velocity.any()
    # Rounding of impulses that are distributed and summed.
    assert step.residual(result.impulse, step.momentum_after(result.impulse)) < 1e-14


def test_contact_without_normal_impulse_has_no_friction_impulse():
    step = tower([1.0], push=0.03, mu=0.5)
    step.rows.append(Row(0, WORLD, np.array([0.0, 0.0, -HALF]), np.zeros(3), UP, 0.5))
    step.guess([[0.0, 0.0, G * DT / 4]] * 4 + [[0.0, 0.0, 0.0]])
    result = step.solve("gauss_seidel", tolerance=1e-8)
    assert result.iterations == 1
    assert not result.velocity.any()
    assert not result.impulse[4].any()
    assert step.residual(result.impulse, step.momentum_after(result.impulse)) < 1e-14


@pytest.mark.parametrize("solver", SOLVERS)
def test_push_beyond_friction_is_not_stopped(solver):
    step = tower([1.0, 1.0], push=0.5, mu=0.2)
    step.guess([[0.0, 0.0, G * DT * weight / 4] for weight in (2.0, 1.0) for _ in range(4)])
    result = step.solve(solver, tolerance=1e-10)
    assert result.converged
    assert result.velocity[1, 0] > 0.4


def test_rest_impulses_of_light_body_do_not_underflow():
    """Products of small masses and short lever arms are below the smallest float32."""
    arms = [np.array([x, y, 0.0]) for x in (-1e-4, 1e-4) for y in (-1e-4, 1e-4)]
    mass = 1e-6
    rows = [Row(0, WORLD, arm, np.zeros(3), UP, 0.5) for arm in [*arms, np.zeros(3)]]
    step = Step([(mass, np.eye(3) * mass * 1e-8)], [((3e-6, 0.0, -1e-4 * G), np.zeros(3))], rows)
    step.guess([[0.0, 0.0, 1e-4 * G * mass / 4]] * 4 + [[0.0, 0.0, 0.0]])
    result = step.solve("gauss_seidel", wp.float32)
    assert result.iterations == 1
    assert not result.velocity.any()
    assert np.isfinite(result.impulse).all()
