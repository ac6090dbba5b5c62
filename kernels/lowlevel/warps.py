"""Warp intrinsics of a GPU: lane index, ballot, shuffle, scan, reductions and bit operations.

All lanes must reach a ballot, shuffle, scan, reduction or ``sync``. On a CPU a warp has one lane, so that kernels written for
warps can be tested there.
"""

import functools

import warp as wp

#: Number of lanes of a warp.
LANES = 32


def _native(on_gpu: str, alone: str) -> str:
    """Returns the source of a function for a GPU, and for a CPU with one lane."""
    return f"""
    #if defined(__CUDA_ARCH__)
    {on_gpu}
    #else
    {alone}
    #endif
    """


@wp.func_native(_native("return threadIdx.x & 31;", "return 0;"))
def lane() -> int:
    """Returns the lane index of this thread."""
    ...


@wp.func_native(_native("return 32;", "return 1;"))
def lane_count() -> int:
    """Returns the number of lanes of a warp."""
    ...


@wp.func_native(_native("return __ballot_sync(0xffffffffu, flag);", "return flag ? 1 : 0;"))
def ballot(flag: bool) -> int:
    """Returns the lanes whose ``flag`` is set, as bits."""
    ...


@wp.func_native(_native("__syncwarp();", ""))
def sync():
    """Synchronizes the lanes of a warp and makes their writes visible to each other."""
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
    """Returns the sum of the values of all lanes up to and including this one."""
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
    """Returns the last lane with ``start`` <= ``number``; ``start`` increases over the lanes, from 0."""
    ...


@functools.cache
def broadcast_function(real: type) -> wp.Function:
    """Returns the device function that broadcasts ``value`` from ``lane`` to all lanes of a warp."""

    @wp.func_native(_native("return __shfl_sync(0xffffffffu, value, lane);", "return value;"))
    def broadcast_from(value: real, lane: int) -> real: ...

    return broadcast_from


@functools.cache
def reductions(real: type) -> tuple[wp.Function, wp.Function]:
    """Returns the device functions of the sum and of the largest of the values of all lanes, the same in each lane."""
    every_lane = """
    for (int way = 16; way > 0; way /= 2) {{
        const auto other = __shfl_xor_sync(0xffffffffu, value, way);
        value = {};
    }}
    return value;
    """

    @wp.func_native(_native(every_lane.format("value + other"), "return value;"))
    def sum_over_lanes(value: real) -> real: ...

    @wp.func_native(_native(every_lane.format("value < other ? other : value"), "return value;"))
    def max_over_lanes(value: real) -> real: ...

    return sum_over_lanes, max_over_lanes


@wp.func_native(_native("return __popc(bits);", "return __builtin_popcount(bits);"))
def popcount(bits: int) -> int:
    """Returns the number of set bits."""
    ...


@wp.func_native(
    _native(
        "while (number-- > 0) bits &= bits - 1; return __ffs(bits) - 1;",
        "while (number-- > 0) bits &= bits - 1; return __builtin_ffs(bits) - 1;",
    )
)
def nth_set_bit(bits: int, number: int) -> int:
    """Returns the index of a set bit, counted from the lowest set bit (``number`` 0)."""
    ...


@wp.func_native(_native("return __ffs(bits) - 1;", "return __builtin_ctz(bits);"))
def lowest_set_bit(bits: int) -> int:
    """Returns the index of the lowest set bit; ``bits`` must not be 0."""
    ...


@wp.func_native("return (unsigned(bits) >> first) & ((1ull << count) - 1ull);")
def bit_range(bits: int, first: int, count: int) -> int:
    """Returns ``count`` bits from bit ``first`` on, shifted to bit 0."""
    ...


@wp.func
def interleave_warps(thread: int, threads: int):
    """Permutes thread numbers so that the first are in different warps, because searches in one warp diverge."""
    number = (threads + 31) // 32
    return (thread % 32) * number + thread // 32
