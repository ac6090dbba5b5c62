"""What the threads of a warp of a GPU tell each other; all of them have to come by."""

import functools
from types import SimpleNamespace

import warp as wp

#: Threads of a warp.
LANES = 32


@wp.func_native("return threadIdx.x & 31;")
def lane() -> int:
    """Number of this thread in its warp."""
    ...


@wp.func_native("return __ballot_sync(0xffffffffu, flag);")
def lanes_with(flag: bool) -> int:
    """The threads that say yes, as bits."""
    ...


@wp.func_native("return __popc(lanes);")
def count_of(lanes: int) -> int:
    """How many they are."""
    ...


@wp.func_native("return __ffs(lanes) - 1;")
def first_of(lanes: int) -> int:
    """The first of them; −1: none."""
    ...


@wp.func_native("return unsigned(lanes) & (unsigned(lanes) - 1u);")
def without_first(lanes: int) -> int:
    """The others."""
    ...


@wp.func_native("return __shfl_sync(0xffffffffu, value, lane);")
def int_of(value: int, lane: int) -> int:
    """The value that a thread has."""
    ...


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""

    @wp.func_native("return __shfl_sync(0xffffffffu, value, lane);")
    def real_of(value: real, lane: int) -> real:  # type: ignore[valid-type]
        """The value that a thread has."""
        ...

    @wp.func_native(
        """
        for (int other = 16; other > 0; other /= 2) {
            const auto its = __shfl_xor_sync(0xffffffffu, value, other);
            value = its < value ? its : value;
        }
        return value;
        """
    )
    def least(value: real) -> real:  # type: ignore[valid-type]
        """The least of all values."""
        ...

    return SimpleNamespace(real_of=real_of, least=least)
