"""Half-spaces."""

from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import Shape, SignedDistance, one, zero


class Plane(Shape):
    """The half-space z ≤ 0; its normal is +z. It has no support function except along z."""

    formula = "z = 0"

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        found.normal = wp.vec3d(zero, zero, one)
        found.gap = x[2]
        found.point = wp.vec3d(x[0], x[1], zero)
        return found
