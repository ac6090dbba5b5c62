"""Eliminates displacements: from K u + Gᵀλ = f to w = W λ + q of the contacts."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.residual import ROUNDINGS, ResidualEvaluator
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

#: A scaled matrix is singular if an eigenvalue is below this fraction of the largest; entries round to less.
SINGULAR = 1e-12


class SingularError(ValueError):
    """Raised if K cannot be inverted: there are motions without elastic force."""


def eliminate(problem: "Problem") -> tuple[Delassus, Array, Array]:
    """Returns the problem w = W λ + q with W = G K⁻¹ Gᵀ, the displacements K⁻¹ f, and K⁻¹ Gᵀ.

    Shapes: (problems, n) and (problems or 1, n, rows).

    Raises:
        SingularError: If any K is exactly singular, or a sparse K is singular to rounding.
    """
    n, contacts = problem.K.shape[-1], problem.contacts
    count = 1 if problem.count is None else problem.count
    G = np.asarray(problem.G)
    G = G.reshape(-1 if G.ndim == 4 else 1, contacts * problem.dim, n) if G.size else np.zeros((1, 0, n))
    f = np.asarray(problem.f).reshape(-1, n)
    transposed = np.swapaxes(G, -1, -2)
    if hasattr(problem.K, "tocsc"):
        inverse = _sparse(problem.K)
        by_contact = np.stack([inverse(one) for one in transposed])
        u_free = inverse(f.T).T
    else:
        K = np.asarray(problem.K).reshape(-1, n, n)
        try:
            by_contact = np.linalg.solve(K, transposed)
            u_free = np.linalg.solve(K, f[..., None])[..., 0]
        except np.linalg.LinAlgError:
            raise SingularError from None
    W = G @ by_contact
    W = 0.5 * (W + np.swapaxes(W, -1, -2))
    u_free = np.broadcast_to(u_free, (count, n))
    targets, shape = problem.targets(), (count, contacts, problem.dim)
    q = targets - (G @ u_free[..., None])[..., 0].reshape(shape)
    magnitudes = np.abs(targets) + (np.abs(G) @ np.abs(u_free)[..., None])[..., 0].reshape(shape)
    return Delassus(W, q, np.atleast_2d(problem.mu), ROUNDINGS * magnitudes.max(axis=2)), u_free, by_contact


def is_regular(problem: "Problem", evaluator: ResidualEvaluator) -> NDArray[np.bool_]:
    """Returns whether the K of each problem can be inverted, independent of units; (problems,)."""
    count, n = 1 if problem.count is None else problem.count, problem.K.shape[-1]
    if hasattr(problem.K, "tocsc"):
        try:
            _sparse(problem.K)
        except SingularError:
            return np.zeros(count, dtype=bool)
        return np.ones(count, dtype=bool)
    K = np.asarray(problem.K).reshape(-1, n, n)
    scale = (
        evaluator.scale if len(evaluator.scale) == len(K) else np.broadcast_to(evaluator.scale[:1], (len(K), n))
    )
    found = np.empty(len(K), dtype=bool)
    for i, one in enumerate(scale[:, :, None] * K * scale[:, None, :]):
        try:
            # Fraction of each diagonal entry that is independent of the other displacements.
            pivots = np.diagonal(np.linalg.cholesky(one)) ** 2 / np.diagonal(one)
            found[i] = pivots.min() > SINGULAR
        except np.linalg.LinAlgError:
            sizes = np.abs(np.linalg.eigvalsh(one))
            found[i] = sizes.min() > SINGULAR * sizes.max()
    return np.broadcast_to(found, (count,))


def _sparse(K: Any) -> Any:
    """Returns a function that solves with K, which is factorized once."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    diagonal = np.abs(K.diagonal())
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    try:
        factors = splu((diags_array(scale) @ K @ diags_array(scale)).tocsc())
    except RuntimeError:
        raise SingularError from None
    pivots = np.abs(factors.U.diagonal())
    if pivots.min() <= SINGULAR * pivots.max():
        raise SingularError
    return lambda right: scale[:, None] * factors.solve(scale[:, None] * right)
