"""Linear spring."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law


class Hooke(Law):
    """Linear elastic contact without damping; also a penalty stiffness."""

    formula = "N = K δ"
    reference = "elementary"
    provenance = "R"
    validity = "any stiffness"
    power = 1.0

    stiffness: float = parameter("N/m", "stiffness K", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta
