"""Power-law spring."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, power


class PowerLaw(Law):
    """Elastic contact with a force proportional to a power of the penetration, without damping."""

    formula = "N = K δⁿ"
    reference = "elementary"
    provenance = "R"
    validity = "n = 1 flat punch or layer, 3/2 smooth point contact, 2 cone or foundation under a sphere"

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * power(c.delta, p.exponent)
