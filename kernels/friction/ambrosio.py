"""Coulomb friction that sets in over a range of slip speeds, by Ambrósio."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


class Ambrosio(Friction):
    """Coulomb friction scaled by a ramp between two slip speeds; no force below the first."""

    formula = "F = −μ N c v/s,  c = 0 below s₀, (s − s₀)/(s₁ − s₀) below s₁, then 1"
    reference = "Ambrósio, in Virtual Nonlinear Multibody Systems (2003); recalled"
    provenance = "R"
    validity = "sliding; no force at all below s₀"

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)
    speed_first: float = parameter("m/s", "slip speed s₀ below which nothing acts", default=1.0e-3, above=0.0)
    speed_full: float = parameter("m/s", "slip speed s₁ of full friction; above s₀", default=1.0e-2, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        gain = type(s.speed)(0.0)
        if s.speed > p.speed_first:
            ramp = (s.speed - p.speed_first) / (p.speed_full - p.speed_first)
            gain = wp.min(ramp, type(s.speed)(1.0)) / s.speed
        return (-p.mu * s.normal_force * gain) * s.velocity
