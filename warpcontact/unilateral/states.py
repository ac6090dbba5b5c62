"""All solutions of a single problem, by enumeration of contact states; K may be indefinite or singular."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.enumeration import (
    OPEN,
    SLIP_DOWN,
    SLIP_UP,
    STICK,
    check_size,
    solve_all,
    state_equations,
    states,
)
from warpcontact.unilateral.freedom import row_null_space
from warpcontact.unilateral.polish import refine
from warpcontact.unilateral.residual import ResidualEvaluator
from warpcontact.unilateral.scaled import ScaledProblem
from warpcontact.unilateral.solution import RawSolution, Solution, Termination, solution_of_displacements
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

# Relative difference, in scaled units, below which two solutions are the same.
_ALIKE = 1e-8
# Residual of a state below which it is refined.
_REFINE_BELOW = 1e-6


@dataclass(frozen=True)
class ContactState:
    """A combination of contact states that satisfies equilibrium.

    Attributes:
        u: Scaled displacements (n,).
        lam: Scaled forces (contacts, dim).
        residual: Residual.
        number: Number of states up to it.
    """

    u: Array
    lam: Array
    residual: float
    number: int

    def same_u(self, other: "ContactState") -> bool:
        """Returns whether both have the same displacements."""
        return self._is_close(self.u, other.u, other)

    def same_lam(self, other: "ContactState") -> bool:
        """Returns whether both have the same forces."""
        return self._is_close(self.lam, other.lam, other)

    def _is_close(self, one: Array, another: Array, other: "ContactState") -> bool:
        # Loads and gaps are of order 1.
        size = max(1.0, *(np.abs(x).max(initial=0.0) for x in (self.u, self.lam, other.u, other.lam)))
        return bool(np.abs(one - another).max(initial=0.0) <= _ALIKE * size)


def all_states(problem: "Problem", tolerance: float) -> tuple[ScaledProblem, list[ContactState]]:
    """Returns a single problem, scaled, and the states that are distinct solutions of it."""
    if problem.count is not None:
        raise ValueError(f"all_solutions() supports a single problem only, got {problem.count} problems")
    scaled = ScaledProblem.of(problem)
    found: list[ContactState] = []
    for state in solutions(scaled, tolerance):
        if not any(state.same_u(other) and state.same_lam(other) for other in found):
            found.append(state)
    return scaled, found


def all_solutions(problem: "Problem", tolerance: float) -> list[Solution]:
    """Returns the distinct solutions of a single problem."""
    return as_solutions(problem, *all_states(problem, tolerance), tolerance)


def as_solutions(
    problem: "Problem", scaled: ScaledProblem, found: list[ContactState], tolerance: float
) -> list[Solution]:
    """Returns states of a single problem as solutions in its units."""
    evaluator, listed = ResidualEvaluator.of(problem), []
    for state in found:
        u, lam = scaled.from_scaled(state.u, state.lam)
        number, converged = np.array([state.number]), np.array([int(Termination.CONVERGED)])
        one = RawSolution(u[None], lam[None], number, converged, np.zeros((1, len(u))))
        listed.append(solution_of_displacements(problem, evaluator, one, tolerance, "enumeration"))
    return listed


def solutions(scaled: ScaledProblem, tolerance: float) -> Iterator[ContactState]:
    """Yields the states that are solutions to the tolerance."""
    for state in candidates(scaled):
        if state.residual <= _REFINE_BELOW:
            u, lam, residual = refine(scaled, state.u, state.lam)
            if residual <= tolerance:
                yield ContactState(u, lam, residual, state.number)


def candidates(scaled: ScaledProblem) -> Iterator[ContactState]:
    """Yields displacements and forces for each combination of contact states."""
    contacts, dim, n = scaled.contacts, scaled.dim, len(scaled.f)
    check_size(contacts, dim)
    rows, G, target = contacts * dim, scaled.flat_rows(), scaled.targets.reshape(-1)
    gaps = np.concatenate([-G, np.zeros((rows, rows))], axis=1)
    forces = np.concatenate([np.zeros((rows, n)), np.eye(rows)], axis=1)
    equilibrium = np.concatenate([scaled.dense(), G.T], axis=1)
    taken = 0
    for chunk in states(contacts, dim):
        matrix, right = state_equations(chunk, gaps, target, forces, scaled.mu, dim)
        matrix = np.concatenate([np.broadcast_to(equilibrium, (len(chunk), n, n + rows)), matrix], axis=1)
        right = np.concatenate([np.broadcast_to(scaled.f, (len(chunk), n)), right], axis=1)
        x = solve_all(matrix, right)
        u, lam = x[:, :n], x[:, n:].reshape(len(x), contacts, dim)
        for k, residual in enumerate(scaled.evaluator.residual(u, lam)):
            number = taken + k + 1
            if dim == 2 and residual > _REFINE_BELOW:
                other = _admissible(scaled, chunk[k], matrix[k], right[k], x[k])
                if other is not None:
                    one, forces_of = other[:n], other[n:].reshape(contacts, dim)
                    yield ContactState(one, forces_of, scaled.residual(one, forces_of), number)
                    continue
            yield ContactState(u[k], lam[k], float(residual), number)
        taken += len(x)


def _admissible(
    scaled: ScaledProblem, state: NDArray[np.int64], matrix: Array, right: Array, x: Array
) -> Array | None:
    """Returns a solution of the equations of a singular state that satisfies its inequalities, or None.

    Args:
        scaled: The problem, in the plane with friction.
        state: State of each contact (contacts,).
        matrix: Equations of the state.
        right: Their right sides.
        x: A solution of them, displacements and forces.
    """
    if np.abs(matrix @ x - right).max() > _REFINE_BELOW:
        return None
    free = row_null_space(matrix)
    if not free.shape[1]:
        return None
    from scipy.optimize import linprog

    n, mu = len(scaled.f), scaled.mu
    motion, force = free[:n], free[n:].reshape(scaled.contacts, 2, -1)
    lam = x[n:].reshape(scaled.contacts, 2)
    w = scaled.targets - scaled.G @ x[:n]
    # Each must be ≥ 0: value at x, and its changes along the null space.
    values, changes = [], []
    for i, contact_mode in enumerate(state):
        if contact_mode == OPEN:
            values.append(w[i, 0])
            changes.append(-scaled.G[i, 0] @ motion)
            continue
        values.append(lam[i, 0])
        changes.append(force[i, 0])
        for side in (1.0, -1.0):
            if contact_mode == STICK:
                values.append(mu[i] * lam[i, 0] - side * lam[i, 1])
                changes.append(mu[i] * force[i, 0] - side * force[i, 1])
            elif contact_mode == (SLIP_UP if side > 0.0 else SLIP_DOWN):
                values.append(-side * w[i, 1])
                changes.append(side * scaled.G[i, 1] @ motion)
    found = linprog(np.zeros(free.shape[1]), A_ub=-np.array(changes), b_ub=np.array(values), bounds=(None, None))
    return np.asarray(x + free @ found.x) if found.status == 0 else None
