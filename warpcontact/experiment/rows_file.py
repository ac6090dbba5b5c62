"""Files with a value for each item of a set: ``.npy``, or ``.csv`` with a row for each."""

from pathlib import Path

import numpy as np

from warpcontact.checks import Array

SUFFIXES = (".npy", ".csv")


def check_rows_file(label: str, name: str) -> str:
    """Returns ``name`` if it is that of a file that ``read_rows`` knows, or raises ``ValueError``."""
    if Path(name).suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"{label} must be a list, or a file that ends in {' or '.join(SUFFIXES)}, got {name!r}".lstrip()
        )
    return name


def read_rows(path: Path) -> Array:
    """Returns the numbers in a file: of a ``.csv`` (n,) if it has one column, else (n, columns).

    Lines of a ``.csv`` that begin with ``#`` are left out; nine columns are a 3×3 tensor each.

    Raises:
        ValueError: If it cannot be read or holds anything but numbers.
    """
    try:
        if path.suffix.lower() == ".npy":
            values = np.load(path, allow_pickle=False)
        else:
            values = np.loadtxt(path, delimiter=",", ndmin=2, encoding="utf-8-sig")
    except FileNotFoundError:
        raise ValueError(f"there is no file {str(path)!r}") from None
    except OSError as error:
        raise ValueError(f"{str(path)!r} cannot be read: {error.strerror or error}") from None
    except (ValueError, EOFError) as error:
        raise ValueError(f"{str(path)!r} holds no table of numbers: {error}") from None
    if values.dtype.kind not in "iuf":
        raise ValueError(f"{str(path)!r} must hold numbers, got {values.dtype}")
    if path.suffix.lower() == ".csv":
        values = values[:, 0] if values.shape[1] == 1 else values
        values = values.reshape(-1, 3, 3) if values.shape[1:] == (9,) else values
    return np.asarray(values, dtype=np.float64)
