"""Saddles of g(n) = n·c(n) − h_b(n) of a torus and a convex body; see ``torus_interlocked.py``.

Newton's method finds saddles where g is smooth. Bisection finds those on edges of g (the body has faces and
edges): the minimum along the loop of the maximum across it. A contact point on a face is interpolated between both
sides.
"""

import functools
import math
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.shapes import root_bracketing
from warpcontact.kernels.shapes.base import Shape, half, one, real, vec3d, zero

# Directions on a circle around one, from which the direction of the loop is computed.
CIRCLE_POINTS = wp.constant(wp.int32(16))
CIRCLE_STEP = wp.constant(real(2.0 * math.pi / 16))
# Maximum number of rounds of ``sharp_saddle``.
MAX_ROUNDS = wp.constant(wp.int32(4))
# Distance below which two directions are equal.
SAME_DIRECTION = wp.constant(real(1.0e-12))
# Tangential distance of the two points, relative to R, of a converged saddle.
TOLERANCE = wp.constant(real(1.0e-12))
# Newton's method: steps, halvings, longest step, difference step, and final residual relative to R.
MAX_NEWTON_STEPS = wp.constant(wp.int32(30))
MAX_HALVINGS = wp.constant(wp.int32(20))
MAX_STEP = wp.constant(real(0.2))
DIFFERENCE_STEP = wp.constant(real(1.0e-7))
ROUNDING = wp.constant(real(1.0e-15))
# Number of azimuths at which the search around a pole starts, logarithm of the initial and largest angle to the
# pole, and first stride of that logarithm.
AZIMUTHS = 32
AZIMUTH_STEP = wp.constant(real(2.0 * math.pi / AZIMUTHS))
LOG_ANGLE_START = wp.constant(real(math.log(1.0e-3)))
LOG_ANGLE_MAX = wp.constant(real(math.log(1.5)))
LOG_STRIDE = 0.05
# Steps to the height of a ridge, and its accuracy relative to R and the search angle.
RIDGE_STEPS = wp.constant(wp.int32(4))
RIDGE_TOLERANCE = wp.constant(real(0.01))


@wp.struct
class DirectionSample:
    """Both surfaces along one direction, frame of b."""

    normal: vec3d  # out of b
    center: vec3d  # point of the core circle [m]
    point: vec3d  # of b [m]
    gap: real  # from b to the center [m]
    tangential_offset: vec3d  # tangential part of the vector from the point to the center [m]


@wp.func
def secant(a: real, b: real, f_a: real, f_b: real):
    """Returns the zero of the secant."""
    return a + (b - a) * (f_a / (f_a - f_b))


class Functions(NamedTuple):
    """Device functions of the saddles of a torus and a convex body."""

    #: ``(p_a, at)``: whether two points are opposite each other along the normal.
    normals_face: wp.Function
    #: ``(p_a, p_b, x, q, n, max_angle)``: g along n, or on a ridge within ``max_angle``.
    ridge_value: wp.Function
    #: ``(p_a, p_b, x, q, n, radius)``: direction of the loop at n.
    loop_direction: wp.Function
    #: ``(p_a, p_b, x, q, start)``: the saddle next to a direction as a ``DirectionSample``, converged if
    #: ``normals_face(p_a, at)`` is true.
    smooth_saddle: wp.Function
    #: ``(p_a, p_b, x, q, start, reach)``: the same, on an edge of g.
    sharp_saddle: wp.Function
    #: ``(p_a, p_b, x, q, pole)``: the saddle on a loop around a pole, and whether it exists.
    saddle_around_pole: wp.Function


@functools.cache
def functions(B: type[Shape]) -> Functions:
    """Returns the device functions of a torus and a convex body."""
    azimuths = wp.constant(wp.int32(AZIMUTHS))
    # Every other step is a bisection, because g has edges.
    angle_search = root_bracketing.functions(
        DirectionSample, secant, bisection_interval=2, max_steps=110, min_width=1.0e-16
    )
    start_search, is_bracketed, update = angle_search.start, angle_search.is_bracketed, angle_search.update
    is_running, next_point = angle_search.is_running, angle_search.next_point
    log_search = root_bracketing.functions(
        DirectionSample, secant, bisection_interval=2, max_steps=110, min_width=1.0e-16, first=LOG_STRIDE
    )
    start_log, is_bracketed_log, update_log = log_search.start, log_search.is_bracketed, log_search.update
    is_running_log, next_point_log = log_search.is_running, log_search.next_point

    @wp.func
    def sample_direction(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d):
        at = DirectionSample()
        at.normal = n
        n_A = wp.quat_rotate_inv(q, n)
        level = wp.normalize(vec3d(n_A[0], n_A[1], zero))
        at.center = x + wp.quat_rotate(q, p_a.major_radius * level)
        at.point = B.support(p_b, n)
        separation = at.center - at.point
        at.gap = wp.dot(n, separation)
        at.tangential_offset = separation - at.gap * n
        return at

    @wp.func
    def ridge_value(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, max_angle: real):
        """Returns g along a direction, or on a ridge or an edge of g next to it."""
        at = sample_direction(p_a, p_b, x, q, n)
        rate = wp.length(at.tangential_offset)
        if rate == zero:
            return at.gap
        e = at.tangential_offset / rate
        n_A = wp.quat_rotate_inv(q, n)
        # Beyond a pole, the center jumps.
        high = wp.min(max_angle, wp.length(vec3d(n_A[0], n_A[1], zero)))
        beside = sample_direction(p_a, p_b, x, q, wp.normalize(n + high * e))
        fall = -wp.dot(beside.tangential_offset, e)
        if fall <= zero:
            return at.gap
        low = zero
        low_gap = at.gap
        high_gap = beside.gap
        best = at.gap
        for _ in range(RIDGE_STEPS):
            # Intersection of both tangents: exact on an edge, an upper bound on a ridge.
            position = wp.clamp((high_gap - low_gap + (high - low) * fall) / (rate + fall), zero, high - low)
            bound = low_gap + rate * position
            position += low
            now = sample_direction(p_a, p_b, x, q, wp.normalize(n + position * e))
            best = wp.max(best, now.gap)
            if bound - best <= RIDGE_TOLERANCE * max_angle * p_a.major_radius:
                break
            slope = wp.dot(now.tangential_offset, e)
            if slope > zero:
                low = position
                low_gap = now.gap
                rate = slope
            else:
                high = position
                high_gap = now.gap
                fall = -slope
        return best

    @wp.func
    def interpolate(
        p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, low: DirectionSample, high: DirectionSample, along: vec3d
    ):
        """Returns the sample at equal directions of two sides: the point of the face opposite the center."""
        at = low
        if wp.length(low.normal - high.normal) > SAME_DIRECTION:
            return sample_direction(p_a, p_b, x, q, wp.normalize(low.normal + high.normal))
        a = wp.dot(low.tangential_offset, along)
        b = wp.dot(high.tangential_offset, along)
        if a != b:
            t = wp.clamp(a / (a - b), zero, one)
            at.point = low.point + t * (high.point - low.point)
            at.center = low.center + t * (high.center - low.center)
            at.tangential_offset = low.tangential_offset + t * (high.tangential_offset - low.tangential_offset)
            at.gap = low.gap + t * (high.gap - low.gap)
            at.normal = wp.normalize(low.normal + t * (high.normal - low.normal))
        return at

    @wp.func
    def maximize_along(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, middle: vec3d, e: vec3d, start: real):
        """Returns the largest g on middle + u e next to u = ``start``, its u, and whether it exists."""
        first = sample_direction(p_a, p_b, x, q, wp.normalize(middle + start * e))
        search = start_search(
            first, start, -wp.dot(first.tangential_offset, e), first, start, -wp.dot(first.tangential_offset, e)
        )
        while is_running(search):
            at = next_point(search)
            now = sample_direction(p_a, p_b, x, q, wp.normalize(middle + at * e))
            search = update(search, at, -wp.dot(now.tangential_offset, e), now)
        return (
            interpolate(p_a, p_b, x, q, search.low, search.high, e),
            half * (search.a + search.b),
            is_bracketed(search),
        )

    @wp.func
    def minimax(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, e_1: vec3d, e_2: vec3d):
        """Returns the minimum along e_1 of the maximum along e_2, starting at n, and whether it exists."""
        first, u, found = maximize_along(p_a, p_b, x, q, n, e_2, zero)
        search = start_search(
            first, zero, wp.dot(first.tangential_offset, e_1), first, zero, wp.dot(first.tangential_offset, e_1)
        )
        while found and is_running(search):
            at = next_point(search)
            now, u, found = maximize_along(p_a, p_b, x, q, n + at * e_1, e_2, u)
            search = update(search, at, wp.dot(now.tangential_offset, e_1), now)
        return interpolate(p_a, p_b, x, q, search.low, search.high, e_1), found and is_bracketed(search)

    @wp.func
    def smooth_saddle(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec3d):
        """Returns the end of Newton's method for facing normals; infinite ``tangential_offset``: not a saddle."""
        at = sample_direction(p_a, p_b, x, q, start)
        sign = zero
        for _i in range(MAX_NEWTON_STEPS):
            n = at.normal
            t_1 = wp.normalize(wp.cross(n, vec3d(n[1], n[2], n[0])))
            t_2 = wp.cross(n, t_1)
            by_1 = (
                sample_direction(p_a, p_b, x, q, wp.normalize(n + DIFFERENCE_STEP * t_1)).tangential_offset
                - at.tangential_offset
            )
            by_2 = (
                sample_direction(p_a, p_b, x, q, wp.normalize(n + DIFFERENCE_STEP * t_2)).tangential_offset
                - at.tangential_offset
            )
            J = (
                wp.mat22d(wp.dot(by_1, t_1), wp.dot(by_2, t_1), wp.dot(by_1, t_2), wp.dot(by_2, t_2))
                / DIFFERENCE_STEP
            )
            sign = wp.determinant(J)
            size = wp.length(at.tangential_offset)
            if size <= ROUNDING * p_a.major_radius:
                break
            step = -(
                wp.inverse(J) * wp.vec2d(wp.dot(at.tangential_offset, t_1), wp.dot(at.tangential_offset, t_2))
            )
            step = step * wp.min(one, MAX_STEP / wp.length(step))
            for _j in range(MAX_HALVINGS):
                now = sample_direction(p_a, p_b, x, q, wp.normalize(n + step[0] * t_1 + step[1] * t_2))
                if wp.length(now.tangential_offset) < size:
                    at = now
                    break
                step = half * step
            if wp.length(at.tangential_offset) >= size:
                break
        if sign >= zero:
            # Not a saddle.
            at.tangential_offset = vec3d(real(wp.inf))
        return at

    @wp.func
    def loop_direction(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, circle_radius: real):
        """Returns the unit vector at n along which g is most like a valley, from values on a circle around n."""
        t_1 = wp.normalize(wp.cross(n, vec3d(n[1], n[2], n[0])))
        t_2 = wp.cross(n, t_1)
        even = zero
        odd = zero
        for k in range(CIRCLE_POINTS):
            angle = CIRCLE_STEP * real(k)
            t = wp.cos(angle) * t_1 + wp.sin(angle) * t_2
            g = sample_direction(p_a, p_b, x, q, wp.normalize(n + circle_radius * t)).gap
            even += g * wp.cos(real(2.0) * angle)
            odd += g * wp.sin(real(2.0) * angle)
        angle = half * wp.atan2(odd, even)
        return wp.cos(angle) * t_1 + wp.sin(angle) * t_2

    @wp.func
    def sharp_saddle(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec3d, reach: real):
        """Returns the saddle next to a direction that lies on an edge of g, or the best approximation."""
        best = sample_direction(p_a, p_b, x, q, start)
        n = start
        circle_radius = half * reach
        for _ in range(MAX_ROUNDS):
            e_1 = loop_direction(p_a, p_b, x, q, n, circle_radius)
            ridge, _u, on_top = maximize_along(p_a, p_b, x, q, n, wp.cross(n, e_1), zero)
            if on_top:
                n = ridge.normal
            circle_radius = half * half * circle_radius
            e_1 = loop_direction(p_a, p_b, x, q, n, circle_radius)
            now, found = minimax(p_a, p_b, x, q, n, e_1, wp.cross(n, e_1))
            if found and wp.length(now.tangential_offset) < wp.length(best.tangential_offset):
                best = now
                n = best.normal
            if wp.length(best.tangential_offset) <= TOLERANCE * p_a.major_radius:
                break
        return best

    @wp.func
    def sample_near_pole(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d, azimuth: real, logarithm: real):
        """Samples a direction at the angle exp(``logarithm``) from a pole; also returns the derivative of g by it.

        The azimuth is exact even for very small angles.
        """
        angle = wp.exp(wp.min(logarithm, LOG_ANGLE_MAX))
        e = wp.quat_rotate(q, vec3d(wp.cos(azimuth), wp.sin(azimuth), zero))
        at = DirectionSample()
        at.normal = wp.normalize(wp.cos(angle) * pole + wp.sin(angle) * e)
        at.center = x + p_a.major_radius * e
        at.point = B.support(p_b, at.normal)
        separation = at.center - at.point
        at.gap = wp.dot(at.normal, separation)
        at.tangential_offset = separation - at.gap * at.normal
        return at, wp.dot(at.tangential_offset, wp.cos(angle) * e - wp.sin(angle) * pole)

    @wp.func
    def maximize_from_pole(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d, azimuth: real, start: real):
        """Returns the largest g outward from a pole, the logarithm of its angle, and whether it exists."""
        first, rise = sample_near_pole(p_a, p_b, x, q, pole, azimuth, start)
        search = start_log(first, start, -rise, first, start, -rise)
        while is_running_log(search):
            at = next_point_log(search)
            now, rise = sample_near_pole(p_a, p_b, x, q, pole, azimuth, at)
            search = update_log(search, at, -rise, now)
        along = wp.quat_rotate(q, vec3d(wp.cos(azimuth), wp.sin(azimuth), zero))
        return interpolate(p_a, p_b, x, q, search.low, search.high, along), search.b, is_bracketed_log(search)

    @wp.func
    def saddle_around_pole(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d):
        """Returns the saddle on a loop around a pole, however small, and whether it exists.

        Near the pole g increases by R + d·e per angle along e, with d from the support point of b at the pole to
        the center of the torus. The increase is least at −d, where the search starts. If |d| is nearly R, the loop
        is close to the pole only there.
        """
        e_1 = wp.quat_rotate(q, vec3d(one, zero, zero))
        e_2 = wp.quat_rotate(q, vec3d(zero, one, zero))
        d = x - B.support(p_b, pole)
        lowest_azimuth = wp.atan2(-wp.dot(d, e_2), -wp.dot(d, e_1))
        first, u, found = maximize_from_pole(p_a, p_b, x, q, pole, lowest_azimuth, LOG_ANGLE_START)
        # Next to the pole, the support point of an edge or vertex may be a different one.
        for k in range(azimuths):
            azimuth = real(k) * AZIMUTH_STEP
            now, at, exists = maximize_from_pole(p_a, p_b, x, q, pole, azimuth, LOG_ANGLE_START)
            if exists and (not found or now.gap < first.gap):
                first = now
                u = at
                found = wp.bool(True)
                lowest_azimuth = azimuth
        sideways = wp.cos(lowest_azimuth) * e_2 - wp.sin(lowest_azimuth) * e_1
        search = start_search(
            first,
            zero,
            wp.dot(first.tangential_offset, sideways),
            first,
            zero,
            wp.dot(first.tangential_offset, sideways),
        )
        while found and is_running(search):
            at = next_point(search)
            now, u, found = maximize_from_pole(p_a, p_b, x, q, pole, lowest_azimuth + at, u)
            sideways = wp.cos(lowest_azimuth + at) * e_2 - wp.sin(lowest_azimuth + at) * e_1
            search = update(search, at, wp.dot(now.tangential_offset, sideways), now)
        return interpolate(p_a, p_b, x, q, search.low, search.high, sideways), found and is_bracketed(search)

    @wp.func
    def normals_face(p_a: Any, at: DirectionSample):
        """Returns whether the two points are opposite each other along the normal."""
        return wp.length(at.tangential_offset) <= TOLERANCE * p_a.major_radius

    return Functions(
        normals_face=normals_face,
        ridge_value=ridge_value,
        loop_direction=loop_direction,
        smooth_saddle=smooth_saddle,
        sharp_saddle=sharp_saddle,
        saddle_around_pole=saddle_around_pole,
    )
