"""Hertz contact of elastic bodies with smooth surfaces, from radii and materials or from the local curvatures.

An ellipse of axis ratio k ≥ 1, m = 1 − 1/k², has the complete elliptic integrals K and E of parameter m, and

    D = (K − E)/m,  B = K − D,  S = (D − B)/(m K).

On the device, the arithmetic-geometric mean gives all of them without differences of nearly equal numbers.
"""

import dataclasses
import math
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords, keywords_of, refuse_unknown
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.formulas import root_between
from warpcontact.kernels.laws.hunt_crossley import damping_factor_of_restitution

#: Largest ratio of the principal curvatures; larger ratios are replaced by this one.
LONGEST = 1.0e6


def hertz_stiffness(
    E: float, nu: float, R: float, E2: float | None = None, nu2: float = 0.0, R2: float = math.inf
) -> float:
    """Returns the stiffness K = (4/3) E* √R* of two spheres in Hertz contact.

    Args:
        E: Young's modulus of the first body [Pa].
        nu: Poisson's ratio of the first body [-].
        R: Radius of the first body [m].
        E2: Young's modulus of the second body [Pa]; ``None``: rigid.
        nu2: Poisson's ratio of the second body [-].
        R2: Radius of the second body [m]; infinite for a plane, negative for a hollow around the first.

    Returns:
        K [N/m^1.5].

    Raises:
        ValueError: If a value is out of range, or the hollow is smaller than the sphere.
    """
    E, R = number("E", E, above=0.0), number("R", R, above=0.0)
    nu, nu2 = number("nu", nu, above=-1.0, at_most=0.5), number("nu2", nu2, above=-1.0, at_most=0.5)
    compliance = (1.0 - nu**2) / E
    if E2 is not None:
        E2 = number("E2", E2, above=0.0)
        compliance += (1.0 - nu2**2) / E2
    R2 = number("R2", R2, may_be_infinite=True)
    if R2 == 0.0 or -R <= R2 < 0.0:
        raise ValueError(f"R2 must be positive, infinite or less than -R = {-R:g} m (a hollow), got {R2:g} m")
    curvature = 1.0 / R + 1.0 / R2
    return 4.0 / 3.0 / compliance / math.sqrt(curvature)


def elliptic_stiffness(
    E: float, nu: float, Rx: float, Ry: float, E2: float | None = None, nu2: float = 0.0
) -> float:
    """Returns the stiffness K of F = K δ^1.5 for an elliptic contact, from complete elliptic integrals.

    Args:
        E: Young's modulus of the first body [Pa].
        nu: Poisson's ratio of the first body [-].
        Rx: Combined principal radius of both bodies in one direction, 1/Rx = 1/Rx1 + 1/Rx2 [m].
        Ry: Combined principal radius in the other direction [m].
        E2: Young's modulus of the second body [Pa]; ``None``: rigid.
        nu2: Poisson's ratio of the second body [-].

    Returns:
        K [N/m^1.5].

    Raises:
        ValueError: If a value is out of range, or one radius is more than 1e6 times the other.
    """
    short, long = sorted((number("Rx", Rx, above=0.0), number("Ry", Ry, above=0.0)))
    # Checks the material: K = (4/3) E* √R of a sphere on a plane.
    effective = 0.75 * hertz_stiffness(E, nu, short, E2, nu2) / math.sqrt(short)
    ratio = long / short
    if not ratio <= 1.0e6:
        raise ValueError(f"Rx and Ry must be positive and within a factor of 1e6, got {Rx:g} m and {Ry:g} m")
    if ratio < 1.0 + 1.0e-6:
        # Nearly circular: use the mean curvature, accurate to second order. The integrals would lose digits.
        return 4.0 / 3.0 * effective * math.sqrt(2.0 / (1.0 / short + 1.0 / long))

    from scipy.special import ellipe, ellipkm1  # slow to import, rarely needed

    def excess(axis_ratio: np.ndarray) -> np.ndarray:
        # ellipkm1 computes K from 1 − m, because m is 1 to almost all digits for a long ellipse.
        first, second = ellipkm1(axis_ratio**-2), ellipe(1.0 - axis_ratio**-2)
        return (axis_ratio**2 * second - first) / (first - second) - ratio

    # The axis ratio lies between the square root of the ratio of the radii and that ratio.
    axes = float(root_between("ratio of half axes", excess, 1.0 + 1.0e-9, 2.0 * ratio))
    complement = axes**-2
    combined = 1.0 / (1.0 / short + 1.0 / long)
    # δ = K(m) [9/(2 E(m) R) (F/(2 π k E*))²]^(1/3)
    per_force = ellipkm1(complement) * (9.0 / (2.0 * ellipe(1.0 - complement) * combined)) ** (1.0 / 3.0)
    return float(2.0 * math.pi * axes * effective * per_force**-1.5)


class Hertz(Law):
    """Elastic contact of bodies with smooth surfaces: a sphere on a plane, or two spheres.

    The facets of a mesh are flat, so the radius is that of the sphere or a given one, not that of a facet.
    """

    formula = "N = K δ^1.5,  K = (4/3) E* √R"
    reference = "Hertz, J. reine angew. Math. 92 (1882) 156; Johnson, Contact Mechanics (1985)"
    provenance = "S"
    validity = "contact radius √(Rδ) ≲ 0.1 R, elastic, impact far slower than sound"
    power = 1.5

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)

    @classmethod
    @explain_keywords
    def from_materials(
        cls,
        E: float,
        nu: float,
        R: float,
        E2: float | None = None,
        nu2: float = 0.0,
        R2: float = math.inf,
    ) -> "Hertz":
        """Returns the law for materials and radii, as for ``hertz_stiffness``."""
        return cls(stiffness=hertz_stiffness(E, nu, R, E2, nu2, R2))

    @classmethod
    @explain_keywords
    def elliptic(
        cls, E: float, nu: float, Rx: float, Ry: float, E2: float | None = None, nu2: float = 0.0
    ) -> "Hertz":
        """Returns the law of an elliptic contact of two principal radii; see ``elliptic_stiffness``."""
        return cls(stiffness=elliptic_stiffness(E, nu, Rx, Ry, E2, nu2))

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * wp.sqrt(c.delta)


@wp.func
def elliptic_integrals(axis_ratio: Any):
    """Returns K, E, B, D and S of an ellipse; see the module docstring."""
    one = type(axis_ratio)(1.0)
    half = type(axis_ratio)(0.5)
    b = one / axis_ratio
    m = (one - b) * (one + b)
    # c_n²/m², with c_n the half difference of the n-th pair; c₀² = m.
    a = half * (one + b)
    b = wp.sqrt(b)
    weight = one + one
    term = one / (type(axis_ratio)(16.0) * a * a)
    S = weight * term
    for _i in range(6):  # sufficient in float64 for start values as different as 1 and 1e-5
        mean = half * (a + b)
        b = wp.sqrt(a * b)
        a = mean
        weight = weight + weight
        term = term * term * m * m / (type(axis_ratio)(16.0) * a * a)
        S = S + weight * term
    K = half * type(axis_ratio)(wp.pi) / a
    D = half * K * (one + m * S)
    B = half * K * (one - m * S)
    return K, K - m * D, B, D, S


@wp.func
def axis_ratio_of(quotient: Any):
    """Returns the axis ratio k of the contact ellipse for a ratio ``quotient`` ≥ 1 of principal curvatures.

    Solves B k²/D = quotient by Newton's method in ln k, in which the equation is nearly linear: its slope lies
    between 3/2 and 2.
    """
    one = type(quotient)(1.0)
    target = wp.log(quotient)
    log_ratio = type(quotient)(0.6) * target
    for _i in range(5):
        k = wp.exp(log_ratio)
        K, _E, B, D, S = elliptic_integrals(k)
        slope = one + K * S * (one / (k * k * B) + one / D)
        log_ratio = log_ratio - (log_ratio + log_ratio + wp.log(B / D) - target) / slope
        log_ratio = wp.max(log_ratio, type(quotient)(0.0))
    return wp.exp(log_ratio)


@wp.func
def stiffness_per_modulus(curvature_1: Any, curvature_2: Any):
    """Returns K/E* of N = K δ^1.5 [√m] from the relative principal curvatures, curvature_1 ≤ curvature_2 [1/m].

    NaN unless curvature_2 is positive and finite. curvature_1 is limited to curvature_2/LONGEST, as for a line
    contact or a saddle.
    """
    zero = type(curvature_1)(0.0)
    one = type(curvature_1)(1.0)
    min_curvature = curvature_2 / type(curvature_1)(LONGEST)
    low = wp.where(curvature_1 < min_curvature, min_curvature, curvature_1)
    k = axis_ratio_of(wp.max(curvature_2 / low, one))
    K, E, _B, _D, _S = elliptic_integrals(k)
    # δ = K(m) [9/(2 E(m) R) (F/(2 π k E*))²]^(1/3), 1/R the sum of the curvatures.
    size = type(curvature_1)(2.0) * E / (type(curvature_1)(9.0) * (low + curvature_2))
    stiffness = type(curvature_1)(2.0) * type(curvature_1)(wp.pi) * k * wp.sqrt(size) / (K * wp.sqrt(K))
    # A comparison with NaN is false.
    if curvature_2 > zero and one / curvature_2 > zero:
        return stiffness
    return type(curvature_1)(wp.NAN)


class HertzElastic(Law):
    """Elastic contact with a stiffness from the local curvatures instead of a given radius.

    Between shapes and between particles, the curvatures are the principal relative ones at the contact, and the
    contact patch is an ellipse. For a sphere on a mesh it is that of the sphere, because the facets are flat; a
    contact of points without radius raises an error. The ratio of the curvatures is limited to 1e6, which affects
    line contacts and close conformity. Edges and tips are rounded by ``edge_radius``. If that is zero, and for a
    flat face on a flat face, there is no Hertz contact: the force is NaN, and the environment is frozen.

    Damping is that of ``HuntCrossley``: restitution e at the entry speed v₀, at least ``speed_floor``, and a
    constant damping χ. Without either the contact is elastic.
    """

    formula = "N = K(κ₁, κ₂) δ^1.5 (1 + d δ̇/v₀ + χ δ̇),  K of complete elliptic integrals"
    reference = "Hertz, J. reine angew. Math. 92 (1882) 156; Johnson, Contact Mechanics (1985); d: HuntCrossley"
    provenance = "S, D"
    validity = "semi-axes of the patch ≲ 0.1 of the radii, elastic, impact far slower than sound"
    device = ("modulus", "d", "chi", "speed_floor", "edge_radius")
    power = 1.5
    needs_curvature = True

    modulus: float = parameter("Pa", "effective modulus E*", above=0.0)
    restitution: float = parameter("-", "coefficient of restitution e", default=1.0, at_least=0.01, at_most=1.0)
    damping: float = parameter("s/m", "damping χ", default=0.0, at_least=0.0)
    speed_floor: float = parameter("m/s", "least entry speed v₀", default=0.01, above=0.0)
    edge_radius: float = parameter("m", "radius of edges and tips", default=0.0, at_least=0.0)

    @classmethod
    def from_materials(
        cls, E: float, nu: float, E2: float | None = None, nu2: float = 0.0, **others: float
    ) -> "HertzElastic":
        """Returns the law for two materials: 1/E* = (1 − ν²)/E + (1 − ν₂²)/E₂.

        Args:
            E: Young's modulus of the first body [Pa].
            nu: Its Poisson's ratio [-].
            E2: Young's modulus of the second body [Pa]; ``None``: rigid.
            nu2: Its Poisson's ratio [-].
            others: Further parameters, such as ``restitution``.

        Raises:
            ValueError: If a value is out of range.
        """
        losses = [field.name for field in dataclasses.fields(cls) if field.name != "modulus"]
        refuse_unknown(f"{cls.__name__}.from_materials", others, [*keywords_of(cls.from_materials), *losses])
        # For a sphere of radius 1 m: K = (4/3) E*.
        return cls(modulus=0.75 * hertz_stiffness(E, nu, 1.0, E2, nu2), **others)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            "modulus": values["modulus"],
            "d": damping_factor_of_restitution(values["restitution"]),
            "chi": values["damping"],
            "speed_floor": values["speed_floor"],
            "edge_radius": values["edge_radius"],
        }

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        sharpest = one / p.edge_radius  # infinite for sharp edges
        stiffness = p.modulus * stiffness_per_modulus(
            wp.min(c.curvature_1, sharpest), wp.min(c.curvature_2, sharpest)
        )
        chi = p.d / wp.max(c.entry_speed, p.speed_floor) + p.chi
        return stiffness * c.delta * wp.sqrt(c.delta) * (one + chi * c.delta_dot)
