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
from warpcontact.kernels.smooth.base import half, real, two, zero

# The first stride to a bracket, usually, and how many there are, each twice as long as the one before.
FIRST = 1.0e-3
STRIDES = wp.constant(wp.int32(9))


@functools.cache
def functions(
    Seen: type, crossing: wp.Function, cycle: int, most: int, narrow: float, first: float = FIRST
) -> SimpleNamespace:
    """Returns the struct ``Search`` and its device functions.

    - ``begin(low, a, f_a, high, b, f_b)``: a search between a and b, or, if they are one, from there,
    - ``closed(search)``: whether it has a bracket,
    - ``going(search)``: whether there is a place to look at,
    - ``place(search)``: that place,
    - ``told(search, at, f, now)``: the search with what was seen there.

    Args:
        Seen: Struct of what is seen at a place, kept for both ends of the bracket.
        crossing: ``(a, b, f_a, f_b)`` → where the straight line through both ends is zero. How that is written
            decides what rounding leaves.
        cycle: The last of so many steps is a halving, the others are false positions.
        most: Number of steps that narrow the bracket.
        narrow: Width of a bracket that is a place.
        first: The first stride to a bracket.
    """
    ahead = wp.constant(real(first))
    steps, every, width = wp.constant(wp.int32(most)), wp.constant(wp.int32(cycle)), wp.constant(real(narrow))

    @wp.struct
    class Search:
        a: real  # lower end
        b: real  # upper end
        f_a: real  # value there, halved where that end stays
        f_b: real
        low: Seen  # at a
        high: Seen  # at b
        stride: real  # the next one
        side: wp.int32  # the end that moved last: −1, 1, or none yet
        steps: wp.int32  # since there is a bracket, or before

    @wp.func
    def begin(low: Seen, a: real, f_a: real, high: Seen, b: real, f_b: real):
        search = Search()
        search.a = a
        search.b = b
        search.f_a = f_a
        search.f_b = f_b
        search.low = low
        search.high = high
        search.stride = wp.where(f_a < zero, ahead, -ahead)
        return search

    @wp.func
    def closed(search: Search):
        return search.f_a <= zero and search.f_b >= zero

    @wp.func
    def going(search: Search):
        if closed(search):
            return search.steps < steps and search.b - search.a > width
        return search.steps < STRIDES

    @wp.func
    def place(search: Search):
        if not closed(search):
            return wp.where(search.stride > zero, search.a, search.b) + search.stride
        if search.steps % every == every - 1:
            return search.a + (search.b - search.a) * half
        return wp.clamp(crossing(search.a, search.b, search.f_a, search.f_b), search.a, search.b)

    @wp.func
    def told(search: Search, at: real, f: real, now: Seen):
        narrowed = closed(search)
        search.steps += 1
        if f <= zero:
            search.a = at
            search.f_a = f
            search.low = now
            if search.side == -1:
                search.f_b = half * search.f_b
            search.side = wp.int32(-1)
        if f >= zero:
            search.b = at
            search.f_b = f
            search.high = now
            if search.side == 1:
                search.f_a = half * search.f_a
            search.side = wp.int32(1)
        if not narrowed:
            search.stride = two * search.stride
            search.side = wp.int32(0)
            if closed(search):
                search.steps = wp.int32(0)
        return search

    return SimpleNamespace(Search=Search, begin=begin, closed=closed, going=going, place=place, told=told)
