"""Arrays on a device: declared first, so that one knows what they take, and made together."""

from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.footprint import Need

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

    def array(self, purpose: str, owner: Any, name: str, dtype: Any, shape: Shape) -> None:
        """Declares ``owner.name``, an array of zeros."""
        size = wp.types.type_size_in_bytes(dtype)

        def make(envs: int) -> None:
            setattr(owner, name, wp.zeros(shape(envs), dtype=dtype, device=self.device))

        self._declare(purpose, lambda envs: size * prod(shape(envs)), make)

    def struct(self, purpose: str, struct: Any, shape: Shape, **others: Shape) -> Any:
        """Returns an instance of a Warp struct of arrays, all to be of ``shape``, or each of its own one."""
        instance = struct()
        for name, variable in struct.vars.items():
            self.array(purpose, instance, name, variable.type.dtype, others.get(name, shape))
        return instance

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


def allocate(struct: Any, shape: tuple[int, int], device: wp.Device) -> Any:
    """Returns an instance of a Warp struct of arrays [env, item], each of ``shape``, and zero."""
    layout = Layout(device)
    instance = layout.struct("", struct, fixed(*shape))
    layout.allocate(shape[0])
    return instance


def row_bytes(values: NDArray[Any]) -> int:
    """Returns the bytes of one row, that of an environment, of ``values`` (1 or envs, …)."""
    return values[:1].nbytes


def broadcast(memory: wp.array, envs: int) -> wp.array:
    """Returns ``memory`` (1 or envs, items) as an array (envs, items), with stride 0 if it is shared.

    The caller keeps ``memory`` alive.
    """
    if memory.shape[0] == envs:
        return memory
    return wp.array(
        ptr=memory.ptr,
        shape=(envs, *memory.shape[1:]),
        strides=(0, *memory.strides[1:]),
        dtype=memory.dtype,
        device=memory.device,
        copy=False,
    )


def _scalar(dtype: Any) -> Any:
    """Returns the Warp type of the components of ``dtype``."""
    return getattr(dtype, "_wp_scalar_type_", dtype)
