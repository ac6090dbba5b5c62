"""Viscoelastic Hertz contact."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.catalogue.roots import root_between
from warpcontact.kernels.laws.base import Law

# Padé approximant of Müller & Pöschel: e as a quotient of polynomials of v* = β^(1/2) v₀^(1/10), lowest order
# first.
NUMERATOR = (1.0, 1.07232, 0.574198, 0.141552)
DENOMINATOR = (1.0, 1.07232, 1.72765, 1.37842, 1.19449, 0.467273, 0.235585)


def restitution_of_viscosity(reduced: np.ndarray) -> np.ndarray:
    """Returns the restitution of a clamped impact from A* = A (K/m)^(2/5) v₀^(1/5) to 7e-4, for e ≥ 0.05."""
    # β v₀^(1/5) = (3/2) A (K/m)^(2/5) v₀^(1/5)
    v = np.sqrt(1.5 * np.asarray(reduced, dtype=np.float64))
    return np.polynomial.polynomial.polyval(v, NUMERATOR) / np.polynomial.polynomial.polyval(v, DENOMINATOR)


class KuwabaraKono(Law):
    """Hertz contact of viscoelastic bodies: restitution decreases with speed as measured, 1 − e ∝ v₀^(1/5).

    A is a material property; ``from_restitution`` determines it from one measured impact. In some texts the factor
    3/2 is part of A.
    """

    formula = "N = max(0, K (δ^1.5 + (3/2) A √δ δ̇))"
    reference = (
        "Kuwabara & Kono, Jpn. J. Appl. Phys. 26 (1987) 1230; Brilliantov et al., Phys. Rev. E 53 (1996) 5382; "
        "e of A: Müller & Pöschel, Phys. Rev. E 84 (2011) 021302"
    )
    provenance = "S"
    validity = "as Hertz, with viscous loss small in the bulk"
    power = 1.5

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)
    viscosity: float = parameter("s", "dissipative constant A", at_least=0.0)

    @classmethod
    @explain_keywords
    def from_restitution(
        cls, *, stiffness: float, restitution: float, speed: float, mass: float
    ) -> "KuwabaraKono":
        """Returns the law that has ``restitution`` at ``speed`` [m/s] for the effective ``mass`` [kg]."""
        restitution = number("restitution", restitution, at_least=0.05, at_most=1.0)
        speed, mass = number("speed", speed, above=0.0), number("mass", mass, above=0.0)
        stiffness = number("stiffness", stiffness, above=0.0)
        reduced = root_between(
            "viscosity", lambda reduced: restitution_of_viscosity(reduced) - restitution, 0.0, 10.0
        )
        viscosity = float(reduced) / ((stiffness / mass) ** 0.4 * speed**0.2)
        return cls(stiffness=stiffness, viscosity=viscosity)

    @wp.func
    def force(p: Any, c: Any):
        root = wp.sqrt(c.delta)
        return p.stiffness * root * (c.delta + type(c.delta)(1.5) * p.viscosity * c.delta_dot)
