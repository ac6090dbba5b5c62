"""Checks arrays from NumPy files for numbers."""

import numpy as np

# Descriptions by the kind of the data type.
_WORDS = {
    "b": "truth values",
    "c": "complex numbers",
    "m": "times",
    "M": "dates",
    "O": "objects of Python",
    "S": "bytes",
    "U": "text",
    "V": "records of several fields",
}


def check_numbers(what: str, array: np.ndarray) -> None:
    """Raises ``ValueError`` about ``what`` unless an array has real numbers."""
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{what} must be numbers, got {_WORDS.get(array.dtype.kind, str(array.dtype))}")
