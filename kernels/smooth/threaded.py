"""How far a ring and a convex body that it is threaded on are apart, however deep its core runs in the body.

With c(n) the point of the core circle that is farthest along n,

    g(n) = n·c(n) − h_b(n)

is the width of the gap across the tube there, on the side of the hole. The azimuth of n is that of the place, so
ways out of the body for all places of the ring are a loop of directions around its axis. The gap is the least g on
the loop where that is largest: by no shorter move does the ring come off the body around it. By that it does where
the hole has room on the other side; a body that is too thick for it, or too much askew, then overlaps there. It is
as well the largest g on the path from one pole to the other where that is least: both meet in a saddle of g, where
the points have facing normals.

That saddle is looked for on a grid of directions: those below a level, as bits, hold a path between the poles or
do not. From its cell Newton's method goes on, or, as g has edges where the body has faces and edges, bisection:
the least along the loop of the largest across it. The point on a face is between those of both sides.
"""

import functools
import math
from types import SimpleNamespace
from typing import Any

import warp as wp
from warpcontact.kernels.smooth import bracket
from warpcontact.kernels.smooth.base import Shape, half, one, real, vec3d, zero

#: Directions around the axis, and between the poles: bits of a word.
COLUMNS = 64
ROWS = 32
COLUMN = wp.constant(real(2.0 * math.pi / COLUMNS))
# On average; at the equator 1.4 of it, so that an edge of g through a cell is within this of its middle.
ROW = wp.constant(real(math.pi / ROWS))
# Rows are closer to each other at the poles, where the center turns around, than at the equator.
DENSER = wp.constant(real(0.4))
QUARTER = wp.constant(real(0.5 * math.pi))
BIT = wp.constant(wp.uint32(1))
LAST = wp.constant(wp.uint32(1 << (ROWS - 1)))
NONE = wp.constant(wp.uint32(0))
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
# Directions beside a cell to start from, and how far.
STARTS = 40
TRIES = wp.constant(wp.int32(2 * STARTS + 2))
SPIRAL = wp.constant(real(math.pi * (3.0 - math.sqrt(5.0))))
REACH = wp.constant(real(0.2))
# Azimuths at which the rim of a pole is looked at first, from an angle to it, up to the largest, by its logarithm,
# and the first stride of that.
AZIMUTHS = 32
AZIMUTH = wp.constant(real(2.0 * math.pi / AZIMUTHS))
NEAR_POLE = wp.constant(real(math.log(1.0e-3)))
FAR_OFF = wp.constant(real(math.log(1.5)))
STRIDE = 0.05
# Steps to the height of a ridge.
HONED = wp.constant(wp.int32(4))
# By how much the grid is off, over R: usually, and at most.
SAME = wp.constant(real(2.0e-3))
UNSURE = wp.constant(real(0.02))

Words = wp.types.vector(COLUMNS, wp.uint32)


@wp.struct
class Across:
    """Both surfaces along one direction, frame of b."""

    normal: vec3d  # out of b
    center: vec3d  # of the core circle [m]
    point: vec3d  # of b [m]
    gap: real  # from b to the center [m]
    off: vec3d  # from the point to the center, less what is along the normal [m]


@wp.func
def joined(below: Words):
    """Whether the bits hold a path from the first row to the last, from side to side of cells."""
    reached = Words()
    columns = wp.int32(COLUMNS)
    for i in range(columns):
        reached[i] = below[i] & BIT
    going = wp.bool(True)
    while going:
        going = wp.bool(False)
        for i in range(columns):
            word = reached[i] | reached[(i + 1) % columns] | reached[(i + columns - 1) % columns]
            word = word & below[i]
            spread = word | ((word << BIT | word >> BIT) & below[i])
            while spread != word:
                word = spread
                spread = word | ((word << BIT | word >> BIT) & below[i])
            if word != reached[i]:
                reached[i] = word
                going = wp.bool(True)
                if (word & LAST) != NONE:
                    return wp.bool(True)
    return wp.bool(False)


@wp.func
def crossing(a: real, b: real, f_a: real, f_b: real):
    """Where a straight line is zero."""
    return a + (b - a) * (f_a / (f_a - f_b))


@functools.cache
def functions(B: type[Shape]) -> SimpleNamespace:
    """Returns the device functions of a torus and a convex body, each for an ``Across`` and whether there is one.

    ``threaded(p_a, p_b, x, q, least, most)``: where the largest loop is least, if that is above ``least`` [m];
    where the grid has one that is not found to the last digit, ``off`` is infinite. Of several that the grid does
    not tell apart, one that is not above ``most`` [m] is taken.

    ``follow(p_a, p_b, x, q, start, level, above, most, reach)``: likewise the saddle next to a direction that is
    about as high as ``level`` and higher than ``above`` [m], from starts within ``reach`` and about the poles.
    """
    columns = wp.constant(wp.int32(COLUMNS))
    rows = wp.constant(wp.int32(ROWS))
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
    def direction(q: wp.quatd, cell: wp.int32):
        azimuth = real(cell // rows) * COLUMN
        up = (real(cell % rows) + half) * ROW / QUARTER - one
        latitude = QUARTER * up * (one + DENSER * (one - up * up))
        level = wp.cos(latitude)
        return wp.quat_rotate(q, vec3d(level * wp.cos(azimuth), level * wp.sin(azimuth), wp.sin(latitude)))

    @wp.func
    def height(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, cell: wp.int32):
        """The value of g in the middle of a cell, or on a ridge or an edge of g that runs through it."""
        at = across(p_a, p_b, x, q, direction(q, cell))
        rate = wp.length(at.off)
        if rate == zero:
            return at.gap
        e = at.off / rate
        middle = at.normal
        n_A = wp.quat_rotate_inv(q, middle)
        # Beyond a pole the center is another one.
        high = wp.min(real(ROW), wp.length(vec3d(n_A[0], n_A[1], zero)))
        beside = across(p_a, p_b, x, q, wp.normalize(middle + high * e))
        fall = -wp.dot(beside.off, e)
        if fall <= zero:
            return at.gap
        low = zero
        low_gap = at.gap
        high_gap = beside.gap
        best = at.gap
        for _ in range(HONED):
            # Where both tangents cross: on an edge at once, and on a ridge from above.
            on = wp.clamp((high_gap - low_gap + (high - low) * fall) / (rate + fall), zero, high - low)
            bound = low_gap + rate * on
            on += low
            now = across(p_a, p_b, x, q, wp.normalize(middle + on * e))
            best = wp.max(best, now.gap)
            if bound - best <= half * SAME * p_a.major_radius:
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
    def sharp(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec3d):
        """The saddle next to a direction that lies on an edge of g, or what comes near to one."""
        best = across(p_a, p_b, x, q, start)
        n = start
        radius = real(ROW)
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
    def follow(
        p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec3d, level: real, above: real, most: real, reach: real
    ):
        """The saddle next to a direction that is about as high as ``level``, and whether there is one."""
        best = across(p_a, p_b, x, q, start)
        error = real(wp.inf)
        below = wp.bool(False)
        t_1 = wp.normalize(wp.cross(start, vec3d(start[1], start[2], start[0])))
        t_2 = wp.cross(start, t_1)
        for k in range(TRIES + 2):
            n = start
            turn = k // 2
            if turn > 0 and k < TRIES:
                # A spiral out.
                angle = SPIRAL * real(turn)
                radius = reach * wp.sqrt(real(turn) / real(wp.static(STARTS)))
                n = wp.normalize(n + radius * (wp.cos(angle) * t_1 + wp.sin(angle) * t_2))
            now = Across()
            if k >= TRIES:
                # No direction from which to start is near enough to a loop that is small.
                axis = wp.quat_rotate(q, vec3d(zero, zero, wp.where(k == TRIES, one, -one)))
                now, there = around_pole(p_a, p_b, x, q, axis)
                if not there:
                    now.off = vec3d(real(wp.inf))
            elif k % 2 == 0:
                now = smooth(p_a, p_b, x, q, n)
            else:
                now = sharp(p_a, p_b, x, q, n)
            off = wp.abs(now.gap - level)
            facing = wp.length(now.off) <= GOAL * p_a.major_radius
            if facing and off <= UNSURE * p_a.major_radius and now.gap > above:
                under = now.gap <= most
                # One that is not above what there may be comes first, and then the nearest to the level.
                if (under and not below) or (under == below and off < error):
                    error = off
                    best = now
                    below = under
            if below and error <= SAME * p_a.major_radius:
                break
        return best, error <= UNSURE * p_a.major_radius

    @wp.func
    def threaded(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, least: real, most: real):
        floor = least - UNSURE * p_a.major_radius
        level = floor
        below = Words()
        open = Words()
        count = wp.int32(0)
        for i in range(columns):
            for j in range(rows):
                cell = i * rows + j
                if height(p_a, p_b, x, q, cell) < floor:
                    below[i] = below[i] | (BIT << wp.uint32(j))
                else:
                    open[i] = open[i] | (BIT << wp.uint32(j))
                    count += 1
        if joined(below):
            return Across(), wp.bool(False)
        # The level at which the poles are joined: open cells are halved by the value of one of them.
        pass_at = wp.int32(-1)
        while count > 0 and pass_at < 0:
            skip = count // 2
            pivot = wp.int32(-1)
            for i in range(columns):
                for j in range(rows):
                    if pivot < 0 and (open[i] >> wp.uint32(j) & BIT) != NONE:
                        if skip == 0:
                            pivot = i * rows + j
                        skip -= 1
            level = height(p_a, p_b, x, q, pivot)
            lower = Words()
            lower_count = wp.int32(0)
            trial = Words()
            for i in range(columns):
                trial[i] = below[i]
                for j in range(rows):
                    cell = i * rows + j
                    if (open[i] >> wp.uint32(j) & BIT) != NONE and cell != pivot:  # noqa: SIM102  Warp computes both
                        if height(p_a, p_b, x, q, cell) < level:
                            lower[i] = lower[i] | (BIT << wp.uint32(j))
                            lower_count += 1
                trial[i] = trial[i] | lower[i]
            if joined(trial):
                open = lower
                count = lower_count
            else:
                own = BIT << wp.uint32(pivot % rows)
                trial[pivot // rows] = trial[pivot // rows] | own
                if joined(trial):
                    pass_at = pivot
                below = trial
                for i in range(columns):
                    open[i] = open[i] & ~trial[i]
                count -= lower_count + 1
        if pass_at < 0:
            return Across(), wp.bool(False)
        found, good = follow(p_a, p_b, x, q, direction(q, pass_at), level, real(-wp.inf), most, REACH)
        if not good:
            # Where it is no better it is not missed.
            found.off = vec3d(real(wp.inf))
            return found, level > least
        if found.gap > most and level <= least:
            # Another saddle, where the grid has none above that either.
            return found, wp.bool(False)
        return found, found.gap > least

    return SimpleNamespace(threaded=threaded, follow=follow)
