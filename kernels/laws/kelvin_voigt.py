"""Linear spring and dashpot, clipped at zero."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, stepped_dashpot
from warpcontact.kernels.laws.clamped_dashpot import damping_ratio_of_restitution


class KelvinVoigt(Law):
    """Linear spring and dashpot in parallel; the force is clipped at zero, so there is no tension.

    With ``restitution`` the dashpot is c = 2ξ√(K m), where m is the effective mass of the contact and ξ the
    damping ratio whose clamped impact has exactly that restitution. With ``damping`` it is the constant c. The
    force jumps to c δ̇ at first touch. For a step the dashpot is slightly reduced, so that the damping ratio of
    the discrete motion is ξ to second order in dt.
    """

    formula = "N = max(0, K δ + c δ̇),  c = 2 ξ(e) √(K m)"
    reference = "Schwager & Pöschel, Granular Matter 9 (2007) 465"
    provenance = "S, D"
    validity = "one impact point per body: the effective mass is that of the point alone"
    power = 1.0
    exactly_one_of = ("restitution", "damping")
    device = ("stiffness", "damping", "ratio")
    needs_mass = True

    stiffness: float = parameter("N/m", "stiffness K", above=0.0)
    restitution: float | None = parameter(
        "-", "coefficient of restitution e", default=None, at_least=0.01, at_most=1.0
    )
    damping: float | None = parameter("N·s/m", "damping c", default=None, at_least=0.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        zero = np.zeros_like(values["stiffness"])
        ratio = damping_ratio_of_restitution(values["restitution"]) if "restitution" in values else zero
        return {"stiffness": values["stiffness"], "damping": values.get("damping", zero), "ratio": ratio}

    @wp.func
    def force(p: Any, c: Any):
        dashpot = p.damping + type(c.delta)(2.0) * p.ratio * wp.sqrt(p.stiffness * c.mass)
        return p.stiffness * c.delta + stepped_dashpot(dashpot, c.inverse_mass, c.dt) * c.delta_dot
