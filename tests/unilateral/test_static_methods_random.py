"""Random static problems with each method, against the contact law and the set of all solutions."""

import numpy as np
import pytest

from warpcontact.unilateral import Problem, Termination

METHODS = ["projection", "enumeration", "gauss_seidel", "energy", "prox"]
KINDS = ["definite", "semidefinite", "indefinite", "singular_indefinite"]


def random_problem(rng, kind, dim):
    """1 to 6 displacements and 1 to 6 contacts, or 3 with friction; some contacts are redundant."""
    n, m = rng.integers(1, 7), rng.integers(1, 7 if dim == 1 else 4)
    turn, sizes = np.linalg.qr(rng.normal(size=(n, n)))[0], rng.uniform(0.2, 3.0, n)
    if kind in ("semidefinite", "indefinite"):
        sizes[: rng.integers(1, n + 1)] *= 0.0 if kind == "semidefinite" else -1.0
    elif kind == "singular_indefinite":
        sizes[0], sizes[1:2] = 0.0, -sizes[1:2]
    K = (turn * sizes) @ turn.T
    G = rng.normal(size=(m, dim, n))
    if m > 1 and rng.random() < 0.3:
        G[1] = rng.uniform(0.5, 2.0) * G[0]
    # Gaps are open or closed at some displacement, or arbitrary.
    d = np.abs(rng.normal(size=m)) * (rng.random(m) < 0.8)
    if rng.random() < 0.5:
        d += G[:, 0] @ rng.normal(size=n)
    f = 2.0 * rng.normal(size=n)
    if rng.random() < 0.8:
        # A load that springs and contacts can balance.
        f = K @ rng.normal(size=n) + G[:, 0].T @ np.abs(rng.normal(size=m))
    if dim == 1:
        return Problem(0.5 * (K + K.T), f, G[:, 0], d)
    previous = 0.2 * rng.normal(size=(m, dim - 1))
    return Problem(0.5 * (K + K.T), f, G, d, rng.uniform(0.05, 1.0), previous)


def violation(problem, solution):
    """Violation of equilibrium and of the contact law, relative to the largest length and the largest force."""
    u, lam = solution.u, solution.lam.reshape(problem.contacts, problem.dim)
    w = problem.targets() - problem.G @ u
    length = max(np.abs(problem.targets()).max(), np.abs(u).max()) or 1.0
    force = np.abs(problem.f).max() + np.abs(lam).max() + np.abs(problem.K).max() * np.abs(u).max() or 1.0
    off = [
        problem.K @ u + np.einsum("mdn,md->n", problem.G, lam) - problem.f,
        np.minimum(lam[:, 0] / force, w[:, 0] / length) * force,
    ]
    if problem.dim > 1:
        slip, across = np.linalg.norm(w[:, 1:], axis=1), np.linalg.norm(lam[:, 1:], axis=1)
        limit = problem.mu * lam[:, 0]
        against = np.linalg.norm(lam[:, 1:] * slip[:, None] + limit[:, None] * w[:, 1:], axis=1)
        off += [np.maximum(across - limit, 0.0), against / length]
    return max(np.abs(one).max() for one in off) / force


def is_isolated(problem):
    """Whether solutions are isolated; with friction, singular K or redundant contacts allow a continuum."""
    rows = problem.G.reshape(-1, problem.G.shape[-1])
    regular = np.abs(np.linalg.eigvalsh(problem.K)).min() > 1e-9
    return problem.dim == 1 or (regular and np.linalg.matrix_rank(rows) == len(rows))


def check(problem, method, solutions):
    """Checks a solution of ``method``; ``solutions``: all solutions, or None if enumeration is not possible."""
    solution = problem.solve(method)
    if solution.converged:
        assert violation(problem, solution) < 1e-9
        if solutions is not None and solution.termination == Termination.CONVERGED and is_isolated(problem):
            size = max(1.0, np.abs(solution.u).max())
            assert min(np.abs(solution.u - one.u).max() for one in solutions) < 1e-7 * size
    elif solution.termination == Termination.UNBOUNDED:
        v = solution.direction
        assert np.abs(problem.K @ v).max() < 1e-9
        assert problem.f @ v > 0.0
        assert (problem.G[:, 0] @ v < 1e-9).all()
    # The default method and enumeration find a solution if one exists; others may report no convergence.
    complete = method in ("projection", "enumeration") or solution.termination != Termination.NOT_CONVERGED
    if solutions is not None and complete:
        assert solution.converged == bool(solutions)
    return solution.converged


def compare(seed, count, kind, dim, methods):
    """Returns the share of problems with a solution that each method solves."""
    rng = np.random.default_rng([seed, KINDS.index(kind), dim])
    solved, solvable = dict.fromkeys(methods, 0), 0
    for _ in range(count):
        problem = random_problem(rng, kind, dim)
        solutions = problem.all_solutions() if dim < 3 else None
        results = {method: check(problem, method, solutions) for method in methods}
        solvable += bool(solutions) if solutions is not None else any(results.values())
        for method, converged in results.items():
            solved[method] += converged
    assert solvable > 0
    return {method: number / solvable for method, number in solved.items()}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [1, 2])
def test_solution_is_one_of_all_solutions_or_reported_as_missing(kind, dim):
    solved = compare(0, 12, kind, dim, METHODS)
    # Without friction the energy is convex, and every method finds its minimum.
    if dim == 1 and kind == "definite":
        assert min(solved.values()) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_many_random_problems_are_solved_or_reported(kind, dim, times):
    """100, or 500 with --thorough."""
    methods = METHODS if dim < 3 else [method for method in METHODS if method != "enumeration"]
    solved = compare(1, 100 * times, kind, dim, methods)
    print(kind, dim, solved)
    if dim == 1 and kind == "definite":
        assert min(solved.values()) == 1.0
    if dim == 1 and kind == "semidefinite":
        assert min(solved.values()) > 0.95


@pytest.mark.parametrize("method", ["projection", "gauss_seidel", "energy"])
def test_redundant_contacts_on_semidefinite_stiffness_are_solved(method):
    # 12 displacements, 4 of them free, on 30 contacts with stiffnesses of 1 to 100.
    rng = np.random.default_rng(5)
    turn, sizes = np.linalg.qr(rng.normal(size=(12, 12)))[0], 10 ** rng.uniform(0.0, 2.0, 12)
    sizes[:4] = 0.0
    K, G, at = (turn * sizes) @ turn.T, rng.normal(size=(30, 12)), rng.normal(size=12)
    d = G @ at + np.abs(rng.normal(size=30)) * (rng.random(30) < 0.5)
    f = K @ rng.normal(size=12) + G.T @ np.abs(rng.normal(size=30))
    problem = Problem(0.5 * (K + K.T), f, G, d)
    solution = problem.solve(method)
    assert solution.converged
    assert violation(problem, solution) < 1e-12
