"""Shapes of revolution about the z axis: cylinder and cone with sharp edges, and torus with a hole (ring torus)."""

from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.base import (
    AXIS_TOLERANCE,
    Shape,
    SignedDistance,
    SupportExpansion,
    half,
    one,
    real,
    vec3d,
    zero,
)


@wp.func
def radial(x: vec3d):
    """Returns the distance of a point from the z axis and the radial unit vector; on the axis, the x axis."""
    radial_distance = wp.sqrt(x[0] * x[0] + x[1] * x[1])
    out = vec3d(one, zero, zero)
    if radial_distance > zero:
        out = vec3d(x[0] / radial_distance, x[1] / radial_distance, zero)
    return radial_distance, out


@wp.func
def disc_expansion(radius: real, n: vec3d):
    """Returns the ``SupportExpansion`` of a flat disc in the plane z = 0, centered at the origin."""
    found = SupportExpansion()
    radial_distance = wp.sqrt(n[0] * n[0] + n[1] * n[1])
    found.disc_radius = radius
    if radial_distance > AXIS_TOLERANCE:
        found.disc_radius = zero
        found.point = vec3d(radius * (n[0] / radial_distance), radius * (n[1] / radial_distance), zero)
        around = vec3d(-n[1] / radial_distance, n[0] / radial_distance, zero)
        found.hessian = (radius / radial_distance) * wp.outer(around, around)
    return found


class Cylinder(Shape):
    """A cylinder about the z axis, centered at the origin."""

    formula = "x² + y² = r², |z| ≤ l"
    kinks: ClassVar[int] = 1
    discs: ClassVar[int] = 2

    radius: float = parameter("m", "radius r", above=0.0)
    half_length: float = parameter("m", "half the length, l", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        point = wp.vec3d()
        radial_distance = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        if radial_distance > AXIS_TOLERANCE:
            point = wp.vec3d(p.radius * (n[0] / radial_distance), p.radius * (n[1] / radial_distance), zero)
        if wp.abs(n[2]) > AXIS_TOLERANCE:
            point[2] = wp.sign(n[2]) * p.half_length
        return point

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = disc_expansion(p.radius, n)
        found.kinks[0, 2] = p.half_length
        return found

    @wp.func
    def margin(p: Any):
        return zero

    @wp.func
    def rolling_ball_radius(p: Any):
        return zero

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.half_length)

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        return wp.min(p.radius, p.half_length)

    @wp.func
    def signed_distance(p: Any, x: wp.vec3d):
        found = SignedDistance()
        radial_distance, out = radial(x)
        up = wp.vec3d(zero, zero, wp.where(x[2] < zero, -one, one))
        mantle_distance = radial_distance - p.radius
        end_distance = wp.abs(x[2]) - p.half_length
        if mantle_distance > zero and end_distance > zero:
            found.gap = wp.sqrt(mantle_distance * mantle_distance + end_distance * end_distance)
            found.normal = (mantle_distance / found.gap) * out + (end_distance / found.gap) * up
        elif mantle_distance > end_distance:
            found.gap = mantle_distance
            found.normal = out
        else:
            found.gap = end_distance
            found.normal = up
        found.point = wp.min(radial_distance, p.radius) * out + wp.min(wp.abs(x[2]), p.half_length) * up
        if mantle_distance <= zero or end_distance <= zero:
            # On the mantle or on an end.
            if mantle_distance > end_distance:
                found.point = p.radius * out + wp.vec3d(zero, zero, x[2])
            else:
                found.point = wp.vec3d(x[0], x[1], zero) + p.half_length * up
        return found


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
        invalid = np.argwhere(minor >= major)
        if len(invalid):
            where = tuple(invalid[0])
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
