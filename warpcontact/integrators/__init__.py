"""Time integrators, chosen by passing an object to ``Simulation``."""

from warpcontact.integrators.base import Integrator
from warpcontact.integrators.moreau_jean import MoreauJean
from warpcontact.integrators.semi_implicit_euler import SemiImplicitEuler

__all__ = ["Integrator", "MoreauJean", "SemiImplicitEuler"]
