"""Dahl friction: presliding hysteresis without stiction."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import history, parameter
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.friction.lugre import advance_deflection


class Dahl(Friction):
    """Bristles whose stiffness decreases to zero as the force approaches μ N: Dahl's law with exponent 1."""

    formula = "F = −N σ₀ z, dz/dt = v − σ₀ s z/μ; in one direction dF/dx = σ₀ N (1 − F/(μ N))"
    reference = "Dahl, Aerospace Corp. TOR-0158 (1968); MotionSolve manual"
    validity = (
        "hysteresis about rest; drifts under a swinging force; its springs take in energy with a growing load; "
        "explicit steps need dt < 2/√(σ₀ N/m)"
    )
    provenance = "R"

    mu: float = parameter("-", "coefficient of friction μ", above=0.0)
    stiffness: float = parameter("1/m", "stiffness σ₀ at rest over N", above=0.0)

    deflection = history("m", "deflection z of the bristles", tangent=True)

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        m.deflection = advance_deflection(m.deflection, s, m.elapsed, p.stiffness * s.speed / p.mu)
        return m

    @wp.func
    def force(p: Any, s: Any, m: Any):
        pull = p.stiffness * m.deflection
        if wp.length(pull) > p.mu:
            pull = (p.mu / wp.length(pull)) * pull
        return -s.normal_force * pull
