"""Ellipsoids."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.base import Shape, SupportExpansion, zero


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
