"""Outcomes and events as labeled data sets."""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact._version import __version__
from warpcontact.forces.sensor import AXES
from warpcontact.model.environments import Environments
from warpcontact.scene.status import EnvironmentStatus, FailureCause
from warpcontact.stepping.outcomes.observer import Monitor, OutcomeState
from warpcontact.stepping.outcomes.watch import MonitorSettings
from warpcontact.stepping.recorder import item_dimension_of

Variable = tuple[Sequence[str], NDArray[Any], Mapping[str, Any]]


def outcomes_of(model: Environments, settings: MonitorSettings, monitors: Sequence[Monitor]) -> xr.Dataset:
    """Returns the outcomes of a simulation so far; see ``Simulation.outcomes``.

    Args:
        model: The model; its current state is included.
        settings: Settings of the monitors.
        monitors: Monitors of the parts of the model; empty if nothing is monitored.
    """
    variables: dict[str, Variable] = {}
    if settings.outcomes:
        needs = {*monitors[0].needs}
        model.ensure_sensor_arrays(needs)
        # Launch all parts before waiting for the first one, so that devices run in parallel.
        for part in model.parts:
            part.evaluate_needs(needs)
        model.check_neighbor_lists()
        for number, outcome_state in enumerate(monitors[0].outcome_states):
            values = np.concatenate([one.results(one.outcome_states[number]) for one in monitors])
            variables[outcome_state.name] = _outcome(model, outcome_state, values)
    parts = model.parts
    status = np.concatenate([part.arrays.status.numpy() for part in parts]).astype(np.int8)
    cause = np.concatenate([part.arrays.guard.cause.numpy() for part in parts]).astype(np.int8)
    time = np.concatenate([part.arrays.time.numpy() for part in parts])
    resets = np.zeros(model.envs, np.int32)
    if monitors:
        resets = np.concatenate([one.resets.numpy() for one in monitors])
    variables["status"] = (["env"], status, {"long_name": "state of the environment", **_flags(EnvironmentStatus)})
    variables["cause"] = (["env"], cause, {"long_name": "cause of failure", **_flags(FailureCause)})
    variables["end_time"] = (["env"], time, {"units": "s", "long_name": "simulated time of the environment"})
    about = {"units": "-", "long_name": "number of resets to the initial state after a failure"}
    variables["resets"] = (["env"], resets, about)
    if settings.stops:
        stopped = np.concatenate([one.stops.stopped_by.numpy() for one in monitors]).astype(np.int16)
        about = {"long_name": "stop condition that ended the environment; −1: none", **_named(settings.stops)}
        variables["stopped_by"] = (["env"], stopped, about)
    if settings.events is not None:
        count = np.concatenate([one.events.count.numpy() for one in monitors])
        about = {"units": "-", "long_name": "number of events that were not stored"}
        variables["events_missed"] = (["env"], np.maximum(count - settings.events.most, 0), about)
    return _dataset(model, variables)


def events_of(model: Environments, settings: MonitorSettings, monitors: Sequence[Monitor]) -> xr.Dataset:
    """Returns the events of a simulation so far; see ``Simulation.events``.

    Args:
        model: The model.
        settings: Settings of the monitors.
        monitors: Monitors of the parts of the model.

    Raises:
        ValueError: If the simulation has no ``events``.
    """
    if settings.events is None:
        raise ValueError("no events are recorded: pass events=wc.ContactEvents(['touch']) to the simulation")
    most = settings.events.most
    event_offsets = np.array(monitors[0].event_offsets)
    count = np.concatenate([one.events.count.numpy() for one in monitors])
    # Oldest event first: the ring buffer starts at count mod most once it is full.
    order = (np.arange(most) + np.where(count > most, count, 0)[:, None]) % most
    there = np.arange(most) < count[:, None]
    time = np.concatenate([one.events.time.numpy() for one in monitors])
    what = np.concatenate([one.events.what.numpy() for one in monitors])
    time, what = (np.take_along_axis(values, order, axis=1) for values in (time, what))
    place = what // 2
    contact = np.searchsorted(event_offsets, place, side="right") - 1
    dims = ["env", "event"]
    named = _named(settings.events.contacts)
    made = {"flag_values": [0, 1], "flag_meanings": "lost made"}
    return _dataset(
        model,
        {
            "time": (
                dims,
                np.where(there, time, np.nan),
                {"units": "s", "long_name": "time of the first state after the event; NaN: no event"},
            ),
            "contact": (
                dims,
                np.where(there, contact, -1).astype(np.int16),
                {"long_name": "contact; −1: no event", **named},
            ),
            "item": (
                dims,
                np.where(there, place - event_offsets[contact], -1).astype(np.int32),
                {"long_name": "item of the contact; −1: no event"},
            ),
            "made": (
                dims,
                np.where(there, what % 2, -1).astype(np.int8),
                {"long_name": "whether the contact was made or lost; −1: no event", **made},
            ),
        },
    )


def _outcome(model: Environments, outcome_state: OutcomeState, values: NDArray[np.float64]) -> Variable:
    """Returns the results of an outcome (env, item, component) as a variable."""
    first = outcome_state.sources[0]
    dims = ["env"]
    if first.sensor.items and first.source.items == "each":
        dims.append(item_dimension_of(model.scene, first.sensor))
    else:
        values = values[:, 0]
    if first.axis is None:
        values = values[..., 0]
    else:
        dims.append(first.axis)
    return (
        dims,
        values,
        {"units": outcome_state.outcome.unit(first.sensor.unit), "long_name": outcome_state.outcome.long_name},
    )


def _dataset(model: Environments, variables: Mapping[str, Variable]) -> xr.Dataset:
    used = {dim for dims, _, _ in variables.values() for dim in dims}
    coordinates: dict[str, Any] = {
        "env": ("env", model.first_env + np.arange(model.envs), {"long_name": "environment"})
    }
    coordinates |= {dim: (dim, np.array(labels, object)) for dim, labels in AXES.values() if dim in used}
    attributes = {
        "source": f"warpcontact {__version__}",
        "device": ", ".join(map(str, model.devices)),
        "precision": model.precision,
    }
    return xr.Dataset(dict(variables), coords=coordinates, attrs=attributes)


def _flags(codes: type[IntEnum]) -> dict[str, Any]:
    return {
        "flag_values": [int(code) for code in codes],
        "flag_meanings": " ".join(code.name for code in codes),
    }


def _named(names: Sequence[str] | Mapping[str, Any]) -> dict[str, Any]:
    return {"flag_values": list(range(len(names))), "flag_meanings": " ".join(names)}
