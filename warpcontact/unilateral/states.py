"""All solutions of a single problem, by the states of its contacts; K may be indefinite or singular."""

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from warpcontact.checks import Array
from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.elimination import ROUNDINGS, SingularError, eliminate
from warpcontact.unilateral.enumeration import check_size, rows_of, solve_all, states
from warpcontact.unilateral.problem import Problem
from warpcontact.unilateral.solution import Solution

# Solutions that differ by less than this part of what is usual are one.
_ALIKE = 1e-8


@dataclass(frozen=True)
class Sizes:
    """What displacements and forces of a problem are compared with, where those of a solution are rounding.

    Attributes:
        u: Largest displacement without contact.
        lam: Largest force that would open or close a gap as wide as those parts that it is the difference of.
    """

    u: float
    lam: float

    def same_u(self, one: Solution, other: Solution) -> bool:
        """Whether both have the same displacements."""
        return _near(np.asarray(one.u), np.asarray(other.u), self.u)

    def same_lam(self, one: Solution, other: Solution) -> bool:
        """Whether both have the same forces."""
        return _near(one.lam, other.lam, self.lam)


def sizes(problem: Problem) -> Sizes:
    """Returns what solutions of a single problem are compared with."""
    system, u_free = _judge(problem)
    parts = system.rounding / ROUNDINGS
    return Sizes(float(np.abs(u_free).max()), float((system.rho * parts).max(initial=0.0)))


def all_solutions(problem: Problem, tolerance: float) -> list[Solution]:
    """Returns the different solutions of a single problem."""
    found: list[Solution] = []
    usual: Sizes | None = None
    for solution in _solutions(problem, tolerance):
        usual = sizes(problem) if usual is None else usual
        if not any(usual.same_u(solution, other) and usual.same_lam(solution, other) for other in found):
            found.append(solution)
    return found


def first_solution(problem: Problem, tolerance: float) -> Solution:
    """Returns the first solution found, or the state that is least off."""
    solution = next(_solutions(problem, tolerance), None)
    if solution is None:
        solution = min(_solutions(problem, None), key=lambda one: one.residual, default=None)
    return _without_contact(problem) if solution is None else solution


def _without_contact(problem: Problem) -> Solution:
    """Returns what is no solution: the load is one that nothing holds in any state."""
    from warpcontact.unilateral.solving import finish

    K = problem.K.toarray() if hasattr(problem.K, "tocsc") else np.asarray(problem.K)
    u = np.linalg.pinv(K, rcond=1e-12) @ np.asarray(problem.f)
    targets = problem.targets()
    w = targets - (np.asarray(problem.G) @ u).reshape(targets.shape)
    number = np.array([(2 * problem.dim) ** problem.contacts])
    none = np.zeros((1, *targets.shape))
    system = _judge(problem)[0]
    left = finish(system, none, w[None], u[None], number, 1e-10, "enumeration", problem, True)
    return replace(left, residual=np.inf, converged=False)


def _near(one: Array, other: Array, usual: float) -> bool:
    size = max(np.abs([one, other]).max(initial=0.0), usual)
    return bool(np.abs(one - other).max(initial=0.0) <= _ALIKE * size)


def _solutions(problem: Problem, tolerance: float | None) -> Iterator[Solution]:
    """Yields what is a solution to the tolerance, or without one all that keeps equilibrium."""
    from warpcontact.unilateral.solving import finish

    if problem.count is not None:
        raise ValueError(f"all states are gone through of a single problem, got {problem.count} problems")
    K = problem.K.toarray() if hasattr(problem.K, "tocsc") else np.asarray(problem.K)
    f, targets = np.asarray(problem.f), problem.targets()
    system, n = _judge(problem)[0], len(K)
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
        many = Delassus(part.W, np.broadcast_to(part.q, (len(x), *part.q.shape[1:])), part.mu, part.rounding)
        residual = many.residual(lam[..., : part.dim], w[..., : part.dim])
        allowed = np.inf if tolerance is None else tolerance
        for k in np.flatnonzero((off <= 1e-11 * parts) & (residual <= allowed)):
            one = slice(k, k + 1)
            number = np.array([taken + k + 1])
            judged = 1e-10 if tolerance is None else tolerance
            yield finish(system, lam[one], w[one], u[one], number, judged, "enumeration", problem, True)
        taken += len(x)


def _judge(problem: Problem) -> tuple[Delassus, Array]:
    """Returns what judges solutions, and u without contact; of a singular K its largest entry is in its place."""
    try:
        return eliminate(problem)[:2]
    except SingularError:
        stiff = copy.copy(problem)
        stiff.K = (abs(problem.K).max() or 1.0) * np.eye(problem.K.shape[-1])
        return eliminate(stiff)[:2]
