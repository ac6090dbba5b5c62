"""Problems in files: NumPy archives without code in them."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from warpcontact.unilateral.problem import Problem

_KIND = "warpcontact.unilateral.Problem"
_SCHEMA = 1
_SPARSE = ("K_data", "K_indices", "K_indptr", "K_shape")


def save(problem: Problem, path: str | Path) -> Path:
    """Writes ``problem``, as ``Problem.save`` says."""
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
    with path.open("wb") as stream:
        np.savez_compressed(stream, **entries)
    return path


def load(path: str | Path) -> Problem:
    """Returns the problem in a file, as ``Problem.load`` says."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not there")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            entries = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise ValueError(f"{path} cannot be read as a problem: {error}") from None
    except AttributeError:  # a single array, or text
        raise ValueError(f"{path} cannot be read as a problem: it is not an archive") from None
    return _problem(entries, path)


def _problem(entries: dict[str, np.ndarray], path: Path) -> Problem:
    if str(entries.get("kind")) != _KIND:
        raise ValueError(f"{path} is not the file of a problem: it has no entry 'kind' of {_KIND!r}")
    schema = entries.get("schema", np.array(None))
    if schema.shape != () or schema.dtype.kind not in "iu":
        raise ValueError(f"{path}: schema must be a whole number, got {schema}")
    if schema != _SCHEMA:
        raise ValueError(f"{path}: schema must be {_SCHEMA}, got {schema}: it was written by another version")
    sparse = "K_data" in entries
    wanted = {"dim", "f", "G", "d", "mu", "previous", *(_SPARSE if sparse else ("K",))}
    missing = sorted(wanted - set(entries))
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}")
    dim = entries["dim"]
    if dim.shape != () or dim not in (1, 2, 3):
        raise ValueError(f"{path}: dim must be 1, 2 or 3, got {dim}")
    try:
        K = _sparse(entries) if sparse else entries["K"]
        f, G, d, mu, previous = (entries[name] for name in ("f", "G", "d", "mu", "previous"))
        return Problem(K, f, G, d, mu, previous, int(dim))
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from None


def _sparse(entries: dict[str, np.ndarray]) -> Any:
    from scipy.sparse import csc_matrix

    data, indices, starts, shape = (entries[name] for name in _SPARSE)
    if shape.shape != (2,) or indices.dtype.kind not in "iu" or starts.dtype.kind not in "iu":
        raise ValueError("K_indices, K_indptr and K_shape must be whole numbers, the last of them two")
    K = csc_matrix((data, indices, starts), shape=tuple(int(x) for x in shape))
    K.check_format(full_check=True)
    return K
