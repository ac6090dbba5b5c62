"""Warps of a GPU: what their threads tell each other, where all of them have to come by, and who is in which.

Compiled for a CPU a warp has one thread, so that what is written for warps can be tried there.
"""

import functools

import warp as wp

#: Threads of a warp.
LANES = 32


def _native(on_gpu: str, alone: str) -> str:
    """Returns the source of a function for a thread of a GPU, and for one alone."""
    return f"""
    #if defined(__CUDA_ARCH__)
    {on_gpu}
    #else
    {alone}
    #endif
    """


@wp.func_native(_native("return threadIdx.x & 31;", "return 0;"))
def lane() -> int:
    """Number of this thread in its warp."""
    ...


@wp.func_native(_native("return __ballot_sync(0xffffffffu, flag);", "return flag ? 1 : 0;"))
def ballot(flag: bool) -> int:
    """The threads that say yes, as bits."""
    ...


@wp.func_native(_native("__syncwarp();", ""))
def sync():
    """Threads go on from here when all have come, and see what each other wrote."""
    ...


@wp.func_native(
    _native(
        """
    for (int way = 1; way < 32; way *= 2) {
        const int other = __shfl_up_sync(0xffffffffu, value, way);
        if ((threadIdx.x & 31) >= way) value += other;
    }
    return value;
    """,
        "return value;",
    )
)
def inclusive_scan(value: int) -> int:
    """Sum of the values of all threads up to this one."""
    ...


@wp.func_native(
    _native(
        """
    int owner = 0;
    for (int way = 16; way > 0; way /= 2)
        if (__shfl_sync(0xffffffffu, start, owner + way) <= number) owner += way;
    return owner;
    """,
        "return 0;",
    )
)
def find_owner(start: int, number: int) -> int:
    """The last thread whose ``start``, which rises from thread to thread from 0 on, is not above ``number``."""
    ...


@functools.cache
def broadcast_function(real: type) -> wp.Function:
    """Returns the device function that tells each thread of a warp the ``value`` that a ``lane`` has."""

    @wp.func_native(_native("return __shfl_sync(0xffffffffu, value, lane);", "return value;"))
    def broadcast_from(value: real, lane: int) -> real: ...

    return broadcast_from


@wp.func_native(_native("return __popc(bits);", "return __builtin_popcount(bits);"))
def popcount(bits: int) -> int:
    """How many bits are set."""
    ...


@wp.func_native(
    _native(
        "while (number-- > 0) bits &= bits - 1; return __ffs(bits) - 1;",
        "while (number-- > 0) bits &= bits - 1; return __builtin_ffs(bits) - 1;",
    )
)
def nth_set_bit(bits: int, number: int) -> int:
    """Place of the bit with a number among those that are set, from the lowest on."""
    ...


@wp.func_native(_native("return __ffs(bits) - 1;", "return __builtin_ctz(bits);"))
def lowest_set_bit(bits: int) -> int:
    """Place of the lowest bit that is set, of some."""
    ...


@wp.func_native("return (unsigned(bits) >> first) & ((1ull << count) - 1ull);")
def bit_range(bits: int, first: int, count: int) -> int:
    """Those among ``count`` bits from ``first`` on, as bits from 0 on."""
    ...


@wp.func
def interleave_warps(thread: int, threads: int):
    """Numbers threads anew, so that the first are in different warps: searches go different ways."""
    number = (threads + 31) // 32
    return (thread % 32) * number + thread // 32
