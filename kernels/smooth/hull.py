"""The convex hull of a torus: a flat disc, rounded all around."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.formula import parameter
from warpcontact.kernels.smooth.base import ON_AXIS, Expansion, Shape
from warpcontact.kernels.smooth.torus import Torus

zero = wp.constant(wp.float64(0.0))


class Hull(Shape):
    """All within r of a disc of radius R in the plane z = 0."""

    discs: ClassVar[int] = 2

    major_radius: float = parameter("m", "radius R of the disc", above=0.0)
    minor_radius: float = parameter("m", "radius r of its edge", above=0.0)

    support: ClassVar = Torus.support
    centre: ClassVar = Torus.centre
    extents: ClassVar = Torus.extents

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = Expansion()
        across = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        found.disc = p.major_radius
        if across > ON_AXIS:
            found.disc = zero
            found.point = wp.vec3d(p.major_radius * (n[0] / across), p.major_radius * (n[1] / across), zero)
            around = wp.vec3d(-n[1] / across, n[0] / across, zero)
            found.hessian = (p.major_radius / across) * wp.outer(around, around)
        return found

    @wp.func
    def margin(p: Any):
        return p.minor_radius

    @wp.func
    def rolling(p: Any):
        return p.minor_radius

    @wp.func
    def inner(p: Any):
        return p.minor_radius
