"""Time integrators; pass an instance to ``Simulation``."""

from warpcontact.stepping.integrators.base import Integrator
from warpcontact.stepping.integrators.moreau_jean import MoreauJean
from warpcontact.stepping.integrators.semi_implicit_euler import SemiImplicitEuler

#: All integrators by class name.
INTEGRATORS: dict[str, type[Integrator]] = {one.__name__: one for one in (SemiImplicitEuler, MoreauJean)}

__all__ = ["INTEGRATORS", "Integrator", "MoreauJean", "SemiImplicitEuler"]
