"""Saddles of g(n) = n·c(n) − h_b(n), of a ring and a convex body: the ways out across the tube (``threaded.py``).

Where g is smooth Newton's method finds them, and bisection where it has edges, as the body has faces and edges:
the least along the loop of the largest across it. The point on a face is between those of both sides.
"""

import functools
import math
from types import SimpleNamespace
from typing import Any

import warp as wp
from warpcontact.kernels.smooth import bracket
from warpcontact.kernels.smooth.base import Shape, half, one, real, vec3d, zero

# Directions beside one, by which the way of the loop is found.
BESIDE = wp.constant(wp.int32(16))
TURN = wp.constant(real(2.0 * math.pi / 16))
# How often that is done.
ROUNDS = wp.constant(wp.int32(4))
# Two directions this near to each other are one.
ONE = wp.constant(real(1.0e-12))
# The tangential distance of the two points, over R, at which it is found.
GOAL = wp.constant(real(1.0e-12))
# Newton's method: steps, their halvings, the longest, the side of differences, and what it ends at, over R.
TURNS = wp.constant(wp.int32(30))
HALVINGS = wp.constant(wp.int32(20))
LONGEST = wp.constant(real(0.2))
ASIDE = wp.constant(real(1.0e-7))
SMALL = wp.constant(real(1.0e-15))
# Azimuths at which the rim of a pole is looked at first, from an angle to it, up to the largest, by its logarithm,
# and the first stride of that.
AZIMUTHS = 32
AZIMUTH = wp.constant(real(2.0 * math.pi / AZIMUTHS))
NEAR_POLE = wp.constant(real(math.log(1.0e-3)))
FAR_OFF = wp.constant(real(math.log(1.5)))
STRIDE = 0.05
# Steps to the height of a ridge, and how well it is known then, over R and the distance looked at.
STEPS = wp.constant(wp.int32(4))
WELL = wp.constant(real(0.01))


@wp.struct
class Across:
    """Both surfaces along one direction, frame of b."""

    normal: vec3d  # out of b
    center: vec3d  # of the core circle [m]
    point: vec3d  # of b [m]
    gap: real  # from b to the center [m]
    off: vec3d  # from the point to the center, less what is along the normal [m]


@wp.func
def crossing(a: real, b: real, f_a: real, f_b: real):
    """Where a straight line is zero."""
    return a + (b - a) * (f_a / (f_a - f_b))


@functools.cache
def functions(B: type[Shape]) -> SimpleNamespace:
    """Returns the device functions of a torus and a convex body.

    - ``height(p_a, p_b, x, q, n, within)``: g along n, or on a ridge of it that is not farther than ``within``,
    - ``loop_way(p_a, p_b, x, q, n, radius)``: the way of the loop there,
    - ``smooth(p_a, p_b, x, q, start)`` and ``sharp(p_a, p_b, x, q, start, reach)``: the saddle next to a direction
      as an ``Across``, if that is ``facing(p_a, at)``,
    - ``around_pole(p_a, p_b, x, q, pole)``: that on a loop around a pole, and whether there is one.
    """
    azimuths = wp.constant(wp.int32(AZIMUTHS))
    # Every other step is a halving: g has edges.
    search_of = bracket.functions(Across, crossing, cycle=2, most=110, narrow=1.0e-16)
    begin, closed, told = search_of.begin, search_of.closed, search_of.told
    going, place = search_of.going, search_of.place
    out_of = bracket.functions(Across, crossing, cycle=2, most=110, narrow=1.0e-16, first=STRIDE)
    begin_out, closed_out, told_out = out_of.begin, out_of.closed, out_of.told
    going_out, place_out = out_of.going, out_of.place

    @wp.func
    def across(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d):
        at = Across()
        at.normal = n
        n_A = wp.quat_rotate_inv(q, n)
        level = wp.normalize(vec3d(n_A[0], n_A[1], zero))
        at.center = x + wp.quat_rotate(q, p_a.major_radius * level)
        at.point = B.support(p_b, n)
        apart = at.center - at.point
        at.gap = wp.dot(n, apart)
        at.off = apart - at.gap * n
        return at

    @wp.func
    def height(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, within: real):
        """The value of g along a direction, or on a ridge or an edge of g next to it."""
        at = across(p_a, p_b, x, q, n)
        rate = wp.length(at.off)
        if rate == zero:
            return at.gap
        e = at.off / rate
        n_A = wp.quat_rotate_inv(q, n)
        # Beyond a pole the center is another one.
        high = wp.min(within, wp.length(vec3d(n_A[0], n_A[1], zero)))
        beside = across(p_a, p_b, x, q, wp.normalize(n + high * e))
        fall = -wp.dot(beside.off, e)
        if fall <= zero:
            return at.gap
        low = zero
        low_gap = at.gap
        high_gap = beside.gap
        best = at.gap
        for _ in range(STEPS):
            # Where both tangents cross: on an edge at once, and on a ridge from above.
            on = wp.clamp((high_gap - low_gap + (high - low) * fall) / (rate + fall), zero, high - low)
            bound = low_gap + rate * on
            on += low
            now = across(p_a, p_b, x, q, wp.normalize(n + on * e))
            best = wp.max(best, now.gap)
            if bound - best <= WELL * within * p_a.major_radius:
                break
            slope = wp.dot(now.off, e)
            if slope > zero:
                low = on
                low_gap = now.gap
                rate = slope
            else:
                high = on
                high_gap = now.gap
                fall = -slope
        return best

    @wp.func
    def between(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, low: Across, high: Across, along: vec3d):
        """Of one direction from two sides: the point on the face that is across from the center."""
        at = low
        if wp.length(low.normal - high.normal) > ONE:
            return across(p_a, p_b, x, q, wp.normalize(low.normal + high.normal))
        a = wp.dot(low.off, along)
        b = wp.dot(high.off, along)
        if a != b:
            t = wp.clamp(a / (a - b), zero, one)
            at.point = low.point + t * (high.point - low.point)
            at.center = low.center + t * (high.center - low.center)
            at.off = low.off + t * (high.off - low.off)
            at.gap = low.gap + t * (high.gap - low.gap)
            at.normal = wp.normalize(low.normal + t * (high.normal - low.normal))
        return at

    @wp.func
    def top(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, middle: vec3d, e: vec3d, start: real):
        """The largest g on middle + u e next to u = ``start``, that u, and whether there is one."""
        first = across(p_a, p_b, x, q, wp.normalize(middle + start * e))
        search = begin(first, start, -wp.dot(first.off, e), first, start, -wp.dot(first.off, e))
        while going(search):
            at = place(search)
            now = across(p_a, p_b, x, q, wp.normalize(middle + at * e))
            search = told(search, at, -wp.dot(now.off, e), now)
        return between(p_a, p_b, x, q, search.low, search.high, e), half * (search.a + search.b), closed(search)

    @wp.func
    def saddle(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, e_1: vec3d, e_2: vec3d):
        """The least along e_1 of the largest along e_2, down from a direction; whether there is one."""
        first, u, found = top(p_a, p_b, x, q, n, e_2, zero)
        search = begin(first, zero, wp.dot(first.off, e_1), first, zero, wp.dot(first.off, e_1))
        while found and going(search):
            at = place(search)
            now, u, found = top(p_a, p_b, x, q, n + at * e_1, e_2, u)
            search = told(search, at, wp.dot(now.off, e_1), now)
        return between(p_a, p_b, x, q, search.low, search.high, e_1), found and closed(search)

    @wp.func
    def smooth(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec3d):
        """Where Newton's method for facing normals leads to; ``off`` is infinite if that is no saddle."""
        at = across(p_a, p_b, x, q, start)
        sign = zero
        for _i in range(TURNS):
            n = at.normal
            t_1 = wp.normalize(wp.cross(n, vec3d(n[1], n[2], n[0])))
            t_2 = wp.cross(n, t_1)
            by_1 = across(p_a, p_b, x, q, wp.normalize(n + ASIDE * t_1)).off - at.off
            by_2 = across(p_a, p_b, x, q, wp.normalize(n + ASIDE * t_2)).off - at.off
            J = wp.mat22d(wp.dot(by_1, t_1), wp.dot(by_2, t_1), wp.dot(by_1, t_2), wp.dot(by_2, t_2)) / ASIDE
            sign = wp.determinant(J)
            size = wp.length(at.off)
            if size <= SMALL * p_a.major_radius:
                break
            step = -(wp.inverse(J) * wp.vec2d(wp.dot(at.off, t_1), wp.dot(at.off, t_2)))
            step = step * wp.min(one, LONGEST / wp.length(step))
            for _j in range(HALVINGS):
                now = across(p_a, p_b, x, q, wp.normalize(n + step[0] * t_1 + step[1] * t_2))
                if wp.length(now.off) < size:
                    at = now
                    break
                step = half * step
            if wp.length(at.off) >= size:
                break
        if sign >= zero:
            # No saddle.
            at.off = vec3d(real(wp.inf))
        return at

    @wp.func
    def loop_way(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, radius: real):
        """The unit vector at n along which g is most like a valley, by its values on a circle around n."""
        t_1 = wp.normalize(wp.cross(n, vec3d(n[1], n[2], n[0])))
        t_2 = wp.cross(n, t_1)
        even = zero
        odd = zero
        for k in range(BESIDE):
            angle = TURN * real(k)
            t = wp.cos(angle) * t_1 + wp.sin(angle) * t_2
            g = across(p_a, p_b, x, q, wp.normalize(n + radius * t)).gap
            even += g * wp.cos(real(2.0) * angle)
            odd += g * wp.sin(real(2.0) * angle)
        angle = half * wp.atan2(odd, even)
        return wp.cos(angle) * t_1 + wp.sin(angle) * t_2

    @wp.func
    def sharp(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec3d, reach: real):
        """The saddle next to a direction that lies on an edge of g, or what comes near to one."""
        best = across(p_a, p_b, x, q, start)
        n = start
        radius = half * reach
        for _ in range(ROUNDS):
            e_1 = loop_way(p_a, p_b, x, q, n, radius)
            ridge, _u, on_top = top(p_a, p_b, x, q, n, wp.cross(n, e_1), zero)
            if on_top:
                n = ridge.normal
            radius = half * half * radius
            e_1 = loop_way(p_a, p_b, x, q, n, radius)
            now, found = saddle(p_a, p_b, x, q, n, e_1, wp.cross(n, e_1))
            if found and wp.length(now.off) < wp.length(best.off):
                best = now
                n = best.normal
            if wp.length(best.off) <= GOAL * p_a.major_radius:
                break
        return best

    @wp.func
    def about(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d, azimuth: real, logarithm: real):
        """Both surfaces along a direction, by the logarithm of its angle to a pole, and how g rises with it.

        However small that angle is, the azimuth is known to the last digit.
        """
        angle = wp.exp(wp.min(logarithm, FAR_OFF))
        e = wp.quat_rotate(q, vec3d(wp.cos(azimuth), wp.sin(azimuth), zero))
        at = Across()
        at.normal = wp.normalize(wp.cos(angle) * pole + wp.sin(angle) * e)
        at.center = x + p_a.major_radius * e
        at.point = B.support(p_b, at.normal)
        apart = at.center - at.point
        at.gap = wp.dot(at.normal, apart)
        at.off = apart - at.gap * at.normal
        return at, wp.dot(at.off, wp.cos(angle) * e - wp.sin(angle) * pole)

    @wp.func
    def rim(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d, azimuth: real, start: real):
        """The largest g on the way out from a pole, the logarithm of that angle, and whether there is one."""
        first, rise = about(p_a, p_b, x, q, pole, azimuth, start)
        search = begin_out(first, start, -rise, first, start, -rise)
        while going_out(search):
            at = place_out(search)
            now, rise = about(p_a, p_b, x, q, pole, azimuth, at)
            search = told_out(search, at, -rise, now)
        along = wp.quat_rotate(q, vec3d(wp.cos(azimuth), wp.sin(azimuth), zero))
        return between(p_a, p_b, x, q, search.low, search.high, along), search.b, closed_out(search)

    @wp.func
    def around_pole(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d):
        """The saddle on a loop around a pole, however small, where the rim is lowest; whether there is one.

        Beside the pole g rises by R + d·e along e, with the distance d of the middle of the ring from the point of
        b across the pole: the least to the side of −d. Where d is nearly R, only there the rim is near.
        """
        e_1 = wp.quat_rotate(q, vec3d(one, zero, zero))
        e_2 = wp.quat_rotate(q, vec3d(zero, one, zero))
        d = x - B.support(p_b, pole)
        least = wp.atan2(-wp.dot(d, e_2), -wp.dot(d, e_1))
        first, u, found = rim(p_a, p_b, x, q, pole, least, NEAR_POLE)
        # The point of an edge or a corner may be another one a little beside the pole.
        for k in range(azimuths):
            azimuth = real(k) * AZIMUTH
            now, at, there = rim(p_a, p_b, x, q, pole, azimuth, NEAR_POLE)
            if there and (not found or now.gap < first.gap):
                first = now
                u = at
                found = wp.bool(True)
                least = azimuth
        aside = wp.cos(least) * e_2 - wp.sin(least) * e_1
        search = begin(first, zero, wp.dot(first.off, aside), first, zero, wp.dot(first.off, aside))
        while found and going(search):
            at = place(search)
            now, u, found = rim(p_a, p_b, x, q, pole, least + at, u)
            aside = wp.cos(least + at) * e_2 - wp.sin(least + at) * e_1
            search = told(search, at, wp.dot(now.off, aside), now)
        return between(p_a, p_b, x, q, search.low, search.high, aside), found and closed(search)

    @wp.func
    def facing(p_a: Any, at: Across):
        """Whether the two points lie across from each other."""
        return wp.length(at.off) <= GOAL * p_a.major_radius

    return SimpleNamespace(
        facing=facing, height=height, loop_way=loop_way, smooth=smooth, sharp=sharp, around_pole=around_pole
    )
