"""Bristle models: the deflection of elastic bristles gives presliding and hysteresis."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import history, parameter
from warpcontact.kernels.friction.base import Friction


@wp.func
def advance_deflection(deflection: Any, s: Any, elapsed: Any, rate: Any):
    """Returns z after integrating dz/dt = v − rate·z at constant v, exactly, for any stiffness of the bristles."""
    one = type(s.speed)(1.0)
    x = rate * elapsed
    decay = wp.exp(-x)
    # (1 − e⁻ˣ)/x; by its series where the difference would lose digits.
    mean = one - x * (one / type(s.speed)(2.0) - x / type(s.speed)(6.0))
    if x > type(s.speed)(1.0e-2):
        mean = (one - decay) / x
    return decay * deflection + (elapsed * mean) * s.velocity


@wp.func
def relaxation(p: Any, s: Any):
    """Returns σ₀ s/g, the relaxation rate of the bristles [1/s]."""
    x = s.speed / p.stribeck_speed
    return p.stiffness * s.speed / (p.mu_dynamic + (p.mu_static - p.mu_dynamic) * wp.exp(-x * x))


class LuGre(Friction):
    """Bristles of deflection z: presliding like a spring, hysteresis, stick–slip, Stribeck effect.

    σ₀ and σ₁ refer to a coefficient of friction, so that z is independent of N. σ₁ decreases with speed if
    ``damping_speed`` is given, which keeps the model passive. The bristle force is clipped at the larger of μ_s N
    and μ_d N, because at the first touch of a fast contact the term with σ₁ would far exceed it. μ_d above μ_s is
    allowed: friction then increases with speed.
    """

    formula = (
        "F = −N (σ₀ z + σ₁(s) dz/dt) − σ₂ v,  dz/dt = v − σ₀ s z/g,  g = μ_d + (μ_s − μ_d) exp(−(s/v_s)²),  "
        "σ₁(s) = σ₁ exp(−(s/v_d)²), or σ₁ without v_d"
    )
    reference = "Canudas de Wit, Olsson, Åström & Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419"
    validity = (
        "stiction with a small drift under a swinging force; its springs take in energy with a growing load; "
        "explicit steps need dt < 2/√(σ₀ N/m)"
    )
    provenance = "S, R"
    device = (
        "mu_static", "mu_dynamic", "stribeck_speed", "stiffness", "damping", "inverse_damping_speed", "viscosity",
    )  # fmt: skip

    mu_static: float = parameter("-", "coefficient of static friction μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "coefficient of dynamic friction μ_d", above=0.0)
    stribeck_speed: float = parameter("m/s", "Stribeck speed v_s", above=0.0)
    stiffness: float = parameter("1/m", "stiffness σ₀ of the bristles", above=0.0)
    damping: float = parameter("s/m", "damping σ₁ of the bristles", default=0.0, at_least=0.0)
    damping_speed: float | None = parameter(
        "m/s", "speed v_d at which σ₁ has fallen to σ₁/e: σ₁ exp(−(s/v_d)²)", default=None, above=0.0
    )
    viscosity: float = parameter("N·s/m", "viscous friction σ₂", default=0.0, at_least=0.0)

    deflection = history("m", "deflection z of the bristles", tangent=True)

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        constant = np.zeros_like(values["stiffness"])
        inverse = 1.0 / values["damping_speed"] if "damping_speed" in values else constant
        return values | {"inverse_damping_speed": inverse}

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        m.deflection = advance_deflection(m.deflection, s, m.elapsed, relaxation(p, s))
        return m

    @wp.func
    def force(p: Any, s: Any, m: Any):
        x = s.speed * p.inverse_damping_speed
        damping = p.damping * wp.exp(-x * x)
        pull = p.stiffness * m.deflection + damping * (s.velocity - relaxation(p, s) * m.deflection)
        size = wp.length(pull)
        largest_mu = wp.max(p.mu_static, p.mu_dynamic)
        if size > largest_mu:
            pull = (largest_mu / size) * pull
        return -s.normal_force * pull - p.viscosity * s.velocity


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
