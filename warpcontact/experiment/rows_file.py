"""Reads files with one value per item of a set: ``.npy``, or ``.csv`` with one row per item."""

import io
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from warpcontact.experiment.errors import abbreviated
from warpcontact.files.regular_files import check_numbers
from warpcontact.files.run_folder import open_file
from warpcontact.system.resources import HOST, available_memory
from warpcontact.validation.checks import Array

SUFFIXES = (".npy", ".csv")


def check_rows_file(label: str, name: str) -> str:
    """Returns ``name`` if ``read_rows`` can read this type of file, or raises ``ValueError``."""
    if Path(name).suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"{label} must be a list, or a file that ends in {' or '.join(SUFFIXES)}, got {name!r}".lstrip()
        )
    return name


def read_rows(path: Path) -> Array:
    """Returns the numbers in a file: for ``.csv`` (n,) if it has one column, otherwise (n, columns).

    Lines of a ``.csv`` that begin with ``#`` are skipped. Nine columns are converted to 3×3 tensors.

    Raises:
        ValueError: If the file cannot be read or contains other data than numbers.
    """
    is_npy = path.suffix.lower() == ".npy"
    memory = available_memory(HOST)
    try:
        with open_file(path, None if memory is None else memory.size) as file:
            values = _array(file) if is_npy else _table(file)
    except FileNotFoundError:
        raise ValueError(f"there is no file {str(path)!r}") from None
    except OSError as error:
        raise ValueError(f"{str(path)!r} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(f"{str(path)!r} holds no table of numbers: {error}") from None
    if not is_npy:
        values = values[:, 0] if values.shape[1] == 1 else values
        values = values.reshape(-1, 3, 3) if values.shape[1:] == (9,) else values
    return np.asarray(values, dtype=np.float64)


def _array(file: BinaryIO) -> NDArray[Any]:
    try:
        found = np.load(file, allow_pickle=False)
    except OSError:
        raise
    except MemoryError:
        raise ValueError("it requires more memory than available, or is damaged") from None
    except Exception:  # NumPy raises various exceptions for damaged files
        raise ValueError("it must be a complete array of numbers as written by numpy.save") from None
    if not isinstance(found, np.ndarray):
        found.close()
        raise ValueError("it must be one array as written by numpy.save, got an archive of arrays (.npz)")
    check_numbers("its values", found)
    return found


def _table(file: BinaryIO) -> NDArray[Any]:
    with io.TextIOWrapper(file, encoding="utf-8-sig") as text:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the warning about empty files
                values = np.loadtxt(text, delimiter=",", ndmin=2)
        except UnicodeDecodeError:
            raise ValueError("it must be text in UTF-8") from None
        except ValueError as error:
            text.seek(0)
            raise ValueError(_fault(text.read()) or str(error)) from None
    if not values.size:
        raise ValueError("it is empty")
    return values


def _fault(content: str) -> str | None:
    """Returns the problem with the first invalid line of a ``.csv``; ``None``: all lines are valid."""
    columns = None
    for number, line in enumerate(content.splitlines(), 1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        cells = text.split(",")
        for k, cell in enumerate(cells, 1):
            if not _is_number(cell):
                return f"line {number}, column {k} must be a number, got {abbreviated(cell.strip())}"
        columns = columns or len(cells)
        if len(cells) != columns:
            return f"line {number} must have as many columns as those before, {columns}, got {len(cells)}"
    return None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
