"""Cylinders with flat ends and sharp edges."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.axis import disc_expansion, radial
from warpcontact.kernels.shapes.base import AXIS_TOLERANCE, Shape, SignedDistance, one, zero


class Cylinder(Shape):
    """A cylinder about the z axis, centered at the origin."""

    formula = "x² + y² = r², |z| ≤ l"
    kinks: ClassVar[int] = 1
    discs: ClassVar[int] = 2

    radius: float = parameter("m", "radius r", above=0.0)
    half_length: float = parameter("m", "half the length, l", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        point = wp.vec3d()
        radial_distance = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        if radial_distance > AXIS_TOLERANCE:
            point = wp.vec3d(p.radius * (n[0] / radial_distance), p.radius * (n[1] / radial_distance), zero)
        if wp.abs(n[2]) > AXIS_TOLERANCE:
            point[2] = wp.sign(n[2]) * p.half_length
        return point

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = disc_expansion(p.radius, n)
        found.kinks[0, 2] = p.half_length
        return found

    @wp.func
    def margin(p: Any):
        return zero

    @wp.func
    def rolling_ball_radius(p: Any):
        return zero

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.half_length)

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        return wp.min(p.radius, p.half_length)

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        radial_distance, out = radial(x)
        up = wp.vec3d(zero, zero, wp.where(x[2] < zero, -one, one))
        mantle_distance = radial_distance - p.radius
        end_distance = wp.abs(x[2]) - p.half_length
        if mantle_distance > zero and end_distance > zero:
            found.gap = wp.sqrt(mantle_distance * mantle_distance + end_distance * end_distance)
            found.normal = (mantle_distance / found.gap) * out + (end_distance / found.gap) * up
        elif mantle_distance > end_distance:
            found.gap = mantle_distance
            found.normal = out
        else:
            found.gap = end_distance
            found.normal = up
        found.point = wp.min(radial_distance, p.radius) * out + wp.min(wp.abs(x[2]), p.half_length) * up
        if mantle_distance <= zero or end_distance <= zero:
            # On the mantle or on an end.
            if mantle_distance > end_distance:
                found.point = p.radius * out + wp.vec3d(zero, zero, x[2])
            else:
                found.point = wp.vec3d(x[0], x[1], zero) + p.half_length * up
        return found
