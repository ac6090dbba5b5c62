"""Root of a function of one variable that rises through zero: bracketing, then refinement of the bracket.

The caller evaluates the function, and the search selects the points:

    while is_running(search):
        at = next_point(search)
        search = update(search, at, value, sample)

Strides of doubled length find a bracket. False positions with the Illinois rule and bisection steps narrow it;
bisection handles jumps and kinks of the function.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.shapes.base import half, real, two, zero
from warpcontact.kernels.types import Struct

# Default length of the first stride, and number of strides; each is twice as long as the one before.
FIRST_STRIDE = 1.0e-3
MAX_STRIDES = wp.constant(wp.int32(9))


class Functions(NamedTuple):
    """Struct of a search for a root, and its device functions."""

    Search: Struct  # state of a search
    #: ``(low, a, f_a, high, b, f_b)``: a search between a and b or, if they are equal, from there.
    start: wp.Function
    #: ``(search)``: whether it has a bracket.
    is_bracketed: wp.Function
    #: ``(search)``: whether there is a point to evaluate.
    is_running: wp.Function
    #: ``(search)``: that point.
    next_point: wp.Function
    #: ``(search, at, f, sample)``: the search with the value and sample at that point.
    update: wp.Function


@functools.cache
def functions(
    Sample: type,
    secant: wp.Function,
    bisection_interval: int,
    max_steps: int,
    min_width: float,
    first: float = FIRST_STRIDE,
) -> Functions:
    """Returns the struct ``Search`` and its device functions.

    Args:
        Sample: Struct of data stored for both ends of the bracket.
        secant: ``(a, b, f_a, f_b)`` → zero of the secant. Its form decides the rounding error.
        bisection_interval: Every n-th step is a bisection, the others are false positions.
        max_steps: Maximum number of steps that narrow the bracket.
        min_width: Width at which the bracket counts as a point.
        first: Length of the first stride.
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
        f_a: real  # value at a, halved each time b moves twice in a row
        f_b: real
        low: Sample  # at a
        high: Sample  # at b
        stride: real  # length of the next stride, with sign
        moved_end: wp.int32  # end that moved last: −1, 1, or 0 for none
        steps: wp.int32  # number of steps since the bracket was found, or of strides before

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

    return Functions(
        Search=Search,
        start=start,
        is_bracketed=is_bracketed,
        is_running=is_running,
        next_point=next_point,
        update=update,
    )
