"""Warps of a GPU: what their threads tell each other, where all of them have to come by, and who is in which."""

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


@wp.func_native("return (unsigned(lanes) >> first) & ((1ull << count) - 1ull);")
def some(lanes: int, first: int, count: int) -> int:
    """Those among ``count`` threads from ``first`` on, as bits from 0 on."""
    ...


@wp.func
def spread(thread: int, threads: int):
    """Numbers threads anew, so that the first are in different warps: searches go different ways."""
    number = (threads + 31) // 32
    return (thread % 32) * number + thread // 32
