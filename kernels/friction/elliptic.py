"""Coulomb friction with two coefficients, along and across an axis of the surface."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.friction.saturation import fast_tanh


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
