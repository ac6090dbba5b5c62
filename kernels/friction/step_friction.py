"""Static and dynamic friction joined by cubics, as in ADAMS."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


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
