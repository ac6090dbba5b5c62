"""Outcomes: scalars per environment, reduced from sensors over time on the device during stepping."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names
from warpcontact.kernels.outcomes.base import OfContact, Outcome

if TYPE_CHECKING:
    from warpcontact.kernels.outcomes.catalogue import (
        OUTCOMES,
        Change,
        Count,
        Duration,
        Final,
        FirstTime,
        Initial,
        Integral,
        Max,
        Mean,
        Min,
        Range,
        Restitution,
        Rms,
        TimeOfMax,
        Work,
    )

__all__ = [
    "OUTCOMES",
    "Change",
    "Count",
    "Duration",
    "Final",
    "FirstTime",
    "Initial",
    "Integral",
    "Max",
    "Mean",
    "Min",
    "OfContact",
    "Outcome",
    "Range",
    "Restitution",
    "Rms",
    "TimeOfMax",
    "Work",
]

if not TYPE_CHECKING:  # a module ``__getattr__`` would make a type checker accept any name
    _LATER = [name for name in __all__ if name not in ("OfContact", "Outcome")]
    __getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(_LATER, "..kernels.outcomes.catalogue"), {})
