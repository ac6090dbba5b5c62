"""Hertz contact of two elastic bodies with smooth surfaces."""

import math
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.catalogue.roots import root_between
from warpcontact.kernels.laws.base import Law


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
