"""No friction."""

from typing import Any

import warp as wp
from warpcontact.kernels.friction.base import Friction


class Frictionless(Friction):
    """No tangential force."""

    formula = "F = 0"
    reference = "elementary"
    provenance = "R"
    validity = "always dissipation free"

    @wp.func
    def force(p: Any, s: Any):
        return type(s.velocity)()
