"""Cones with a sharp tip."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.formula import parameter
from warpcontact.kernels.smooth.axis import outward
from warpcontact.kernels.smooth.base import ON_AXIS, Expansion, Nearest, Shape, half, one, zero


class Cone(Shape):
    """A cone about the z axis: the middle of its base at the origin, its tip at z = h."""

    formula = "√(x² + y²) = r (1 − z/h), 0 ≤ z ≤ h"
    kinks: ClassVar[int] = 1
    discs: ClassVar[int] = 1
    bent: ClassVar[bool] = True

    radius: float = parameter("m", "radius r of the base", above=0.0)
    height: float = parameter("m", "height h", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        across = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        rim = wp.vec3d()
        if across > ON_AXIS:
            rim = wp.vec3d(p.radius * (n[0] / across), p.radius * (n[1] / across), zero)
        tip = wp.vec3d(zero, zero, p.height)
        lead = p.radius * across - p.height * n[2]
        if wp.abs(lead) <= ON_AXIS * (p.radius + p.height):
            return half * (rim + tip)
        if lead > zero:
            return rim
        return tip

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        # The larger of that of the rim and that of the tip: half their sum and half the size of their difference.
        found = Expansion()
        across = wp.sqrt(n[0] * n[0] + n[1] * n[1])
        rim = wp.vec3d()
        if across > ON_AXIS:
            rim = wp.vec3d(half * p.radius * (n[0] / across), half * p.radius * (n[1] / across), zero)
            around = wp.vec3d(-n[1] / across, n[0] / across, zero)
            found.hessian = (half * p.radius / across) * wp.outer(around, around)
        elif n[2] < zero:
            found.disc = p.radius
        found.point = wp.vec3d(rim[0], rim[1], half * p.height)
        found.kinks[0] = wp.vec3d(rim[0], rim[1], -half * p.height)
        found.bend = one
        return found

    @wp.func
    def margin(p: Any):
        return zero

    @wp.func
    def rolling(p: Any):
        return zero

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.height)

    @wp.func
    def centre(p: Any):
        slant = wp.sqrt(p.radius * p.radius + p.height * p.height)
        return wp.vec3d(zero, zero, p.radius * (p.height / (p.radius + slant)))

    @wp.func
    def inner(p: Any):
        slant = wp.sqrt(p.radius * p.radius + p.height * p.height)
        return p.radius * (p.height / (p.radius + slant))

    @wp.func
    def nearest(p: Any, x: wp.vec3d):
        found = Nearest()
        across, out = outward(x)
        up = wp.vec3d(zero, zero, one)
        # In the half-plane through the axis, along the generator from the rim: t = 0, to the tip: t = 1.
        slant = wp.sqrt(p.radius * p.radius + p.height * p.height)
        sine = p.radius / slant
        cosine = p.height / slant
        beside = (across - p.radius) * cosine + x[2] * sine
        along = (x[2] * cosine - (across - p.radius) * sine) / slant
        t = wp.clamp(along, zero, one)
        on_mantle = (p.radius * (one - t)) * out + (p.height * t) * up
        if beside <= zero and x[2] >= zero:
            # Inside: the mantle or the base.
            if -beside <= x[2]:
                found.gap = beside
                found.normal = cosine * out + sine * up
                found.point = on_mantle
            else:
                found.gap = -x[2]
                found.normal = -up
                found.point = wp.vec3d(x[0], x[1], zero)
            return found
        if x[2] <= zero and across <= p.radius:
            found.gap = -x[2]
            found.normal = -up
            found.point = wp.vec3d(x[0], x[1], zero)
            return found
        found.point = on_mantle
        if along > zero and along < one:
            found.gap = beside
            found.normal = cosine * out + sine * up
            return found
        found.gap = wp.length(x - on_mantle)
        found.normal = cosine * out + sine * up
        if found.gap > zero:
            found.normal = (x - on_mantle) / found.gap
        return found
