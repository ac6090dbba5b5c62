"""Friction without a static peak: Coulomb, its regularizations, elliptic (anisotropic) and viscous friction."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction, fast_tanh


class Coulomb(Friction):
    """Friction cone without regularization: a sticking contact does not creep. For nonsmooth contact.

    As rolling or torsion of a material it bounds the torque in the same way.
    """

    formula = "|F| ≤ μ N; where it slips, F = −μ N v/s"
    reference = "Coulomb"
    provenance = "S"
    validity = "nonsmooth contact; it has no force of its own"
    rigid = True

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return type(s.speed)(0.0) * s.velocity


class RegularizedCoulomb(Friction):
    """Coulomb friction with a linear ramp below a slip speed; exactly μN above it.

    On a slope θ < arctan μ it creeps at s_d tan θ/μ. Explicit steps need dt < 2 m s_d/(μ N).
    """

    formula = "F = −μ N min(s/s_d, 1) v/s"
    reference = "ramp of slip speed, as in Exudyn and other multibody codes"
    provenance = "S"
    validity = "no stiction"

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)
    velocity_scale: float = parameter("m/s", "slip speed s_d at which sliding is full", default=1.0e-2, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return (-p.mu * s.normal_force / wp.max(s.speed, p.velocity_scale)) * s.velocity


class CoulombThreshold(Friction):
    """Full Coulomb friction above a slip speed, none below: no stiction, and a jump at the threshold."""

    formula = "F = −μ N v/s for s > s₀, else 0"
    reference = "sign law with a threshold, as in Project Chrono"
    provenance = "S"
    validity = "sliding; chatters about the threshold when it should stop"

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)
    threshold: float = parameter("m/s", "slip speed s₀", default=1.0e-3, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        gain = type(s.speed)(0.0)
        if s.speed > p.threshold:
            gain = -p.mu * s.normal_force / s.speed
        return gain * s.velocity


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


class Ambrosio(Friction):
    """Coulomb friction scaled by a ramp between two slip speeds; no force below the first."""

    formula = "F = −μ N c v/s,  c = 0 below s₀, (s − s₀)/(s₁ − s₀) below s₁, then 1"
    reference = "Ambrósio, in Virtual Nonlinear Multibody Systems (2003); recalled"
    provenance = "R"
    validity = "sliding; no force at all below s₀"

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)
    speed_first: float = parameter("m/s", "slip speed s₀ below which nothing acts", default=1.0e-3, above=0.0)
    speed_full: float = parameter("m/s", "slip speed s₁ of full friction; above s₀", default=1.0e-2, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        gain = type(s.speed)(0.0)
        if s.speed > p.speed_first:
            ramp = (s.speed - p.speed_first) / (p.speed_full - p.speed_first)
            gain = wp.min(ramp, type(s.speed)(1.0)) / s.speed
        return (-p.mu * s.normal_force * gain) * s.velocity


class Elliptic(Friction):
    """Anisotropic friction of maximum dissipation, for example of wood grain, treads, scales or skate blades.

    Axis 1 is the x axis of the surface frame, projected into the tangent plane and rotated by ``angle`` about the
    normal (the y axis if x is parallel to the normal). The force lies on the ellipse (F₁/μ₁)² + (F₂/μ₂)² = N². It
    is not opposite to the slip but inclined towards the axis of higher friction.
    """

    formula = "F_i = −N μ_i² v_i tanh(r/r₀)/r, r = √(μ₁² v₁² + μ₂² v₂²), r₀ = max(μ₁, μ₂) v_s"
    reference = "Goyal, Ruina & Papadopoulos, Wear 143 (1991) 307; oracle by direct integration"
    validity = "no stiction; creeps like Tanh; explicit steps need dt < 2 m v_s/(μ N)"
    provenance = "D"
    directional = True

    mu_1: float = parameter("-", "coefficient of friction μ₁ along axis 1", at_least=0.0)
    mu_2: float = parameter("-", "coefficient of friction μ₂ across", at_least=0.0)
    angle: float = parameter("rad", "from the surface's x axis to axis 1, about the normal", default=0.0)
    velocity_scale: float = parameter("m/s", "velocity scale v_s", default=1.0e-2, above=0.0)

    @wp.func
    def force(p: Any, s: Any):
        one = type(s.speed)(1.0)
        axis_1 = wp.cos(p.angle) * s.axis + wp.sin(p.angle) * wp.cross(s.normal, s.axis)
        axis_2 = wp.cross(s.normal, axis_1)
        drag_1 = p.mu_1 * wp.dot(s.velocity, axis_1)
        drag_2 = p.mu_2 * wp.dot(s.velocity, axis_2)
        r = wp.sqrt(drag_1 * drag_1 + drag_2 * drag_2)
        scale = wp.max(p.mu_1, p.mu_2) * p.velocity_scale
        if scale == type(s.speed)(0.0):
            return type(s.speed)(0.0) * s.velocity
        # tanh(r/r₀)/r → 1/r₀ at rest.
        gain = one / scale
        if r > type(s.speed)(1.0e-3) * scale:
            gain = fast_tanh(r / scale) / r
        return (-s.normal_force * gain) * (p.mu_1 * drag_1 * axis_1 + p.mu_2 * drag_2 * axis_2)


class Viscous(Friction):
    """Dashpot proportional to the load: a lubricating film, or as ``rolling`` the hysteresis of a wheel."""

    formula = "F = −β N v"
    reference = "type B of rolling resistance: Ai, Chen, Rotter & Ooi, Powder Technol. 206 (2011) 269"
    validity = "no stiction; explicit steps need dt < 2 m/(β N)"
    provenance = "R"

    drag: float = parameter("s/m", "drag β", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return (-p.drag * s.normal_force) * s.velocity
