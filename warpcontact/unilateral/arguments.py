"""Arguments of static contact problems: checks, and files, which are NumPy archives without pickled objects.

Each error names the argument and its condition.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.files.atomic_files import open_for_writing
from warpcontact.files.regular_files import check_numbers
from warpcontact.files.run_folder import open_file
from warpcontact.kernels.catalogue.device_model import as_numbers
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem
#: Largest asymmetry of a matrix, relative to its largest entry; exceeds any rounding.
_SKEW = 1e-8


def values(name: str, given: ArrayLike, at_least: float = -np.inf) -> Array:
    """Returns finite numbers in float64."""
    array = as_numbers(given)
    if array is None:
        raise ValueError(f"{name} must be numbers, got {_brief(given)}")
    array = array.astype(np.float64)
    invalid = np.argwhere(~np.isfinite(array) | (array < at_least))
    if len(invalid):
        where = tuple(int(i) for i in invalid[0])
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
        invalid = np.flatnonzero(~np.isfinite(K.data))
        if len(invalid):
            row, column = K.indices[invalid[0]], np.searchsorted(K.indptr, invalid[0], side="right") - 1
            raise ValueError(f"K[{row}, {column}] must be finite, got {K.data[invalid[0]]:g}")
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
    invalid = np.argwhere(skew > _SKEW * largest)
    if len(invalid):
        where = tuple(int(i) for i in invalid[0])
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


_KIND = "warpcontact.unilateral.Problem"
_SCHEMA = 1
_SPARSE = ("K_data", "K_indices", "K_indptr", "K_shape")
_ENTRIES = {"kind", "schema", "dim", "K", *_SPARSE, "f", "G", "d", "mu", "previous"}


def save(problem: Problem, path: str | Path) -> Path:
    """Writes ``problem``; see ``Problem.save``."""
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path must end in .npz, got {str(path)!r}")
    entries: dict[str, Any] = {"kind": _KIND, "schema": _SCHEMA, "dim": problem.dim}
    if hasattr(problem.K, "tocsc"):
        values = (problem.K.data, problem.K.indices, problem.K.indptr, problem.K.shape)
        entries.update(zip(_SPARSE, values, strict=True))
    else:
        entries["K"] = problem.K
    for name in ("f", "G", "d", "mu", "previous"):
        entries[name] = getattr(problem, name)
    if problem.dim == 1:
        entries["G"] = entries["G"][..., 0, :]
    with open_for_writing(path) as stream:
        np.savez_compressed(stream, **entries)
    return path


def read_arguments(path: str | Path) -> dict[str, Any]:
    """Returns the arguments of the problem in a file, by name; errors as for ``Problem.load``."""
    path = Path(path)
    try:
        stream = open_file(path)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist") from None
    except OSError as error:
        raise ValueError(f"{path} cannot be read as a problem: {error.strerror}") from None
    with stream:
        try:
            archive = np.load(stream, allow_pickle=False)
        except Exception:  # a damaged file can raise any exception in NumPy
            archive = None
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise ValueError(
                f"{path} cannot be read as a problem: it is not a NumPy archive (.npz) or is truncated"
            )
        return _arguments({name: _entry(archive, name, path) for name in archive.files if name in _ENTRIES}, path)


def _entry(archive: Any, name: str, path: Path) -> np.ndarray:
    try:
        return np.asarray(archive[name])
    except MemoryError:
        raise MemoryError(f"{path}: entry {name!r} exceeds the available memory, or is damaged") from None
    except Exception:  # a damaged file can raise any exception in NumPy
        raise ValueError(
            f"{path} cannot be read as a problem: entry {name!r} is damaged, or is not an array of numbers"
        ) from None


def _arguments(entries: dict[str, np.ndarray], path: Path) -> dict[str, Any]:
    if str(entries.get("kind")) != _KIND:
        raise ValueError(f"{path} is not a problem file: its entry 'kind' must be {_KIND!r}")
    if "schema" not in entries:
        raise ValueError(f"{path} lacks schema")
    schema = _whole_number("schema", entries["schema"], path)
    if schema != _SCHEMA:
        raise ValueError(f"{path}: schema must be {_SCHEMA}, got {schema}: it was written by another version")
    sparse = "K_data" in entries
    numbers = ("f", "G", "d", "mu", "previous")
    matrix = _SPARSE if sparse else ("K",)
    missing = sorted({"dim", *numbers, *matrix} - set(entries))
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}")
    dim = _whole_number("dim", entries["dim"], path)
    if dim not in (1, 2, 3):
        raise ValueError(f"{path}: dim must be 1, 2 or 3, got {dim}")
    try:
        for name in (*numbers, *matrix):
            check_numbers(name, entries[name])
        K = _sparse(*(entries[name] for name in _SPARSE)) if sparse else entries["K"]
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from None
    return {"K": K, "dim": dim, **{name: entries[name] for name in numbers}}


def _whole_number(name: str, value: np.ndarray, path: Path) -> int:
    if value.shape != () or value.dtype.kind not in "iu":
        got = repr(value.item()) if value.shape == () else f"an array of shape {value.shape}"
        raise ValueError(f"{path}: {name} must be a whole number, got {got}")
    return int(value)


def _sparse(data: np.ndarray, rows: np.ndarray, starts: np.ndarray, shape: np.ndarray) -> Any:
    """Returns K from its compressed columns, checked because SciPy would fail on invalid ones."""
    from scipy.sparse import csc_matrix

    for name, array in zip(_SPARSE, (data, rows, starts, shape), strict=True):
        if array.ndim != 1 or (name != "K_data" and array.dtype.kind not in "iu"):
            kind = "numbers" if name == "K_data" else "whole numbers"
            raise ValueError(f"{name} must be a list of {kind}, got {array.dtype} of shape {array.shape}")
    if len(shape) != 2 or shape[0] != shape[1] or shape[0] < 1:
        raise ValueError(f"K_shape must be (n, n) with n at least 1, got {shape[:3].tolist()}")
    n = int(shape[0])
    if len(starts) != n + 1:
        raise ValueError(f"K_indptr must have {n + 1} values (from K_shape), got {len(starts)}")
    if starts[0] != 0 or starts[-1] != len(data):
        raise ValueError(
            f"K_indptr must go from 0 to {len(data)} (size of K_data), got {starts[0]} to {starts[-1]}"
        )
    down = np.flatnonzero(starts[1:] < starts[:-1])
    if len(down):
        k = int(down[0]) + 1
        raise ValueError(f"K_indptr[{k}] must be at least {starts[k - 1]} (previous value), got {starts[k]}")
    if len(rows) != len(data):
        raise ValueError(f"K_indices must have {len(data)} values (size of K_data), got {len(rows)}")
    outside = np.flatnonzero((rows < 0) | (rows >= n))
    if len(outside):
        raise ValueError(f"K_indices[{outside[0]}] must be at least 0 and less than {n}, got {rows[outside[0]]}")
    return csc_matrix((data, rows, starts), shape=(n, n))
