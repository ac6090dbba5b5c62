"""Contact of a torus and another closed shape: the point of the core circle that is deepest in it, or nearest.

A torus is all points within r of its core circle, so the gap is the least signed distance f(θ) of the circle from
the other shape, minus r. f has several minima. The whole circle is searched in every step, so the result depends
on the pose only. The signed distance from a convex body is convex, so f + ½ R θ² is convex: values and slopes at
two samples bound f from below in between. Only intervals that can contain a lower value are refined.

If the core circle is inside the other shape, f can have a kink at its minimum: two separations of the other shape are
equally short and neither is normal to the tube. Such a contact is NOT_CONVERGED.
"""

import functools
import math
from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import (
    Shape,
    ShapeContactPoint,
    SignedDistance,
    half,
    real,
    vec3d,
    zero,
)
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.shapes.signed_distance import signed_distance
from warpcontact.kernels.types import NOT_CONVERGED

#: Number of samples on the circle, and of subintervals between two of them.
SAMPLES = 48
SUBINTERVALS = 6
SAMPLE_ANGLE = wp.constant(real(2.0 * math.pi / SAMPLES))
SUBINTERVAL_ANGLE = wp.constant(real(2.0 * math.pi / SAMPLES / SUBINTERVALS))
# Largest accepted f'/R, the cosine between normal and circle.
MAX_SLOPE = wp.constant(real(1.0e-9))
# Every n-th step to a minimum is a bisection because of kinks. A smooth minimum takes 8 to 10 steps.
BISECTION_INTERVAL = wp.constant(wp.int32(4))
MAX_STEPS = wp.constant(wp.int32(60))
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


@wp.struct
class SlopeBracket:
    """Interval of the core circle in which the slope of f rises through zero."""

    a: real  # lower end [rad]
    b: real  # upper end [rad]
    slope_a: real  # at a, halved each time b moves twice in a row (Illinois rule)
    slope_b: real  # at b, likewise
    moved_end: wp.int32  # end that moved last: −1, 1, or 0 for none
    steps: wp.int32


@wp.func
def next_angle(bracket: SlopeBracket):
    """Returns the next angle to evaluate: the zero of the secant, or the middle in every fourth step."""
    if bracket.steps % BISECTION_INTERVAL == BISECTION_INTERVAL - 1:
        return bracket.a + (bracket.b - bracket.a) * half
    # The form a + t (b − a) would leave a larger slope from rounding.
    root = (bracket.a * bracket.slope_b - bracket.b * bracket.slope_a) / (bracket.slope_b - bracket.slope_a)
    return wp.clamp(root, bracket.a, bracket.b)


@wp.func
def narrow_bracket(bracket: SlopeBracket, angle: real, slope: real):
    """Returns the bracket with an end at ``angle``, where f has the given slope."""
    bracket.steps += 1
    if slope <= zero:
        bracket.a = angle
        bracket.slope_a = slope
        if bracket.moved_end == -1:
            bracket.slope_b = half * bracket.slope_b
        bracket.moved_end = wp.int32(-1)
    if slope >= zero:
        bracket.b = angle
        bracket.slope_b = slope
        if bracket.moved_end == 1:
            bracket.slope_a = half * bracket.slope_a
        bracket.moved_end = wp.int32(1)
    return bracket


@functools.cache
def pair_function(A: type[Torus], B: type[Shape]) -> wp.Function:
    """Returns the device function for a torus and a closed shape; arguments as in ``pair_dispatch.py``."""
    distance_at = signed_distance(B)
    samples = wp.constant(wp.int32(SAMPLES))
    subintervals = wp.constant(wp.int32(SUBINTERVALS))
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
        bracket = SlopeBracket()
        bracket.a = low.angle
        bracket.b = high.angle
        bracket.slope_a = low.slope
        bracket.slope_b = high.slope
        best = low
        if high.closest.gap < low.closest.gap:
            best = high
        while (
            bracket.steps < MAX_STEPS
            and bracket.b - bracket.a > ANGLE_TOLERANCE
            and wp.abs(best.slope) > ANGLE_TOLERANCE
        ):
            now = sample_circle(p_a, p_b, x, q, next_angle(bracket))
            bracket = narrow_bracket(bracket, now.angle, now.slope)
            # Compare beyond rounding: the zero of the slope is more accurate than the minimum of f.
            lower = now.closest.gap < best.closest.gap - VALUE_ROUNDING * p_a.major_radius
            if lower or wp.abs(now.slope) <= wp.abs(best.slope):
                best = now
        return best, bracket.steps

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
