"""Allocation plan: device arrays are declared first, so that their memory can be estimated, then allocated."""

from collections.abc import Callable, Collection, Mapping
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.lowlevel import static_strides as strides
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.storage.state_storage import Allocation, Allowed

#: Purpose of the arrays of sensors.
SENSOR_PURPOSE = "measures"

#: Shape of an array for a number of environments.
Shape = Callable[[int], tuple[int, ...]]


def per_env(*items: int) -> Shape:
    """Returns the shape (envs, *items)."""
    return lambda envs: (envs, *items)


def fixed(*shape: int) -> Shape:
    """Returns a shape that does not depend on the number of environments."""
    return lambda _: shape


class AllocationPlan:
    """Declared device arrays; ``allocate`` allocates them.

    Memory estimate and allocation use the same declared shapes.

    Args:
        device: The device.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._sizes: list[tuple[str, Callable[[int], int]]] = []  # purpose, bytes for a number of environments
        self._pending: list[Callable[[int], None]] = []
        # Memory that steps write, by "number:purpose".
        self._step_memory: dict[str, Allocation] = {}

    def array(
        self,
        purpose: str,
        owner: Any,
        name: str,
        dtype: Any,
        shape: Shape,
        *,
        transient: bool = False,
        ranges: Mapping[str, Allowed] | None = None,
    ) -> None:
        """Declares ``owner.name``, an array of zeros; for ``transient`` and ``ranges`` see ``struct``."""
        size = wp.types.type_size_in_bytes(dtype)
        saved = () if transient or purpose == SENSOR_PURPOSE else (name,)
        written = Allocation({name: dtype}, {name: 0}, size, saved, ranges)

        def make(envs: int) -> None:
            array = wp.zeros(shape(envs), dtype=dtype, device=self.device)
            setattr(owner, name, array)
            written.bind(_as_bytes(array), shape(envs))

        self._declare(purpose, lambda envs: size * prod(shape(envs)), make)
        self._add_step_memory(purpose, written)

    def struct(
        self,
        purpose: str,
        struct: Any,
        shape: Shape,
        *,
        records: bool = False,
        transient: bool | Collection[str] = False,
        ranges: Mapping[str, Allowed] | None = None,
        **others: Shape,
    ) -> Any:
        """Declares all arrays of a Warp struct, filled with zeros, and returns an instance of the struct.

        Args:
            purpose: Purpose, for memory estimates.
            struct: The struct.
            shape: Default shape of its arrays.
            records: Whether to interleave the arrays (array of structs), which is faster if few items are accessed.
                On a CPU some structs are always interleaved, see ``kernels/lowlevel/static_strides.py``.
            transient: Names of the arrays that checkpoints omit; ``True``: all. Zeros must be valid values: these
                are caches, and arrays that are computed before they are read.
            ranges: Allowed values of the integers of all other arrays, by array, or array and field (``a.b``).
                Loaded integers are checked, because kernels use them as indices.
            others: Shapes of arrays that differ from ``shape``, by name; for a record, that of its first array.
                Except in records of ``static_strides.py``, these arrays are not interleaved.

        Raises:
            TypeError: If integers that checkpoints store have no range.
        """
        instance = struct()
        dtypes = {name: variable.type.dtype for name, variable in struct.vars.items()}
        omitted = (tuple(dtypes) if transient else ()) if isinstance(transient, bool) else tuple(transient)
        record_groups = strides.record_fields(struct) if self.device.is_cpu else ()
        if records and not record_groups:
            record_names = tuple(name for name in dtypes if name not in others)
            record_groups = (record_names,) if record_names else ()
        for names in record_groups:
            own = {name: dtypes.pop(name) for name in names}
            saved = [name for name in names if name not in omitted]
            self._records(purpose, instance, own, others.get(names[0], shape), saved, ranges)
        for name, dtype in dtypes.items():
            own_shape = others.get(name, shape)
            self.array(purpose, instance, name, dtype, own_shape, transient=name in omitted, ranges=ranges)
        return instance

    def _records(
        self,
        purpose: str,
        owner: Any,
        dtypes: dict[str, Any],
        shape: Shape,
        saved: Collection[str],
        ranges: Mapping[str, Allowed] | None,
    ) -> None:
        """Declares arrays [env, item] that are interleaved in one block of memory."""
        offsets, record = strides.record_layout(dtypes)
        written = Allocation(dtypes, offsets, record, () if purpose == SENSOR_PURPOSE else saved, ranges)

        def number(envs: int) -> int:
            return max(1, prod(shape(envs)))

        def make(envs: int) -> None:
            # Two dimensions, because each is limited to 2³¹ elements, fewer than the bytes of a device.
            memory = wp.zeros((number(envs), record), dtype=wp.uint8, device=self.device)
            own = shape(envs)
            written.bind(memory, own)
            for name, dtype in dtypes.items():
                array = wp.array(
                    ptr=memory.ptr + offsets[name],
                    dtype=dtype,
                    shape=own,
                    strides=(record * own[1], record),
                    device=self.device,
                    copy=False,
                )
                array.memory = memory  # keeps the memory alive
                setattr(owner, name, array)

        self._declare(purpose, lambda envs: number(envs) * record, make)
        self._add_step_memory(purpose, written)

    def _add_step_memory(self, purpose: str, written: Allocation) -> None:
        if purpose != SENSOR_PURPOSE:  # sensors are recomputed on request
            self._step_memory[f"{len(self._step_memory)}:{purpose}"] = written

    def step_memory(self) -> Mapping[str, Allocation]:
        """Returns all memory that steps write (declared as zeros), by "number:purpose"."""
        return self._step_memory

    def constant(self, purpose: str, owner: Any, name: str, values: Any, dtype: Any) -> None:
        """Declares ``owner.name``, an array of ``values`` that all environments share."""
        array = np.asarray(values, dtype=wp.dtype_to_numpy(_scalar(dtype)))

        def make(_: int) -> None:
            setattr(owner, name, wp.array(array, dtype=dtype, device=self.device))

        self.custom(purpose, array.nbytes, make)

    def custom(self, purpose: str, size: int, make: Callable[[int], None]) -> None:
        """Declares an object of ``size`` bytes that ``make`` creates, given the number of environments."""
        self._declare(purpose, lambda _: size, make)

    def allocate(self, envs: int) -> None:
        """Allocates everything that was declared since the last call."""
        pending, self._pending = self._pending, []
        for make in pending:
            make(envs)

    def memory_items(self, envs: int) -> list[MemoryItem]:
        """Returns the memory of all declared arrays, allocated or not, for a number of environments."""
        return [
            MemoryItem(purpose, str(self.device), size(envs), size(2) - size(1)) for purpose, size in self._sizes
        ]

    def _declare(self, purpose: str, size: Callable[[int], int], make: Callable[[int], None]) -> None:
        self._sizes.append((purpose, size))
        self._pending.append(make)


def _as_bytes(array: wp.array) -> wp.array:
    """Returns a view of a contiguous array as bytes, with an additional last axis for the bytes of an element."""
    shape = (*array.shape, wp.types.type_size_in_bytes(array.dtype))
    view = wp.array(ptr=array.ptr, dtype=wp.uint8, shape=shape, device=array.device, copy=False)
    view.memory = array  # keeps the memory alive
    return view


def row_bytes(values: NDArray[Any]) -> int:
    """Returns the bytes of one row (one environment) of ``values`` (1 or envs, …)."""
    return values[:1].nbytes


def broadcast(memory: wp.array, envs: int, items: int | None = None) -> wp.array:
    """Returns ``memory`` (1 or envs, items) as an array (envs, items), with stride 0 if it has one row.

    With ``items``, a single item is broadcast to that number of items.
    """
    if memory.shape[0] == envs and items is None:
        return memory
    shape, strides = [envs, *memory.shape[1:]], list(memory.strides)
    if memory.shape[0] == 1:
        strides[0] = 0
    if items is not None:
        shape[1], strides[1] = items, 0
    array = wp.array(
        ptr=memory.ptr,
        shape=tuple(shape),
        strides=tuple(strides),
        dtype=memory.dtype,
        device=memory.device,
        copy=False,
    )
    array.memory = memory  # keeps the memory alive
    return array


def _scalar(dtype: Any) -> Any:
    """Returns the Warp type of the components of ``dtype``."""
    return getattr(dtype, "_wp_scalar_type_", dtype)
