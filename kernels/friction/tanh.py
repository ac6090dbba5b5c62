"""Coulomb friction smoothed by a hyperbolic tangent."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.friction.saturation import fast_tanh


class Tanh(Friction):
    """Coulomb friction smoothed by a hyperbolic tangent; creeps under any tangential load.

    On a slope θ < arctan μ it creeps at v_s artanh(tan θ/μ). Explicit steps need dt < 2 m v_s/(μ N).
    """

    formula = "F = −μ N tanh(s/v_s) v/s"
    reference = "Simcenter STAR-CCM+ manual, body couplings"
    provenance = "S"
    validity = "no stiction; 95 % of μ at 1.83 v_s, 99 % at 2.65 v_s"

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)
    velocity_scale: float = parameter("m/s", "velocity scale v_s = 1/k_t", default=1.0e-2, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        # tanh(x)/s → 1/v_s at rest.
        gain = type(s.speed)(1.0) / p.velocity_scale
        x = s.speed * gain
        if x > type(s.speed)(1.0e-3):
            gain = fast_tanh(x) / s.speed
        return (-p.mu * s.normal_force * gain) * s.velocity
