"""Enumeration of the combinations of contact states: open, stick, slip.

Method "enumeration" tests them for problems in W and q. ``all_states`` finds all solutions of a single problem in
K, which may be indefinite or singular.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.scaled import ScaledProblem, refine, row_null_space
from warpcontact.unilateral.solution import (
    RawSolution,
    ResidualEvaluator,
    Solution,
    Termination,
    solution_of_displacements,
)
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem
#: Maximum number of contacts: with 2 states each without friction and 4 in the plane, 65 536 combinations.
MAX_CONTACTS = {1: 16, 2: 8}
_CHUNK = 2048
# Solution relative to its right side from which on it is recomputed by singular values.
_LARGE = 1e8

# States of a contact in the plane. Without friction OPEN and STICK, which then means closed.
OPEN, STICK, SLIP_UP, SLIP_DOWN = range(4)


def check_size(contacts: int, dim: int) -> None:
    """Raises ``ValueError`` if there are too many states, or infinitely many (friction in space)."""
    if dim == 3:
        raise ValueError(
            "method 'enumeration' tests open, stick and each direction of slip of each contact; with friction in "
            "space there are infinitely many slip directions: use 'projection' or 'gauss_seidel'"
        )
    most, states = MAX_CONTACTS[dim], 2 * dim
    if contacts > most:
        raise ValueError(
            f"method 'enumeration' tests all {states} states of each contact and supports at most {most} contacts, "
            f"got {contacts}: use 'projection'"
        )


def enumerate_states(problem: Delassus, tolerance: float) -> tuple[Array, Array]:
    """Returns the first solution of each problem, or the state of least residual, and the number of states tested."""
    found, state_counts = np.zeros(problem.q.shape), np.zeros(problem.count, dtype=int)
    for k in range(problem.count):
        one, least = problem.part(np.array([k])), np.inf
        for lam in candidate_forces(one):
            residual = _residuals(one, lam)
            good = np.flatnonzero(residual <= tolerance)
            i = good[0] if len(good) else int(np.argmin(residual))
            if residual[i] < least:
                least, found[k] = residual[i], lam[i]
            state_counts[k] += i + 1 if len(good) else len(lam)
            if len(good):
                break
    return found, state_counts


def states(contacts: int, dim: int) -> Iterator[NDArray[np.int64]]:
    """Yields combinations of contact states in chunks, (chunk, contacts); all open is the first."""
    base, total = 2 * dim, (2 * dim) ** contacts
    for start in range(0, total, _CHUNK):
        number = np.arange(start, min(start + _CHUNK, total), dtype=np.int64)
        yield number[:, None] // base ** np.arange(contacts) % base


def candidate_forces(problem: Delassus) -> Iterator[Array]:
    """Yields the l of each combination of states of a single problem, (chunk, contacts, dim)."""
    size = problem.contacts * problem.dim
    # Rows in units of l.
    rho = np.repeat(problem.rho[0], problem.dim)
    W, q = rho[:, None] * problem.W[0], rho * problem.q[0].reshape(-1)
    for chunk in states(problem.contacts, problem.dim):
        matrix, right_side = state_equations(chunk, W, q, np.eye(size), problem.mu[0], problem.dim)
        yield solve_all(matrix, right_side).reshape(len(chunk), problem.contacts, problem.dim)


def state_equations(
    chunk: NDArray[np.int64], W: Array, q: Array, lam: Array, mu: Array, dim: int
) -> tuple[Array, Array]:
    """Returns the equations of combinations of states: (chunk, rows, unknowns) and right sides.

    ``W`` and ``q`` give w, and ``lam`` gives l, from the unknowns.
    """
    closed = chunk != OPEN
    is_velocity_row = np.repeat(closed[..., None], dim, axis=-1)
    if dim == 2:
        is_velocity_row[..., 1] = chunk == STICK
    is_velocity_row = is_velocity_row.reshape(len(chunk), -1)
    matrix = np.where(is_velocity_row[..., None], W, lam)
    right_side = np.where(is_velocity_row, -q, 0.0)
    if dim == 2:
        # Slip: l_t ∓ μ l_n = 0.
        side = np.where(chunk == SLIP_UP, 1.0, np.where(chunk == SLIP_DOWN, -1.0, 0.0)) * mu
        matrix[:, 1::2] -= side[..., None] * lam[0::2]
    return matrix, right_side


def solve_all(matrix: Array, right_side: Array) -> Array:
    """Returns the solutions of many systems; for a consistent singular system, the solution of least norm."""
    try:
        found = _solved(matrix, right_side)
        invalid = ~np.isfinite(found).all(axis=1)
        # A solution this large indicates a matrix that is singular to rounding.
        invalid |= np.abs(found).max(axis=1, initial=0.0) > _LARGE * np.abs(right_side).max(axis=1, initial=0.0)
    except np.linalg.LinAlgError:
        found, invalid = np.zeros(right_side.shape), np.ones(len(right_side), dtype=bool)
    if invalid.any():
        inverse = np.linalg.pinv(matrix[invalid], rcond=1e-12)
        found[invalid] = (inverse @ right_side[invalid][..., None])[..., 0]
        found[invalid] += (inverse @ (right_side[invalid] - _times(matrix[invalid], found[invalid]))[..., None])[
            ..., 0
        ]
    if not invalid.all():
        # Refinement: small entries of the right side get the same relative accuracy as large ones.
        found[~invalid] += _solved(
            matrix[~invalid], right_side[~invalid] - _times(matrix[~invalid], found[~invalid])
        )
    return found


def _solved(matrix: Array, right_side: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right_side[..., None]), dtype=np.float64)[..., 0]


def _times(matrix: Array, x: Array) -> Array:
    return np.asarray((matrix @ x[..., None])[..., 0])


def _residuals(problem: Delassus, lam: Array) -> Array:
    many = Delassus(problem.W, np.broadcast_to(problem.q, lam.shape), problem.mu, problem.rounding)
    residual = many.residual(lam)
    return np.where(np.isfinite(residual), residual, np.inf)


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
