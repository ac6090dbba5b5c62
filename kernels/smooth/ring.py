"""Where a torus and another closed shape meet: the point of the core circle that is deepest in it, or nearest.

A torus is all within r of its core circle, so the gap is the least signed distance of the circle from the other
shape, less r. That distance f(θ) has several minima: all around is looked at, every time, so that the result
depends on the pose alone and on nothing that came before. As the signed distance from a convex body is a convex
function, f + ½ R θ² is convex: two neighbouring values and slopes bound f from below in between, and only what can
lie lower than the least value known is looked at closely.

Where f has a kink at its least value, the way out of the other shape is as short to two sides, and neither is
across the tube. Behind a sharp edge, or where the tube pierces a thin part, the contact is then the one whose
normal lies between the two, across the tube: the circle's farthest point and the shape's are sought from there by
Newton's method. Where that leads nowhere, no pair of points has facing normals, and this is reported.
"""

import functools
import math
from typing import Any

import warp as wp
from warpcontact.kernels.smooth.base import Meeting, Nearest, Shape
from warpcontact.kernels.smooth.nearest import nearest
from warpcontact.kernels.smooth.torus import Torus
from warpcontact.kernels.types import MET, NOT_CONVERGED

real = wp.float64
vec3d = wp.vec3d
zero = wp.constant(real(0.0))
one = wp.constant(real(1.0))
half = wp.constant(real(0.5))

#: Places on the circle that are looked at, and parts that what lies between two of them is cut into.
PLACES = 48
PARTS = 6
WIDTH = wp.constant(real(2.0 * math.pi / PLACES))
PART = wp.constant(real(2.0 * math.pi / PLACES / PARTS))
# Of f'/R, the cosine between normal and circle.
ALLOWED = wp.constant(real(1.0e-9))
# Halvings of a bracket, in the worst case; a smooth minimum takes 8 to 10 steps.
STEPS = wp.constant(wp.int32(60))
# A bracket this narrow is a point of the circle [rad].
NARROW = wp.constant(real(1.0e-15))
# How far to the side differences are taken [rad], and steps of Newton's method from a kink.
ASIDE = wp.constant(real(1.0e-6))
TURNS = wp.constant(wp.int32(30))
HALVINGS = wp.constant(wp.int32(30))
# Of the tangential distance of the two points, over R.
GOAL = wp.constant(real(1.0e-14))


@wp.struct
class Seen:
    """The other shape from one point of the core circle, frame of b."""

    angle: real
    near: Nearest  # frame of b
    center: vec3d  # the point of the circle, frame of b
    slope: real  # df/dθ over R


@functools.cache
def meet(A: type[Torus], B: type[Shape]) -> wp.Function:
    """Returns the device function of a torus and a closed shape; arguments as in ``meet.py``."""
    of_place = nearest(B)
    rounded = B.convex and hasattr(B, "support")
    places = wp.constant(wp.int32(PLACES))
    parts = wp.constant(wp.int32(PARTS))
    Values = wp.types.vector(PLACES, real)

    @wp.func
    def seen(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, angle: real):
        at = Seen()
        at.angle = angle
        c = wp.cos(angle)
        s = wp.sin(angle)
        at.center = x + wp.quat_rotate(q, vec3d(p_a.major_radius * c, p_a.major_radius * s, zero))
        at.near = of_place(p_b, at.center)
        at.slope = wp.dot(at.near.normal, wp.quat_rotate(q, vec3d(-s, c, zero)))
        return at

    @wp.func
    def lowest(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, low: Seen, high: Seen):
        """The minimum between a falling and a rising slope, by false positions and halvings."""
        a = low.angle
        b = high.angle
        f_a = low.slope
        f_b = high.slope
        best = low
        if high.near.gap < low.near.gap:
            best = high
        side = wp.int32(0)
        steps = wp.int32(0)
        for k in range(STEPS):
            if b - a <= NARROW or wp.abs(best.slope) <= NARROW:
                break
            at = a + (b - a) * half
            # Every fourth step is a halving: a kink is no straight line.
            if k % 4 != 3:
                at = (a * f_b - b * f_a) / (f_b - f_a)
                at = wp.clamp(at, a, b)
            now = seen(p_a, p_b, x, q, at)
            steps += 1
            if wp.abs(now.slope) <= wp.abs(best.slope) or now.near.gap < best.near.gap:
                best = now
            if now.slope < zero:
                a = at
                f_a = now.slope
                if side == -1:
                    f_b = half * f_b
                side = wp.int32(-1)
            else:
                b = at
                f_b = now.slope
                if side == 1:
                    f_a = half * f_a
                side = wp.int32(1)
        return best, steps

    @wp.func
    def bound(radius: real, low: real, low_slope: real, high: real, high_slope: real, width: real):
        """What f is not below between two places; slopes are those over the radius."""
        # Where the tangents cross, less what the circle can bend away from them.
        steepness = low_slope - high_slope
        least = wp.min(low, high)
        if steepness < zero:
            on = wp.clamp((high - low - radius * high_slope * width) / (radius * steepness), zero, width)
            least = wp.min(least, low + radius * low_slope * on)
        return least - half * radius * width * width

    @wp.func
    def beside(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, near: vec3d):
        """The place of the circle with the tube's normal along n, of two the one by ``near``, from the shape's."""
        n_A = wp.quat_rotate_inv(q, n)
        level = wp.normalize(vec3d(n_A[0], n_A[1], zero))
        center = x + wp.quat_rotate(q, p_a.major_radius * level)
        other = x - wp.quat_rotate(q, p_a.major_radius * level)
        if wp.length(other - near) < wp.length(center - near):
            center = other
        point = B.support(p_b, n)
        return center, point, center - point - wp.dot(center - point, n) * n

    @wp.func
    def squeezed(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, kink: Seen):
        """The contact from a kink on, as far as there is one; its residual says so."""
        before = seen(p_a, p_b, x, q, kink.angle - ASIDE)
        after = seen(p_a, p_b, x, q, kink.angle + ASIDE)
        n = after.slope * before.near.normal - before.slope * after.near.normal
        met = Meeting()
        met.residual = one
        if wp.length(n) < ASIDE:
            return met
        n = wp.normalize(n)
        center, point, off = beside(p_a, p_b, x, q, n, kink.center)
        for _i in range(TURNS):
            if wp.length(off) <= GOAL * p_a.major_radius:
                break
            t_1 = wp.normalize(wp.cross(n, vec3d(n[1], n[2], n[0])))
            t_2 = wp.cross(n, t_1)
            _c_1, _p_1, off_1 = beside(p_a, p_b, x, q, wp.normalize(n + ASIDE * t_1), kink.center)
            _c_2, _p_2, off_2 = beside(p_a, p_b, x, q, wp.normalize(n + ASIDE * t_2), kink.center)
            by_1 = (off_1 - off) / ASIDE
            by_2 = (off_2 - off) / ASIDE
            J = wp.mat22d(wp.dot(by_1, t_1), wp.dot(by_2, t_1), wp.dot(by_1, t_2), wp.dot(by_2, t_2))
            step = -(wp.inverse(J) * wp.vec2d(wp.dot(off, t_1), wp.dot(off, t_2)))
            going = wp.bool(False)
            for _j in range(HALVINGS):
                turned = wp.normalize(n + step[0] * t_1 + step[1] * t_2)
                c_now, p_now, off_now = beside(p_a, p_b, x, q, turned, kink.center)
                if wp.length(off_now) < wp.length(off):
                    n = turned
                    center = c_now
                    point = p_now
                    off = off_now
                    going = wp.bool(True)
                    break
                step = half * step
            if not going:
                break
        met.normal = n
        met.gap = wp.dot(n, center - point) - p_a.minor_radius
        met.point_b = point
        met.point_a = center - p_a.minor_radius * n
        met.residual = wp.length(off) / p_a.major_radius
        return met

    @wp.func
    def met_by(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, seed: Any):
        q = wp.normalize(rotation)
        values = Values()
        slopes = Values()
        best = seen(p_a, p_b, x, q, zero)
        for i in range(places):
            at = seen(p_a, p_b, x, q, real(i) * WIDTH)
            values[i] = at.near.gap
            slopes[i] = at.slope
            if at.near.gap < best.near.gap:
                best = at
        iterations = places
        radius = p_a.major_radius
        for i in range(places):
            j = (i + 1) % places
            if bound(radius, values[i], slopes[i], values[j], slopes[j], WIDTH) < best.near.gap:
                low = seen(p_a, p_b, x, q, real(i) * WIDTH)
                for k in range(parts):
                    high = seen(p_a, p_b, x, q, real(i) * WIDTH + real(k + 1) * PART)
                    iterations += 1
                    if low.slope < zero and high.slope >= zero:
                        least = bound(radius, low.near.gap, low.slope, high.near.gap, high.slope, PART)
                        if least < best.near.gap:
                            found, steps = lowest(p_a, p_b, x, q, low, high)
                            iterations += steps
                            if found.near.gap < best.near.gap:
                                best = found
                    low = high
        met = Meeting()
        met.normal = best.near.normal
        met.gap = best.near.gap - p_a.minor_radius
        met.point_b = best.near.point
        met.point_a = best.center - p_a.minor_radius * met.normal
        met.iterations = iterations
        met.residual = wp.abs(best.slope)
        if wp.static(rounded):  # noqa: SIM102  a static branch
            if met.residual > ALLOWED:
                between = squeezed(p_a, p_b, x, q, best)
                # Across the tube the way out is longer than the shortest; another contact is not meant.
                if between.residual <= ALLOWED and between.gap <= met.gap:
                    met.normal = between.normal
                    met.gap = between.gap
                    met.point_a = between.point_a
                    met.point_b = between.point_b
                    met.residual = between.residual
        met.status = wp.where(met.residual <= ALLOWED, MET, NOT_CONVERGED)
        met.seed.normal = met.normal
        met.seed.known = 1
        return met

    return met_by
