"""Spheres."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.base import Shape, SignedDistance, SupportExpansion, zero


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
