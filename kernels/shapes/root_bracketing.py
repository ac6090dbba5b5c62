"""Where a function of one variable rises through zero: brackets, and how they are found and made narrow.

A search says where to look next and is told what is there, until nothing is left to look for:

    while going(search):
        at = place(search)
        search = told(search, at, value, what was seen)

It strides to a bracket first, and narrows that by false positions, with the Illinois rule, and by halvings: where
the function jumps or bends sharply, it is no straight line.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.shapes.base import half, real, two, zero

# The first stride to a bracket, usually, and how many there are, each twice as long as the one before.
FIRST_STRIDE = 1.0e-3
MAX_STRIDES = wp.constant(wp.int32(9))


@functools.cache
def functions(
    Sample: type,
    secant: wp.Function,
    bisection_interval: int,
    max_steps: int,
    min_width: float,
    first: float = FIRST_STRIDE,
) -> SimpleNamespace:
    """Returns the struct ``Search`` and its device functions.

    - ``start(low, a, f_a, high, b, f_b)``: a search between a and b, or, if they are one, from there,
    - ``is_bracketed(search)``: whether it has a bracket,
    - ``is_running(search)``: whether there is a place to look at,
    - ``next_point(search)``: that place,
    - ``update(search, at, f, now)``: the search with what was seen there.

    Args:
        Sample: Struct of what is seen at a place, kept for both ends of the bracket.
        secant: ``(a, b, f_a, f_b)`` → where the straight line through both ends is zero. How that is written
            decides what rounding leaves.
        bisection_interval: The last of so many steps is a halving, the others are false positions.
        max_steps: Number of steps that narrow the bracket.
        min_width: Width of a bracket that is a place.
        first: The first stride to a bracket.
    """
    first_stride = wp.constant(real(first))
    steps, interval, width = (
        wp.constant(wp.int32(max_steps)),
        wp.constant(wp.int32(bisection_interval)),
        wp.constant(real(min_width)),
    )

    @wp.struct
    class Search:
        a: real  # lower end
        b: real  # upper end
        f_a: real  # value there, halved where that end stays
        f_b: real
        low: Sample  # at a
        high: Sample  # at b
        stride: real  # the next one
        moved_end: wp.int32  # the end that moved last: −1, 1, or none yet
        steps: wp.int32  # since there is a bracket, or before

    @wp.func
    def start(low: Sample, a: real, f_a: real, high: Sample, b: real, f_b: real):
        search = Search()
        search.a = a
        search.b = b
        search.f_a = f_a
        search.f_b = f_b
        search.low = low
        search.high = high
        search.stride = wp.where(f_a < zero, first_stride, -first_stride)
        return search

    @wp.func
    def is_bracketed(search: Search):
        return search.f_a <= zero and search.f_b >= zero

    @wp.func
    def is_running(search: Search):
        if is_bracketed(search):
            return search.steps < steps and search.b - search.a > width
        return search.steps < MAX_STRIDES

    @wp.func
    def next_point(search: Search):
        if not is_bracketed(search):
            return wp.where(search.stride > zero, search.a, search.b) + search.stride
        if search.steps % interval == interval - 1:
            return search.a + (search.b - search.a) * half
        return wp.clamp(secant(search.a, search.b, search.f_a, search.f_b), search.a, search.b)

    @wp.func
    def update(search: Search, at: real, f: real, sample: Sample):
        was_bracketed = is_bracketed(search)
        search.steps += 1
        if f <= zero:
            search.a = at
            search.f_a = f
            search.low = sample
            if search.moved_end == -1:
                search.f_b = half * search.f_b
            search.moved_end = wp.int32(-1)
        if f >= zero:
            search.b = at
            search.f_b = f
            search.high = sample
            if search.moved_end == 1:
                search.f_a = half * search.f_a
            search.moved_end = wp.int32(1)
        if not was_bracketed:
            search.stride = two * search.stride
            search.moved_end = wp.int32(0)
            if is_bracketed(search):
                search.steps = wp.int32(0)
        return search

    return SimpleNamespace(
        Search=Search,
        start=start,
        is_bracketed=is_bracketed,
        is_running=is_running,
        next_point=next_point,
        update=update,
    )
