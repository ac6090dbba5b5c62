"""Infinitely differentiable Stribeck friction, as in Simscape."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.friction.saturation import fast_tanh


class SmoothStribeck(Friction):
    """Breakaway and Coulomb friction in one smooth curve: a bell plus a hyperbolic tangent.

    μ_d above μ_s is allowed: friction then increases with speed.
    """

    formula = (
        "F = −N [√(2e) (μ_s − μ_d) exp(−(s/s_St)²) s/s_St + μ_d tanh(s/s_C)] v/s,  s_St = √2 s_b, s_C = s_b/10"
    )
    reference = "MathWorks Simscape manual, translational friction"
    provenance = "S"
    validity = "no stiction: creeps; μ_s at the breakaway speed s_b, slope at rest about 10 μ_d/s_b"

    mu_static: float = parameter("-", "static coefficient μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "dynamic coefficient μ_d", at_least=0.0)
    breakaway_speed: float = parameter("m/s", "breakaway speed s_b", default=1.0e-2, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        stribeck = type(s.speed)(1.4142135623730951) * p.breakaway_speed
        x = s.speed / stribeck
        # √(2e)
        bell = type(s.speed)(2.3316439815971242) * (p.mu_static - p.mu_dynamic) * wp.exp(-x * x) / stribeck
        level = type(s.speed)(10.0) / p.breakaway_speed
        y = s.speed * level
        if y > type(s.speed)(1.0e-3):
            level = fast_tanh(y) / s.speed
        return (-s.normal_force * (bell + p.mu_dynamic * level)) * s.velocity
