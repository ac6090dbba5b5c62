"""Cylinders with flat ends and sharp edges."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.formula import parameter
from warpcontact.kernels.smooth.axis import disc, outward
from warpcontact.kernels.smooth.base import ON_AXIS, Nearest, Shape, one, zero


class Cylinder(Shape):
    """A cylinder about the z axis, its middle at the origin."""

    formula = "x² + y² = r², |z| ≤ l"
    kinks: ClassVar[int] = 1
    discs: ClassVar[int] = 2

    radius: float = parameter("m", "radius r", above=0.0)
    half_length: float = parameter("m", "half the length, l", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        point = wp.vec3d()
        across = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        if across > ON_AXIS:
            point = wp.vec3d(p.radius * (n[0] / across), p.radius * (n[1] / across), zero)
        if wp.abs(n[2]) > ON_AXIS:
            point[2] = wp.sign(n[2]) * p.half_length
        return point

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = disc(p.radius, n)
        found.kinks[0, 2] = p.half_length
        return found

    @wp.func
    def margin(p: Any):
        return zero

    @wp.func
    def rolling(p: Any):
        return zero

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.half_length)

    @wp.func
    def centre(p: Any):
        return wp.vec3d()

    @wp.func
    def inner(p: Any):
        return wp.min(p.radius, p.half_length)

    @wp.func
    def nearest(p: Any, x: wp.vec3d):
        found = Nearest()
        across, out = outward(x)
        up = wp.vec3d(zero, zero, wp.where(x[2] < zero, -one, one))
        beside = across - p.radius
        above = wp.abs(x[2]) - p.half_length
        if beside > zero and above > zero:
            found.gap = wp.sqrt(beside * beside + above * above)
            found.normal = (beside / found.gap) * out + (above / found.gap) * up
        elif beside > above:
            found.gap = beside
            found.normal = out
        else:
            found.gap = above
            found.normal = up
        found.point = wp.min(across, p.radius) * out + wp.min(wp.abs(x[2]), p.half_length) * up
        if beside <= zero or above <= zero:
            # On the mantle or on an end.
            if beside > above:
                found.point = p.radius * out + wp.vec3d(zero, zero, x[2])
            else:
                found.point = wp.vec3d(x[0], x[1], zero) + p.half_length * up
        return found
