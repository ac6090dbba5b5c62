"""Unilateral contact: static problems, equilibrium, and the hard contacts of time stepping.

What takes a model is loaded on first use.
"""

import importlib
from typing import TYPE_CHECKING, Any

from warpcontact.unilateral.diagnosis import Diagnosis
from warpcontact.unilateral.problem import Problem
from warpcontact.unilateral.solution import Solution
from warpcontact.unilateral.solve import solve, solve_delassus

if TYPE_CHECKING:
    from warpcontact.unilateral.acceleration import ParadoxError
    from warpcontact.unilateral.assembly import Assembly, assemble
    from warpcontact.unilateral.at_rest import Equilibrium, equilibrium
    from warpcontact.unilateral.event_driven import EventDriven
    from warpcontact.unilateral.events import Event, EventKind, EventRun

# Where each public name lives.
_HOME = {
    "Assembly": "assembly",
    "Equilibrium": "at_rest",
    "Event": "events",
    "EventDriven": "event_driven",
    "EventKind": "events",
    "EventRun": "events",
    "ParadoxError": "acceleration",
    "assemble": "assembly",
    "equilibrium": "at_rest",
}

__all__ = [
    "Assembly",
    "Diagnosis",
    "Equilibrium",
    "Event",
    "EventDriven",
    "EventKind",
    "EventRun",
    "ParadoxError",
    "Problem",
    "Solution",
    "assemble",
    "equilibrium",
    "solve",
    "solve_delassus",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'warpcontact.unilateral' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"warpcontact.unilateral.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
