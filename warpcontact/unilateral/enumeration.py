"""Method "enumeration": tests all combinations of contact states (open, stick, slip)."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.delassus import Delassus
from warpcontact.validation.checks import Array

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
        bad = ~np.isfinite(found).all(axis=1)
        # A solution this large indicates a matrix that is singular to rounding.
        bad |= np.abs(found).max(axis=1, initial=0.0) > _LARGE * np.abs(right_side).max(axis=1, initial=0.0)
    except np.linalg.LinAlgError:
        found, bad = np.zeros(right_side.shape), np.ones(len(right_side), dtype=bool)
    if bad.any():
        inverse = np.linalg.pinv(matrix[bad], rcond=1e-12)
        found[bad] = (inverse @ right_side[bad][..., None])[..., 0]
        found[bad] += (inverse @ (right_side[bad] - _times(matrix[bad], found[bad]))[..., None])[..., 0]
    if not bad.all():
        # Refinement: small entries of the right side get the same relative accuracy as large ones.
        found[~bad] += _solved(matrix[~bad], right_side[~bad] - _times(matrix[~bad], found[~bad]))
    return found


def _solved(matrix: Array, right_side: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right_side[..., None]), dtype=np.float64)[..., 0]


def _times(matrix: Array, x: Array) -> Array:
    return np.asarray((matrix @ x[..., None])[..., 0])


def _residuals(problem: Delassus, lam: Array) -> Array:
    many = Delassus(problem.W, np.broadcast_to(problem.q, lam.shape), problem.mu, problem.rounding)
    residual = many.residual(lam)
    return np.where(np.isfinite(residual), residual, np.inf)
