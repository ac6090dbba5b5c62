"""Time integrators, chosen by passing an object to ``Simulation``."""

from warpcontact.integrators.base import Integrator
from warpcontact.integrators.moreau_jean import MoreauJean
from warpcontact.integrators.semi_implicit_euler import SemiImplicitEuler

#: Every integrator by its name.
INTEGRATORS: dict[str, type[Integrator]] = {one.__name__: one for one in (SemiImplicitEuler, MoreauJean)}

__all__ = ["INTEGRATORS", "Integrator", "MoreauJean", "SemiImplicitEuler"]
