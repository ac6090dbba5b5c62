"""Arrays on a device: declared first, so that one knows what they take, and made together."""

from collections.abc import Callable, Collection, Mapping
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.lowlevel import static_strides as strides
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.storage.state_storage import Allocation, Allowed

#: Purpose of what sensors are measured into.
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
    """What is to lie on a device. Nothing is allocated before ``allocate``.

    Whatever is declared here is both counted and made from the same shape.

    Args:
        device: The device.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._sizes: list[tuple[str, Callable[[int], int]]] = []  # what for, bytes for a number of environments
        self._pending: list[Callable[[int], None]] = []
        # Memory that steps write, by number and purpose.
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
        """Declares ``owner.name``, an array of zeros; ``transient`` and ``ranges``: see ``struct``."""
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
        """Returns an instance of a Warp struct of arrays, to be zero.

        Args:
            purpose: What for.
            struct: The struct.
            shape: Shape of its arrays.
            records: Whether what belongs to an item lies side by side: few items here and there are fetched whole.
                On a CPU some structs do anyway, as far as ``strides.py`` says.
            transient: Names of the arrays that checkpoints omit, ``True``: all. Zeros must be valid values: these
                are caches, and arrays that are computed before they are read.
            ranges: Allowed values of the integers of all other arrays, by array, or array and field (``a.b``).
                Loaded integers are checked, as kernels use them as indices.
            others: Arrays that have a shape of their own, one for those of a record. They lie apart, if not in
                records of ``strides.py``.

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
        """Declares arrays [env, item] of some types, interleaved in one piece of memory."""
        offsets, record = strides.record_layout(dtypes)
        written = Allocation(dtypes, offsets, record, () if purpose == SENSOR_PURPOSE else saved, ranges)

        def number(envs: int) -> int:
            return max(1, prod(shape(envs)))

        def make(envs: int) -> None:
            # Of two dimensions, as each has less than 2³¹ elements, and a device may have more bytes.
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
                array.memory = memory  # which lives as long as the last of them
                setattr(owner, name, array)

        self._declare(purpose, lambda envs: number(envs) * record, make)
        self._add_step_memory(purpose, written)

    def _add_step_memory(self, purpose: str, written: Allocation) -> None:
        if purpose != SENSOR_PURPOSE:  # measured again on each request
            self._step_memory[f"{len(self._step_memory)}:{purpose}"] = written

    def step_memory(self) -> Mapping[str, Allocation]:
        """Returns all memory that was declared as zeros, which is all that steps write, by number and purpose."""
        return self._step_memory

    def constant(self, purpose: str, owner: Any, name: str, values: Any, dtype: Any) -> None:
        """Declares ``owner.name``, an array that holds ``values``, the same for all environments."""
        array = np.asarray(values, dtype=wp.dtype_to_numpy(_scalar(dtype)))

        def make(_: int) -> None:
            setattr(owner, name, wp.array(array, dtype=dtype, device=self.device))

        self.custom(purpose, array.nbytes, make)

    def custom(self, purpose: str, size: int, make: Callable[[int], None]) -> None:
        """Declares something of ``size`` bytes that ``make`` makes, given the number of environments."""
        self._declare(purpose, lambda _: size, make)

    def allocate(self, envs: int) -> None:
        """Makes what was declared since the last time."""
        pending, self._pending = self._pending, []
        for make in pending:
            make(envs)

    def memory_items(self, envs: int) -> list[MemoryItem]:
        """Returns what all of it takes, made or not, for a number of environments."""
        return [
            MemoryItem(purpose, str(self.device), size(envs), size(2) - size(1)) for purpose, size in self._sizes
        ]

    def _declare(self, purpose: str, size: Callable[[int], int], make: Callable[[int], None]) -> None:
        self._sizes.append((purpose, size))
        self._pending.append(make)


def _as_bytes(array: wp.array) -> wp.array:
    """Returns a contiguous array as bytes, those of an element along an axis more, in the same memory."""
    shape = (*array.shape, wp.types.type_size_in_bytes(array.dtype))
    view = wp.array(ptr=array.ptr, dtype=wp.uint8, shape=shape, device=array.device, copy=False)
    view.memory = array  # which lives as long
    return view


def row_bytes(values: NDArray[Any]) -> int:
    """Returns the bytes of one row, that of an environment, of ``values`` (1 or envs, …)."""
    return values[:1].nbytes


def broadcast(memory: wp.array, envs: int, items: int | None = None) -> wp.array:
    """Returns ``memory`` (1 or envs, items) as an array (envs, items), with stride 0 if it is shared.

    With ``items`` that many share the one that there is.
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
    array.memory = memory  # which lives as long
    return array


def _scalar(dtype: Any) -> Any:
    """Returns the Warp type of the components of ``dtype``."""
    return getattr(dtype, "_wp_scalar_type_", dtype)
