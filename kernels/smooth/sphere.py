"""Spheres."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.formula import parameter
from warpcontact.kernels.smooth.base import Expansion, Nearest, Shape, zero


class Sphere(Shape):
    """A sphere about the origin."""

    formula = "|y| = r"
    polyhedral: ClassVar[bool] = True

    radius: float = parameter("m", "radius r", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        return p.radius * n

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        return Expansion()

    @wp.func
    def margin(p: Any):
        return p.radius

    @wp.func
    def rolling(p: Any):
        return p.radius

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.radius)

    @wp.func
    def centre(p: Any):
        return wp.vec3d()

    @wp.func
    def inner(p: Any):
        return p.radius

    @wp.func
    def nearest(p: Any, x: wp.vec3d):
        found = Nearest()
        distance = wp.length(x)
        found.normal = wp.vec3d(zero, zero, wp.float64(1.0))
        if distance > zero:
            found.normal = x / distance
        found.gap = distance - p.radius
        found.point = p.radius * found.normal
        return found
