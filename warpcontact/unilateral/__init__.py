"""Unilateral contact: static problems, equilibrium, and the nonsmooth contacts of time stepping."""

from typing import TYPE_CHECKING

from warpcontact.kernels.catalogue.names import lazy_names

if TYPE_CHECKING:
    from warpcontact.unilateral.diagnosis import Diagnosis
    from warpcontact.unilateral.problem import Problem, solve
    from warpcontact.unilateral.reference.acceleration import ParadoxError
    from warpcontact.unilateral.reference.contacts import Assembly, assemble
    from warpcontact.unilateral.reference.equilibrium import Equilibrium, equilibrium
    from warpcontact.unilateral.reference.event_driven import EventDriven
    from warpcontact.unilateral.reference.events import Event, EventKind, EventRun
    from warpcontact.unilateral.solution import Solution, Termination
    from warpcontact.unilateral.solving import solve_delassus

# Module of each public name.
_HOME = {
    "Assembly": "reference.contacts",
    "Diagnosis": "diagnosis",
    "Equilibrium": "reference.equilibrium",
    "Event": "reference.events",
    "EventDriven": "reference.event_driven",
    "EventKind": "reference.events",
    "EventRun": "reference.events",
    "ParadoxError": "reference.acceleration",
    "Problem": "problem",
    "Solution": "solution",
    "Termination": "solution",
    "assemble": "reference.contacts",
    "equilibrium": "reference.equilibrium",
    "solve": "problem",
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

if not TYPE_CHECKING:  # a type checker would accept any name
    __getattr__, __dir__ = lazy_names(__name__, _HOME, {})
