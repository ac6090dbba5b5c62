"""Nested plain values with arrays in them, as a header of plain values and flat arrays, and back."""

from math import prod
from typing import IO, Any

import numpy as np

from warpcontact.meshes.isolation import Limits, array_of, header_of, unexpected_answer
from warpcontact.meshes.readers.unreadable import Unreadable

# No name of USD: what stands for an array in the header.
_ARRAY = "*"
_TYPES = ("<f8", "<i8", "|b1")


def pack(value: Any) -> tuple[dict[str, Any], list[Any]]:
    """Returns the header and the flat arrays of a value of dictionaries, lists, arrays and plain values."""
    arrays: list[Any] = []
    described: list[Any] = []

    def taken(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: taken(one) for key, one in value.items()}
        if isinstance(value, list):
            return [taken(one) for one in value]
        if isinstance(value, np.ndarray):
            kind = {"f": "<f8", "i": "<i8", "b": "|b1"}[value.dtype.kind]
            if value.size:
                arrays.append(np.ascontiguousarray(value, dtype=kind).reshape(-1).view(np.uint8))
            described.append([kind, *value.shape])
            return {_ARRAY: len(described) - 1}
        return value

    tree = taken(value)
    return {"tree": tree, "arrays": described}, arrays


def unpack(output: IO[bytes], limits: Limits) -> Any:
    """Returns the value that a process wrote; sizes are checked before memory is taken for them.

    Raises:
        EOFError: If it ends early.
        Unreadable: If it is a reason instead, or makes no sense.
    """
    try:
        header = header_of(output, limits)
        shapes = [(str(kind), [int(size) for size in shape]) for kind, *shape in header["arrays"]]
        if any(kind not in _TYPES or min(shape, default=0) < 0 for kind, shape in shapes):
            raise unexpected_answer("arrays of unknown types")
        if sum(np.dtype(kind).itemsize * prod(shape) for kind, shape in shapes) > limits.memory:
            raise unexpected_answer("more than is allowed")
        arrays = [array_of(output, prod(shape), kind).reshape(shape) for kind, shape in shapes]

        def put(value: Any) -> Any:
            if isinstance(value, dict):
                return arrays[value[_ARRAY]] if _ARRAY in value else {key: put(one) for key, one in value.items()}
            return [put(one) for one in value] if isinstance(value, list) else value

        return put(header["tree"])
    except (Unreadable, EOFError):
        raise
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise unexpected_answer(f"{type(error).__name__}: {error}") from error
