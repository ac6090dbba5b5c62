"""Linearized couplings at the initial state: Jacobians, stiffnesses and dampings, for warnings about the time step."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpcontact.algebra.vectors import quat_multiply, transform_points
from warpcontact.scene.couplings import Bushing, Catenary, Coupling, SpringDamper
from warpcontact.scene.elements import Body
from warpcontact.scene.mobility import inverse_mass
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.scene.elements import Points

#: Directions of a bushing, in the order of its rows.
BUSHING_DIRECTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")


@dataclass(frozen=True)
class CouplingRows:
    """A coupling, linearized at the initial state; each row is a direction in which it acts.

    Attributes:
        name: Name of the coupling.
        bodies: Bodies of its ends; ``None``: the world.
        jacobians: One of each end, the derivative of the relative displacement or rotation by the velocity of the body, linear and
            angular part, world axes, (envs, rows, 6).
        stiffness: (envs, rows) [N/m], [N·m/rad].
        damping: (envs, rows) [N·s/m], [N·m·s/rad].
    """

    name: str
    bodies: tuple[Body | None, Body | None]
    jacobians: tuple[Array, Array]
    stiffness: Array
    damping: Array

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.stiffness.shape[1])

    def mobility(self, model: "Environments") -> Array:
        """Returns the mobility of each row, the sum of those of both bodies, (envs, rows) [1/kg], [1/(kg·m²)]."""
        total = np.zeros_like(self.stiffness)
        for body, jacobian in zip(self.bodies, self.jacobians, strict=True):
            if body is not None:
                total += np.einsum("eri,eij,erj->er", jacobian, inverse_mass(model, body), jacobian)
        return total


def coupling_rows(model: "Environments", coupling: Coupling) -> CouplingRows | None:
    """Returns a coupling with its largest slopes, zero where it is disabled; ``None``: its slopes are unknown.

    A spring-damper has the largest slopes of its tables, and at rest and at the initial length; a catenary is taut.
    """
    if isinstance(coupling, Bushing):
        rows = bushing_rows(model, coupling)
    else:
        length, jacobians = _line(model, coupling)
        stiffness = damping = None
        if isinstance(coupling, SpringDamper):
            stiffness, damping = (largest_slope(model, coupling, part, length) for part in ("spring", "damper"))
        elif isinstance(coupling, Catenary):
            stiffness = model[f"{coupling.name}.axial_stiffness"] / model[f"{coupling.name}.length"]
        if stiffness is None and damping is None:
            return None
        stiffness, damping = (np.zeros(model.envs) if one is None else one for one in (stiffness, damping))
        name = f"{coupling.name} (taut)" if isinstance(coupling, Catenary) else coupling.name
        rows = CouplingRows(name, coupling.bodies, jacobians, stiffness[:, None], damping[:, None])
    enabled = model[f"{coupling.name}.enabled"][:, None]
    return CouplingRows(rows.name, rows.bodies, rows.jacobians, rows.stiffness * enabled, rows.damping * enabled)


def bushing_rows(model: "Environments", bushing: Bushing) -> CouplingRows:
    """Returns the rows of a bushing, in the order of ``BUSHING_DIRECTIONS``, whether or not it is enabled."""
    name = bushing.name
    (place_1, arm_1), (place_2, arm_2) = (place_and_arm(model, one) for one in (bushing.point_a, bushing.point_b))
    orientation = model[f"{name}.orientation"]
    first = bushing.bodies[0]
    if first is not None:
        orientation = quat_multiply(model[f"{first.name}.orientation"], orientation)
    # Rows are the axes of the bushing in the world.
    axes = transform_points(np.broadcast_to(np.eye(3), (model.envs, 3, 3)), np.zeros((model.envs, 3)), orientation)
    # The force acts on both bodies at the second point.
    arms = (arm_1 + place_2 - place_1, arm_2)
    zero = np.zeros_like(axes)
    jacobian_a, jacobian_b = (
        sign
        * np.concatenate(
            [
                np.concatenate([axes, np.cross(arm[:, None], axes)], axis=2),
                np.concatenate([zero, axes], axis=2),
            ],
            axis=1,
        )
        for sign, arm in zip((-1.0, 1.0), arms, strict=True)
    )
    stiffness, damping = (
        np.concatenate([model[f"{name}.{key}"], model[f"{name}.turn_{key}"]], axis=1)
        for key in ("stiffness", "damping")
    )
    return CouplingRows(name, bushing.bodies, (jacobian_a, jacobian_b), stiffness, damping)


def slope(model: "Environments", coupling: SpringDamper, part: str, lengths: Array) -> Array | None:
    """Returns the slope of a part at ``lengths`` (envs, n), not below 0, (envs, n); ``None``: not available."""
    formula = coupling.formulas[part]
    plain = coupling.plain_spring if part == "spring" else coupling.plain_damper
    prefix = coupling.name if plain else f"{coupling.name}.{part}"
    count = lengths.shape[1]
    values = {name: np.repeat(model[f"{prefix}.{name}"], count) for name in formula.parameters()}
    values["rest_length"] = np.repeat(model[f"{coupling.name}.rest_length"], count)
    found = formula.slope(values, lengths.reshape(-1))
    if found is None:
        return None
    return np.maximum(np.broadcast_to(found, lengths.size), 0.0).reshape(lengths.shape)


def largest_slope(model: "Environments", coupling: SpringDamper, part: str, length: Array) -> Array | None:
    """Returns the largest slope at rest, at ``length`` (envs,), and in the table of a part, (envs,); ``None``: unknown."""
    lengths = [model[f"{coupling.name}.rest_length"], length]
    formula = coupling.formulas[part]
    if (field := formula.table_field()) is not None:
        nodes = np.asarray(getattr(formula, field.name))[:, 0]
        # Slopes are linear between nodes, or constant, with jumps at nodes.
        lengths += [np.full(model.envs, node) for node in np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])])]
    found = slope(model, coupling, part, np.stack(lengths, axis=1))
    return None if found is None else found.max(axis=1)


def initial_length(model: "Environments", coupling: Coupling) -> Array:
    """Returns the initial distance of the ends, (envs,) [m]."""
    return _line(model, coupling)[0]


def mobility_of_line(model: "Environments", coupling: Coupling) -> Array:
    """Returns the total mobility along the line between the ends, (envs,) [1/kg]."""
    zero = np.zeros((model.envs, 1))
    return CouplingRows(coupling.name, coupling.bodies, _line(model, coupling)[1], zero, zero).mobility(model)[
        :, 0
    ]


def place_and_arm(model: "Environments", point: "Points") -> tuple[Array, Array]:
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


def _line(model: "Environments", coupling: Coupling) -> tuple[Array, tuple[Array, Array]]:
    """Returns the initial distance of the ends (envs,) [m], and the Jacobian of the distance of each end, (envs, 1, 6)."""
    (position_a, arm_a), (position_b, arm_b) = (
        place_and_arm(model, point) for point in (coupling.point_a, coupling.point_b)
    )
    apart = position_b - position_a
    length = np.linalg.norm(apart, axis=1)
    along = np.where(length[:, None] > 0.0, apart / np.where(length > 0.0, length, 1.0)[:, None], (0, 0, 1.0))
    jacobian_a, jacobian_b = (
        sign * np.concatenate([along, np.cross(arm, along)], axis=1)[:, None]
        for sign, arm in ((-1.0, arm_a), (1.0, arm_b))
    )
    return length, (jacobian_a, jacobian_b)
