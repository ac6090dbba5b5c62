"""Impacts of the same sphere with several laws: loops, restitution and its dependence on speed, as data sets."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from warpcontact._version import __version__
from warpcontact.analysis.compare.drop_tests import Impact, LawCase, Run, cases, dissipation_values, drop
from warpcontact.analysis.compare.instances import notes, settings
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

#: Default restitutions.
RESTITUTIONS = tuple(round(0.05 * k, 2) for k in range(1, 21))
# Largest ratio of depths of laws that are simulated together if nothing is recorded over time.
MAX_DEPTH_RATIO = 2.0
# Allowed restitutions, as in the laws.
ALLOWED = checks.limits("-", at_least=0.01, at_most=1.0)


@explain_keywords
def impacts(
    laws: Any,
    restitution: Any = RESTITUTIONS,
    *,
    mass: float = 1.0,
    speed: float = 1.0,
    depth: float | None = None,
    device: str = "cpu",
) -> xr.Dataset:
    """Simulates the same impact of a sphere on a plate with each law, one environment per restitution.

    Args:
        laws: A law, several, or a mapping from labels to laws; each an instance or a class. The elastic parameter of
            a class is fitted so that the undamped impact has the penetration ``depth``. With given values,
            ``functools.partial(Class, stiffness=1e6)``, only the others are chosen.
        restitution: Prescribed coefficients of restitution [-]. A law without this parameter gets the damping that
            reaches it, if possible. An elastic law, a plastic law, and a class with a given restitution or damping
            are the same in all environments.
        mass: Mass of the sphere [kg].
        speed: Impact speed [m/s].
        depth: Largest penetration of the undamped impact for laws given as a class [m]; default: that of the first
            instance, or 1 mm.
        device: Warp device.

    Returns:
        A data set with ``penetration`` [m], ``approach_speed`` [m/s] and ``normal_force`` [N] over (law,
        restitution, time), with time 0 at first contact, and over (law, restitution): ``effective_restitution`` [-]
        (NaN if the sphere did not leave the plate), ``contact_time`` [s] until the force stays zero,
        ``greatest_penetration`` [m], ``greatest_force`` [N], ``energy_loss`` [J], the area of the loop, and
        ``parameter``, the value of the varied parameter. Coordinates over laws: ``varied``, the name of that
        parameter (empty if there is none), its ``unit``, ``class``, and ``settings``, the other parameters.
        Attributes: ``mass``, ``speed``, ``depth``, the penetration to which classes are fitted, and ``depth_of``, the
        law that defines it (empty if none does).

    Raises:
        TypeError: If an entry is not a law.
        ValueError: If a value is out of range, or a class has parameters for which no value can be chosen.
    """
    impact = Impact(mass, speed, depth, device)
    restitutions = check_restitutions(restitution)
    chosen = cases(laws, impact)
    values = dissipation_values(chosen, restitutions, impact)
    run = drop(chosen, values, np.full(len(restitutions), impact.speed), impact)
    return _dataset(chosen, restitutions, values, run, impact)


@explain_keywords
def rebounds(
    laws: Any,
    restitution: Any = (0.3, 0.6, 0.9),
    speeds: Any = None,
    *,
    mass: float = 1.0,
    speed: float = 1.0,
    depth: float | None = None,
    device: str = "cpu",
) -> xr.Dataset:
    """Simulates impacts of several speeds, to measure the dependence of restitution on speed.

    Args:
        laws: As for ``impacts``.
        restitution: Prescribed coefficients of restitution at ``speed`` [-].
        speeds: Impact speeds [m/s]; default: from ``speed`` / 10 to 10 ``speed``.
        mass: Mass of the sphere [kg].
        speed: Speed for which elastic parameters and dampings are chosen [m/s].
        depth: Largest penetration of the undamped impact at ``speed`` for laws given as a class [m]; default: that of
            the first instance, or 1 mm.
        device: Warp device.

    Returns:
        A data set with ``effective_restitution`` [-] over (law, restitution, speed), NaN if the sphere did not
        leave the plate.

    Raises:
        TypeError: If an entry is not a law.
        ValueError: If a value is out of range, or a class has parameters for which no value can be chosen.
    """
    impact = Impact(mass, speed, depth, device)
    restitutions = check_restitutions(restitution)
    speed_values = impact.speed * np.geomspace(0.1, 10.0, 13) if speeds is None else speeds
    speed_values = checks.row("speeds", speed_values, checks.limits("m/s", above=0.0))
    chosen = cases(laws, impact)
    shape = len(restitutions), len(speed_values)
    values = {
        label: np.repeat(value, len(speed_values))
        for label, value in dissipation_values(chosen, restitutions, impact).items()
    }
    found: dict[str, Array] = {}
    for part in _by_depth(chosen):
        given = {label: value for label, value in values.items() if label in part}
        found |= drop(part, given, np.tile(speed_values, len(restitutions)), impact, record=False).rebound
    rebound = np.array([found[label].reshape(shape) for label in chosen])
    return xr.Dataset(
        {
            "effective_restitution": (
                ("law", "restitution", "speed"),
                rebound,
                notes("-", "effective restitution"),
            )
        },
        coords={
            "law": list(chosen),
            "restitution": ("restitution", restitutions, notes("-", "prescribed restitution")),
            "speed": ("speed", speed_values, notes("m/s", "impact speed")),
        },
        attrs={"source": f"warpcontact {__version__}", "mass": impact.mass, "reference_speed": impact.speed},
    )


def check_restitutions(given: Any) -> Array:
    """Returns coefficients of restitution as an array, after validation."""
    return checks.row("restitution", given, ALLOWED)


def _by_depth(chosen: Mapping[str, LawCase]) -> list[dict[str, LawCase]]:
    """Splits ``chosen`` into parts of similar depth; the stiffest law sets the step, the softest the duration."""
    parts: list[dict[str, LawCase]] = []
    for label, case in sorted(chosen.items(), key=lambda item: item[1].depth):
        if not parts or not case.depth <= MAX_DEPTH_RATIO * next(iter(parts[-1].values())).depth:
            parts.append({})
        parts[-1][label] = case
    return parts


def _dataset(
    chosen: Mapping[str, LawCase], restitutions: Array, values: Mapping[str, Array], run: Run, impact: Impact
) -> xr.Dataset:
    over_time, over_cases = ("law", "restitution", "time"), ("law", "restitution")
    delta, rate, force = (
        np.array([run.sensors[label][name].T for label in chosen])
        for name in ("penetration", "approach_speed", "normal_force")
    )
    has_force = force != 0.0
    last = force.shape[-1] - 1 - has_force[..., ::-1].argmax(axis=-1)
    no_value = np.full(len(restitutions), np.nan)
    variables = {
        "penetration": (over_time, delta, notes("m", "penetration")),
        "approach_speed": (over_time, rate, notes("m/s", "rate of penetration")),
        "normal_force": (over_time, force, notes("N", "normal force")),
        "effective_restitution": (
            over_cases,
            np.array([run.rebound[label] for label in chosen]),
            notes("-", "effective restitution"),
        ),
        "contact_time": (over_cases, run.time[last], notes("s", "time from first contact until the force ends")),
        "greatest_penetration": (over_cases, delta.max(axis=-1), notes("m", "greatest penetration")),
        "greatest_force": (over_cases, force.max(axis=-1), notes("N", "greatest normal force")),
        "energy_loss": (
            over_cases,
            _area(force, delta),
            notes("J", "energy lost, the area of the loop"),
        ),
        "parameter": (
            over_cases,
            np.array([values.get(label, no_value) for label in chosen]),
            {"long_name": "value of the varied parameter; its name and unit are coordinates"},
        ),
    }
    varied = [case.varied or "" for case in chosen.values()]
    texts = [settings(case.law, without=case.varied) for case in chosen.values()]
    units = [case.law.limits(case.varied)["unit"] if case.varied else "" for case in chosen.values()]
    return xr.Dataset(
        variables,
        coords={
            "law": list(chosen),
            "restitution": ("restitution", restitutions, notes("-", "prescribed restitution")),
            "time": ("time", run.time, notes("s", "time since first contact")),
            "varied": ("law", np.array(varied, object)),
            "unit": ("law", np.array(units, object)),
            "class": ("law", np.array([type(case.law).__name__ for case in chosen.values()], object)),
            "settings": ("law", np.array(texts, object)),
        },
        attrs={
            "source": f"warpcontact {__version__}",
            "mass": impact.mass,
            "speed": impact.speed,
            **_depth(chosen, impact),
            "precision": "float64",
        },
    )


def _depth(chosen: Mapping[str, LawCase], impact: Impact) -> dict[str, Any]:
    """Returns the depth to which elastic parameters of classes are fitted, and the law that defines it."""
    depth = next((case.depth for case in chosen.values() if not case.given), np.nan)
    if impact.depth is not None or np.isnan(depth):
        return {"depth": depth, "depth_of": ""}
    same = (label for label, case in chosen.items() if case.given and case.depth == depth)
    return {"depth": depth, "depth_of": next(same, "")}


def _area(force: Array, delta: Array) -> Array:
    """Returns the area of loops along the last axis [J]."""
    before, after = force[..., :-1], force[..., 1:]
    # If the force jumps at first contact or at release, keep its magnitude up to there.
    before = np.where(delta[..., :-1] > 0.0, before, after)
    after = np.where(delta[..., 1:] > 0.0, after, before)
    return np.asarray((0.5 * (before + after) * np.diff(delta, axis=-1)).sum(axis=-1))
