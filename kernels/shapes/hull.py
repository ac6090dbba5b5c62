"""Convex hull of a torus: a flat disc with a rounded edge."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.axis import disc_expansion
from warpcontact.kernels.shapes.base import Shape
from warpcontact.kernels.shapes.torus import Torus


class Hull(Shape):
    """All points within r of a disc of radius R in the plane z = 0."""

    discs: ClassVar[int] = 2

    major_radius: float = parameter("m", "radius R of the disc", above=0.0)
    minor_radius: float = parameter("m", "radius r of its edge", above=0.0)

    support: ClassVar = Torus.support
    inscribed_center: ClassVar = Torus.inscribed_center
    extents: ClassVar = Torus.extents

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        return disc_expansion(p.major_radius, n)

    @wp.func
    def margin(p: Any):
        return p.minor_radius

    @wp.func
    def rolling_ball_radius(p: Any):
        return p.minor_radius

    @wp.func
    def inscribed_radius(p: Any):
        return p.minor_radius
