"""Arrays on a device: declared first, so that one knows what they take, and made together."""

from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.footprint import Need
from warpcontact.kernels import strides

#: Purpose of what readings are measured into.
MEASURES = "measures"

#: Shape of an array for a number of environments.
Shape = Callable[[int], tuple[int, ...]]


def per_env(*items: int) -> Shape:
    """Returns the shape (envs, *items)."""
    return lambda envs: (envs, *items)


def fixed(*shape: int) -> Shape:
    """Returns a shape that does not depend on the number of environments."""
    return lambda _: shape


class Layout:
    """What is to lie on a device. Nothing is allocated before ``allocate``.

    Whatever is declared here is both counted and made from the same shape.

    Args:
        device: The device.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._sizes: list[tuple[str, Callable[[int], int]]] = []  # what for, bytes for a number of environments
        self._missing: list[Callable[[int], None]] = []
        # What steps write: purpose, name, and how to find it once it is made.
        self._written: list[tuple[str, str, Callable[[], wp.array]]] = []

    def array(self, purpose: str, owner: Any, name: str, dtype: Any, shape: Shape) -> None:
        """Declares ``owner.name``, an array of zeros."""
        size = wp.types.type_size_in_bytes(dtype)

        def make(envs: int) -> None:
            setattr(owner, name, wp.zeros(shape(envs), dtype=dtype, device=self.device))

        self._declare(purpose, lambda envs: size * prod(shape(envs)), make)
        self._written.append((purpose, name, lambda: getattr(owner, name)))

    def struct(self, purpose: str, struct: Any, shape: Shape, *, records: bool = False, **others: Shape) -> Any:
        """Returns an instance of a Warp struct of arrays, to be zero.

        Args:
            purpose: What for.
            struct: The struct.
            shape: Shape of its arrays.
            records: Whether what belongs to an item lies side by side: few items here and there are fetched whole.
                On a CPU some structs do anyway, as far as ``strides.py`` says.
            others: Arrays that have a shape of their own, one for those of a record. They lie apart, if not in
                records of ``strides.py``.
        """
        instance = struct()
        dtypes = {name: variable.type.dtype for name, variable in struct.vars.items()}
        kinds = strides.in_records(struct) if self.device.is_cpu else ()
        if records and not kinds:
            alike = tuple(name for name in dtypes if name not in others)
            kinds = (alike,) if alike else ()
        for names in kinds:
            own = {name: dtypes.pop(name) for name in names}
            self._records(purpose, instance, own, others.get(names[0], shape))
        for name, dtype in dtypes.items():
            self.array(purpose, instance, name, dtype, others.get(name, shape))
        return instance

    def _records(self, purpose: str, owner: Any, dtypes: dict[str, Any], shape: Shape) -> None:
        """Declares arrays [env, item] of some types, interleaved in one piece of memory."""
        offsets, record = strides.record_of(dtypes)

        def number(envs: int) -> int:
            return max(1, prod(shape(envs)))

        made: list[wp.array] = []

        def make(envs: int) -> None:
            # Of two dimensions, as each has less than 2³¹ elements, and a device may have more bytes.
            memory = wp.zeros((number(envs), record), dtype=wp.uint8, device=self.device)
            made[:] = [memory]
            own = shape(envs)
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
        self._written.append((purpose, "+".join(dtypes), lambda: made[0]))

    def written(self) -> dict[str, wp.array]:
        """Returns the bytes of every array that was declared as zeros, by a name that says which it is.

        That is all that steps write; measures, which are made anew whenever they are asked for, are left out.
        """
        return {
            f"{number}:{purpose}:{name}": _bytes_of(find())
            for number, (purpose, name, find) in enumerate(self._written)
            if purpose != MEASURES
        }

    def content(self, purpose: str, owner: Any, name: str, values: Any, dtype: Any) -> None:
        """Declares ``owner.name``, an array that holds ``values``, the same for all environments."""
        array = np.asarray(values, dtype=wp.dtype_to_numpy(_scalar(dtype)))

        def make(_: int) -> None:
            setattr(owner, name, wp.array(array, dtype=dtype, device=self.device))

        self.other(purpose, array.nbytes, make)

    def other(self, purpose: str, size: int, make: Callable[[int], None]) -> None:
        """Declares something of ``size`` bytes that ``make`` makes, given the number of environments."""
        self._declare(purpose, lambda _: size, make)

    def allocate(self, envs: int) -> None:
        """Makes what was declared since the last time."""
        missing, self._missing = self._missing, []
        for make in missing:
            make(envs)

    def needs(self, envs: int) -> list[Need]:
        """Returns what all of it takes, made or not, for a number of environments."""
        return [Need(purpose, str(self.device), size(envs), size(2) - size(1)) for purpose, size in self._sizes]

    def _declare(self, purpose: str, size: Callable[[int], int], make: Callable[[int], None]) -> None:
        self._sizes.append((purpose, size))
        self._missing.append(make)


def _bytes_of(array: wp.array) -> wp.array:
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
