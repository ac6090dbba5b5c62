"""Power-law spring with damping that is switched on over a depth."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, power


class Impact(Law):
    """IMPACT function of multibody codes: damping increases from zero at touch to its full value at a depth."""

    formula = "N = max(0, K δⁿ + c S(δ/δ_c) δ̇),  S(x) = x²(3 − 2x), 1 for x ≥ 1"
    reference = "IMPACT of MSC Adams and Altair MotionSolve (manuals)"
    provenance = "S"
    validity = "no relation to a restitution: calibrate; continuous at touch"

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)
    damping: float = parameter("N·s/m", "full damping c", at_least=0.0)
    depth: float = parameter("m", "depth δ_c of full damping", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        x = wp.min(c.delta / p.depth, type(c.delta)(1.0))
        switch = x * x * (type(c.delta)(3.0) - type(c.delta)(2.0) * x)
        return p.stiffness * power(c.delta, p.exponent) + p.damping * switch * c.delta_dot
