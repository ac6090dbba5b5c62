"""Hertz spring with damping on approach only."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law


class Jankowski(Law):
    """Hertz spring with a dashpot that acts on approach only, for pounding of structures."""

    formula = "N = K δ^1.5 + 2 ξ √(m K √δ) max(δ̇, 0),  ξ = (9√5/2)(1−e²)/{e[e(9π−16)+16]}"
    reference = "Jankowski, EESD 34 (2005) 595; 35 (2006) 517"
    provenance = "S"
    validity = "returns e within 0.0086; one impact point per body"
    power = 1.5
    device = ("stiffness", "ratio")
    needs_mass = True

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        e = values["restitution"]
        ratio = 4.5 * np.sqrt(5.0) * (1.0 - e**2) / (e * (e * (9.0 * np.pi - 16.0) + 16.0))
        return {"stiffness": values["stiffness"], "ratio": ratio}

    @wp.func
    def force(p: Any, c: Any):
        root = wp.sqrt(c.delta)
        dashpot = type(c.delta)(2.0) * p.ratio * wp.sqrt(c.mass * p.stiffness * root)
        return p.stiffness * c.delta * root + dashpot * wp.max(c.delta_dot, type(c.delta)(0.0))
