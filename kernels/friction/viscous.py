"""Friction proportional to speed and load."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


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
