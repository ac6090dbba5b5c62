"""Linear spring and dashpot with tension before release."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, stepped_dashpot


def damping_ratio_of_oscillator(restitution: np.ndarray) -> np.ndarray:
    """Returns ξ = −ln e/√(π² + ln² e), for which an oscillator keeps e of its speed per half period."""
    log = np.log(restitution)
    return -log / np.sqrt(np.pi**2 + log**2)


class Anagnostopoulos(Law):
    """Linear spring and dashpot in parallel; the contact ends at zero penetration, with tension before.

    ``KelvinVoigt`` has no tension.
    """

    formula = "N = K δ + 2 ξ √(K m) δ̇,  ξ = −ln e/√(π² + ln² e)"
    reference = "Anagnostopoulos, EESD 16 (1988) 443; 33 (2004) 897"
    provenance = "S"
    validity = "returns e exactly, with attraction before release"
    power = 1.0
    device = ("stiffness", "ratio")
    needs_mass = True
    pulls = True

    stiffness: float = parameter("N/m", "stiffness K", above=0.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            "stiffness": values["stiffness"],
            "ratio": damping_ratio_of_oscillator(values["restitution"]),
        }

    @wp.func
    def force(p: Any, c: Any):
        dashpot = type(c.delta)(2.0) * p.ratio * wp.sqrt(p.stiffness * c.mass)
        return p.stiffness * c.delta + stepped_dashpot(dashpot, c.inverse_mass, c.dt) * c.delta_dot
