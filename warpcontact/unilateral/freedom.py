"""Motions of a static problem without elastic resistance, and proofs that no solution exists.

With the columns of R a basis of the null space of K, equilibrium requires Rᵀ(f − Gᵀλ) = 0: only contacts balance
the load along R. The least-squares solution λ in the friction cones either balances it, or leaves p ≠ 0; then the
load does work along R p and no admissible contact force opposes it. A second least-squares problem yields either
displacements that all gaps permit, or weights y ≥ 0 of the gaps with Gᵀy = 0 and d·y < 0 (Farkas' lemma).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.scaled import ScaledProblem
from warpcontact.validation.checks import Array

#: Eigenvalues below this fraction of the largest are zero.
ZERO_EIGENVALUE = 1e-12
# A residual of a least-squares problem below this is rounding, in scaled units.
_RESIDUAL_TOLERANCE = 1e-10
# Number of tangents of the polygon around the friction cone in space.
_TANGENTS = 32
# Maximum number of displacements for which the null space of a sparse K is computed densely.
_DENSE = 1000
# Shift and number of steps of the subspace iteration for larger K.
_SHIFT = 1e-10
_STEPS = 6


def null_space(problem: ScaledProblem, scale: Array) -> Array:
    """Returns an orthonormal basis of the null space of the scaled K, (n, null space dimension).

    Args:
        problem: The problem.
        scale: D of ``scaling`` (n,), the scale of the stiffness, in which eigenvalues of K are compared.
    """
    K, n = problem.K, len(problem.f)
    rescale = scale / problem.scale
    if hasattr(K, "tocsc"):
        from scipy.sparse import diags_array

        K = diags_array(rescale) @ K @ diags_array(rescale)
        basis = _sparse_null_space(K) if n > _DENSE else _dense_null_space(K.toarray())
    else:
        basis = _dense_null_space(rescale[:, None] * K * rescale)
    return np.asarray(np.linalg.qr(rescale[:, None] * basis)[0])


def _dense_null_space(K: Array) -> Array:
    sizes, vectors = np.linalg.eigh(K)
    return np.asarray(vectors[:, np.abs(sizes) <= ZERO_EIGENVALUE * np.abs(sizes).max()])


def _sparse_null_space(K: Any) -> Array:
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    n = K.shape[0]
    factors = splu((K + _SHIFT * eye_array(n)).tocsc())
    size = float(abs(K).max())
    count = 8
    while True:
        basis = np.linalg.qr(np.random.default_rng(0).normal(size=(n, min(count, n))))[0]
        for _ in range(_STEPS):
            basis = np.linalg.qr(factors.solve(basis))[0]
        sizes, rescale = np.linalg.eigh(basis.T @ (K @ basis))
        zero = np.abs(sizes) <= 1e-12 * size
        if not zero.all() or count >= n:
            return np.asarray((basis @ rescale)[:, zero])
        count *= 2


def unopposed_motion(problem: ScaledProblem, free: Array) -> Array | None:
    """Returns a motion (n,) in ``free`` along which the load acts and which no contact opposes, or None."""
    if not free.shape[1]:
        return None
    load = free.T @ problem.f
    directions = _cone_edges(problem) @ free
    lengths = np.linalg.norm(directions, axis=1)
    directions = directions[lengths > _RESIDUAL_TOLERANCE] / lengths[lengths > _RESIDUAL_TOLERANCE, None]
    remainder = load - directions.T @ _nonnegative(directions.T, load)
    if np.linalg.norm(remainder) <= _RESIDUAL_TOLERANCE * np.linalg.norm(problem.f):
        return None
    return np.asarray(free @ remainder / np.linalg.norm(remainder))


def _cone_edges(problem: ScaledProblem) -> Array:
    """Returns vectors Gᵀλ (edges, n) whose nonnegative combinations are all loads that contacts can balance.

    In space they span a polygonal cone around the friction cone.
    """
    if problem.dim == 1:
        return problem.G[:, 0]
    if problem.dim == 2:
        tangential = np.array([[-1.0], [1.0]])
    else:
        angles = 2.0 * np.pi * np.arange(_TANGENTS) / _TANGENTS
        tangential = np.stack([np.cos(angles), np.sin(angles)], axis=1) / np.cos(np.pi / _TANGENTS)
    # Divided by √(1 + μ²), for large μ.
    cos = 1.0 / np.hypot(1.0, problem.mu)
    normal = cos[:, None] * problem.G[:, 0]
    tangents = (cos * problem.mu)[:, None, None] * np.einsum("ta,man->mtn", tangential, problem.G[:, 1:])
    return np.asarray((normal[:, None] + tangents).reshape(-1, problem.G.shape[2]))


def gaps_infeasible(problem: ScaledProblem) -> bool:
    """Returns whether no displacements make all gaps nonnegative."""
    rows, gaps = problem.G[:, 0], problem.targets[:, 0]
    if not (gaps < 0.0).any():
        return False
    lengths = np.linalg.norm(rows, axis=1)
    fixed = lengths <= _RESIDUAL_TOLERANCE
    if (gaps[fixed] < 0.0).any():
        return True
    rows, gaps = rows[~fixed] / lengths[~fixed, None], gaps[~fixed] / lengths[~fixed]
    matrix = np.vstack([rows.T, gaps / np.abs(gaps).max()])
    goal = np.append(np.zeros(rows.shape[1]), -1.0)
    return bool(np.linalg.norm(goal - matrix @ _nonnegative(matrix, goal)) <= _RESIDUAL_TOLERANCE)


def free_motion(problem: ScaledProblem, free: Array, u: Array, lam: Array, tolerance: float) -> Array | None:
    """Returns a motion (n,) in ``free`` that changes no force of a solution, None if u is unique.

    Closed contacts with a force stay closed, closed ones without a force may open, sticking ones stick, and
    slipping ones slip along the same line.
    """
    if not free.shape[1]:
        return None
    scales, w = problem.scales(u, lam), problem.targets - problem.G @ u
    closed_below = np.maximum(10.0 * tolerance * scales.length[0], scales.rounding[0])
    is_pressing = lam[:, 0] > 10.0 * tolerance * scales.force[0]
    is_touching = ~is_pressing & (w[:, 0] <= closed_below)
    constraints = [problem.G[is_pressing, 0] @ free]
    for i in np.flatnonzero(is_pressing & (problem.mu > 0.0)) if problem.dim > 1 else []:
        tangential, slip = problem.G[i, 1:] @ free, np.linalg.norm(w[i, 1:])
        if slip > closed_below[i]:
            e = w[i, 1:] / slip
            tangential = tangential - np.outer(e, e @ tangential)
        constraints.append(tangential)
    motions = free @ row_null_space(np.concatenate(constraints))
    if not motions.shape[1]:
        return None
    rows = problem.G[is_touching, 0] @ motions
    lengths = np.linalg.norm(rows, axis=1)
    rows = rows[lengths > _RESIDUAL_TOLERANCE] / lengths[lengths > _RESIDUAL_TOLERANCE, None]
    fixed = row_null_space(rows)
    if fixed.shape[1]:
        return np.asarray(motions @ fixed[:, 0])
    # If no motion opens some of these and closes none, positive weights balance them (Stiemke's theorem).
    opening = rows.sum(axis=0)
    remainder = -opening - rows.T @ _nonnegative(rows.T, -opening)
    size = np.linalg.norm(remainder)
    return np.asarray(motions @ remainder / size) if size > _RESIDUAL_TOLERANCE * max(1, len(rows)) else None


def row_null_space(rows: Array) -> Array:
    """Returns an orthonormal basis of the null space of ``rows``."""
    n = rows.shape[1]
    if not len(rows) or not n:
        return np.eye(n)
    _, sizes, right = np.linalg.svd(rows)
    rank = int((sizes > _RESIDUAL_TOLERANCE * max(sizes.max(initial=0.0), 1.0)).sum())
    return np.asarray(right[rank:].T)


def _nonnegative(matrix: Array, goal: Array) -> NDArray[np.float64]:
    """Returns x ≥ 0 that minimizes |matrix x − goal|."""
    from scipy.optimize import nnls

    if not matrix.shape[1]:
        return np.zeros(0)
    return np.asarray(nnls(matrix, goal, maxiter=30 * (sum(matrix.shape) + 10))[0])
