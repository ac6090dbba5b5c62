"""Coulomb friction that vanishes below a slip speed."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


class CoulombThreshold(Friction):
    """Full Coulomb friction above a slip speed, none below: no stiction, and a jump at the threshold."""

    formula = "F = −μ N v/s for s > s₀, else 0"
    reference = "sign law with a threshold, as in Project Chrono"
    provenance = "S"
    validity = "sliding; chatters about the threshold when it should stop"

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)
    threshold: float = parameter("m/s", "slip speed s₀", default=1.0e-3, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        gain = type(s.speed)(0.0)
        if s.speed > p.threshold:
            gain = -p.mu * s.normal_force / s.speed
        return gain * s.velocity
