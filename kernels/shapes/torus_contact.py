"""Contact of a torus and another closed shape: the point of the core circle that is deepest in it, or nearest.

A torus is all points within r of its core circle, so the gap is the least signed distance f(θ) of the circle from
the other shape, minus r. f has several minima. The whole circle is searched in every step, so the result depends
on the pose only. The signed distance from a convex body is convex, so f + ½ R θ² is convex: values and slopes at
two samples bound f from below in between. Only intervals that can contain a lower value are refined.

At a kink of f in its minimum, two separations of the other shape are equally short and neither is normal to the
tube. For a convex body, the torus then separates along the shorter of two displacements: as a whole, like its
convex hull, or around the body in its hole (``torus_interlocked.py``).
"""

import functools
import math
from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes import convex, root_bracketing, torus_interlocked
from warpcontact.kernels.shapes.base import (
    AXIS_TOLERANCE,
    Shape,
    ShapeContactPoint,
    SignedDistance,
    WarmStart,
    half,
    one,
    real,
    vec3d,
    zero,
)
from warpcontact.kernels.shapes.hull import Hull
from warpcontact.kernels.shapes.plane import Plane
from warpcontact.kernels.shapes.signed_distance import signed_distance
from warpcontact.kernels.shapes.torus import Torus
from warpcontact.kernels.types import MET, NOT_CONVERGED

#: Number of samples on the circle, and of subintervals between two of them.
SAMPLES = 48
SUBINTERVALS = 6
SAMPLE_ANGLE = wp.constant(real(2.0 * math.pi / SAMPLES))
SUBINTERVAL_ANGLE = wp.constant(real(2.0 * math.pi / SAMPLES / SUBINTERVALS))
# Largest accepted f'/R, the cosine between normal and circle.
MAX_SLOPE = wp.constant(real(1.0e-9))
# Width of a bracket that is a point of the circle [rad], and slope that is zero.
ANGLE_TOLERANCE = wp.constant(real(1.0e-15))
# Accuracy of a point of the circle relative to R, and largest cosine accepted if that rounding explains it.
POINT_ROUNDING = wp.constant(real(4.0e-15))
MAX_SLOPE_CROSSING = wp.constant(real(1.0e-6))
# Distance relative to R at which two core circles cross, and smallest sine of their angle.
CROSSING_TOLERANCE = wp.constant(real(1.0e-9))
MIN_CROSSING_SINE = wp.constant(real(1.0e-3))
# Rounding of f, relative to R.
VALUE_ROUNDING = wp.constant(real(1.0e-14))


@wp.struct
class CircleSample:
    """The other shape as seen from one point of the core circle, frame of b."""

    angle: real
    closest: SignedDistance  # frame of b
    center: vec3d  # the point of the circle, frame of b
    slope: real  # df/dθ over R


@wp.func
def secant(a: real, b: real, f_a: real, f_b: real):
    """Returns the zero of the secant. The form a + t (b − a) would leave a larger slope from rounding."""
    return (a * f_b - b * f_a) / (f_b - f_a)


@functools.cache
def pair_function(A: type[Torus], B: type[Shape]) -> wp.Function:
    """Returns the device function for a torus and a closed shape; arguments as in ``pair_dispatch.py``."""
    distance_at = signed_distance(B)
    convex_b = B.convex and B is not Plane
    hull_contact = interlocked_gap = loop_at_pole = HullCoefficients = None
    if convex_b:
        interlocked = torus_interlocked.functions(B)
        hull_contact, interlocked_gap, loop_at_pole = (
            convex.pair_function(Hull, B),
            interlocked.interlocked_gap,
            interlocked.loop_at_pole,
        )
        HullCoefficients = coefficient_struct(Hull, real)
    samples = wp.constant(wp.int32(SAMPLES))
    subintervals = wp.constant(wp.int32(SUBINTERVALS))
    # Every fourth step is a bisection because of kinks. A smooth minimum takes 8 to 10 steps.
    search_of = root_bracketing.functions(
        CircleSample, secant, bisection_interval=4, max_steps=60, min_width=float(ANGLE_TOLERANCE)
    )
    start, is_running, next_point, update = (
        search_of.start,
        search_of.is_running,
        search_of.next_point,
        search_of.update,
    )
    Values = wp.types.vector(SAMPLES, real)

    @wp.func
    def sample_circle(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, angle: real):
        at = CircleSample()
        at.angle = angle
        c = wp.cos(angle)
        s = wp.sin(angle)
        at.center = x + wp.quat_rotate(q, vec3d(p_a.major_radius * c, p_a.major_radius * s, zero))
        at.closest = distance_at(p_b, at.center)
        at.slope = wp.dot(at.closest.normal, wp.quat_rotate(q, vec3d(-s, c, zero)))
        return at

    @wp.func
    def minimize(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, low: CircleSample, high: CircleSample):
        """Returns the minimum between a falling and a rising slope, and the number of steps."""
        search = start(low, low.angle, low.slope, high, high.angle, high.slope)
        best = low
        if high.closest.gap < low.closest.gap:
            best = high
        while is_running(search) and wp.abs(best.slope) > ANGLE_TOLERANCE:
            now = sample_circle(p_a, p_b, x, q, next_point(search))
            search = update(search, now.angle, now.slope, now)
            # Compare beyond rounding: the zero of the slope is more accurate than the minimum of f.
            lower = now.closest.gap < best.closest.gap - VALUE_ROUNDING * p_a.major_radius
            if lower or wp.abs(now.slope) <= wp.abs(best.slope):
                best = now
        return best, search.steps

    @wp.func
    def lower_bound(radius: real, low: real, low_slope: real, high: real, high_slope: real, width: real):
        """Returns a lower bound of f between two samples; slopes are divided by the radius."""
        # Intersection of the tangents, minus the largest deviation of the circle from them.
        steepness = low_slope - high_slope
        lower_value = wp.min(low, high)
        if steepness < zero:
            crossing_angle = wp.clamp(
                (high - low - radius * high_slope * width) / (radius * steepness), zero, width
            )
            lower_value = wp.min(lower_value, low + radius * low_slope * crossing_angle)
        return lower_value - half * radius * width * width

    @wp.func
    def separate_convex(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, deepest: real, iterations: wp.int32):
        """Returns the contact of a torus and a convex body if f has a kink at its minimum ``deepest``."""
        # Each loop contains the azimuth of the minimum, so no loop has a higher gap, up to the accuracy of the
        # minimum.
        upper_limit = deepest + MAX_SLOPE * p_a.major_radius
        hull_coefficients = HullCoefficients()
        hull_coefficients.major_radius = p_a.major_radius
        hull_coefficients.minor_radius = p_a.minor_radius
        contact = hull_contact(hull_coefficients, p_b, x, q, WarmStart())
        contact.iterations += iterations
        if contact.status == MET:
            # The flat side of the hull does not belong to the torus: there the body leaves through the hole.
            n_A = wp.quat_rotate_inv(q, contact.normal)
            flat = wp.length(wp.vec2d(n_A[0], n_A[1])) <= AXIS_TOLERANCE
            lower_value = contact.gap + p_a.minor_radius
            loop, found = interlocked_gap(p_a, p_b, x, q, lower_value, upper_limit)
            if flat and not found:
                # The loop is too close to the axis for the grid.
                contact.residual = one
                loop, found = loop_at_pole(p_a, p_b, x, q, contact.normal, lower_value, upper_limit)
            if found:
                contact.normal = loop.normal
                contact.gap = loop.gap - p_a.minor_radius
                contact.point_b = loop.point
                contact.point_a = loop.center - p_a.minor_radius * loop.normal
                contact.residual = wp.length(loop.tangential_offset) / p_a.major_radius
        return contact

    @wp.func
    def separate_crossing(p_a: Any, p_b: Any, q: wp.quatd, at: CircleSample, contact: ShapeContactPoint):
        """Separates crossing core circles along the normal of both, towards the current side."""
        own = wp.quat_rotate(q, vec3d(-wp.sin(at.angle), wp.cos(at.angle), zero))
        other = wp.normalize(vec3d(-at.center[1], at.center[0], zero))
        normal = wp.cross(own, other)
        if wp.length(normal) > MIN_CROSSING_SINE:
            normal = wp.normalize(normal)
            if wp.dot(normal, at.closest.normal) < zero:
                normal = -normal
            contact.normal = normal
            contact.point_a = at.center - p_a.minor_radius * normal
            contact.point_b = at.center + p_b.minor_radius * normal
            contact.residual = wp.abs(wp.dot(normal, own))
        return contact

    @wp.func
    def find_contact(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, warm_start: Any):
        q = wp.normalize(rotation)
        values = Values()
        slopes = Values()
        best = sample_circle(p_a, p_b, x, q, zero)
        for i in range(samples):
            at = sample_circle(p_a, p_b, x, q, real(i) * SAMPLE_ANGLE)
            values[i] = at.closest.gap
            slopes[i] = at.slope
            if at.closest.gap < best.closest.gap:
                best = at
        iterations = samples
        radius = p_a.major_radius
        for i in range(samples):
            j = (i + 1) % samples
            if lower_bound(radius, values[i], slopes[i], values[j], slopes[j], SAMPLE_ANGLE) < best.closest.gap:
                low = sample_circle(p_a, p_b, x, q, real(i) * SAMPLE_ANGLE)
                for k in range(subintervals):
                    high = sample_circle(p_a, p_b, x, q, real(i) * SAMPLE_ANGLE + real(k + 1) * SUBINTERVAL_ANGLE)
                    iterations += 1
                    if low.slope < zero and high.slope >= zero:
                        lower_value = lower_bound(
                            radius, low.closest.gap, low.slope, high.closest.gap, high.slope, SUBINTERVAL_ANGLE
                        )
                        if lower_value < best.closest.gap:
                            found, steps = minimize(p_a, p_b, x, q, low, high)
                            iterations += steps
                            if found.closest.gap < best.closest.gap:
                                best = found
                    low = high
        contact = ShapeContactPoint()
        contact.normal = best.closest.normal
        contact.gap = best.closest.gap - p_a.minor_radius
        contact.point_b = best.closest.point
        contact.point_a = best.center - p_a.minor_radius * contact.normal
        contact.iterations = iterations
        contact.residual = wp.abs(best.slope)
        if wp.static(convex_b):
            if contact.residual > MAX_SLOPE:
                contact = separate_convex(p_a, p_b, x, q, best.closest.gap, iterations)
        max_slope = MAX_SLOPE
        if wp.static(B is Torus):
            # If the core circles nearly cross, rounding of a point can turn the normal by any angle.
            core_distance = best.closest.gap + p_b.minor_radius
            if contact.residual > MAX_SLOPE_CROSSING and core_distance <= CROSSING_TOLERANCE * p_a.major_radius:
                contact = separate_crossing(p_a, p_b, q, best, contact)
            elif contact.residual * core_distance <= POINT_ROUNDING * p_a.major_radius:
                max_slope = MAX_SLOPE_CROSSING
        if contact.residual > max_slope:
            contact.status = NOT_CONVERGED
        contact.warm_start.normal = contact.normal
        contact.warm_start.valid = 1
        return contact

    return find_contact
