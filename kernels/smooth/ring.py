"""Where a torus and another closed shape meet: the point of the core circle that is deepest in it, or nearest.

A torus is all within r of its core circle, so the gap is the least signed distance of the circle from the other
shape, less r. That distance f(θ) has several minima: all around is looked at, every time, so that the result
depends on the pose alone and on nothing that came before. As the signed distance from a convex body is a convex
function, f + ½ R θ² is convex: two neighbouring values and slopes bound f from below in between, and only what can
lie lower than the least value known is looked at closely.

Where f has a kink at its least value, the way out of the other shape is as short to two sides, and neither is
across the tube. Of a convex body the ring then leaves on the shorter of two ways: as a whole, like its convex
hull, or around the body, which stays in its hole (``threaded.py``).
"""

import functools
import math
from typing import Any

import warp as wp
from warpcontact.kernels.formula import coefficient_struct
from warpcontact.kernels.smooth import bracket, convex, threaded
from warpcontact.kernels.smooth.base import ON_AXIS, Meeting, Nearest, Seed, Shape, half, one, real, vec3d, zero
from warpcontact.kernels.smooth.hull import Hull
from warpcontact.kernels.smooth.nearest import nearest
from warpcontact.kernels.smooth.plane import Plane
from warpcontact.kernels.smooth.torus import Torus
from warpcontact.kernels.types import MET, NOT_CONVERGED

#: Places on the circle that are looked at, and parts that what lies between two of them is cut into.
PLACES = 48
PARTS = 6
WIDTH = wp.constant(real(2.0 * math.pi / PLACES))
PART = wp.constant(real(2.0 * math.pi / PLACES / PARTS))
# Of f'/R, the cosine between normal and circle.
ALLOWED = wp.constant(real(1.0e-9))
# A bracket this narrow is a point of the circle [rad], and a slope this small is none.
NARROW = wp.constant(real(1.0e-15))
# How well a place of the circle is known, over R, and of what is found there the normal at worst.
PLACED = wp.constant(real(4.0e-15))
TURNED = wp.constant(real(1.0e-6))
# Core circles that pass each other nearer than this, over R, cross; as far as they do so at an angle, its sine.
CROSSED = wp.constant(real(1.0e-9))
ASLANT = wp.constant(real(1.0e-3))
# By how much f is lower beyond rounding, over R.
LOWER = wp.constant(real(1.0e-14))


@wp.struct
class Seen:
    """The other shape from one point of the core circle, frame of b."""

    angle: real
    near: Nearest  # frame of b
    center: vec3d  # the point of the circle, frame of b
    slope: real  # df/dθ over R


@wp.func
def crossing(a: real, b: real, f_a: real, f_b: real):
    """Where a straight line is zero. As a plus a part of the bracket, rounding would leave more of the slope."""
    return (a * f_b - b * f_a) / (f_b - f_a)


@functools.cache
def meet(A: type[Torus], B: type[Shape]) -> wp.Function:
    """Returns the device function of a torus and a closed shape; arguments as in ``meet.py``."""
    of_place = nearest(B)
    convex_b = B.convex and B is not Plane
    around_hull = threaded_on = beside_pole = Of_hull = None
    if convex_b:
        of_body = threaded.functions(B)
        around_hull, threaded_on, beside_pole = convex.meet(Hull, B), of_body.threaded, of_body.beside_pole
        Of_hull = coefficient_struct(Hull, real)
    places = wp.constant(wp.int32(PLACES))
    parts = wp.constant(wp.int32(PARTS))
    # Every fourth step is a halving: a kink is no straight line. A smooth minimum takes 8 to 10 steps.
    search_of = bracket.functions(Seen, crossing, cycle=4, most=60, narrow=float(NARROW))
    begin, going, place, told = search_of.begin, search_of.going, search_of.place, search_of.told
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
        search = begin(low, low.angle, low.slope, high, high.angle, high.slope)
        best = low
        if high.near.gap < low.near.gap:
            best = high
        while going(search) and wp.abs(best.slope) > NARROW:
            now = seen(p_a, p_b, x, q, place(search))
            search = told(search, now.angle, now.slope, now)
            # Lower by rounding is not lower: where the slope is none is known much better than where f is least.
            lower = now.near.gap < best.near.gap - LOWER * p_a.major_radius
            if lower or wp.abs(now.slope) <= wp.abs(best.slope):
                best = now
        return best, search.steps

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
    def apart(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, deepest: real, iterations: wp.int32):
        """Where a torus and a convex body meet that the core circle runs deep in, as ``deepest`` says."""
        # Each loop passes the azimuth of that place, so there is none above; if it is the deepest indeed.
        most = deepest + ALLOWED * p_a.major_radius
        p_hull = Of_hull()
        p_hull.major_radius = p_a.major_radius
        p_hull.minor_radius = p_a.minor_radius
        met = around_hull(p_hull, p_b, x, q, Seed())
        met.iterations += iterations
        if met.status == MET:
            # The flat side of the hull is none of the ring's: within it the body comes out of the hole.
            n_A = wp.quat_rotate_inv(q, met.normal)
            flat = wp.length(wp.vec2d(n_A[0], n_A[1])) <= ON_AXIS
            least = met.gap + p_a.minor_radius
            loop, found = threaded_on(p_a, p_b, x, q, least, most)
            if flat and not found:
                # Its loop is so near around the axis that the grid does not see it.
                met.residual = one
                loop, found = beside_pole(p_a, p_b, x, q, met.normal, least, most)
            if found:
                met.normal = loop.normal
                met.gap = loop.gap - p_a.minor_radius
                met.point_b = loop.point
                met.point_a = loop.center - p_a.minor_radius * loop.normal
                met.residual = wp.length(loop.off) / p_a.major_radius
        return met

    @wp.func
    def across(p_a: Any, p_b: Any, q: wp.quatd, at: Seen, met: Meeting):
        """Where two core circles cross: rings part across both of them, to the side where they are already."""
        own = wp.quat_rotate(q, vec3d(-wp.sin(at.angle), wp.cos(at.angle), zero))
        other = wp.normalize(vec3d(-at.center[1], at.center[0], zero))
        normal = wp.cross(own, other)
        if wp.length(normal) > ASLANT:
            normal = wp.normalize(normal)
            if wp.dot(normal, at.near.normal) < zero:
                normal = -normal
            met.normal = normal
            met.point_a = at.center - p_a.minor_radius * normal
            met.point_b = at.center + p_b.minor_radius * normal
            met.residual = wp.abs(wp.dot(normal, own))
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
        if wp.static(convex_b):  # noqa: SIM102  a static branch
            if met.residual > ALLOWED:
                met = apart(p_a, p_b, x, q, best.near.gap, iterations)
        allowed = ALLOWED
        if wp.static(B is Torus):
            # Where both core circles all but cross, the normal turns around within the rounding of a place.
            passing = best.near.gap + p_b.minor_radius
            if met.residual > TURNED and passing <= CROSSED * p_a.major_radius:
                met = across(p_a, p_b, q, best, met)
            elif met.residual * passing <= PLACED * p_a.major_radius:
                allowed = TURNED
        if met.residual > allowed:
            met.status = NOT_CONVERGED
        met.seed.normal = met.normal
        met.seed.known = 1
        return met

    return met_by
