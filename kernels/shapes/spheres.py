"""Spheres, capsules and ellipsoids."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.base import AXIS_TOLERANCE, Shape, SignedDistance, SupportExpansion, one, zero


class Sphere(Shape):
    """A sphere centered at the origin."""

    formula = "|y| = r"
    polyhedral: ClassVar[bool] = True

    radius: float = parameter("m", "radius r", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        return p.radius * n

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        return SupportExpansion()

    @wp.func
    def margin(p: Any):
        return p.radius

    @wp.func
    def rolling_ball_radius(p: Any):
        return p.radius

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.radius)

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        return p.radius

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        distance = wp.length(x)
        found.normal = wp.vec3d(zero, zero, wp.float64(1.0))
        if distance > zero:
            found.normal = x / distance
        found.gap = distance - p.radius
        found.point = p.radius * found.normal
        return found


class Capsule(Shape):
    """All points within r of a segment of the z axis, centered at the origin."""

    formula = "distance from the segment |z| ≤ l of the z axis = r"
    kinks: ClassVar[int] = 1
    polyhedral: ClassVar[bool] = True

    radius: float = parameter("m", "radius r", above=0.0)
    half_length: float = parameter("m", "half the length of the cylindrical part, l", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        point = p.radius * n
        if wp.abs(n[2]) > AXIS_TOLERANCE:
            point[2] = point[2] + wp.sign(n[2]) * p.half_length
        return point

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = SupportExpansion()
        found.kinks[0, 2] = p.half_length
        return found

    @wp.func
    def margin(p: Any):
        return p.radius

    @wp.func
    def rolling_ball_radius(p: Any):
        return p.radius

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.radius + p.half_length)

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        return p.radius

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        axis_point = wp.vec3d(zero, zero, wp.clamp(x[2], -p.half_length, p.half_length))
        offset = x - axis_point
        distance = wp.length(offset)
        # On the segment all normal directions are equally near; x is used.
        found.normal = wp.vec3d(one, zero, zero)
        if distance > zero:
            found.normal = offset / distance
        found.gap = distance - p.radius
        found.point = axis_point + p.radius * found.normal
        return found


class Ellipsoid(Shape):
    """An ellipsoid centered at the origin, with axes along x, y, z."""

    formula = "(x/a)² + (y/b)² + (z/c)² = 1"

    semi_axes: tuple[float, float, float] = parameter("m", "semi-axes a, b, c", shape=(3,), above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        scaled = wp.cw_mul(p.semi_axes, n)
        return wp.cw_mul(p.semi_axes, scaled) / wp.length(scaled)

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = SupportExpansion()
        scaled = wp.cw_mul(p.semi_axes, n)
        value = wp.length(scaled)
        found.point = wp.cw_mul(p.semi_axes, scaled) / value
        squares = wp.diag(wp.cw_mul(p.semi_axes, p.semi_axes))
        found.hessian = (squares - wp.outer(found.point, found.point)) / value
        return found

    @wp.func
    def margin(p: Any):
        return zero

    @wp.func
    def rolling_ball_radius(p: Any):
        shortest = wp.min(p.semi_axes)
        return shortest * (shortest / wp.max(p.semi_axes))

    @wp.func
    def extents(p: Any):
        return p.semi_axes

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        return wp.min(p.semi_axes)
