"""Curved solids as shapes of one class, whose separation ``kernels/shapes`` computes.

A form is an ellipsoid, a cone, or the sum of a disc, a segment and a ball: a cylinder is a disc and a segment, a capsule a
segment and a ball. So one search for the direction of the largest separation serves all pairs.
"""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CONE, CYLINDER
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.catalogue.device_model import coefficient_struct, parameter
from warpcontact.kernels.shapes import convex
from warpcontact.kernels.shapes.base import Shape, SupportExpansion, half, one, zero
from warpcontact.kernels.shapes.revolution import disc_expansion

double = wp.float64
vec3d = wp.vec3d

# Overlap relative to the inscribed radius, up to which a stationary direction counts as that of the least overlap if the form has
# sharp edges. Deeper ones are searched over all directions.
SHALLOW = wp.constant(double(1.0e-2))


class ConvexForm(Shape):
    """An ellipsoid, a cone about z with the base at the origin, or the sum of a disc normal to z, a segment and a ball."""

    formula = "ellipsoid, cone, or disc + segment + ball"
    kinks: ClassVar[int] = 1
    discs: ClassVar[int] = 2
    curved_kink: ClassVar[bool] = True

    semi_axes: tuple[float, float, float] = parameter("m", "of an ellipsoid", shape=(3,), at_least=0.0)
    half_axis: tuple[float, float, float] = parameter("m", "half of the segment, a vector", shape=(3,))
    disc_radius: float = parameter("m", "radius of the disc, or of the base of a cone", at_least=0.0)
    height: float = parameter("m", "height of a cone", at_least=0.0)
    ball_radius: float = parameter("m", "radius of the ball", at_least=0.0)
    inner_radius: float = parameter("m", "of an inscribed sphere", at_least=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        """Returns the point that is farthest along ``n``."""
        if p.semi_axes[0] > zero:
            weighted = wp.cw_mul(p.semi_axes, n)
            return wp.cw_mul(p.semi_axes, weighted) / wp.length(weighted)
        disc = disc_expansion(p.disc_radius, n)
        if p.height > zero:
            rise = wp.dot(n, disc.point) - p.height * n[2]
            if rise > zero:
                return disc.point
            return wp.vec3d(zero, zero, p.height)
        return disc.point + wp.sign(wp.dot(n, p.half_axis)) * p.half_axis + p.ball_radius * n

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        """Returns the ``SupportExpansion`` about ``n``, without the ball."""
        found = SupportExpansion()
        if p.semi_axes[0] > zero:
            weighted = wp.cw_mul(p.semi_axes, n)
            value = wp.length(weighted)
            found.point = wp.cw_mul(p.semi_axes, weighted) / value
            squares = wp.diag(wp.cw_mul(p.semi_axes, p.semi_axes))
            found.hessian = (squares - wp.outer(found.point, found.point)) / value
            return found
        if p.disc_radius > zero:
            found = disc_expansion(p.disc_radius, n)
        if p.height > zero:
            # The larger of the supports of base and tip: half of their sum, and half of the size of their difference.
            found.kinks[0] = half * found.point - wp.vec3d(zero, zero, half * p.height)
            found.point = half * found.point + wp.vec3d(zero, zero, half * p.height)
            found.hessian = half * found.hessian
            found.kink_curvature = one
            if n[2] > zero:
                found.disc_radius = zero
        else:
            found.kinks[0] = p.half_axis
        return found

    @wp.func
    def margin(p: Any):
        """Returns the radius of the ball [m]."""
        return p.ball_radius

    @wp.func
    def rolling_ball_radius(p: Any):
        """Returns the overlap up to which a stationary direction is that of the least overlap [m]."""
        if p.semi_axes[0] > zero:
            shortest = wp.min(p.semi_axes)
            return shortest * (shortest / wp.max(p.semi_axes))
        return wp.max(p.ball_radius, SHALLOW * p.inner_radius)

    @wp.func
    def extents(p: Any):
        """Returns half the sides of a bounding box [m]."""
        disc = wp.vec3d(p.disc_radius, p.disc_radius, p.height)
        ball = wp.vec3d(p.ball_radius, p.ball_radius, p.ball_radius)
        return p.semi_axes + disc + wp.abs(p.half_axis) + ball

    @wp.func
    def inscribed_center(p: Any):
        """Returns the center of an inscribed sphere [m]."""
        if p.height > zero:
            return wp.vec3d(zero, zero, p.inner_radius)
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        """Returns the radius of an inscribed sphere [m]."""
        return p.inner_radius


FormCoefficients = coefficient_struct(ConvexForm, double)
separation = convex.pair_function(ConvexForm, ConvexForm)


@wp.func
def form_of(side: SolidGeometry):
    """Returns a curved solid as a form in its frame."""
    form = FormCoefficients()
    scale = side.scale
    r = scale[0]
    if (side.flags & CAPSULE) != 0:
        form.ball_radius = r
        form.half_axis = vec3d(zero, zero, scale[2] - r)
        form.inner_radius = r
    elif (side.flags & CYLINDER) != 0:
        form.disc_radius = r
        form.half_axis = vec3d(zero, zero, scale[2])
        form.inner_radius = wp.min(r, scale[2])
    elif (side.flags & CONE) != 0:
        form.disc_radius = r
        form.height = scale[2]
        form.inner_radius = r * (scale[2] / (r + wp.sqrt(r * r + scale[2] * scale[2])))
    elif scale[1] == r and scale[2] == r:
        form.ball_radius = r
        form.inner_radius = r
    else:
        form.semi_axes = scale
        form.inner_radius = wp.min(scale)
    return form
