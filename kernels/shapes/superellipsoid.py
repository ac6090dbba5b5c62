"""Superellipsoids, from nearly a box to nearly an octahedron."""

from typing import Any, ClassVar

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.base import LOOSE_AXIS_TOLERANCE, Shape, SupportExpansion, one, real, two, zero

# Offset from an axis at which a zero or infinite curvature of a support function is evaluated.
OFF_AXIS = wp.constant(real(1.0e-60))


@wp.func
def positive_power(x: real, exponent: real):
    """Returns x^exponent for x ≥ 0."""
    if x == zero:
        return zero
    return wp.exp(exponent * wp.log(x))


@wp.func
def p_norm(x: real, y: real, exponent: real):
    """Returns (x^q + y^q)^(1/q), its two derivatives and a curvature, for x, y ≥ 0 and q = 2/(2 − e).

    The Hessian is the curvature times w wᵀ, w = (y, −x).
    """
    longest = wp.max(x, y)
    if longest == zero:
        return zero, zero, zero, zero
    shorter = wp.min(x, y) / longest
    q = two / (two - exponent)
    power = positive_power(shorter, q)
    root = positive_power(one + power, one / q)
    value = longest * root
    # (value/longest)^(1 − q) and (value/shorter)^(1 − q)
    of_longest = root / (one + power)
    of_shorter = of_longest * positive_power(shorter, q - one)
    ratio = wp.max(shorter, OFF_AXIS)
    curvature = (
        (q - one) * of_longest / (one + power) * positive_power(ratio, q - two) / (longest * longest * longest)
    )
    if x < y:
        return value, of_shorter, of_longest, curvature
    return value, of_longest, of_shorter, curvature


@wp.func
def support_point(p: Any, n: wp.vec3d):
    """Returns the support point along n."""
    axes = p.semi_axes
    x = axes[0] * wp.abs(n[0])
    y = axes[1] * wp.abs(n[1])
    z = axes[2] * wp.abs(n[2])
    flat, by_x, by_y, _ = p_norm(x, y, p.exponents[1])
    _, by_flat, by_z, _ = p_norm(flat, z, p.exponents[0])
    return wp.vec3d(
        axes[0] * wp.sign(n[0]) * by_flat * by_x,
        axes[1] * wp.sign(n[1]) * by_flat * by_y,
        axes[2] * wp.sign(n[2]) * by_z,
    )


class Superellipsoid(Shape):
    """A superellipsoid centered at the origin, with axes along x, y, z. Exponents (1, 1) give an ellipsoid.

    Exponents below 1 make it box-like, above 1 octahedron-like; e₂ is the exponent of the section z = 0.
    """

    formula = "(|x/a|^(2/e₂) + |y/b|^(2/e₂))^(e₂/e₁) + |z/c|^(2/e₁) = 1"
    reference = "A. H. Barr, Superquadrics and angle-preserving transformations, 1981"
    # If n is almost normal to an axis whose exponent is below 1, the support point moves as along an edge.
    kinks: ClassVar[int] = 3
    ill_conditioned: ClassVar[bool] = True

    semi_axes: tuple[float, float, float] = parameter("m", "semi-axes a, b, c", shape=(3,), above=0.0)
    exponents: tuple[float, float] = parameter(
        "-", "exponents e₁, e₂", shape=(2,), at_least=0.1, at_most=1.9, default=(1.0, 1.0)
    )

    support: ClassVar = support_point

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        signed = wp.vec3d(
            p.semi_axes[0] * wp.sign(n[0]), p.semi_axes[1] * wp.sign(n[1]), p.semi_axes[2] * wp.sign(n[2])
        )
        x = signed[0] * n[0]
        y = signed[1] * n[1]
        z = signed[2] * n[2]
        flat, by_x, by_y, flat_curvature = p_norm(x, y, p.exponents[1])
        _, by_flat, by_z, curvature = p_norm(flat, z, p.exponents[0])
        found = SupportExpansion()
        found.point = wp.cw_mul(signed, wp.vec3d(by_flat * by_x, by_flat * by_y, by_z))
        up = wp.cw_mul(signed, wp.vec3d(z * by_x, z * by_y, -flat))
        around = wp.cw_mul(signed, wp.vec3d(y, -x, zero))
        found.hessian = curvature * wp.outer(up, up) + (by_flat * flat_curvature) * wp.outer(around, around)
        exponents = wp.vec3d(p.exponents[1], p.exponents[1], p.exponents[0])
        axes = wp.int32(3)
        for i in range(axes):
            if wp.abs(n[i]) <= LOOSE_AXIS_TOLERANCE and exponents[i] < one:
                beside = n
                beside[i] = LOOSE_AXIS_TOLERANCE
                found.kinks[i, i] = support_point(p, beside)[i]
                found.point[i] = zero
                # Across the edge, the kink holds the curvature.
                for j in range(3):
                    found.hessian[i, j] = zero
                    found.hessian[j, i] = zero
        return found

    @wp.func
    def support_powers(p: Any):
        """Returns the powers of the components of n that those of the support point follow near zero."""
        across = p.exponents[1] / (two - p.exponents[1])
        return wp.vec3d(across, across, p.exponents[0] / (two - p.exponents[0]))

    @wp.func
    def gauss_map(p: Any, y: wp.vec3d):
        """Returns the normal at a point, after scaling the point to the surface."""
        axes = p.semi_axes
        x_1 = wp.abs(y[0]) / axes[0]
        x_2 = wp.abs(y[1]) / axes[1]
        x_3 = wp.abs(y[2]) / axes[2]
        section_exponent = two / p.exponents[1]
        up = two / p.exponents[0] - one
        flat = zero
        by_1 = zero
        by_2 = zero
        longest = wp.max(x_1, x_2)
        if longest > zero:
            flat = longest * positive_power(
                positive_power(x_1 / longest, section_exponent) + positive_power(x_2 / longest, section_exponent),
                one / section_exponent,
            )
            by_1 = positive_power(x_1 / flat, section_exponent - one)
            by_2 = positive_power(x_2 / flat, section_exponent - one)
        largest = wp.max(flat, x_3)
        by_flat = positive_power(flat / largest, up)
        return wp.normalize(
            wp.vec3d(
                wp.sign(y[0]) * by_flat * by_1 / axes[0],
                wp.sign(y[1]) * by_flat * by_2 / axes[1],
                wp.sign(y[2]) * positive_power(x_3 / largest, up) / axes[2],
            )
        )

    @wp.func
    def gauge(p: Any, y: wp.vec3d):
        """Returns the factor by which the surface must be scaled to contain a point."""
        x_1 = wp.abs(y[0]) / p.semi_axes[0]
        x_2 = wp.abs(y[1]) / p.semi_axes[1]
        x_3 = wp.abs(y[2]) / p.semi_axes[2]
        longest = wp.max(x_1, x_2)
        flat = zero
        if longest > zero:
            section_exponent = two / p.exponents[1]
            flat = longest * positive_power(
                positive_power(x_1 / longest, section_exponent) + positive_power(x_2 / longest, section_exponent),
                one / section_exponent,
            )
        longest = wp.max(flat, x_3)
        if longest == zero:
            return zero
        up = two / p.exponents[0]
        return longest * positive_power(
            positive_power(flat / longest, up) + positive_power(x_3 / longest, up), one / up
        )

    @wp.func
    def margin(p: Any):
        return zero

    @wp.func
    def rolling_ball_radius(p: Any):
        # The edges may be sharp.
        return zero

    @wp.func
    def extents(p: Any):
        return p.semi_axes

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        # Inscribed sphere of the inscribed octahedron.
        axes = p.semi_axes
        return one / wp.length(wp.vec3d(one / axes[0], one / axes[1], one / axes[2]))
