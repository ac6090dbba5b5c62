"""Tori with a hole (ring tori)."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.axis import radial
from warpcontact.kernels.shapes.base import Shape, SignedDistance, one, zero


class Torus(Shape):
    """A torus about the z axis: all points within r of the core circle of radius R in the plane z = 0.

    A contact is determined at the point of the core circle that is deepest in the other shape. A contact deeper than r
    is NOT_CONVERGED, and exerts no force, if that point is equally close to two sides of the other shape.
    """

    formula = "(√(x² + y²) − R)² + z² = r²"
    convex: ClassVar[bool] = False

    major_radius: float = parameter("m", "radius R of the core circle", above=0.0)
    minor_radius: float = parameter("m", "radius r of the tube, less than R", above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.coefficients({name: np.asarray(getattr(self, name)) for name in self.varying()})

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        minor, major = np.broadcast_arrays(values["minor_radius"], values["major_radius"])
        bad = np.argwhere(minor >= major)
        if len(bad):
            where = tuple(bad[0])
            entry = f"minor_radius{list(map(int, where)) if where else ''}"
            raise ValueError(
                f"Torus.{entry} must be less than the major radius, got {minor[where]:g} m, "
                f"major radius {major[where]:g} m"
            )
        return values

    @wp.func
    def support(p: Any, n: wp.vec3d):
        radial_distance = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        point = p.minor_radius * n
        if radial_distance > zero:
            point += wp.vec3d(
                p.major_radius * (n[0] / radial_distance), p.major_radius * (n[1] / radial_distance), zero
            )
        return point

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def extents(p: Any):
        outer = p.major_radius + p.minor_radius
        return wp.vec3d(outer, outer, p.minor_radius)

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        radial_distance, out = radial(x)
        beside = radial_distance - p.major_radius
        distance = wp.sqrt(beside * beside + x[2] * x[2])
        # On the core circle all normal directions are equally near; z is used.
        found.normal = wp.vec3d(zero, zero, one)
        if distance > zero:
            found.normal = (beside / distance) * out + wp.vec3d(zero, zero, x[2] / distance)
        found.gap = distance - p.minor_radius
        found.point = p.major_radius * out + p.minor_radius * found.normal
        return found
