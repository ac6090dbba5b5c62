"""Arrays in files of NumPy: what they hold that is no number, in words."""

import numpy as np

# By the kind of their type, as NumPy calls it.
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
    """Raises ``ValueError`` naming ``what`` unless an array is of real numbers."""
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{what} must be numbers, got {_WORDS.get(array.dtype.kind, str(array.dtype))}")
