"""Smooth friction of Simbody, by Hollars."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


class Hollars(Friction):
    """Friction that reaches exactly the static coefficient at a transition speed and decreases to the dynamic one.

    μ_d above μ_s is allowed, up to 2 μ_s: friction then increases with speed. Beyond, the force at slow slip would
    have the direction of the slip.
    """

    formula = "F = −{N min(r, 1) [μ_d + 2 (μ_s − μ_d)/(1 + r²)] + b s} v/s,  r = s/v_t"
    reference = "Hollars, as in Simbody's HuntCrossleyForce"
    provenance = "S"
    validity = "no stiction: creeps; kink of the slope at v_t"

    mu_static: float = parameter("-", "static coefficient μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "dynamic coefficient μ_d", at_least=0.0)
    transition_speed: float = parameter("m/s", "transition speed v_t of the peak", default=1.0e-2, above=0.0)
    viscosity: float = parameter("N·s/m", "viscous coefficient b", default=0.0, at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        one = type(s.speed)(1.0)
        r = s.speed / p.transition_speed
        excess = p.mu_static - p.mu_dynamic
        mu = p.mu_dynamic + (excess + excess) / (one + r * r)
        return (-(s.normal_force * mu / wp.max(s.speed, p.transition_speed) + p.viscosity)) * s.velocity
