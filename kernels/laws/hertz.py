"""Hertz contact of two smooth elastic bodies."""

import math
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.formula import check_values, parameter
from warpcontact.kernels.laws.base import Law


def hertz_stiffness(
    E: float, nu: float, R: float, E2: float | None = None, nu2: float = 0.0, R2: float = math.inf
) -> float:
    """Stiffness K = (4/3) E* √R* of two spheres in Hertz contact.

    Args:
        E: Young's modulus of the first body [Pa].
        nu: Its Poisson's ratio [-].
        R: Its radius [m].
        E2: Young's modulus of the second body [Pa]; ``None``: rigid.
        nu2: Its Poisson's ratio [-].
        R2: Its radius [m]; infinite for a plane, negative for a hollow that the first fits in.

    Returns:
        K [N/m^1.5].

    Raises:
        ValueError: If a value is out of range, or the hollow is smaller than the sphere.
    """
    positive = {"unit": "-", "above": 0.0, "at_least": -math.inf, "at_most": math.inf}
    poisson = {"unit": "-", "above": -1.0, "at_least": -math.inf, "at_most": 0.5}
    check_values("E", np.asarray(E, dtype=np.float64), positive)
    check_values("R", np.asarray(R, dtype=np.float64), positive)
    check_values("nu", np.asarray(nu, dtype=np.float64), poisson)
    check_values("nu2", np.asarray(nu2, dtype=np.float64), poisson)
    compliance = (1.0 - nu**2) / E
    if E2 is not None:
        check_values("E2", np.asarray(E2, dtype=np.float64), positive)
        compliance += (1.0 - nu2**2) / E2
    if math.isnan(R2) or R2 == 0.0 or -R <= R2 < 0.0:
        raise ValueError(f"R2 must be positive, infinite or less than -R = {-R:g} m (a hollow), got {R2:g} m")
    curvature = 1.0 / R + 1.0 / R2
    return 4.0 / 3.0 / compliance / math.sqrt(curvature)


class Hertz(Law):
    """Elastic contact of smooth bodies: a sphere on a plane, or two spheres.

    The facets of the mesh are flat, so the radius is that of the sphere or one given by hand, never a facet's.
    """

    formula = "N = K δ^1.5,  K = (4/3) E* √R"
    reference = "Hertz, J. reine angew. Math. 92 (1882) 156; Johnson, Contact Mechanics (1985)"
    validity = "contact radius √(Rδ) ≲ 0.1 R, elastic, impact far slower than sound"

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)

    @classmethod
    def from_materials(
        cls,
        E: float,
        nu: float,
        R: float,
        E2: float | None = None,
        nu2: float = 0.0,
        R2: float = math.inf,
    ) -> "Hertz":
        """Returns the law for materials and radii; see ``hertz_stiffness``. Without ``E2`` the second is rigid."""
        return cls(stiffness=hertz_stiffness(E, nu, R, E2, nu2, R2))

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * wp.sqrt(c.delta)
