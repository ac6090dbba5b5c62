"""Serialization of nested dictionaries, lists and arrays into a plain header and flat arrays, and back."""

from math import prod
from typing import IO, Any

import numpy as np

from warpcontact.meshes.isolation import Limits, array_of, header_of, unexpected_answer
from warpcontact.meshes.readers.unreadable import Unreadable

# Key of an array in the header; not a valid name in USD.
_ARRAY = "*"
_TYPES = ("<f8", "<i8", "|b1")


def pack(value: Any) -> tuple[dict[str, Any], list[Any]]:
    """Returns the header and the flat arrays of a value of dictionaries, lists, arrays and plain values."""
    arrays: list[Any] = []
    described: list[Any] = []

    def packed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: packed(one) for key, one in value.items()}
        if isinstance(value, list):
            return [packed(one) for one in value]
        if isinstance(value, np.ndarray):
            kind = {"f": "<f8", "i": "<i8", "b": "|b1"}[value.dtype.kind]
            if value.size:
                arrays.append(np.ascontiguousarray(value, dtype=kind).reshape(-1).view(np.uint8))
            described.append([kind, *value.shape])
            return {_ARRAY: len(described) - 1}
        return value

    tree = packed(value)
    return {"tree": tree, "arrays": described}, arrays


def unpack(output: IO[bytes], limits: Limits) -> Any:
    """Returns the value written by a process; checks sizes before allocating memory.

    Raises:
        EOFError: If the output ends early.
        Unreadable: If the output is an error report, or invalid.
    """
    try:
        header = header_of(output, limits)
        shapes = [(str(kind), [int(size) for size in shape]) for kind, *shape in header["arrays"]]
        if any(kind not in _TYPES or min(shape, default=0) < 0 for kind, shape in shapes):
            raise unexpected_answer("arrays of unknown types")
        if sum(np.dtype(kind).itemsize * prod(shape) for kind, shape in shapes) > limits.memory:
            raise unexpected_answer("more than is allowed")
        arrays = [array_of(output, prod(shape), kind).reshape(shape) for kind, shape in shapes]

        def restore(value: Any) -> Any:
            if isinstance(value, dict):
                return (
                    arrays[value[_ARRAY]] if _ARRAY in value else {key: restore(one) for key, one in value.items()}
                )
            return [restore(one) for one in value] if isinstance(value, list) else value

        return restore(header["tree"])
    except (Unreadable, EOFError):
        raise
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise unexpected_answer(f"{type(error).__name__}: {error}") from error
