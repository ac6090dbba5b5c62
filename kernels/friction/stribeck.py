"""Friction with a static peak at a slip speed and a dynamic level above (Stribeck effect), smooth through zero slip.

None of the models can hold a load: they creep.
"""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction, fast_tanh


class StepFriction(Friction):
    """Friction that increases to the static coefficient and decreases to the dynamic one along cubics.

    μ_d above μ_s is allowed: friction then increases with speed.
    """

    formula = (
        "F = −μ(s) N v/s;  μ = μ_s (3x − x³)/2, x = s/s_s, below s_s; "
        "μ_s + (μ_d − μ_s) y²(3 − 2y), y = (s − s_s)/(s_d − s_s), below s_d; then μ_d"
    )
    reference = "friction of MSC Adams, NX and MotionSolve (manuals); cubic through zero recalled"
    provenance = "S, R"
    validity = "no stiction: creeps; slope at rest 1.5 μ_s/s_s"

    mu_static: float = parameter("-", "static coefficient μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "dynamic coefficient μ_d", at_least=0.0)
    speed_static: float = parameter("m/s", "slip speed s_s of the static coefficient", default=1.0e-2, above=0.0)
    speed_dynamic: float = parameter(
        "m/s", "slip speed s_d of the dynamic coefficient; above s_s", default=2.0e-2, above=0.0
    )

    @wp.func
    def force(p: Any, s: Any):
        one = type(s.speed)(1.0)
        half = type(s.speed)(0.5)
        gain = p.mu_dynamic / wp.max(s.speed, p.speed_static)
        if s.speed < p.speed_static:
            x = s.speed / p.speed_static
            gain = p.mu_static * half * (type(s.speed)(3.0) - x * x) / p.speed_static
        elif s.speed < p.speed_dynamic:
            y = (s.speed - p.speed_static) / (p.speed_dynamic - p.speed_static)
            step = y * y * (type(s.speed)(3.0) - y - y)
            gain = (p.mu_static + (p.mu_dynamic - p.mu_static) * step) / s.speed
        return (-one * gain * s.normal_force) * s.velocity


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
