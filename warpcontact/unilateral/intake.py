"""Checks the arguments of a static contact problem; each error names the argument and its condition."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.catalogue.device_model import as_numbers
from warpcontact.validation.checks import Array

#: Largest asymmetry of a matrix, relative to its largest entry; exceeds any rounding.
_SKEW = 1e-8


def values(name: str, given: ArrayLike, at_least: float = -np.inf) -> Array:
    """Returns finite numbers in float64."""
    array = as_numbers(given)
    if array is None:
        raise ValueError(f"{name} must be numbers, got {_brief(given)}")
    array = array.astype(np.float64)
    bad = np.argwhere(~np.isfinite(array) | (array < at_least))
    if len(bad):
        where = tuple(int(i) for i in bad[0])
        allowed = "finite" if at_least == -np.inf else f"finite and at least {at_least:g}"
        raise ValueError(f"{name}{list(where) if where else ''} must be {allowed}, got {array[where]:g}")
    return array


def fit(name: str, array: Array, sizes: Mapping[str, int], spread: bool = False) -> Array:
    """Returns ``array`` if its last axes have the ``sizes``, with or without one leading axis.

    With ``spread`` a single number is broadcast.
    """
    shape = tuple(sizes.values())
    if spread and array.ndim == 0:
        return np.full(shape, float(array))
    if array.shape[-len(shape) :] != shape or array.ndim > len(shape) + 1:
        words = ", ".join(f"{word} = {size}" for word, size in sizes.items())
        number = "a number, or " if spread else ""
        raise ValueError(
            f"{name} must be {number}of shape ({', '.join(sizes)}{',' if len(shape) == 1 else ''}) or (problems, "
            f"{', '.join(sizes)}) with {words}, got {_shape(array)}"
        )
    return array


def stiffness(given: Any) -> Any:
    """Returns K: (n, n) or (problems, n, n), symmetric, or a sparse matrix of SciPy in CSC format."""
    if hasattr(given, "tocsc"):
        if given.dtype.kind not in "iuf":
            raise ValueError(f"K must be numbers, got a sparse matrix of {given.dtype}")
        K = given.tocsc().astype(np.float64)
        if K.ndim != 2 or K.shape[0] != K.shape[1] or not K.shape[0]:
            raise ValueError(f"K must be square, got a sparse matrix of shape {K.shape}")
        bad = np.flatnonzero(~np.isfinite(K.data))
        if len(bad):
            row, column = K.indices[bad[0]], np.searchsorted(K.indptr, bad[0], side="right") - 1
            raise ValueError(f"K[{row}, {column}] must be finite, got {K.data[bad[0]]:g}")
        skew, size = abs(K - K.T).tocoo(), abs(K)
        if skew.nnz and skew.data.max() > _SKEW * size.max():
            worst = int(np.argmax(skew.data))
            i, j = sorted((int(skew.row[worst]), int(skew.col[worst])))
            raise ValueError(_not_symmetric("K", i, j, K[i, j], K[j, i]))
        return K
    K = values("K", given)
    K = K.reshape(1, 1) if K.ndim == 0 else K
    if not K.shape[-1]:
        raise ValueError(f"K must have at least one displacement, got {_shape(K)}")
    return symmetric("K", K, "n")


def symmetric(name: str, array: Array, size: str) -> Array:
    """Returns square matrices (…, size, size), symmetrized; raises ``ValueError`` if they are not symmetric."""
    if array.ndim not in (2, 3) or array.shape[-1] != array.shape[-2]:
        raise ValueError(
            f"{name} must be of shape ({size}, {size}) or (problems, {size}, {size}), got {_shape(array)}"
        )
    turned = np.swapaxes(array, -1, -2)
    if np.array_equal(array, turned):
        return array
    skew, largest = np.abs(array - turned).max(axis=(-1, -2)), np.abs(array).max(axis=(-1, -2))
    bad = np.argwhere(skew > _SKEW * largest)
    if len(bad):
        where = tuple(int(i) for i in bad[0])
        one = array[where]
        i, j = (int(k) for k in np.unravel_index(np.argmax(np.abs(one - one.T)), one.shape))
        entry = f"{name}{list(where) if where else ''}"
        raise ValueError(_not_symmetric(entry, i, j, one[i, j], one[j, i]))
    return 0.5 * (array + turned)


def _not_symmetric(name: str, i: int, j: int, one: float, other: float) -> str:
    return f"{name} must be symmetric, got {one:g} at [{i}, {j}] and {other:g} at [{j}, {i}]"


def gap_rows(given: Any, n: int, d: Array, friction: bool, dim: int) -> tuple[Array, int]:
    """Returns G as (m, dim, n) or (problems, m, dim, n), and dim."""
    if isinstance(dim, bool) or not isinstance(dim, int | np.integer) or dim not in (0, 1, 2, 3):
        raise ValueError(f"dim must be 1, 2 or 3, or 0 to infer it from G, got {dim!r}")
    given = given.toarray() if hasattr(given, "tocsc") else given
    G = values("G", given)
    if G.ndim == 0:
        G = G.reshape(1, 1)
    if d.ndim not in (1, 2):
        raise ValueError(f"d must be of shape (m,) or (problems, m), got {_shape(d)}")
    m = d.shape[-1]
    # With three axes it is (problems, m, n) or (m, dim, n).
    flat = dim == 1 or (dim == 0 and not friction and G.shape[-2] == m)
    if G.ndim == 2 or (G.ndim == 3 and flat):
        G = G[..., None, :]
    found = G.shape[-2] if G.ndim in (3, 4) else 0
    fits = G.ndim in (3, 4) and G.shape[-3] == m and G.shape[-1] == n and found in (1, 2, 3)
    if not fits or dim not in (0, found):
        wanted = f" and dim = {dim}" if dim else ""
        raise ValueError(
            "G must be of shape (m, n), or with friction (m, dim, n) with dim 2 or 3, or have a leading axis of "
            f"problems, with m = {m} (from d) and n = {n} (from K){wanted}, got "
            f"{_shape(np.asarray(given))}"
        )
    if found == 1 and friction:
        raise ValueError(
            "G must be of shape (m, dim, n) with dim 2 or 3 if mu is not 0 (friction acts along tangents), got "
            f"{_shape(np.asarray(given))}"
        )
    return G, found


def count_of(counts: Mapping[str, int | None]) -> int | None:
    """Returns the number of problems; raises ``ValueError`` if arguments disagree."""
    many = {name: count for name, count in counts.items() if count is not None}
    for name, count in many.items():
        if not count:
            raise ValueError(f"{name} must have at least one problem, got 0")
    if len(set(many.values())) > 1:
        raise ValueError(
            "arguments with an axis of problems must have the same number of problems, got "
            + ", ".join(f"{name} {count}" for name, count in many.items())
        )
    return next(iter(many.values()), None)


def _shape(array: Array) -> str:
    return f"shape {array.shape}"


def _brief(given: Any) -> str:
    text = repr(given)
    return text if len(text) <= 60 else f"{text[:57]}…"
