"""Boxes with rounded edges."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.base import AXIS_TOLERANCE, Shape, SignedDistance, SupportExpansion, zero


class RoundedBox(Shape):
    """A box centered at the origin, with edges along x, y, z rounded by a radius; 0: sharp edges.

    The flat parts of its faces extend to the half extents minus the radius.
    """

    formula = "distance from the box |x| ≤ a − r, |y| ≤ b − r, |z| ≤ c − r = r"
    kinks: ClassVar[int] = 3
    polyhedral: ClassVar[bool] = True

    half_extents: tuple[float, float, float] = parameter(
        "m", "half extents a, b, c of the outside", shape=(3,), above=0.0
    )
    radius: float = parameter("m", "radius r of the edges, less than any half extent", at_least=0.0, default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.coefficients({name: np.asarray(getattr(self, name)) for name in self.varying()})

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        radius, shortest = np.broadcast_arrays(values["radius"], values["half_extents"].min(axis=-1))
        invalid = np.argwhere(radius >= shortest)
        if len(invalid):
            where = tuple(invalid[0])
            entry = f"radius{list(map(int, where)) if where else ''}"
            raise ValueError(
                f"RoundedBox.{entry} must be less than every half extent, got {radius[where]:g} m, "
                f"shortest half extent {shortest[where]:g} m"
            )
        return values

    @wp.func
    def support(p: Any, n: wp.vec3d):
        point = p.radius * n
        for i in range(3):
            if wp.abs(n[i]) > AXIS_TOLERANCE:
                point[i] = point[i] + wp.sign(n[i]) * (p.half_extents[i] - p.radius)
        return point

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = SupportExpansion()
        found.kinks = wp.diag(p.half_extents - wp.vec3d(p.radius, p.radius, p.radius))
        return found

    @wp.func
    def margin(p: Any):
        return p.radius

    @wp.func
    def rolling_ball_radius(p: Any):
        return p.radius

    @wp.func
    def extents(p: Any):
        return p.half_extents

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        return wp.min(p.half_extents)

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        core = p.half_extents - wp.vec3d(p.radius, p.radius, p.radius)
        foot = wp.vec3d(
            wp.clamp(x[0], -core[0], core[0]), wp.clamp(x[1], -core[1], core[1]), wp.clamp(x[2], -core[2], core[2])
        )
        offset = x - foot
        distance = wp.length(offset)
        if distance > zero:
            found.normal = offset / distance
            found.gap = distance - p.radius
            found.point = foot + p.radius * found.normal
            return found
        # Inside the core: the nearest face.
        side = wp.int32(0)
        for i in range(1, 3):
            if wp.abs(x[i]) - core[i] > wp.abs(x[side]) - core[side]:
                side = i
        found.normal[side] = wp.where(x[side] < zero, wp.float64(-1.0), wp.float64(1.0))
        found.gap = wp.abs(x[side]) - p.half_extents[side]
        found.point = x - found.gap * found.normal
        return found
