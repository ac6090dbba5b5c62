"""Refines solutions of static problems to rounding, by Newton's method in displacements and forces."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.scaled import ScaledProblem
from warpcontact.validation.checks import Array

# Maximum number of steps: few are needed near a solution, further ones reduce rounding.
_STEPS = 12
# Residual at which refinement stops, and residual below which a step must halve it to continue.
_ROUNDING = 1e-15
_LAST_STEP_BELOW = 1e-12
# Pivots below this fraction of the largest are zero (redundant contacts, unconstrained displacements).
_SINGULAR = 1e-12
# Maximum number of unknowns for orthogonal factorization; shift and refinement steps of larger systems.
_SMALL = 150
_SHIFT = 1e-8
_REFINEMENTS = 3


def refine(problem: ScaledProblem, u: Array, lam: Array) -> tuple[Array, Array, float]:
    """Returns displacements (n,), forces (contacts, dim) and their residual, which does not increase.

    Each step solves K u + Gᵀλ = f with the linearized equations of the state of each contact: open, closed,
    sticking or slipping. For a singular system it takes a small change. The right side is computed from u and λ
    themselves, so each step also refines the previous one.
    """
    best_u, best_lam, least = u, lam, problem.residual(u, lam)
    for _ in range(_STEPS):
        change = _step(problem, u, lam)
        if change is None:
            break
        u, lam = u + change[0], lam + change[1]
        inside, before = _into_cone(problem.mu, lam), least
        found = problem.residual(u, inside)
        if found < least:
            best_u, best_lam, least = u, inside, found
        if least <= _ROUNDING or (before <= _LAST_STEP_BELOW and found > 0.5 * before):
            break
    return best_u, best_lam, least


def _step(problem: ScaledProblem, u: Array, lam: Array) -> tuple[Array, Array] | None:
    """Returns the changes of u and λ in a step of Newton's method, None if the system cannot be solved."""
    n, dim = len(u), problem.dim
    scales = problem.scales(u, lam)
    rho = scales.force[0] / scales.length[0]
    w = problem.targets - problem.G @ u
    z = lam - rho[:, None] * w
    closed = np.flatnonzero(z[:, 0] > 0.0)
    change = -lam
    rows = problem.G[closed].reshape(len(closed) * dim, n)
    A, B, right = _linearized_law(problem, lam, w, z, rho, closed)
    off = problem.f - problem.K @ u - problem.flat_rows().T @ lam.reshape(-1)
    # Forces of open contacts vanish.
    is_open = np.ones(problem.contacts, dtype=bool)
    is_open[closed] = False
    off = off + problem.G[is_open].reshape(-1, n).T @ lam[is_open].reshape(-1)
    right_side = np.concatenate([off, right.reshape(-1)])
    if not (np.isfinite(right_side).all() and np.isfinite(A).all() and np.isfinite(B).all()):
        return None
    x = _solve(problem.K, rows, A, B, right_side)
    if x is None or not np.isfinite(x).all():
        return None
    change[closed] = x[n:].reshape(len(closed), dim)
    return x[:n], change


def _linearized_law(
    problem: ScaledProblem, lam: Array, w: Array, z: Array, rho: Array, closed: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Returns the linearized laws of closed contacts, A G Δu + B Δλ = right, in blocks (closed, dim, dim).

    The law is λ = (z_n, projection of z_t onto the disc of radius μ z_n), z = λ − ρ w. Rows without λ are divided
    by ρ.
    """
    dim, count = problem.dim, len(closed)
    lam, w, z, rho, mu = lam[closed], w[closed], z[closed], rho[closed], problem.mu[closed]
    A, B, right = np.zeros((count, dim, dim)), np.zeros((count, dim, dim)), np.zeros((count, dim))
    A[:, 0, 0], right[:, 0] = 1.0, w[:, 0]
    if dim == 1:
        return A, B, right
    radius, across = mu * z[:, 0], np.linalg.norm(z[:, 1:], axis=1)
    stick = across <= radius
    A[stick, 1:, 1:], right[stick, 1:] = np.eye(dim - 1), w[stick, 1:]
    for k in np.flatnonzero(~stick):
        e = z[k, 1:] / across[k]
        # λ_t − μ z_n e(z_t) = 0 with the derivative of e.
        turn = radius[k] / across[k] * (np.eye(dim - 1) - np.outer(e, e))
        B[k, 1:, 1:] = np.eye(dim - 1) - turn
        B[k, 1:, 0] = -mu[k] * e
        A[k, 1:, 1:] = -rho[k] * turn
        A[k, 1:, 0] = -rho[k] * mu[k] * e
        right[k, 1:] = -(lam[k, 1:] - radius[k] * e)
        size = max(1.0, mu[k], rho[k], rho[k] * mu[k])
        A[k, 1:], B[k, 1:], right[k, 1:] = A[k, 1:] / size, B[k, 1:] / size, right[k, 1:] / size
    return A, B, right


def _solve(K: Any, rows: Array, A: Array, B: Array, right: Array) -> Array | None:
    """Returns a small solution of [[K, rowsᵀ], [A rows, B]] x = right, None on failure.

    A large matrix is made regular by a shift, +ε in the first block and −ε in the second; refinement removes the
    effect of the shift.
    """
    count, dim = A.shape[:2]
    n, active = rows.shape[1], len(rows)
    lower = (A @ rows.reshape(count, dim, n)).reshape(active, n)
    shift = np.append(np.full(n, _SHIFT), np.full(active, -_SHIFT))
    if hasattr(K, "tocsc") and n + active > _SMALL:
        from scipy.sparse import block_array, block_diag, csc_array, diags_array
        from scipy.sparse.linalg import splu

        matrix: Any = K
        if active:
            blocks = [[K, csc_array(rows.T)], [csc_array(lower), block_diag(list(B), format="csc")]]
            matrix = block_array(blocks, format="csc")
        try:
            return _refined(matrix, splu((matrix + diags_array(shift)).tocsc()).solve, right)
        except RuntimeError:
            return None
    matrix = np.zeros((n + active, n + active))
    matrix[:n, :n] = K.toarray() if hasattr(K, "tocsc") else K
    matrix[:n, n:], matrix[n:, :n] = rows.T, lower
    k = np.arange(active).reshape(count, dim)
    matrix[n + k[:, :, None], n + k[:, None, :]] = B
    if n + active > _SMALL:
        from scipy.linalg.lapack import dgetrf, dgetrs

        factors, pivots, info = dgetrf(matrix + np.diag(shift))
        return _refined(matrix, lambda x: dgetrs(factors, pivots, x)[0], right) if info == 0 else None
    from scipy.linalg import lstsq

    return np.asarray(lstsq(matrix, right, cond=_SINGULAR, lapack_driver="gelsy")[0])


def _refined(matrix: Any, inverse: Callable[[Array], Array], right: Array) -> Array:
    """Returns x with matrix x = right, from the inverse of a nearby matrix."""
    x = inverse(right)
    for _ in range(_REFINEMENTS):
        x = x + inverse(right - matrix @ x)
    return np.asarray(x)


def _into_cone(mu: Array, lam: Array) -> Array:
    """Returns forces with nonnegative normals and friction of at most μ times these."""
    lam = lam.copy()
    lam[:, 0] = np.maximum(lam[:, 0], 0.0)
    across = np.linalg.norm(lam[:, 1:], axis=1)
    share = np.minimum(1.0, mu * lam[:, 0] / np.where(across > 0.0, across, 1.0))
    lam[:, 1:] *= share[:, None]
    return lam
