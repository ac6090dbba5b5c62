"""Unilateral contact: static problems, equilibrium, and the nonsmooth contacts of time stepping."""

from typing import TYPE_CHECKING

from warpcontact.kernels.on_demand import lazy_names

if TYPE_CHECKING:
    from warpcontact.unilateral.diagnosis import Diagnosis
    from warpcontact.unilateral.problem import Problem
    from warpcontact.unilateral.rigid.acceleration import ParadoxError
    from warpcontact.unilateral.rigid.assembly import Assembly, assemble
    from warpcontact.unilateral.rigid.equilibrium import Equilibrium, equilibrium
    from warpcontact.unilateral.rigid.event_driven import EventDriven
    from warpcontact.unilateral.rigid.events import Event, EventKind, EventRun
    from warpcontact.unilateral.solution import Solution, Termination
    from warpcontact.unilateral.solving import solve, solve_delassus

# Where each public name lives.
_HOME = {
    "Assembly": "rigid.assembly",
    "Diagnosis": "diagnosis",
    "Equilibrium": "rigid.equilibrium",
    "Event": "rigid.events",
    "EventDriven": "rigid.event_driven",
    "EventKind": "rigid.events",
    "EventRun": "rigid.events",
    "ParadoxError": "rigid.acceleration",
    "Problem": "problem",
    "Solution": "solution",
    "Termination": "solution",
    "assemble": "rigid.assembly",
    "equilibrium": "rigid.equilibrium",
    "solve": "solving",
    "solve_delassus": "solving",
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
    "Termination",
    "assemble",
    "equilibrium",
    "solve",
    "solve_delassus",
]

if not TYPE_CHECKING:  # there it would know every name
    __getattr__, __dir__ = lazy_names(__name__, _HOME, {})
