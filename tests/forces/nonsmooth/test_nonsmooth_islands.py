"""Islands of a nonsmooth step: sets of bodies that contacts connect are solved by themselves, on handmade bodies and contacts."""

from dataclasses import replace

import nonsmooth_rows
import numpy as np
import pytest
import warp as wp
from nonsmooth_rows import DT, G, Step, launch, tower
from test_nonsmooth_solvers import assert_solved, ball, random_step
from warpcontact.kernels.nonsmooth import anderson
from warpcontact.kernels.types import WORLD


@pytest.fixture(autouse=True)
def on_device(device, monkeypatch):
    monkeypatch.setattr(nonsmooth_rows, "DEVICE", device)


def together(*steps):
    """One step with the bodies of several, and their rows in turn."""
    bodies, velocities, groups = [], [], []
    for step in steps:
        first = len(bodies)
        moved = {WORLD: WORLD} | {body: body + first for body in range(len(step.inverse))}
        groups.append([replace(row, first=moved[row.first], second=moved[row.second]) for row in step.rows])
        bodies += [(1.0 / m[0, 0], np.linalg.inv(m[3:, 3:])) for m in step.inverse]
        velocities += [(v[:3], v[3:]) for v in step.velocity]
    longest = max(len(group) for group in groups)
    return Step(bodies, velocities, [group[i] for i in range(longest) for group in groups if i < len(group)])


def parts(result, one, *steps):
    """The impulses and velocities of each of the steps in the result of all ``together``."""
    first = 0
    for step in steps:
        bodies = range(first, first + len(step.inverse))
        own = [i for i, row in enumerate(one.rows) if row.first in bodies or row.second in bodies]
        yield result.impulse[own], result.velocity[bodies.start : bodies.stop]
        first = bodies.stop


def test_islands_are_solved_as_if_alone():
    steps = [tower([1.0, 2.0, 0.5], push=0.3), tower([3.0, 1.0], mu=0.3), ball((0.1, 0.0, -G * DT), mu=0.2)]
    one = together(*steps)
    result = one.solve("gauss_seidel", tolerance=1e-10)
    assert_solved(one, result, 1e-10)
    alone = [step.solve("gauss_seidel", tolerance=1e-10) for step in steps]
    assert result.iterations == max(each.iterations for each in alone)
    for (impulse, velocity), each in zip(parts(result, one, *steps), alone, strict=True):
        np.testing.assert_array_equal(impulse, each.impulse)
        np.testing.assert_array_equal(velocity, each.velocity)


def test_second_solver_changes_only_islands_that_the_first_did_not_solve():
    steps = [tower([1.0, 2.0], push=0.3), random_step(1041, mu=3.0), tower([2.0, 2.0], push=0.1)]
    one = together(*steps)
    result = one.solve_in_turn(["gauss_seidel", "accelerated"], 1e-10, (300, 2000))
    assert_solved(one, result, 1e-10)
    assert result.iterations > 300
    assert result.residual == pytest.approx(one.residual(result.impulse, result.velocity), rel=1e-3)
    found = list(parts(result, one, *steps))
    for i in (0, 2):
        alone = steps[i].solve("gauss_seidel", tolerance=1e-10, iterations=300)
        assert alone.converged
        np.testing.assert_array_equal(found[i][0], alone.impulse)
        np.testing.assert_array_equal(found[i][1], alone.velocity)


def test_tower_is_stopped_exactly_beside_a_body_that_moves():
    standing, sliding = tower([1.0, 3.0]), tower([1.0, 1.0], push=0.5, mu=0.2)
    standing.guess([[0.0, 0.0, G * DT * weight / 4.1] for weight in (4.0, 3.0) for _ in range(4)])
    one = together(standing, sliding)
    result = one.solve("gauss_seidel", tolerance=1e-8)
    assert result.converged
    assert not result.velocity[:2].any()
    assert result.velocity[3, 0] > 0.4


def test_start_changes_only_marked_rows():
    """The load of the upper cube is shared, with the impulses below held fixed."""
    step = tower([1.0, 1.0])
    step.guess([[0.0, 0.0, G * DT * 2.0 / 4.0]] * 4 + [[0.0, 0.0, 0.0]] * 4)
    rows, moving, outcome = step.arrays(wp.float64, 1)
    values = rows.numpy()
    values["is_unsolved"][0, 4:8] = 1
    rows.assign(values)
    outcome.was_cleared = wp.full(1, 1, dtype=wp.int32, device=nonsmooth_rows.DEVICE)
    launch("accelerated", (rows, moving, outcome), wp.float64, False, False, 1e-12, 20, (0,), is_start=True)
    impulse = rows.numpy()["impulse"][0]
    np.testing.assert_array_equal(impulse[:4], [[0.0, 0.0, G * DT / 2.0]] * 4)
    # Impulses below of twice the weight of a cube stop both: four equal loads above.
    np.testing.assert_allclose(impulse[4:8, 2], G * DT / 4.0, rtol=1e-3)
    # Velocities do not change before the solve.
    np.testing.assert_array_equal(moving.numpy()["linear"][0], step.velocity[:, :3])


@wp.kernel(enable_backward=False)
def combine(
    gram: wp.array(dtype=anderson.types(wp.float64).Gram),
    products: wp.array(dtype=anderson.types(wp.float64).Products),
    number: wp.array(dtype=wp.int32),
    out: wp.array(dtype=anderson.types(wp.float64).Products),
):
    i = wp.tid()
    out[i] = wp.static(anderson.combination(wp.float64))(gram[i], products[i], number[i])


def test_combination_of_sweeps_is_the_least_squares_solution(device):
    rng = np.random.default_rng(5)
    count = anderson.HISTORY
    differences = rng.normal(size=(6, 30, count))
    step = rng.normal(size=(6, 30))
    numbers = np.array([0, 1, 2, count, count, count], np.int32)
    # A difference that repeats another one, and one that is zero.
    differences[4, :, 2] = differences[4, :, 0]
    differences[5, :, 1] = 0.0
    gram = np.einsum("eki,ekj->eij", differences, differences)
    products = np.einsum("eki,ek->ei", differences, step)
    types = anderson.types(wp.float64)
    inputs = [
        wp.array(gram, dtype=types.Gram, device=device),
        wp.array(products, dtype=types.Products, device=device),
        wp.array(numbers, device=device),
    ]
    out = wp.zeros(6, dtype=types.Products, device=device)
    wp.launch(combine, 6, inputs, [out], device=device)
    for i, number in enumerate(numbers):
        coefficients = out.numpy()[i]
        assert not coefficients[number:].any()
        expected = np.linalg.lstsq(differences[i, :, :number], step[i], rcond=None)[0]
        # Coefficients of equal differences are not unique, but their sum.
        np.testing.assert_allclose(differences[i] @ coefficients, differences[i, :, :number] @ expected, atol=1e-6)


def test_environment_that_is_not_finite_is_not_solved_by_the_second_solver():
    step = tower([1.0, 2.0], push=0.3)
    step.velocity[0, 0] = np.nan
    result = step.solve_in_turn(["gauss_seidel", "accelerated"], 1e-10, (300, 2000))
    assert not result.converged
    assert np.isnan(result.residual)
