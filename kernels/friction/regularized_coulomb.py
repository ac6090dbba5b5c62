"""Coulomb friction with a linear ramp through zero slip."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


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
