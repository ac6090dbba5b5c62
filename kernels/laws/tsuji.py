"""Mass-proportional nonlinear dashpot."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, power
from warpcontact.kernels.laws.clamped_dashpot import damping_ratio_of_restitution


class Tsuji(Law):
    """Power-law spring and a dashpot of power (n−1)/2: restitution without a history of the entry speed.

    In the variable δ^((n+1)/2) the impact is that of a linear oscillator of damping ratio ξ, so the clamped impact
    returns e exactly with the ξ of ``KelvinVoigt``. Tsuji's α is √5 ξ for n = 3/2.
    """

    formula = "N = max(0, K δⁿ + ξ √(2(n+1) m K) δ^((n−1)/2) δ̇)"
    reference = (
        "Tsuji, Tanaka & Ishida, Powder Technol. 71 (1992) 239; Antypov & Elliott, EPL 94 (2011) 50004; clamped: "
        "Schwager & Pöschel, Granular Matter 9 (2007) 465"
    )
    provenance = "S, D"
    validity = "one impact point per body: the effective mass is that of the point alone"
    exactly_one_of = ("restitution", "ratio")
    device = ("stiffness", "exponent", "ratio")
    needs_mass = True

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)
    restitution: float | None = parameter(
        "-", "coefficient of restitution e", default=None, at_least=0.01, at_most=1.0
    )
    ratio: float | None = parameter("-", "damping ratio ξ", default=None, at_least=0.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        ratio = damping_ratio_of_restitution(values["restitution"]) if "restitution" in values else values["ratio"]
        return {"stiffness": values["stiffness"], "exponent": values["exponent"], "ratio": ratio}

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        scale = wp.sqrt(type(c.delta)(2.0) * (p.exponent + one) * c.mass * p.stiffness)
        # δ^((n−1)/2) = √(δⁿ/δ)
        elastic = power(c.delta, p.exponent)
        dashpot = p.ratio * scale * wp.sqrt(elastic / c.delta)
        return p.stiffness * elastic + dashpot * c.delta_dot
