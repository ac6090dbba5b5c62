"""Solvers of a nonsmooth step, on handmade bodies and contacts."""

import json

import nonsmooth_rows
import numpy as np
import pytest
import warp as wp
from nonsmooth_rows import DT, SOLVERS, UP, G, Row, Step, cross, frame, tower
from warpcontact.kernels.types import WORLD

both = pytest.mark.parametrize("solver", list(SOLVERS))
precisions = pytest.mark.parametrize("real", [wp.float64, wp.float32])


@pytest.fixture(autouse=True)
def on_device(device, monkeypatch):
    monkeypatch.setattr(nonsmooth_rows, "DEVICE", device)


def close(real, fine=1e-9, coarse=2e-4):
    """Tolerance for quantities of order one at the default residual."""
    return fine if real == wp.float64 else coarse


def block(force=0.0, height=1.0, mu=0.5):
    """A rigid block of 10 kg, 1 m wide, 2 m high, on four vertices, after a step under a push at a height."""
    inertia = np.diag([10.0 * 5 / 12, 10.0 * 5 / 12, 10.0 / 6])
    rows = [
        Row(0, WORLD, np.array([x, y, -1.0]), np.array([x, y, 0.0]), UP, mu)
        for x in (-0.5, 0.5)
        for y in (-0.5, 0.5)
    ]
    spin = np.array([0.0, force * (height - 1.0) / inertia[1, 1] * DT, 0.0])
    return Step([(10.0, inertia)], [(np.array([force / 10.0 * DT, 0.0, -G * DT]), spin)], rows)


def ball(velocity, spin=(0.0, 0.0, 0.0), mass=2.0, radius=0.1, **options):
    """A solid ball on the ground."""
    arm = np.array([0.0, 0.0, -radius])
    row = Row(0, WORLD, arm, np.zeros(3), UP, **options)
    return Step([(mass, 0.4 * mass * radius**2 * np.eye(3))], [(np.array(velocity), np.array(spin))], [row])


def random_step(seed, bodies=5, contacts=10, mu=0.5, hinges=False, restitution_speed=0.3):
    """Bodies in contact with each other and the world at random, approaching or separating."""
    rng = np.random.default_rng(seed)
    inverse_masses, velocities = [], []
    for i in range(bodies):
        R = frame(unit(rng))
        mass = 10 ** rng.uniform(-0.5, 0.5)
        inertia = mass * R @ np.diag(rng.uniform(0.3, 1.0, 3)) @ R.T
        if hinges and i % 2 == 0:
            inverse_masses.append(hinge(unit(rng), rng.normal(size=3), mass, inertia))
            velocities.append((np.zeros(3), np.zeros(3)))
        else:
            inverse_masses.append((mass, inertia))
            velocities.append((rng.normal(size=3), rng.normal(size=3)))
    if hinges:
        inverse_masses = [free(*m) if isinstance(m, tuple) else m for m in inverse_masses]
    rows = []
    for _ in range(contacts):
        first, second = rng.choice(np.arange(WORLD, bodies), 2, replace=False)
        # Bodies with one degree of freedom cannot separate at all contacts simultaneously.
        parting = 0.0 if hinges else restitution_speed * rng.random()
        arm_1, arm_2 = rng.normal(size=3), rng.normal(size=3)
        rows.append(Row(first, second, arm_1, arm_2, unit(rng), mu * rng.random(), parting))
    return Step(inverse_masses, velocities, rows)


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def free(mass, inertia):
    """[[A, B], [Bᵀ, C]] of a free body."""
    inverse = np.zeros((6, 6))
    inverse[:3, :3] = np.eye(3) / mass
    inverse[3:, 3:] = np.linalg.inv(inertia)
    return inverse


def hinge(axis, arm, mass, inertia):
    """Same for a body that rotates about an axis; ``arm`` points from there to its center of mass."""
    lever = np.concatenate([np.cross(axis, arm), axis])
    about = axis @ (inertia - mass * cross(arm) @ cross(arm)) @ axis
    return np.outer(lever, lever) / about


def assert_solved(step, result, tolerance):
    """Asserts that the residual is as reported and small, and that velocities match the impulses."""
    assert result.converged
    assert result.residual <= tolerance
    assert step.residual(result.impulse, result.velocity) <= 1.01 * tolerance + 1e-13
    after = step.momentum_after(result.impulse, result.couple)
    np.testing.assert_allclose(result.velocity, after, rtol=0, atol=1e-12 * max(1.0, np.abs(after).max()))


@both
@pytest.mark.parametrize("case", ["slip", "stick", "open"])
def test_nonsmooth_solver_matches_reference_for_one_contact(shared, solver, case):
    oracle = json.loads((shared / "spec" / "oracle_signorini.json").read_text())["contact3d"]
    # A body whose inverse mass for impulses at its center of mass is W of the oracle.
    inverse = np.zeros((6, 6))
    inverse[:3, :3] = oracle["W"]
    inverse[3:, 3:] = np.eye(3)
    given = oracle[case]
    row = Row(0, WORLD, np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0]), given["mu"])
    step = Step([inverse], [(np.array(given["b"]), np.zeros(3))], [row])
    result = step.solve(solver, tolerance=1e-14)
    np.testing.assert_allclose(result.impulse[0], given["l"], rtol=0, atol=1e-13)
    np.testing.assert_allclose(result.velocity[0, :3], given["w"], rtol=0, atol=1e-13)


@both
@precisions
def test_nonsmooth_solver_block_rests_slides_or_tips(solver, real):
    atol = close(real)
    rests = block(force=20.0, height=1.0).solve(solver, real)
    left, right = rests.impulse[:2].sum(0) / DT, rests.impulse[2:].sum(0) / DT
    assert rests.converged
    np.testing.assert_allclose([left[2], right[2], left[0] + right[0]], [29.05, 69.05, -20.0], atol=100 * atol)
    np.testing.assert_allclose(rests.velocity, 0.0, atol=atol)

    slides = block(force=60.0, height=0.5).solve(solver, real)
    left, right = slides.impulse[:2].sum(0) / DT, slides.impulse[2:].sum(0) / DT
    assert slides.converged
    np.testing.assert_allclose([left[2], right[2], left[0] + right[0]], [30.0, 68.1, -49.05], atol=100 * atol)
    np.testing.assert_allclose(slides.velocity[0] / DT, [1.095, 0, 0, 0, 0, 0], atol=10 * atol)

    tips = block(force=40.0, height=1.8, mu=0.9).solve(solver, real)
    left, right = tips.impulse[:2].sum(0) / DT, tips.impulse[2:].sum(0) / DT
    assert tips.converged
    np.testing.assert_allclose(left, 0.0, atol=100 * atol)
    np.testing.assert_allclose(right[[0, 2]], [-26.23, 104.985], atol=100 * atol)
    np.testing.assert_allclose(tips.velocity[0] / DT, [1.377, 0, 0.6885, 0, 1.377, 0], atol=10 * atol)


@both
@pytest.mark.parametrize("hinges", [False, True])
def test_random_systems_satisfy_the_contact_law(solver, hinges):
    for seed in range(20):
        step = random_step(seed, hinges=hinges)
        assert_solved(step, step.solve(solver, tolerance=1e-11, iterations=20000), 1e-11)


@both
def test_random_systems_satisfy_the_contact_law_in_float32(solver):
    for seed in range(20):
        step = random_step(seed)
        result = step.solve(solver, wp.float32)
        assert result.converged
        # Recomputed in float64 from values rounded once more.
        assert step.residual(result.impulse, result.velocity) <= 2e-5


@pytest.mark.parametrize("hinges", [False, True])
def test_nonsmooth_solvers_agree_on_velocities(hinges):
    """With low friction, velocities are unique for any distribution of impulses."""
    for seed in range(10):
        step = random_step(100 + seed, bodies=4, contacts=12, mu=0.2, hinges=hinges)
        one, other = (step.solve(solver, tolerance=1e-12, iterations=50000) for solver in SOLVERS)
        assert one.converged
        assert other.converged
        np.testing.assert_allclose(one.velocity, other.velocity, rtol=0, atol=1e-8)


@both
def test_contact_between_bodies_conserves_momentum(solver):
    step = random_step(3)
    step.rows = [row for row in step.rows if WORLD not in (row.first, row.second)]
    for row in step.rows:  # at one point of the world: bodies at the origin
        row.arm_2 = row.arm_1
    result = step.solve(solver)
    linear, angular = np.zeros(3), np.zeros(3)
    for body, change in enumerate(result.velocity - step.velocity):
        linear += change[:3] / step.inverse[body, 0, 0]
        angular += np.linalg.solve(step.inverse[body, 3:, 3:], change[3:])
    assert np.abs(result.impulse).max() > 0.01
    np.testing.assert_allclose([linear, angular], 0.0, atol=1e-13)


@both
def test_contact_separates_at_its_bounce_velocity(solver):
    result = ball([0.0, 0.0, -3.0], restitution_speed=2.4).solve(solver)
    np.testing.assert_allclose(result.velocity[0], [0, 0, 2.4, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(result.impulse[0], [0, 0, 2.0 * 5.4], atol=1e-11)
    # Separates faster than its restitution already: the impulse is zero.
    result = ball([0.3, 0.0, 3.0], restitution_speed=2.4, mu=0.5).solve(solver)
    np.testing.assert_allclose(result.velocity[0], [0.3, 0, 3.0, 0, 0, 0], atol=0)
    np.testing.assert_allclose(result.impulse, 0.0, atol=0)


@both
def test_sliding_ball_gains_spin(solver):
    result = ball([1.0, 0.0, -0.1], mu=0.3).solve(solver)
    # P = m (−μ 0.1, 0, 0.1), and r × P over 2/5 m r².
    expected = [0.97, 0.0, 0.0, 0.0, 2.5 * 0.03 / 0.1, 0.0]
    np.testing.assert_allclose(result.velocity[0], expected, atol=1e-11)
    # Friction is sufficient for rolling: 5/7 of the velocity.
    result = ball([1.0, 0.0, -3.0], mu=0.3).solve(solver)
    np.testing.assert_allclose(result.velocity[0], [5 / 7, 0, 0, 0, 5 / 0.7, 0], atol=1e-10)


@pytest.mark.slow
@both
@precisions
def test_rolling_and_torsional_friction_are_bounded(solver, real):
    mass, radius, rolling, spinning = 2.0, 0.1, 2e-3, 1e-3
    inertia, pressed = 0.4 * mass * radius**2, mass * 0.1
    about = inertia + mass * radius**2
    atol = close(real)
    # It continues to roll, decelerated: (I + m r²) Δω = rolling P_n, and spin about the normal likewise.
    spin = 2.0
    options = {"mu": 0.8, "rolling": rolling, "spinning": spinning}
    fast = ball([spin * radius, 0.0, -0.1], [0.0, spin, spin], **options).solve(solver, real)
    assert fast.converged
    rate = spin - rolling * pressed / about
    twist = spin - spinning * pressed / inertia
    np.testing.assert_allclose(fast.velocity[0], [rate * radius, 0, 0, 0, rate, twist], atol=10 * atol)
    np.testing.assert_allclose(fast.couple[0], [0, -rolling * pressed, -spinning * pressed], rtol=10 * atol)
    # So slow that it stops within the limits.
    spin = 1e-3
    slow = ball([spin * radius, 0.0, -0.1], [0.0, spin, spin], **options).solve(solver, real)
    assert slow.converged
    np.testing.assert_allclose(slow.velocity[0], 0.0, atol=10 * atol)
    # A residual is relative to the impulse, and to the torque at its lever arm.
    expected = [0, -about * spin, -inertia * spin]
    np.testing.assert_allclose(slow.couple[0], expected, atol=atol * radius * pressed)


@both
@precisions
@pytest.mark.parametrize("other_mass", [1e-6, 1e8])
def test_ball_next_to_one_of_another_mass_moves_as_alone(solver, real, other_mass):
    alone = ball([1.0, 0.0, -0.02], mu=0.3)
    other = ball([0.0, 0.0, -0.02], mass=other_mass, mu=0.3)
    other.rows[0].first = 1
    masses = [(m, 0.4 * m * 0.01 * np.eye(3)) for m in (2.0, other_mass)]
    velocities = [(one.velocity[0, :3], one.velocity[0, 3:]) for one in (alone, other)]
    both_balls = Step(masses, velocities, [*alone.rows, *other.rows]).solve(solver, real)
    assert both_balls.converged
    # The speed is reduced by μ 0.02; the other ball is unchanged.
    expected = [1.0 - 0.3 * 0.02, 0.0, 0.0, 0.0, 2.5 * 0.3 * 0.02 / 0.1, 0.0]
    np.testing.assert_allclose(both_balls.velocity[0], expected, atol=close(real))
    np.testing.assert_allclose(both_balls.velocity[1], 0.0, atol=close(real))


@precisions
def test_light_cube_on_heavy_one_rests(real):
    result = tower([1e5, 1e-2]).solve("accelerated", real)
    assert result.converged
    # Relative to the velocity of gravity in a step, for any mass.
    np.testing.assert_allclose(result.velocity, 0.0, atol=G * DT * close(real))


@both
def test_door_is_stopped_and_rebounds(solver):
    axis, arm = UP, np.array([0.5, 0.0, 0.0])
    inertia = np.diag([0.1, 0.2, 0.3])
    about = 0.3 + 4.0 * 0.25
    rate = -2.0
    velocity = (rate * np.cross(axis, arm), rate * axis)
    stop = Row(
        0, WORLD, np.array([0.4, 0.0, 0.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.5, restitution_speed=0.9
    )
    step = Step([hinge(axis, arm, 4.0, inertia)], [velocity], [stop])
    result = step.solve(solver)
    after = 0.9 / 0.9  # velocity after the bounce over the lever arm
    np.testing.assert_allclose(result.velocity[0], [0, 0.5 * after, 0, 0, 0, after], atol=1e-12)
    np.testing.assert_allclose(result.impulse[0], [0, about * (after - rate) / 0.9, 0], atol=1e-10)


@both
def test_immovable_body_has_no_impulse(solver):
    step = random_step(5, hinges=True)
    step.inverse[0] = 0.0
    step.rows.append(Row(0, WORLD, np.ones(3), np.ones(3), UP, 0.5, impulse=np.ones(3)))
    step.rows.append(Row(0, 1, np.ones(3), np.ones(3), UP, 0.5))
    step.velocity[0] = [0.0, 0.0, -0.3, 0.0, 0.0, 0.0]
    result = step.solve(solver, tolerance=1e-10, iterations=20000)
    assert result.converged
    np.testing.assert_array_equal(result.velocity[0], step.velocity[0])
    np.testing.assert_array_equal(result.impulse[-2], 0.0)
    assert np.abs(result.impulse).max() > 0.0


@both
def test_step_without_rows_changes_nothing(solver):
    step = random_step(1)
    step.rows = []
    result = step.solve(solver)
    assert (result.residual, result.iterations, result.converged) == (0.0, 0, True)
    np.testing.assert_array_equal(result.velocity, step.velocity)


@both
def test_inactive_environments_are_unchanged(solver):
    step = random_step(2)
    for row in step.rows:
        row.rolling = row.spinning = 0.1
    rows, moving, outcome = step.solve(solver, status=(0, 1, 2, 0)).arrays
    before = step.arrays(wp.float64, 4)
    for env, touched in enumerate((True, False, False, True)):
        for now, then in zip((rows, moving, outcome), before, strict=True):
            for name in ("impulse", "couple", "linear", "angular", "residual", "iterations", "converged"):
                values = [_values(one, name) for one in (now, then)]
                if values[0] is not None:
                    assert np.array_equal(values[0][env], values[1][env], True) != touched, (env, name)


def _values(arrays, name):
    """Values by name, from records or from a struct of arrays; None if absent."""
    if isinstance(arrays, wp.array):
        records = arrays.numpy()
        return records[name] if name in records.dtype.names else None
    return getattr(arrays, name).numpy() if hasattr(arrays, name) else None


@both
def test_non_finite_system_is_not_converged(solver):
    for place in ("velocity", "impulse"):
        step = random_step(2)
        if place == "velocity":
            step.velocity[1, 2] = np.nan
        else:
            step.rows[1].impulse = np.full(3, np.nan)
        result = step.solve(solver)
        assert not result.converged
        assert not np.isfinite(result.residual)


@both
def test_good_warm_start_is_kept_and_fair_one_saves_iterations(solver):
    step = tower([1.0, 1.0])
    cold = step.solve(solver, tolerance=1e-8)
    step.guess(cold.impulse)
    # Below the tolerance, Gauss–Seidel still stops standing bodies to rounding. If the bodies were at rest, it
    # keeps the impulses.
    step.guess(step.solve(solver, tolerance=1e-8).impulse)
    step.still = True
    warm = step.solve(solver, tolerance=1e-8)
    assert warm.iterations == 0
    np.testing.assert_array_equal(warm.impulse, [row.impulse for row in step.rows])
    for row in step.rows:
        row.impulse = row.impulse * 1.001
    assert 0 < step.solve(solver, tolerance=1e-8).iterations < 0.8 * cold.iterations


@both
def test_float32_solution_is_invariant_to_common_velocity(solver):
    """A tower that moves at 1000 m/s, where velocities are rounded to more than the tolerance."""
    step = tower([1.0, 1.0])
    still = step.solve(solver, wp.float32)
    for row in step.rows[:4]:
        row.first, row.second = 0, 2
    step.velocity = np.vstack([step.velocity, np.zeros(6)])
    step.inverse = np.concatenate([step.inverse, free(1e9, np.eye(3) * 1e9)[None]])
    step.velocity[:, 0] += 1000.0
    fast = step.solve(solver, wp.float32)
    assert fast.converged
    np.testing.assert_allclose(fast.impulse, still.impulse, atol=1e-5)


@both
def test_residual_is_reported_if_not_converged(solver):
    step = tower([1.0, 1.0, 1.0], push=0.3)
    result = step.solve(solver, tolerance=1e-12, iterations=5)
    assert not result.converged
    assert result.iterations == 5
    # The reported residual is correct.
    assert result.residual == pytest.approx(step.residual(result.impulse, result.velocity), rel=1e-9)
    assert result.residual > 1e-6


@both
@precisions
def test_tolerance_below_rounding_ends_the_iteration(solver, real):
    result = block(force=20.0).solve(solver, real, tolerance=1e-30, iterations=100000)
    # In float32 a residual may be exactly zero.
    assert result.converged == (result.residual == 0.0)
    assert result.iterations < 2000
    assert result.residual < (1e-14 if real == wp.float64 else 1e-6)


@both
def test_systems_with_large_friction_and_joints_are_solved(solver):
    """Up to μ = 2, where exact Gauss–Seidel steps cycle, and with joints, where they diverge.

    Solutions exist, because there are velocities at which all contacts separate.
    """
    for seed in (1004, 1009, 1015, 1016, 1025, 1041, 1056):
        step = random_step(seed, mu=2.0)
        assert_solved(step, step.solve(solver, tolerance=1e-10, iterations=3000), 1e-10)
    for seed in (16, 17):
        step = random_step(seed, bodies=2 + seed % 7, contacts=1 + seed % 23, mu=0.7, hinges=True)
        assert_solved(step, step.solve(solver, tolerance=1e-9, iterations=3000), 1e-9)


def test_second_solver_converges_if_the_first_cycles():
    step = random_step(1041, mu=3.0)
    alone = step.solve("gauss_seidel", tolerance=1e-10, iterations=3000)
    assert not alone.converged
    assert alone.residual > 1e-3
    # From the same warm start and velocities without contact.
    result = step.solve_in_turn(["gauss_seidel", "accelerated"], 1e-10, (100, 1000))
    assert_solved(step, result, 1e-10)
    assert 100 < result.iterations < 1100


def test_second_solver_keeps_the_solution_of_the_first():
    step = random_step(3)
    one = step.solve("gauss_seidel", tolerance=1e-10)
    two = step.solve_in_turn(["gauss_seidel", "accelerated"], 1e-10, (1000, 1000))
    np.testing.assert_array_equal(one.impulse, two.impulse)
    np.testing.assert_array_equal(one.velocity, two.velocity)
    assert one.iterations == two.iterations


def test_accelerated_solver_converges_for_hyperstatic_towers():
    """Ten cubes with four contacts each: Gauss–Seidel needs over 1000 sweeps, this solver under 200 iterations."""
    step = tower([1.0] * 10)
    slow = step.solve("gauss_seidel", tolerance=1e-10, iterations=400)
    fast = step.solve("accelerated", tolerance=1e-10, iterations=400)
    assert not slow.converged
    assert_solved(step, fast, 1e-10)
    np.testing.assert_allclose(fast.velocity, 0.0, atol=1e-9)


@both
def test_heavy_body_on_light_one_is_solved(solver):
    """Mass ratio of a thousand, pushed so that contacts slip: both solvers converge after thousands of iterations."""
    step = tower([1.0, 1000.0], push=0.1)
    assert_solved(step, step.solve(solver, tolerance=1e-9, iterations=20000), 1e-9)


def test_warm_start_is_passed_to_the_second_solver():
    step = tower([1.0, 10.0, 100.0, 1000.0], push=0.1)
    solved = step.solve("accelerated", tolerance=1e-9, iterations=20000)
    for row, impulse in zip(step.rows, solved.impulse, strict=True):
        row.impulse = impulse
    step.velocity[1, 0] += 1e-9
    result = step.solve_in_turn(["gauss_seidel", "accelerated"], 1e-10, (5, 400))
    alone = step.solve("accelerated", tolerance=1e-10, iterations=400)
    assert result.iterations == 5 + alone.iterations
    np.testing.assert_array_equal(result.impulse, alone.impulse)


@pytest.mark.slow
@pytest.mark.parametrize("hinges", [False, True])
@pytest.mark.parametrize("mu", [0.2, 0.7, 2.0])
def test_random_systems_are_solved_or_reported_as_not_converged(hinges, mu):
    """Runs the solvers in turn; if both fail, the reported residual is correct. Without motion all rows hold."""
    failed = 0
    for seed in range(1000):
        bodies = 2 + seed % 7
        step = random_step(seed, bodies, 1 + seed % (2 * bodies), mu, hinges, restitution_speed=0.0)
        result = step.solve_in_turn(["gauss_seidel", "accelerated"], 1e-9, (300, 3000))
        true = step.residual(result.impulse, result.velocity)
        assert result.residual == pytest.approx(true, rel=1e-3, abs=1e-12)
        assert result.converged == (result.residual <= 1e-9)
        failed += not result.converged
    assert failed <= 10


@pytest.mark.slow
def test_accelerated_solver_converges_for_tall_towers():
    """Thirty cubes: an iteration passes impulses to the next cube only, so some hundreds are needed."""
    step = tower([1.0] * 30)
    assert_solved(step, step.solve("accelerated", tolerance=1e-9, iterations=1500), 1e-9)
