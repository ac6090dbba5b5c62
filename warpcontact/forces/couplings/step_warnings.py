"""Warnings about couplings that run but give wrong results: too long time steps, catenary ends below the floor."""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.forces.couplings.coupling_rows import (
    BUSHING_DIRECTIONS,
    bushing_rows,
    initial_length,
    mobility_of_line,
    place_and_arm,
    slope,
)
from warpcontact.scene.couplings import Bushing, Catenary, SpringDamper
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments

# Minimum number of steps per period of a spring: oscillations are then accurate to about 1 %.
MIN_STEPS_PER_PERIOD = 20.0
# Maximum relative change of velocity by a damper in a step; above twice this value, integration is unstable.
MAX_DAMPING = 1.0
# Depth of an end below the floor without a warning, relative to the length: an anchor may be slightly buried.
MAX_BURIED_DEPTH = 0.01


def spring_warnings(model: "Environments", coupling: SpringDamper, dt: float) -> list[str]:
    """Returns the warnings about a spring-damper and the time step.

    The period is estimated from stiffness and damping at the initial length and at rest, and from the effective mass
    along the line between the points. Formulas without a slope are not checked.
    """
    mobility = mobility_of_line(model, coupling)
    lengths = np.stack([model[f"{coupling.name}.rest_length"], initial_length(model, coupling)], axis=1)
    stiffness, damping = (slope(model, coupling, part, lengths) for part in ("spring", "damper"))
    sentences = []
    if stiffness is not None:
        sentences += _period_warnings(model, coupling.name, np.sqrt(stiffness.max(axis=1) * mobility), dt)
    if damping is not None:
        sentences += _damping_warnings(model, coupling.name, damping.max(axis=1) * mobility, dt)
    return sentences


def bushing_warnings(model: "Environments", bushing: Bushing, dt: float) -> list[str]:
    """Returns the warnings about a bushing and the time step, for its worst direction."""
    rows = bushing_rows(model, bushing)
    mobility = rows.mobility(model) * model[f"{bushing.name}.enabled"][:, None]
    sentences = []
    for values, warnings in (
        (np.sqrt(rows.stiffness * mobility), _period_warnings),
        (rows.damping * mobility, _damping_warnings),
    ):
        direction = int(np.argmax(values.max(axis=0)))
        name = f"{bushing.name}, {BUSHING_DIRECTIONS[direction]}"
        sentences += warnings(model, name, values[:, direction], dt)
    return sentences


def _period_warnings(model: "Environments", name: str, turning: Array, dt: float) -> list[str]:
    """Returns the warning about angular frequencies (envs,) [rad/s] with too few steps per period."""
    worst = int(np.argmax(turning))
    if turning[worst] * dt * MIN_STEPS_PER_PERIOD <= 2.0 * np.pi:
        return []
    period = 2.0 * np.pi / turning[worst]
    return [
        f"{name}: dt = {dt:g} s is too long: a period is {period:.2g} s in environment "
        f"{model.first_env + worst}, {period / dt:.1f} steps. Use dt ≤ {period / MIN_STEPS_PER_PERIOD:.2g} s for "
        f"{MIN_STEPS_PER_PERIOD:g} steps"
    ]


def _damping_warnings(model: "Environments", name: str, rate: Array, dt: float) -> list[str]:
    """Returns the warning about dampers with too large rates (envs,) [1/s]."""
    worst = int(np.argmax(rate))
    if rate[worst] * dt <= MAX_DAMPING:
        return []
    return [
        f"{name}: dt = {dt:g} s is too long for its damping, which changes the velocity by "
        f"{rate[worst] * dt:.2g} times its value per step in environment {model.first_env + worst}. Use dt ≤ "
        f"{0.1 * MAX_DAMPING / rate[worst]:.2g} s"
    ]


def catenary_warnings(model: "Environments", line: Catenary, dt: float) -> list[str]:
    """Returns the warnings about a catenary: the time step for the taut cable, and ends below the floor."""
    return _taut_warnings(model, line, dt) + _floor_warnings(model, line)


def _taut_warnings(model: "Environments", line: Catenary, dt: float) -> list[str]:
    length, stiffness = (model[f"{line.name}.{key}"] for key in ("length", "axial_stiffness"))
    turning = np.sqrt(stiffness / length * mobility_of_line(model, line))
    worst = int(np.argmax(turning))
    if turning[worst] * dt <= 2.0:
        return []
    period = 2.0 * np.pi / turning[worst]
    return [
        f"{line.name}: dt = {dt:g} s is too long for the taut cable: a period is {period:.2g} s in "
        f"environment {model.first_env + worst}, {period / dt:.1f} steps. Use dt ≤ {period / MIN_STEPS_PER_PERIOD:.2g} s "
        f"for {MIN_STEPS_PER_PERIOD:g} steps"
    ]


def _floor_warnings(model: "Environments", line: Catenary) -> list[str]:
    if line.floor is None:
        return []
    gravity = model["scene.gravity"]
    size = np.linalg.norm(gravity, axis=1)
    upright = -gravity / np.where(size > 0.0, size, 1.0)[:, None]
    floor, length = (model[f"{line.name}.{key}"] for key in ("floor", "length"))
    sentences = []
    for key, point in (("point_a", line.point_a), ("point_b", line.point_b)):
        height = (place_and_arm(model, point)[0] * upright).sum(axis=1)
        depth = np.where(size > 0.0, floor - height, 0.0)  # without gravity, depth is undefined
        worst = int(np.argmax(depth / length))
        if depth[worst] > MAX_BURIED_DEPTH * length[worst]:
            sentences.append(
                f"{line.name}: its {key} {point.name!r} is {depth[worst]:.3g} m below the floor in environment "
                f"{model.first_env + worst} and is treated as on the floor. floor = {floor[worst]:g} m is the height "
                "above the origin, negative below it"
            )
    return sentences
