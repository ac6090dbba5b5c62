"""Selects the contact algorithm of a pair of shapes when a model is built; closed-form contacts.

Contacts of convex shapes have a closed form with a plane, with a sphere, and between two capsules. Tori and
parametric surfaces are not convex.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes import convex
from warpcontact.kernels.shapes.base import (
    AXIS_TOLERANCE,
    Plane,
    Shape,
    ShapeContactPoint,
    WarmStart,
    half,
    one,
    real,
    vec3d,
    zero,
)
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.shapes.separation import perpendicular
from warpcontact.kernels.shapes.spheres import Capsule, Sphere

quatd = wp.quatd


@wp.func
def direct_result(gap: real, normal: vec3d, point_a: vec3d, point_b: vec3d):
    """Returns a contact point that needed no iteration."""
    found = ShapeContactPoint()
    found.gap = gap
    found.normal = normal
    found.point_a = point_a
    found.point_b = point_b
    found.warm_start.normal = normal
    found.warm_start.valid = 1
    return found


@functools.cache
def with_plane(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function for a convex shape and a plane."""
    CoefficientsA, CoefficientsB = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def plane_contact(p_a: CoefficientsA, p_b: CoefficientsB, x: vec3d, q: quatd, warm_start: WarmStart):
        unit_q = wp.normalize(q)
        up = vec3d(zero, zero, one)
        point = x + wp.quat_rotate(unit_q, A.support(p_a, wp.quat_rotate_inv(unit_q, -up)))
        return direct_result(point[2], up, point, vec3d(point[0], point[1], zero))

    return plane_contact


@functools.cache
def with_sphere(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function for a sphere and a shape with ``signed_distance``."""
    CoefficientsA, CoefficientsB = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def sphere_contact(p_a: CoefficientsA, p_b: CoefficientsB, x: vec3d, q: quatd, warm_start: WarmStart):
        signed_distance = B.signed_distance(p_b, x)
        n = signed_distance.normal
        return direct_result(signed_distance.gap - p_a.radius, n, x - p_a.radius * n, signed_distance.point)

    return sphere_contact


@functools.cache
def swapped_pair(function: wp.Function, A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function for (B, A) from that for (A, B)."""
    CoefficientsA, CoefficientsB = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def swapped_contact(p_b: CoefficientsB, p_a: CoefficientsA, x: vec3d, q: quatd, warm_start: WarmStart):
        unit_q = wp.normalize(q)
        swapped = function(p_a, p_b, -wp.quat_rotate_inv(unit_q, x), wp.quat_inverse(unit_q), WarmStart())
        return direct_result(
            swapped.gap,
            -wp.quat_rotate(unit_q, swapped.normal),
            x + wp.quat_rotate(unit_q, swapped.point_b),
            x + wp.quat_rotate(unit_q, swapped.point_a),
        )

    return swapped_contact


@functools.cache
def capsule_pair(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function for two capsules: closest points of two segments."""
    CoefficientsA, CoefficientsB = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def capsule_contact(p_a: CoefficientsA, p_b: CoefficientsB, x: vec3d, q: quatd, warm_start: WarmStart):
        up = vec3d(zero, zero, one)
        axis = wp.quat_rotate(wp.normalize(q), up)
        # Points x + s axis and t up; cosine and squared sine of the angle between the axes.
        cosine = axis[2]
        sine_2 = axis[0] * axis[0] + axis[1] * axis[1]
        s = zero
        if sine_2 > AXIS_TOLERANCE:
            s = wp.clamp((x[2] * cosine - wp.dot(x, axis)) / sine_2, -p_a.half_length, p_a.half_length)
        else:
            # Parallel axes: the middle of the common interval, in s.
            along = wp.dot(x, axis)
            low = wp.max(-along - p_b.half_length, -p_a.half_length)
            high = wp.min(-along + p_b.half_length, p_a.half_length)
            s = wp.clamp(half * (low + high), -p_a.half_length, p_a.half_length)
        t = wp.clamp(x[2] + s * cosine, -p_b.half_length, p_b.half_length)
        s = wp.clamp(t * cosine - wp.dot(x, axis), -p_a.half_length, p_a.half_length)
        foot_a = x + s * axis
        foot_b = t * up
        separation = foot_a - foot_b
        distance = wp.length(separation)
        n = wp.cross(axis, up)
        if distance > AXIS_TOLERANCE * (p_a.half_length + p_b.half_length):
            n = separation / distance
        elif sine_2 > AXIS_TOLERANCE:
            # The axes cross: separate along the normal of both.
            n = wp.normalize(n)
        else:
            n = perpendicular(axis)
        return direct_result(
            distance - p_a.radius - p_b.radius, n, foot_a - p_a.radius * n, foot_b + p_b.radius * n
        )

    return capsule_contact


@functools.cache
def pair_function(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function ``(p_a, p_b, x, q, warm_start)`` → ``ShapeContactPoint`` of a pair of shapes.

    ``p_a`` and ``p_b`` are the ``coefficient_struct`` of both in float64, ``x`` [m] is the origin of a in the
    frame of b and ``q`` the rotation a → b. The contact points are the pair of points with antiparallel normals
    along their connecting line that has the largest gap.

    If two faces or edges lie on each other, the contact points are common points of both, displaced from the
    middle of each in proportion to its size.

    Raises:
        TypeError: If both are planes.
    """
    if issubclass(A, Plane) and issubclass(B, Plane):
        raise TypeError("two planes have no contact point; at most one shape of a pair may be a plane")
    if not (A.convex and B.convex):
        return nonconvex_pair_function(A, B)
    if issubclass(B, Plane):
        return with_plane(A, B)
    if issubclass(A, Plane):
        return swapped_pair(with_plane(B, A), B, A)
    if issubclass(A, Sphere) and hasattr(B, "signed_distance"):
        return with_sphere(A, B)
    if issubclass(B, Sphere) and hasattr(A, "signed_distance"):
        return swapped_pair(with_sphere(B, A), B, A)
    if issubclass(A, Capsule) and issubclass(B, Capsule):
        return capsule_pair(A, B)
    return convex.pair_function(A, B)


@functools.cache
def nonconvex_pair_function(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of a pair with a torus or a parametric surface; see ``pair_function``.

    The warm start is not used: the whole surface is searched each time. So a step never follows a contact that is
    no longer the deepest, and a restored state gives bitwise identical results.

    Raises:
        TypeError: If both are parametric surfaces.
    """
    from warpcontact.kernels.shapes import parametric_contact, torus_contact  # rarely needed

    if issubclass(A, ParametricSurface) and issubclass(B, ParametricSurface):
        raise TypeError(
            f"two parametric surfaces, {A.__name__} and {B.__name__}, cannot be in contact: one shape of a pair "
            "must be closed"
        )
    if issubclass(B, ParametricSurface):
        return parametric_contact.pair_function(A, B)
    if issubclass(A, ParametricSurface):
        return _swapped(parametric_contact.pair_function(B, A))
    if A is Sphere:
        # The torus has ``signed_distance`` for the center of the sphere.
        return with_sphere(A, B)
    if B is Sphere:
        return swapped_pair(with_sphere(B, A), B, A)
    if A is Torus:
        return torus_contact.pair_function(A, B)
    return _swapped(torus_contact.pair_function(B, A))


def _swapped(pair_contact: wp.Function) -> wp.Function:
    """Returns the device function for (B, A) from that for (A, B)."""

    @wp.func
    def find_contact(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, warm_start: WarmStart):
        q = wp.normalize(rotation)
        contact = pair_contact(p_b, p_a, wp.quat_rotate_inv(q, -x), wp.quat_inverse(q), WarmStart())
        point_b = x + wp.quat_rotate(q, contact.point_a)
        contact.point_a = x + wp.quat_rotate(q, contact.point_b)
        contact.point_b = point_b
        contact.normal = -wp.quat_rotate(q, contact.normal)
        contact.warm_start.normal = contact.normal
        contact.warm_start.u = wp.vec4d(
            contact.warm_start.u[2], contact.warm_start.u[3], contact.warm_start.u[0], contact.warm_start.u[1]
        )
        return contact

    return find_contact
