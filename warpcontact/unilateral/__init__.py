"""Unilateral contact: static problems, equilibrium, and the hard contacts of time stepping.

Names are loaded on first use: ``import warpcontact`` stays quick.
"""

import importlib
from typing import TYPE_CHECKING, Any

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
    "solve_delassus": "solve",
}

__all__ = [
    "Assembly",
    "Equilibrium",
    "Event",
    "EventDriven",
    "EventKind",
    "EventRun",
    "ParadoxError",
    "assemble",
    "equilibrium",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'warpcontact.unilateral' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"warpcontact.unilateral.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
