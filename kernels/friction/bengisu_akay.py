"""Static and dynamic friction in one curve, by Bengisu and Akay."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


class BengisuAkay(Friction):
    """Friction that increases along a parabola to the static coefficient and decays to the dynamic one.

    μ_d above μ_s is allowed: friction then increases with speed.
    """

    formula = "F = −μ(s) N v/s;  μ = μ_s [1 − (s − s₀)²/s₀²] below s₀, then μ_d + (μ_s − μ_d) exp[−η (s − s₀)]"
    reference = "Bengisu & Akay, J. Sound Vib. 171 (1994) 557; recalled"
    provenance = "R"
    validity = "no stiction: creeps; kink of the slope at s₀"

    mu_static: float = parameter("-", "static coefficient μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "dynamic coefficient μ_d", at_least=0.0)
    velocity_scale: float = parameter("m/s", "slip speed s₀ of the peak", default=1.0e-2, above=0.0)
    decay: float = parameter("s/m", "rate η of the decay", default=100.0, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        # μ_s [1 − (s − s₀)²/s₀²]/s = μ_s (2 s₀ − s)/s₀²
        gain = (
            p.mu_static * (p.velocity_scale + p.velocity_scale - s.speed) / (p.velocity_scale * p.velocity_scale)
        )
        if s.speed > p.velocity_scale:
            fall = wp.exp(-p.decay * (s.speed - p.velocity_scale))
            gain = (p.mu_dynamic + (p.mu_static - p.mu_dynamic) * fall) / s.speed
        return (-gain * s.normal_force) * s.velocity
