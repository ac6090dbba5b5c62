"""Reads and writes static contact problems as NumPy archives without pickled objects."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.files.atomic_files import open_for_writing
from warpcontact.files.numpy_files import check_numbers
from warpcontact.files.run_folder import open_file

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

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
