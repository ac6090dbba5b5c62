"""Fast slip, which Gauss–Seidel solves by its direction, gives the results of the slip equation."""

import numpy as np
import pytest
from nonsmooth_rows import UP, Row, Step
from warpcontact.kernels.nonsmooth import gauss_seidel, row_solution
from warpcontact.kernels.types import WORLD


@pytest.fixture
def by_equation(monkeypatch):
    """Solves a step without the search over directions."""

    def clear_caches():
        gauss_seidel.kernel.cache_clear()
        row_solution.functions.cache_clear()

    def solve(step, **options):
        monkeypatch.setattr(row_solution, "MAX_SLIP_ITERATIONS", 0)
        clear_caches()
        result = step.solve("gauss_seidel", **options)
        monkeypatch.undo()
        clear_caches()
        return result

    return solve


def slipping(rng, bodies, has_joints, mu):
    """Bodies that slip fast on the ground, or on each other, at one contact."""
    inverse = [(2.0, np.diag(rng.uniform(0.1, 0.3, 3))) for _ in range(bodies)]
    if has_joints:
        free = Step(inverse, np.zeros((bodies, 2, 3)), []).inverse
        # Directional mass coupled with rotation, as for a body with a joint.
        couplings = rng.uniform(-0.2, 0.2, (bodies, 6, 6))
        inverse = [one + coupling @ coupling.T for one, coupling in zip(free, couplings, strict=True)]
    velocities = rng.uniform(-1.0, 1.0, (bodies, 2, 3))
    arms = rng.uniform(-0.3, 0.3, (2, 3))
    step = Step(inverse, velocities, [Row(0, 1 if bodies == 2 else WORLD, *arms, UP, mu)])
    # Fast slip and slow approach.
    wanted = np.concatenate([rng.uniform(-0.1, -0.01, 1), rng.uniform(2.0, 4.0, 2)])
    _, q = step.dense()
    R = step.jacobian()[:, :3]
    step.velocity[0, :3] += np.linalg.solve(R, wanted - q)
    return step


@pytest.mark.parametrize("mu", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("has_joints", [False, True])
@pytest.mark.parametrize("bodies", [1, 2])
def test_single_slip_solve_matches_its_equation(bodies, has_joints, mu, by_equation):
    rng = np.random.default_rng(5)
    for _ in range(3):
        step = slipping(rng, bodies, has_joints, mu)
        found = step.solve("gauss_seidel", iterations=1)
        expected = by_equation(step, iterations=1)
        assert found.converged
        assert found.iterations == 1
        np.testing.assert_allclose(found.impulse, expected.impulse, rtol=1e-11, atol=1e-13)
        assert np.linalg.norm(found.impulse) > 0.0


@pytest.mark.parametrize("number", range(8))
def test_impulse_is_bounded_for_immobile_contact_direction(number):
    """A slider along the ground: the normal direction is immobile up to rounding."""
    turn = 0.1 + 0.37 * number
    axis = np.array([np.cos(turn), np.sin(turn), 0.0])
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    inverse = np.zeros((6, 6))
    inverse[:3, :3] = np.outer(tilt @ axis, tilt @ axis)
    step = Step([inverse], [(tilt @ axis, np.zeros(3))], [])
    step.rows = [Row(0, WORLD, np.zeros(3), np.zeros(3), tilt @ UP, 0.0, restitution_speed=0.01)]
    result = step.solve("gauss_seidel", iterations=1)
    # Bound from the relaxed row: a hundredth of the mass, three times.
    assert np.abs(result.impulse).max() < 5.0
    assert not result.converged
