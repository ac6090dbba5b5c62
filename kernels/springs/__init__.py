"""Spring-dampers by the formula of their force: elastic parts and damping. One's own derive from the bases."""

from warpcontact.kernels.springs.base import Damper, Spring
from warpcontact.kernels.springs.damping import DampingTable, PolynomialDamping, Undamped, Viscous
from warpcontact.kernels.springs.elastic import ForceTable, Linear, Polynomial, StiffnessTable

#: All elastic parts, and all dampings, that come with the library.
SPRINGS: tuple[type[Spring], ...] = (Linear, Polynomial, StiffnessTable, ForceTable)
DAMPERS: tuple[type[Damper], ...] = (Undamped, Viscous, PolynomialDamping, DampingTable)

__all__ = [
    "DAMPERS",
    "SPRINGS",
    "Damper",
    "DampingTable",
    "ForceTable",
    "Linear",
    "Polynomial",
    "PolynomialDamping",
    "Spring",
    "StiffnessTable",
    "Undamped",
    "Viscous",
]
