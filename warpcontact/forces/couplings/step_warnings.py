"""Warnings about couplings that run but give wrong results: too long time steps, catenary ends below the floor."""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.algebra.vectors import transform_points
from warpcontact.scene.couplings import Catenary, Coupling, SpringDamper
from warpcontact.scene.mobility import mobility_along
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.scene.elements import Points

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
    length, mobility = _along(model, coupling)
    rest = model[f"{coupling.name}.rest_length"]
    sentences = []
    stiffness, damping = (_slope(model, coupling, part, rest, length) for part in ("spring", "damper"))
    if stiffness is not None:
        turning = np.sqrt(stiffness * mobility)
        worst = int(np.argmax(turning))
        if turning[worst] * dt * MIN_STEPS_PER_PERIOD > 2.0 * np.pi:
            period = 2.0 * np.pi / turning[worst]
            sentences.append(
                f"{coupling.name}: dt = {dt:g} s is too long: a period is {period:.2g} s in environment "
                f"{model.first_env + worst}, {period / dt:.1f} steps. Use dt ≤ {period / MIN_STEPS_PER_PERIOD:.2g} s for "
                f"{MIN_STEPS_PER_PERIOD:g} steps"
            )
    if damping is not None:
        rate = damping * mobility
        worst = int(np.argmax(rate))
        if rate[worst] * dt > MAX_DAMPING:
            sentences.append(
                f"{coupling.name}: dt = {dt:g} s is too long for its damping, which changes the velocity by "
                f"{rate[worst] * dt:.2g} times its value per step in environment {model.first_env + worst}. Use dt ≤ "
                f"{0.1 * MAX_DAMPING / rate[worst]:.2g} s"
            )
    return sentences


def catenary_warnings(model: "Environments", line: Catenary, dt: float) -> list[str]:
    """Returns the warnings about a catenary: the time step for the taut cable, and ends below the floor."""
    return _taut_warnings(model, line, dt) + _floor_warnings(model, line)


def _taut_warnings(model: "Environments", line: Catenary, dt: float) -> list[str]:
    length, stiffness = (model[f"{line.name}.{key}"] for key in ("length", "axial_stiffness"))
    turning = np.sqrt(stiffness / length * _along(model, line)[1])
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
        height = (_place_and_arm(model, point)[0] * upright).sum(axis=1)
        depth = np.where(size > 0.0, floor - height, 0.0)  # without gravity, depth is undefined
        worst = int(np.argmax(depth / length))
        if depth[worst] > MAX_BURIED_DEPTH * length[worst]:
            sentences.append(
                f"{line.name}: its {key} {point.name!r} is {depth[worst]:.3g} m below the floor in environment "
                f"{model.first_env + worst} and is treated as on the floor. floor = {floor[worst]:g} m is the height "
                "above the origin, negative below it"
            )
    return sentences


def _along(model: "Environments", coupling: Coupling) -> tuple[Array, Array]:
    """Returns the initial distance of the ends [m], and the total mobility along the line between them [1/kg]."""
    points = (coupling.point_a, coupling.point_b)
    (position_a, arm_a), (position_b, arm_b) = (_place_and_arm(model, point) for point in points)
    apart = position_b - position_a
    length = np.linalg.norm(apart, axis=1)
    direction = np.where(length[:, None] > 0.0, apart / np.where(length > 0.0, length, 1.0)[:, None], (0, 0, 1.0))
    mobility = _mobility(model, points[0], arm_a, direction) + _mobility(model, points[1], arm_b, direction)
    return length, mobility


def _slope(model: "Environments", coupling: SpringDamper, part: str, rest: Array, length: Array) -> Array | None:
    """Returns the larger slope of a part at rest and at the initial length, (envs,); ``None``: not available."""
    formula = coupling.formulas[part]
    plain = coupling.plain_spring if part == "spring" else coupling.plain_damper
    prefix = coupling.name if plain else f"{coupling.name}.{part}"
    values = {name: model[f"{prefix}.{name}"] for name in formula.parameters()}
    values["rest_length"] = rest
    slopes = [formula.slope(values, lengths) for lengths in (rest, length)]
    if any(slope is None for slope in slopes):
        return None
    return np.maximum(np.maximum(*np.broadcast_arrays(*slopes)), 0.0)


def _place_and_arm(model: "Environments", point: "Points") -> tuple[Array, Array]:
    """Returns the initial position of a point, and its arm from the center of mass, (envs, 3), world [m]."""
    place = model[f"{point.name}.position"][:, None]
    if point.surface is not None:
        scale, position, orientation = (
            model[f"{point.surface.name}.{key}"] for key in ("scale", "position", "orientation")
        )
        place = transform_points(scale[:, None, None] * place, position, orientation)
    if point.body is None:
        return place[:, 0], np.zeros((model.envs, 3))
    centre, turn = (model[f"{point.body.name}.{key}"] for key in ("position", "orientation"))
    arm = transform_points(place, np.zeros_like(centre), turn)[:, 0]
    return centre + arm, arm


def _mobility(model: "Environments", point: "Points", arm: Array, direction: Array) -> Array:
    """Returns the mobility of a point along ``direction``, (envs,) [1/kg]."""
    if point.body is None:
        return np.zeros(model.envs)
    return mobility_along(model, point.body, arm, direction)
