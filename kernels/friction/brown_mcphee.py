"""Smooth friction with one transition speed, by Brown and McPhee."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.friction.saturation import fast_tanh


class BrownMcPhee(Friction):
    """Static peak, dynamic level and viscous part in one smooth curve with one transition speed.

    μ_d above μ_s is allowed: friction then increases with speed.
    """

    formula = "F = −{N [μ_d tanh(4r) + (μ_s − μ_d) r/(r²/4 + 3/4)²] + μ_v s tanh(4N/N_t)} v/s,  r = s/v_t"
    reference = "Brown & McPhee, J. Comput. Nonlinear Dyn. 11 (2016) 054502"
    provenance = "S"
    validity = "no stiction: creeps; peak at v_t to 7e-4 μ_d; 1 % above μ_d at 10 v_t"

    mu_static: float = parameter("-", "static coefficient μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "dynamic coefficient μ_d", at_least=0.0)
    transition_speed: float = parameter("m/s", "transition speed v_t of the peak", default=1.0e-2, above=0.0)
    viscosity: float = parameter("N·s/m", "viscous coefficient μ_v", default=0.0, at_least=0.0)
    transition_force: float = parameter("N", "normal force N_t of full viscous friction", default=1.0, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        four = type(s.speed)(4.0)
        quarter = type(s.speed)(0.25)
        r = s.speed / p.transition_speed
        bell = quarter * r * r + type(s.speed)(0.75)
        # Both terms divided by s: tanh(4r)/s → 4/v_t at rest.
        level = four / p.transition_speed
        if four * r > type(s.speed)(1.0e-3):
            level = fast_tanh(four * r) / s.speed
        peak = type(s.speed)(1.0) / (p.transition_speed * bell * bell)
        gain = s.normal_force * (p.mu_dynamic * level + (p.mu_static - p.mu_dynamic) * peak)
        viscous = p.viscosity * fast_tanh(four * s.normal_force / p.transition_force)
        return (-(gain + viscous)) * s.velocity
