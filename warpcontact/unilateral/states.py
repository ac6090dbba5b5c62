"""All solutions of a single problem, by the states of its contacts; K may be indefinite or singular."""

from collections.abc import Iterator

import numpy as np

from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.elimination import SingularError, eliminate
from warpcontact.unilateral.enumeration import check_size, rows_of, solve_all, states
from warpcontact.unilateral.problem import Problem
from warpcontact.unilateral.solution import Solution


def all_solutions(problem: Problem, tolerance: float) -> list[Solution]:
    """Returns the different solutions of a single problem."""
    found: list[Solution] = []
    for solution in _solutions(problem, tolerance):
        if all(not _alike(solution, other) for other in found):
            found.append(solution)
    return found


def first_solution(problem: Problem, tolerance: float) -> Solution:
    """Returns the first solution found, or the state that is least off."""
    solution = next(_solutions(problem, tolerance), None)
    return min(_solutions(problem, None), key=lambda one: one.residual) if solution is None else solution


def _alike(one: Solution, other: Solution) -> bool:
    def near(a: np.ndarray, b: np.ndarray) -> bool:
        return bool(np.abs(a - b).max(initial=0.0) <= 1e-8 * np.abs([a, b]).max(initial=0.0))

    return near(one.lam, other.lam) and near(one.u, other.u)  # type: ignore[arg-type]


def _solutions(problem: Problem, tolerance: float | None) -> Iterator[Solution]:
    """Yields what is a solution to the tolerance, or without one all that keeps equilibrium."""
    from warpcontact.unilateral.solve import finish

    if problem.count is not None:
        raise ValueError(f"all states are gone through of a single problem, got {problem.count} problems")
    K = problem.K.toarray() if hasattr(problem.K, "tocsc") else np.asarray(problem.K)
    f, targets = np.asarray(problem.f), problem.targets()
    system, n = _judge(problem, K), len(K)
    # Without friction, normals alone.
    part = system if system.mu.any() else system.normals()
    check_size(part)
    rows = part.contacts * part.dim
    G = np.asarray(problem.G)[:, : part.dim].reshape(rows, n)
    target = targets[:, : part.dim].reshape(rows)
    # All in forces: the unknowns s u and λ, the equations of equilibrium, and gaps times s.
    s = part.rho.max(initial=0.0) or 1.0
    gaps = np.concatenate([-G, np.zeros((rows, rows))], axis=1)
    forces = np.concatenate([np.zeros((rows, n)), np.eye(rows)], axis=1)
    equilibrium = np.concatenate([K / s, G.T], axis=1)
    taken = 0
    for chunk in states(part.contacts, part.dim):
        matrix, right = rows_of(chunk, gaps, s * target, forces, part)
        matrix = np.concatenate([np.broadcast_to(equilibrium, (len(chunk), n, n + rows)), matrix], axis=1)
        right = np.concatenate([np.broadcast_to(f, (len(chunk), n)), right], axis=1)
        x = solve_all(matrix, right)
        u, lam = x[:, :n] / s, np.zeros((len(x), *targets.shape))
        lam[..., : part.dim] = x[:, n:].reshape(len(x), -1, part.dim)
        # Of a singular system there may be no solution.
        off = np.abs(u @ K + x[:, n:] @ G - f).max(axis=1, initial=0.0)
        parts = (np.abs(u) @ np.abs(K) + np.abs(x[:, n:]) @ np.abs(G) + np.abs(f)).max(axis=1, initial=0.0)
        w = targets - (u @ np.asarray(problem.G).reshape(-1, n).T).reshape(lam.shape)
        many = Delassus(part.W, np.broadcast_to(part.q, (len(x), *part.q.shape[1:])), part.mu)
        residual = many.residual(lam[..., : part.dim], w[..., : part.dim])
        allowed = np.inf if tolerance is None else tolerance
        for k in np.flatnonzero((off <= 1e-11 * parts) & (residual <= allowed)):
            one = slice(k, k + 1)
            number = np.array([taken + k + 1])
            judged = 1e-10 if tolerance is None else tolerance
            yield finish(system, lam[one], w[one], u[one], number, judged, "enumeration", problem, True)
        taken += len(x)


def _judge(problem: Problem, K: np.ndarray) -> Delassus:
    """Returns what judges solutions; of a singular K, with its largest entry in place of K."""
    try:
        return eliminate(problem)[0]
    except SingularError:
        size = np.abs(K).max() or 1.0
        G = np.asarray(problem.G)
        flat = G.reshape(-1, len(K))
        q = problem.targets() - G @ np.asarray(problem.f) / size
        return Delassus(flat @ flat.T[None] / size, q[None], np.asarray(problem.mu)[None])
