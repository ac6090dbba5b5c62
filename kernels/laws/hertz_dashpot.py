"""Hertz spring with a linear dashpot."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, stepped_dashpot


class HertzDashpot(Law):
    """Hertz spring with a linear dashpot. Restitution increases with speed, contrary to experiments."""

    formula = "N = max(0, K δ^1.5 + c δ̇)"
    reference = "attributed to Ristow, J. Phys. I France 2 (1992) 649; form of Modelica's ElastoGap"
    provenance = "S"
    validity = "calibrated at one speed; the force jumps at touch"
    power = 1.5
    needs_mass = True

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)
    damping: float = parameter("N·s/m", "damping c", at_least=0.0)

    @wp.func
    def force(p: Any, c: Any):
        dashpot = stepped_dashpot(p.damping, c.inverse_mass, c.dt)
        return p.stiffness * c.delta * wp.sqrt(c.delta) + dashpot * c.delta_dot
