"""Residual of static problems: definition, units, and gaps far smaller than deflections."""

import sys

import numpy as np
import pytest

from warpcontact.unilateral import Problem, solve
from warpcontact.unilateral.solution import ResidualEvaluator

METHODS = ["projection", "gauss_seidel", "energy", "prox", "enumeration"]


def residual(problem, u, lam):
    """Residual of one problem at given displacements and forces."""
    lam = np.reshape(np.asarray(lam, dtype=float), (problem.contacts, problem.dim))
    return ResidualEvaluator.of(problem).residual(np.array([u], dtype=float), lam[None])[0]


# A spring of 1000 N/m, 25 N against a wall at 10 mm: u = 0.01 m, λ = 15 N.
SPRING = Problem(1000.0, 25.0, 1.0, 0.01)


def test_gap_violation_is_relative_to_the_length():
    # Equilibrium holds: K u + λ = f.
    for off in (1e-3, -1e-3, 1e-9, -1e-9):
        u = 0.01 + off * 0.01
        assert residual(SPRING, [u], [25.0 - 1000.0 * u]) == pytest.approx(abs(off), rel=2e-3)
    # Without a gap, the reference length is the deflection of the spring by load and contact.
    bare = Problem(1000.0, 25.0, 1.0, 0.0)
    assert residual(bare, [1e-3], [24.0]) == pytest.approx(1e-3 / 0.049)


def test_force_violation_is_relative_to_the_terms_of_equilibrium():
    # The terms are 25 N of load, 10 N of the spring and 15 N of the wall.
    assert residual(SPRING, [0.01], [15.0 + 1e-6 * 50.0]) == pytest.approx(1e-6, rel=1e-5)
    # A wall that pulls with 5 N, where the mass would rest at 5 mm.
    assert residual(Problem(1000.0, 5.0, 1.0, 0.01), [0.01], [-5.0]) == pytest.approx(5.0 / 20.0)


def test_friction_violation_is_the_share_outside_of_the_cone_or_against_slip():
    # Sticks with 4 N of at most 4.5 N; tangential terms are 4 N of load and 4 N of friction.
    stick = Problem(np.diag([1000.0, 500.0]), [25.0, 4.0], np.eye(2)[None], [0.01], 0.3)
    assert residual(stick, [0.01, 0.0], [15.0, 4.0]) < 1e-15
    slip = Problem(np.diag([1000.0, 500.0]), [25.0, 6.0], np.eye(2)[None], [0.01], 0.3)
    assert residual(slip, [0.01, 0.003], [15.0, 4.5]) < 1e-15
    # 0.9 N outside of the cone, over 12 N of terms.
    assert residual(slip, [0.01, 0.0012], [15.0, 5.4]) == pytest.approx(0.9 / 12.0)
    # Too little friction for that slip: the smaller of 0.5 N over 12 N and the slip over 10 mm.
    assert residual(slip, [0.01, 0.004], [15.0, 4.0]) == pytest.approx(0.5 / 12.0)


@pytest.mark.parametrize("shared", [True, False])
def test_residual_force_scale_is_the_minimum_over_the_rows_of_a_contact(shared):
    rng = np.random.default_rng(5)
    problems, contacts, n = 4, 6, 9
    G = rng.normal(size=(1 if shared else problems, contacts, 2, n))
    G[rng.random((len(G), contacts, 1, n)).repeat(2, axis=2) < 0.6] = 0.0
    G[:, 1] = 0.0  # not in any row
    G[:, 2, :, :3], G[:, 2, :, 3:] = 1.0, 1e-12  # rounding of zero
    K, f = np.eye(n)[None], rng.normal(size=(problems, n))
    evaluator = ResidualEvaluator(K, f, G, np.zeros((1, contacts, 2)), np.full((1, contacts), 0.3))
    u, lam = rng.normal(size=(problems, n)), rng.normal(size=(problems, contacts, 2))
    sizes = np.broadcast_to(np.abs(G), (problems, *G.shape[1:]))
    terms = np.abs(f) + np.abs(u) + np.einsum("pmdn,pmd->pn", sizes, np.abs(lam))
    expected = np.full((problems, contacts), np.inf)
    for p in range(problems):
        entries = sizes[p].max(axis=1)
        for i in range(contacts):
            for row in range(n):
                scaled = entries[i] * evaluator.scale[p % len(evaluator.scale)]
                if scaled[row] > 1e-6 * scaled.max():
                    expected[p, i] = min(expected[p, i], terms[p, row] / entries[i, row])
    expected[:, 1] = expected[:, [0, 2, 3, 4, 5]].max(axis=1)
    np.testing.assert_allclose(evaluator.scales(u, lam).force, expected, rtol=1e-12)


def test_cost_of_the_residual_does_not_grow_with_contacts():
    def calls(contacts):
        one, nothing = np.eye(contacts), np.zeros((1, contacts))
        evaluator = ResidualEvaluator(
            one[None], np.ones((1, contacts)), one[None, :, None], nothing[..., None], nothing
        )
        profile, found = sys.getprofile(), []
        sys.setprofile(lambda frame, event, arg: found.append(event))
        try:
            evaluator.residual(np.ones((1, contacts)), np.ones((1, contacts, 1)))
        finally:
            sys.setprofile(profile)
        return len(found)

    assert calls(50) == calls(5) > 10


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dim", [1, 2])
def test_residual_does_not_depend_on_units(method, dim):
    # Displacements in mm and rad, mm and degrees; loads in kN.
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6))
    K, G, f = 1e5 * (A @ A.T + 0.1 * np.eye(6)), rng.normal(size=(3, dim, 6)), 1e3 * rng.normal(size=6)
    d, mu = 1e-3 * rng.random(3), 0.3 * (dim > 1)
    one = solve(K, f, G if dim > 1 else G[:, 0], d, mu, method=method)
    assert one.converged
    for length, force in ((1e3, 1e-3), (1e-6, 1e9)):
        unit = np.array([length, length, length, 1.0, 1.0, 180.0 / np.pi])
        rows = G * length / unit
        other = solve(
            K * force * length / np.outer(unit, unit),
            f * force * length / unit,
            rows if dim > 1 else rows[:, 0],
            d * length,
            mu,
            method=method,
        )
        assert other.converged
        np.testing.assert_array_equal(other.status, one.status)
        np.testing.assert_allclose(other.u / unit, one.u, rtol=1e-6, atol=1e-9 * np.abs(one.u).max())
        np.testing.assert_allclose(other.lam / force, one.lam, rtol=1e-6, atol=1e-9 * np.abs(one.lam).max())


@pytest.mark.parametrize("method", METHODS)
def test_gap_below_the_tolerance_of_the_deflection_is_not_converged(method):
    # The load would deflect the spring by 1e4 m; the gap is 0.1 m.
    problem = Problem(1e-4, 1.0, 1.0, 0.1)
    assert residual(problem, [0.1 + 3.5e-7], [1.0 - 1e-4 * (0.1 + 3.5e-7)]) > 3e-6
    solution = problem.solve(method)
    assert solution.converged
    assert abs(solution.gap[0]) <= 1e-10 * 0.1


@pytest.mark.parametrize("method", METHODS[:4])
def test_residual_after_iteration_limit_is_that_of_the_returned_solution(method):
    rng = np.random.default_rng(2)
    A, G = rng.normal(size=(9, 9)), rng.normal(size=(3, 3, 9))
    problem = Problem(A @ A.T + np.eye(9), 20.0 * G[:, 0].sum(axis=0), G, 0.1 * np.ones(3), 0.4)
    solution = problem.solve(method, iterations=1, tolerance=1e-12)
    assert not solution.converged
    assert solution.residual == pytest.approx(residual(problem, solution.u, solution.lam), rel=1e-12)
    assert solution.residual > 1e-9
