"""Coulomb friction with an exponential rise, by Threlfall."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


class Threlfall(Friction):
    """Coulomb friction that increases exponentially to 95 % at a slip speed and is constant beyond."""

    formula = "F = −μ N min(1 − exp(−3 s/s_r), 0.95) v/s"
    reference = "Threlfall, Mech. Mach. Theory 13 (1978) 475; recalled"
    provenance = "R"
    validity = "never reaches μ: 5 % low; no stiction"

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)
    velocity_scale: float = parameter("m/s", "slip speed s_r", default=1.0e-2, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        x = type(s.speed)(3.0) * s.speed / p.velocity_scale
        # (1 − exp(−x))/s → (1 − x/2) 3/s_r at rest.
        gain = type(s.speed)(3.0) / p.velocity_scale * (type(s.speed)(1.0) - type(s.speed)(0.5) * x)
        if x > type(s.speed)(1.0e-3):
            gain = wp.min(type(s.speed)(1.0) - wp.exp(-x), type(s.speed)(0.95)) / s.speed
        return (-p.mu * s.normal_force * gain) * s.velocity
