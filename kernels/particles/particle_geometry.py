"""Poses of particles, closest points of two particles, and their relative curvatures."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.particles.base import ParticleTraits, particle_structs
from warpcontact.kernels.types import Struct, structs

# Squared sine of the angle below which two segments are parallel.
PARALLEL = 1.0e-10


@wp.func
def _clamp_unit(value: wp.float64):
    return wp.clamp(value, wp.float64(-1.0), wp.float64(1.0))


@wp.func
def closest_on_segments(d: wp.vec3d, g: wp.vec3d, h: wp.vec3d):
    """Returns the parameters (s, t) in [−1, 1] of the closest points of two segments.

    ``d`` is the vector from the middle of the second to that of the first, ``g`` and ``h`` are the vectors from
    the middles to the ends [m]. For parallel segments that overlap in projection, the middle of the overlap is
    used.
    """
    a = wp.dot(g, g)
    b = wp.dot(g, h)
    c = wp.dot(h, h)
    e = wp.dot(g, d)
    f = wp.dot(h, d)
    zero = wp.float64(0.0)
    s, t = zero, zero
    if a == zero:
        if c > zero:
            t = _clamp_unit(f / c)
        return s, t
    if c == zero:
        return _clamp_unit(-e / a), t
    det = a * c - b * b
    if det > wp.float64(PARALLEL) * a * c:
        s = _clamp_unit((b * f - c * e) / det)
    else:
        # Ends of the second in parameters of the first; the middle of the overlap if there is one.
        first_end = (-e - b) / a
        second_end = (-e + b) / a
        low = wp.max(wp.min(first_end, second_end), wp.float64(-1.0))
        high = wp.min(wp.max(first_end, second_end), wp.float64(1.0))
        s = _clamp_unit(wp.float64(0.5) * (low + high))
        if low > high:
            s = wp.where(wp.max(first_end, second_end) < wp.float64(-1.0), wp.float64(-1.0), wp.float64(1.0))
    t = (f + s * b) / c
    if wp.abs(t) > wp.float64(1.0):
        t = _clamp_unit(t)
        s = _clamp_unit((t * b - e) / a)
    return s, t


class Functions(NamedTuple):
    """Structs and device functions for particles with given traits."""

    AxisPoint: Struct  # pose of a particle
    ClosestApproach: Struct  # closest points of the axes of two particles
    #: ``(particles, state, env, particle)``: pose of a particle.
    axis_point: wp.Function
    #: ``(first, second)``: closest points of two particles.
    closest_approach: wp.Function
    #: ``(pair, first, second, radius_1, radius_2)``: relative principal curvatures, the smaller first [1/m].
    curvatures: wp.Function


@functools.cache
def functions(traits: ParticleTraits, real: type) -> Functions:
    """Returns the device functions for particles with the given traits."""
    t = structs(real)
    vec3, State = t.vec3, t.State
    Particles = particle_structs(real).Particles
    to_float64, from_float64 = frames.functions(real).to_float64, frames.functions(real).from_float64
    has_offsets, has_capsules = traits.has_offsets, traits.has_capsules

    @wp.struct
    class AxisPoint:
        """Center of a particle as ``origin`` + ``offset``, which keeps small distances accurate."""

        origin: vec3  # center of mass of its body, W [m]
        offset: vec3  # remainder of the body position, plus vector to the center of the particle, W [m]
        axis: vec3  # from the center to the center of an end cap, W [m]; 0: a sphere

    @wp.struct
    class ClosestApproach:
        """Closest points of the axes of two particles."""

        separation: vec3  # from the closest axis point of the second to that of the first, W [m]
        s: real  # axis parameters of these points, −1…1
        t: real

    @wp.func
    def axis_point(particles: Particles, state: State, env: int, particle: int):
        result = AxisPoint()
        body = assume_nonnegative(particles.body[particle])
        result.origin = state.body_position[env, body]
        result.offset = state.body_position_remainder[env, body]
        if wp.static(has_offsets):
            result.offset += wp.quat_rotate(state.body_orientation[env, body], particles.offset[env, particle])
        if wp.static(has_capsules):
            result.axis = wp.quat_rotate(state.body_orientation[env, body], particles.axis[env, particle])
        return result

    @wp.func
    def closest_approach(first: AxisPoint, second: AxisPoint):
        pair = ClosestApproach()
        pair.separation = (first.origin - second.origin) + (first.offset - second.offset)
        if wp.static(has_capsules):
            d = to_float64(pair.separation)
            g = to_float64(first.axis)
            h = to_float64(second.axis)
            s, t = closest_on_segments(d, g, h)
            pair.s = real(s)
            pair.t = real(t)
            pair.separation = from_float64(d + s * g - t * h)
        return pair

    @wp.func
    def is_on_cylinder(parameter: real, axis: vec3):
        """Returns whether an axis point is between the ends, where the surface is a cylinder and not a sphere."""
        return wp.abs(parameter) < real(1.0) and wp.length_sq(axis) > real(0.0)

    @wp.func
    def curvatures(pair: ClosestApproach, first: AxisPoint, second: AxisPoint, radius_1: real, radius_2: real):
        k_1 = real(1.0) / radius_1
        k_2 = real(1.0) / radius_2
        # Cylinders are curved only across their axis, spheres and caps in all directions.
        side_1 = real(0.0)
        side_2 = real(0.0)
        smaller = real(0.0)
        if wp.static(has_capsules):
            if is_on_cylinder(pair.s, first.axis):
                side_1 = k_1
            if is_on_cylinder(pair.t, second.axis):
                side_2 = k_2
        larger = wp.max(side_1, side_2)
        if wp.static(has_capsules):
            if wp.min(side_1, side_2) > real(0.0):
                g = wp.normalize(first.axis)
                h = wp.normalize(second.axis)
                cosine = wp.dot(g, h)
                sine = wp.length(wp.cross(g, h))
                product = side_1 * side_2
                difference = side_1 - side_2
                spread = wp.sqrt(difference * difference + real(4.0) * product * cosine * cosine)
                larger = real(0.5) * (side_1 + side_2 + spread)
                # From the product of the roots: a difference would cancel for nearly parallel axes.
                smaller = product * sine * sine / larger
        round_1 = k_1 - side_1
        round_2 = k_2 - side_2
        return smaller + (round_1 + round_2), larger + (round_1 + round_2)

    return Functions(
        AxisPoint=AxisPoint,
        ClosestApproach=ClosestApproach,
        axis_point=axis_point,
        closest_approach=closest_approach,
        curvatures=curvatures,
    )
