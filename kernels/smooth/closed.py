"""Pairs of convex shapes that are solved at once: with a plane, with a sphere, and two capsules."""

import functools

import warp as wp
from warpcontact.kernels.formula import coefficient_struct
from warpcontact.kernels.smooth.base import ON_AXIS, Meeting, Seed, Shape, half, one, real, vec3d, zero
from warpcontact.kernels.smooth.pair import tangent

quatd = wp.quatd


@wp.func
def solved(gap: real, normal: vec3d, point_a: vec3d, point_b: vec3d):
    """A result without an iteration."""
    found = Meeting()
    found.gap = gap
    found.normal = normal
    found.point_a = point_a
    found.point_b = point_b
    found.seed.normal = normal
    found.seed.known = 1
    return found


@functools.cache
def on_plane(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of a convex shape and a plane."""
    Of_a, Of_b = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def meet_plane(p_a: Of_a, p_b: Of_b, x: vec3d, q: quatd, seed: Seed):
        turned = wp.normalize(q)
        up = vec3d(zero, zero, one)
        point = x + wp.quat_rotate(turned, A.support(p_a, wp.quat_rotate_inv(turned, -up)))
        return solved(point[2], up, point, vec3d(point[0], point[1], zero))

    return meet_plane


@functools.cache
def on_sphere(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of a sphere and a shape that knows the point nearest to a place."""
    Of_a, Of_b = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def meet_sphere(p_a: Of_a, p_b: Of_b, x: vec3d, q: quatd, seed: Seed):
        nearest = B.nearest(p_b, x)
        n = nearest.normal
        return solved(nearest.gap - p_a.radius, n, x - p_a.radius * n, nearest.point)

    return meet_sphere


@functools.cache
def swapped(function: wp.Function, A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of (B, A) from that of (A, B)."""
    Of_a, Of_b = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def meet_swapped(p_b: Of_b, p_a: Of_a, x: vec3d, q: quatd, seed: Seed):
        turned = wp.normalize(q)
        other = function(p_a, p_b, -wp.quat_rotate_inv(turned, x), wp.quat_inverse(turned), Seed())
        return solved(
            other.gap,
            -wp.quat_rotate(turned, other.normal),
            x + wp.quat_rotate(turned, other.point_b),
            x + wp.quat_rotate(turned, other.point_a),
        )

    return meet_swapped


@functools.cache
def capsules(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of two capsules: the nearest points of two segments."""
    Of_a, Of_b = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def meet_capsules(p_a: Of_a, p_b: Of_b, x: vec3d, q: quatd, seed: Seed):
        up = vec3d(zero, zero, one)
        axis = wp.quat_rotate(wp.normalize(q), up)
        # Points x + s axis and t up; cosine and square of the sine of the angle between them.
        cosine = axis[2]
        sine_2 = axis[0] * axis[0] + axis[1] * axis[1]
        s = zero
        if sine_2 > ON_AXIS:
            s = wp.clamp((x[2] * cosine - wp.dot(x, axis)) / sine_2, -p_a.half_length, p_a.half_length)
        else:
            # Side by side: the middle of what they have in common, in s.
            along = wp.dot(x, axis)
            low = wp.max(-along - p_b.half_length, -p_a.half_length)
            high = wp.min(-along + p_b.half_length, p_a.half_length)
            s = wp.clamp(half * (low + high), -p_a.half_length, p_a.half_length)
        t = wp.clamp(x[2] + s * cosine, -p_b.half_length, p_b.half_length)
        s = wp.clamp(t * cosine - wp.dot(x, axis), -p_a.half_length, p_a.half_length)
        foot_a = x + s * axis
        foot_b = t * up
        off = foot_a - foot_b
        distance = wp.length(off)
        n = wp.cross(axis, up)
        if distance > ON_AXIS * (p_a.half_length + p_b.half_length):
            n = off / distance
        elif sine_2 > ON_AXIS:
            # Where the axes cross, the way apart is across both.
            n = wp.normalize(n)
        else:
            n = tangent(axis)
        return solved(distance - p_a.radius - p_b.radius, n, foot_a - p_a.radius * n, foot_b + p_b.radius * n)

    return meet_capsules
