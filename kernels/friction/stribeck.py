"""Stribeck curve smoothed by a hyperbolic tangent."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.friction.saturation import fast_tanh


class Stribeck(Friction):
    """Static friction that decays with slip speed to the dynamic one, smooth through zero; plus viscous friction.

    μ_d above μ_s is allowed: friction then increases with speed.
    """

    formula = "F = −{N [μ_d + (μ_s − μ_d) exp(−(s/v_S)^p)] tanh(s/v_s) + b s} v/s"
    reference = "Andersson, Söderberg & Björklund, Tribol. Int. 40 (2007) 580"
    provenance = "S"
    validity = "no stiction: creeps; the peak is a little below μ_s"

    mu_static: float = parameter("-", "static coefficient μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "dynamic coefficient μ_d", at_least=0.0)
    stribeck_speed: float = parameter("m/s", "Stribeck speed v_S", default=0.1, above=0.0)
    exponent: float = parameter("-", "exponent p", default=2.0, at_least=0.5, at_most=4.0)
    velocity_scale: float = parameter("m/s", "velocity scale v_s", default=1.0e-2, above=0.0)
    viscosity: float = parameter("N·s/m", "viscous coefficient b", default=0.0, at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        fall = wp.exp(-wp.pow(s.speed / p.stribeck_speed, p.exponent))
        mu = p.mu_dynamic + (p.mu_static - p.mu_dynamic) * fall
        gain = type(s.speed)(1.0) / p.velocity_scale
        x = s.speed * gain
        if x > type(s.speed)(1.0e-3):
            gain = fast_tanh(x) / s.speed
        return (-(s.normal_force * mu * gain + p.viscosity)) * s.velocity
