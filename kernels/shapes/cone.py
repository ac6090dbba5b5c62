"""Cones with a sharp tip."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.axis import radial
from warpcontact.kernels.shapes.base import (
    AXIS_TOLERANCE,
    Shape,
    SignedDistance,
    SupportExpansion,
    half,
    one,
    zero,
)


class Cone(Shape):
    """A cone about the z axis: center of the base at the origin, tip at z = h."""

    formula = "√(x² + y²) = r (1 − z/h), 0 ≤ z ≤ h"
    kinks: ClassVar[int] = 1
    discs: ClassVar[int] = 1
    curved_kink: ClassVar[bool] = True

    radius: float = parameter("m", "radius r of the base", above=0.0)
    height: float = parameter("m", "height h", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        radial_distance = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        edge_point = wp.vec3d()
        if radial_distance > AXIS_TOLERANCE:
            edge_point = wp.vec3d(p.radius * (n[0] / radial_distance), p.radius * (n[1] / radial_distance), zero)
        tip = wp.vec3d(zero, zero, p.height)
        difference = p.radius * radial_distance - p.height * n[2]
        if wp.abs(difference) <= AXIS_TOLERANCE * (p.radius + p.height):
            return half * (edge_point + tip)
        if difference > zero:
            return edge_point
        return tip

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        # Maximum of the support functions of base edge and tip: half their sum plus half the size of their
        # difference.
        found = SupportExpansion()
        radial_distance = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        edge_point = wp.vec3d()
        if radial_distance > AXIS_TOLERANCE:
            edge_point = wp.vec3d(
                half * p.radius * (n[0] / radial_distance), half * p.radius * (n[1] / radial_distance), zero
            )
            around = wp.vec3d(-n[1] / radial_distance, n[0] / radial_distance, zero)
            found.hessian = (half * p.radius / radial_distance) * wp.outer(around, around)
        elif n[2] < zero:
            found.disc_radius = p.radius
        found.point = wp.vec3d(edge_point[0], edge_point[1], half * p.height)
        found.kinks[0] = wp.vec3d(edge_point[0], edge_point[1], -half * p.height)
        found.kink_curvature = one
        return found

    @wp.func
    def margin(p: Any):
        return zero

    @wp.func
    def rolling_ball_radius(p: Any):
        return zero

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.height)

    @wp.func
    def inscribed_center(p: Any):
        slant = wp.sqrt(p.radius * p.radius + p.height * p.height)
        return wp.vec3d(zero, zero, p.radius * (p.height / (p.radius + slant)))

    @wp.func
    def inscribed_radius(p: Any):
        slant = wp.sqrt(p.radius * p.radius + p.height * p.height)
        return p.radius * (p.height / (p.radius + slant))

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        radial_distance, out = radial(x)
        up = wp.vec3d(zero, zero, one)
        # In the half-plane through the axis, along the generator: t = 0 at the base edge, t = 1 at the tip.
        slant = wp.sqrt(p.radius * p.radius + p.height * p.height)
        sine = p.radius / slant
        cosine = p.height / slant
        mantle_distance = (radial_distance - p.radius) * cosine + x[2] * sine
        along = (x[2] * cosine - (radial_distance - p.radius) * sine) / slant
        t = wp.clamp(along, zero, one)
        on_mantle = (p.radius * (one - t)) * out + (p.height * t) * up
        if mantle_distance <= zero and x[2] >= zero:
            # Inside: the mantle or the base.
            if -mantle_distance <= x[2]:
                found.gap = mantle_distance
                found.normal = cosine * out + sine * up
                found.point = on_mantle
            else:
                found.gap = -x[2]
                found.normal = -up
                found.point = wp.vec3d(x[0], x[1], zero)
            return found
        if x[2] <= zero and radial_distance <= p.radius:
            found.gap = -x[2]
            found.normal = -up
            found.point = wp.vec3d(x[0], x[1], zero)
            return found
        found.point = on_mantle
        if along > zero and along < one:
            found.gap = mantle_distance
            found.normal = cosine * out + sine * up
            return found
        found.gap = wp.length(x - on_mantle)
        found.normal = cosine * out + sine * up
        if found.gap > zero:
            found.normal = (x - on_mantle) / found.gap
        return found
