"""Displacements eliminated: from K u + Gᵀλ = f to w = W λ + q of the contacts."""

from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.checks import Array
from warpcontact.unilateral.delassus import Delassus

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

#: A matrix whose smallest eigenvalue is less than this of its largest is singular to rounding.
SINGULAR = 1e-14
#: Roundings of d, G u and their difference.
ROUNDINGS = 16.0 * float(np.finfo(np.float64).eps)


class SingularError(ValueError):
    """K cannot be inverted: something can move without force."""


def eliminate(problem: "Problem") -> tuple[Delassus, Array, Array]:
    """Returns w = W λ + q with W = G K⁻¹ Gᵀ, the displacements K⁻¹ f without contact, and K⁻¹ Gᵀ.

    Shapes: (problems, n) and (problems or 1, n, rows).

    Raises:
        SingularError: If K, or one of many, is singular.
    """
    n, contacts = problem.K.shape[-1], problem.contacts
    count = 1 if problem.count is None else problem.count
    G = np.asarray(problem.G)
    G = G.reshape(-1 if G.ndim == 4 else 1, contacts * problem.dim, n) if G.size else np.zeros((1, 0, n))
    f = np.asarray(problem.f).reshape(-1, n)
    turned = np.swapaxes(G, -1, -2)
    if hasattr(problem.K, "tocsc"):
        inverse = _sparse(problem.K)
        by_contact = np.stack([inverse(one) for one in turned])
        u_free = inverse(f.T).T
    else:
        K = np.asarray(problem.K).reshape(-1, n, n)
        _check_regular(K, problem.count is not None and len(K) > 1)
        by_contact = np.linalg.solve(K, turned)
        u_free = np.linalg.solve(K, f[..., None])[..., 0]
    W = G @ by_contact
    W = 0.5 * (W + np.swapaxes(W, -1, -2))
    u_free = np.broadcast_to(u_free, (count, n))
    targets, shape = problem.targets(), (count, contacts, problem.dim)
    q = targets - (G @ u_free[..., None])[..., 0].reshape(shape)
    parts = np.abs(targets) + (np.abs(G) @ np.abs(u_free)[..., None])[..., 0].reshape(shape)
    return Delassus(W, q, np.atleast_2d(problem.mu), ROUNDINGS * parts.max(axis=2)), u_free, by_contact


def _check_regular(K: Array, many: bool) -> None:
    for i, one in enumerate(K):
        try:
            pivots = np.diagonal(np.linalg.cholesky(one))
            regular = (pivots.min() / pivots.max()) ** 2 > SINGULAR
        except np.linalg.LinAlgError:
            sizes = np.abs(np.linalg.eigvalsh(one))
            regular = sizes.min() > SINGULAR * sizes.max()
        if not regular:
            raise SingularError(_message(f"K[{i}]" if many else "K"))


def _sparse(K: Any) -> Any:
    """Returns the function that solves with K, factorised once."""
    from scipy.sparse.linalg import splu

    try:
        factors = splu(K)
    except RuntimeError:
        raise SingularError(_message("K")) from None
    pivots = np.abs(factors.U.diagonal())
    if pivots.min() <= SINGULAR * pivots.max():
        raise SingularError(_message("K"))
    return lambda right: factors.solve(np.ascontiguousarray(right))


def _message(name: str) -> str:
    return (
        f"{name} is singular: something can move without force. Support it, or take method 'enumeration' "
        "or all_solutions() of a single small problem"
    )
