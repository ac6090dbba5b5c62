"""Outcomes: what is kept of readings over time, by a few numbers per environment, while it is stepped."""

from warpcontact.kernels.outcomes.base import OfContact, Outcome
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
