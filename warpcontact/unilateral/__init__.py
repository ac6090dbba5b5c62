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
    from warpcontact.unilateral.rigid.acceleration import ParadoxError
    from warpcontact.unilateral.rigid.assembly import Assembly, assemble
    from warpcontact.unilateral.rigid.equilibrium import Equilibrium, equilibrium
    from warpcontact.unilateral.rigid.event_driven import EventDriven
    from warpcontact.unilateral.rigid.events import Event, EventKind, EventRun

# Where each public name lives.
_HOME = {
    "Assembly": "rigid.assembly",
    "Equilibrium": "rigid.equilibrium",
    "Event": "rigid.events",
    "EventDriven": "rigid.event_driven",
    "EventKind": "rigid.events",
    "EventRun": "rigid.events",
    "ParadoxError": "rigid.acceleration",
    "assemble": "rigid.assembly",
    "equilibrium": "rigid.equilibrium",
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
