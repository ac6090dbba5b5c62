"""Johnson's contact of parallel cylinders."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law


class JohnsonCylinder(Law):
    """Elastic contact of parallel cylinders along a length: a pin in a hole, or two cylinders side by side.

    The published formula gives δ of F. It is inverted with the real Lambert branch W₋₁, by Newton's method. Beyond
    δ = 4 e⁻² ΔR the formula has no solution, and the force is continued in proportion to δ.
    """

    formula = "δ = F/(π E* L) [ln(4 π E* L ΔR/F) − 1],  i.e. F = −π E* L δ/W₋₁(−e δ/(4 ΔR))"
    reference = "Johnson, Contact Mechanics (1985)"
    provenance = "S, D"
    validity = "δ < 0.541 ΔR; ΔR = R_hole − R_pin, or R₁ + R₂ outside"

    modulus: float = parameter("Pa", "effective modulus E*", above=0.0)
    length: float = parameter("m", "length L", above=0.0)
    clearance: float = parameter("m", "difference or sum of radii ΔR", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        # w eʷ = −x with x = e δ/(4 ΔR) < 1/e and w < −1, as w + ln(−w) = ln x. ln x = −1 is the turning point.
        log = one + wp.log(c.delta / (type(c.delta)(4.0) * p.clearance))
        w = -one
        if log < -one:
            # Near the turning point w ≈ −1 − √(2(−1 − ln x)), far from it w ≈ ln x − ln(−ln x). The smaller start
            # value is safe.
            w = wp.min(-one - wp.sqrt(type(c.delta)(2.0) * (-one - log)), log - wp.log(-log))
            for _i in range(6):
                w = w - (w + wp.log(-w) - log) / (one + one / w)
        return -type(c.delta)(wp.pi) * p.modulus * p.length * c.delta / w
