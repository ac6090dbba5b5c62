"""Host access to the memory that steps write: the arrays a checkpoint stores, and checks of loaded values."""

from collections.abc import Collection, Iterator, Mapping
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

#: Allowed values of an integer: lowest and highest (scalars or one per item), or the set of all values.
Allowed = tuple[Any, Any] | frozenset[int]

#: Range of counters that kernels do not use as an index.
COUNT = (0, 2**31 - 1)
SWITCH = (0, 1)


class Allocation:
    """Memory of one array, or of several that are interleaved in records.

    Args:
        dtypes: Warp types of the arrays, by name.
        offsets: Offset of each array in a record [bytes].
        size: Size of a record [bytes].
        saved: Names of the arrays that checkpoints store.
        ranges: Allowed values of their integers, by array, or array and field (``a.b``).

    Attributes:
        saved: Names of the arrays that checkpoints store.
        shape: Shape of the arrays, after allocation.

    Raises:
        TypeError: If integers that checkpoints store have no range.
    """

    def __init__(
        self,
        dtypes: Mapping[str, Any],
        offsets: Mapping[str, int],
        size: int,
        saved: Collection[str],
        ranges: Mapping[str, Allowed] | None = None,
    ) -> None:
        self.saved = tuple(saved)
        self.shape: tuple[int, ...] = ()
        self._record = np.dtype(
            {
                "names": list(dtypes),
                "formats": [_numpy_type(dtype) for dtype in dtypes.values()],
                "offsets": [offsets[name] for name in dtypes],
                "itemsize": size,
            }
        )
        self._memory: wp.array | None = None
        known = ranges or {}
        self._ranges: dict[str, list[tuple[str, Allowed]]] = {}
        for name in self.saved:
            paths = list(_integers(name, self._record[name]))
            if missing := [path for path in paths if path not in known]:
                raise TypeError(f"{missing[0]}: integers that checkpoints store must have a range")
            self._ranges[name] = [(path, known[path]) for path in paths]

    def bind(self, memory: wp.array, shape: tuple[int, ...]) -> None:
        """Attaches the allocated bytes (…, bytes of a record) of arrays with ``shape``."""
        self._memory, self.shape = memory, shape

    @property
    def memory(self) -> wp.array:
        """All bytes, as an array on the device."""
        assert self._memory is not None
        return self._memory

    def _as_records(self, content: NDArray[np.uint8]) -> NDArray[Any]:
        """Returns bytes as records, of the shape of the arrays."""
        # Empty arrays have the memory of one record.
        flat = content.reshape(-1, self._record.itemsize)[: prod(self.shape)]
        return flat.view(self._record).reshape(self.shape)

    def content(self) -> dict[str, NDArray[np.uint8]]:
        """Returns the bytes of the arrays that checkpoints store, by name."""
        if not self.saved:
            return {}
        records = self._as_records(self.memory.numpy())
        return {name: np.ascontiguousarray(records[name]).reshape(-1).view(np.uint8) for name in self.saved}

    def checked(self, name: str, found: NDArray[Any]) -> NDArray[Any]:
        """Returns the values of an array, in its shape, for the bytes ``found`` in a file.

        Raises:
            ValueError: If the number of bytes or an integer is not allowed; the message names the array.
        """
        element = self._record[name]
        expected = prod(self.shape) * element.itemsize
        if found.dtype != np.uint8 or found.shape != (expected,):
            got = f"{found.nbytes} bytes as {found.dtype} of shape {found.shape}"
            raise ValueError(f"{name} must be {expected} bytes, got {got}")
        values = np.ascontiguousarray(found).view(element.base).reshape(*self.shape, *element.shape)
        for path, allowed in self._ranges[name]:
            _check(path, _field(values, path), allowed, self.shape)
        return values

    def restore(self, values: Mapping[str, NDArray[Any]]) -> None:
        """Sets arrays to ``values``, by name, and all other memory to zero."""
        if not values:
            self.memory.zero_()
            return
        content = np.zeros(self.memory.shape, dtype=np.uint8)
        records = self._as_records(content)
        for name, own in values.items():
            records[name] = own
        self.memory.assign(content)


def _numpy_type(dtype: Any) -> np.dtype[Any]:
    """Returns the NumPy type of the elements of a Warp type: numbers, vectors, matrices and structs."""
    if hasattr(dtype, "numpy_dtype"):
        return np.dtype(dtype.numpy_dtype())
    if hasattr(dtype, "_wp_scalar_type_"):
        return np.dtype((wp.dtype_to_numpy(dtype._wp_scalar_type_), dtype._shape_))
    # Booleans as bytes, so that values other than 0 and 1 are detected.
    return np.dtype(np.uint8 if dtype is wp.bool else wp.dtype_to_numpy(dtype))


def _integers(path: str, dtype: np.dtype[Any]) -> Iterator[str]:
    """Yields the paths of integers and booleans in a type: ``path``, or its fields."""
    base = dtype.base
    if base.names is not None:
        for name in base.names:
            yield from _integers(f"{path}.{name}", base[name])
    elif base.kind != "f":
        yield path


def _field(values: NDArray[Any], path: str) -> NDArray[Any]:
    for name in path.split(".")[1:]:
        values = values[name]
    return values


def _check(path: str, values: NDArray[Any], allowed: Allowed, shape: tuple[int, ...]) -> None:
    """Raises ``ValueError`` if one of ``values`` (shape, …) is not allowed; the message names the first one."""
    if isinstance(allowed, frozenset):
        invalid, condition = ~np.isin(values, list(allowed)), f"one of {sorted(allowed)}"
    else:
        low, high = (np.broadcast_to(limit, shape) for limit in allowed)
        more = (...,) + (None,) * (values.ndim - len(shape))
        invalid, condition = (values < low[more]) | (values > high[more]), ""
    if not invalid.any():
        return
    index = tuple(np.argwhere(invalid)[0])
    if not condition:
        own = index[: len(shape)]
        condition = f"from {low[own]} to {high[own]}"
    raise ValueError(f"{path}[{', '.join(map(str, index))}] must be {condition}, got {values[index]}")
