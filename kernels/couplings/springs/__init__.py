"""Spring and damper models of spring-dampers. Custom ones derive from ``Spring`` and ``Damper``."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.kernels.couplings.springs.base import Damper, Spring

if TYPE_CHECKING:
    from warpcontact.kernels.couplings.springs.models import (
        DampingTable,
        ForceTable,
        Linear,
        Polynomial,
        PolynomialDamping,
        StiffnessTable,
        Undamped,
        Viscous,
    )

    SPRINGS: tuple[type[Spring], ...]
    DAMPERS: tuple[type[Damper], ...]

#: Names of the springs and of the dampers of the library.
SPRING_NAMES = ("Linear", "Polynomial", "StiffnessTable", "ForceTable")
DAMPER_NAMES = ("Undamped", "Viscous", "PolynomialDamping", "DampingTable")

__all__ = [
    "DAMPERS",
    "DAMPER_NAMES",
    "SPRINGS",
    "SPRING_NAMES",
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

if not TYPE_CHECKING:  # there it would know every name
    __getattr__, __dir__ = lazy_names(
        __name__,
        dict.fromkeys((*SPRING_NAMES, *DAMPER_NAMES), "models"),
        {"SPRINGS": SPRING_NAMES, "DAMPERS": DAMPER_NAMES},
    )
