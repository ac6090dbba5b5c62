"""Assembles closed contacts and bodies of one environment as matrices."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import cross
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.types import WORLD
from warpcontact.unilateral.reference.bodies import Bodies
from warpcontact.unilateral.reference.candidates import Candidates, MeasuredPairs
from warpcontact.unilateral.reference.snapshot import EnvironmentAccess, Snapshot, find_environment
from warpcontact.validation import checks
from warpcontact.validation.checks import Array


@dataclass(frozen=True)
class Assembly:
    """Closed contacts and bodies: U = H v, M v̇ = force + Hᵀ λ.

    v contains linear and angular velocity of each body, in world axes, at the centers of mass. U and λ have
    components (n, t1, t2) for each contact: the velocity of the first body relative to the second at K, and the
    force on the first.

    Attributes:
        body_names: Names of the bodies; for a body set with the item in brackets.
        names: Names of the contacts (contacts,).
        items: Items of the contacts (contacts,), −1 for a contact without items.
        labels: Labels of the contacts in messages.
        bodies: Indices of the first and the second body, −1 for the world, (contacts, 2).
        gap: Signed distances (contacts,) [m].
        axes: Unit vectors n, t1, t2 (contacts, 3, 3), world; n points out of the second body.
        point: Points K (contacts, 3), world [m].
        mu_static: Coefficients of static friction (contacts,).
        mu: Coefficients of dynamic friction (contacts,).
        restitution: Coefficients of restitution (contacts,).
        H: (contacts, 3, 6 bodies) [-, m].
        inverse_mass: Inverse mass matrix (6 bodies, 6 bodies), zero along directions constrained by joints.
        velocity: v (6 bodies,) [m/s, rad/s].
        force: Applied forces and torques (6 bodies,), including gravity and couplings, [N, N·m].
        free_acceleration: Acceleration without contact (6 bodies,) [m/s², rad/s²].
    """

    body_names: list[str]
    names: NDArray[Any]
    items: NDArray[np.int_]
    labels: list[str]
    bodies: NDArray[np.int_]
    gap: Array
    axes: Array
    point: Array
    mu_static: Array
    mu: Array
    restitution: Array
    H: Array = field(repr=False)
    inverse_mass: Array = field(repr=False)
    velocity: Array = field(repr=False)
    force: Array = field(repr=False)
    free_acceleration: Array = field(repr=False)

    @property
    def count(self) -> int:
        """Number of contacts."""
        return len(self.names)

    @property
    def rows(self) -> Array:
        """H with one row per component (3 contacts, 6 bodies)."""
        return self.H.reshape(3 * self.count, self.H.shape[-1])

    @cached_property
    def delassus(self) -> Array:
        """W = H M⁻¹ Hᵀ, (3 contacts, 3 contacts)."""
        return self.rows @ self.inverse_mass @ self.rows.T

    @property
    def contact_velocity(self) -> Array:
        """U = H v, (contacts, 3) [m/s]."""
        return (self.rows @ self.velocity).reshape(-1, 3)

    def accelerations(self, forces: Array) -> Array:
        """Returns accelerations (6 bodies,) under contact forces λ (contacts, 3) [N]."""
        return self.free_acceleration + self.inverse_mass @ (self.rows.T @ forces.reshape(-1))


class Assembler:
    """Creates assemblies of one environment in many states.

    Args:
        model: From ``Scene.build``.
        env: Index of the environment.

    Raises:
        TypeError: If ``model`` is not a model.
        ValueError: If there is no such environment, or a contact has a friction model without Coulomb
            coefficients.
    """

    def __init__(self, model: Any, env: int = 0) -> None:
        self.model, self.env = find_environment(model, env)
        self.environment = EnvironmentAccess(self.model, self.env)
        self.bodies = Bodies(self.model, self.env)
        self.candidates = Candidates(self.environment)

    def assembly(self, snapshot: Snapshot, measured: MeasuredPairs, chosen: NDArray[np.int_]) -> Assembly:
        """Returns the assembly of the ``chosen`` candidate pairs in the state that was measured last."""
        own, bodies = self.candidates, self.bodies
        response = bodies.response(snapshot)
        weight = np.zeros((bodies.count, 6))
        weight[:, :3] = bodies.mass[:, None] * bodies.gravity
        force = measured.force + weight.reshape(-1)
        free = response.inverse_mass @ force + response.bias + bodies.prescribed_accelerations()
        axes = contact_axes(measured.normal[chosen])
        return Assembly(
            body_names=bodies.names,
            names=own.names[chosen],
            items=own.items[chosen],
            labels=[own.labels[number] for number in chosen],
            bodies=own.bodies[chosen],
            gap=measured.gap[chosen],
            axes=axes,
            point=measured.point[chosen],
            mu_static=own.mu_static[chosen],
            mu=own.mu[chosen],
            restitution=own.restitution[chosen],
            H=contact_rows(axes, measured.point[chosen], own.bodies[chosen], snapshot.position),
            inverse_mass=response.inverse_mass,
            velocity=snapshot.velocity,
            force=force,
            free_acceleration=free,
        )


def contact_axes(normal: Array) -> Array:
    """Returns n, t1, t2 of unit normals (n, 3), right-handed, (n, 3, 3)."""
    x, y, z = normal.T
    # Duff et al., J. Comput. Graph. Tech. 6 (2017): without a branch that rounding could switch.
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([normal, first, second], axis=1)


def contact_rows(axes: Array, point: Array, bodies: NDArray[np.int_], position: Array) -> Array:
    """Returns H (n, 3, 6 bodies): velocity of the first body relative to the second at K, along ``axes``."""
    count = len(position)
    rows = np.zeros((len(axes), 3, count, 6))
    for side, sign in ((0, 1.0), (1, -1.0)):
        moved_rows = np.flatnonzero(bodies[:, side] != WORLD)
        own = bodies[moved_rows, side]
        arm = (point[moved_rows] - position[own])[:, None, :]
        rows[moved_rows, :, own, :3] += sign * axes[moved_rows]
        rows[moved_rows, :, own, 3:] += sign * cross(arm, axes[moved_rows])
    return rows.reshape(len(axes), 3, 6 * count)


@explain_keywords
def assemble(model: Any, env: int = 0, closed: float = 1.0e-6) -> Assembly:
    """Returns the closed contacts of one environment in its current state, and its bodies, as matrices.

    All contacts of the scene count: point and sphere contacts with meshes, shape contacts, and pairs of particle
    contacts. Contact couplings are forces like other couplings. μ is that of the friction model of a contact
    (``mu``, or ``mu_static`` and ``mu_dynamic``), the restitution that of its law, or 0.

    Args:
        model: From ``Scene.build``; its state is not changed. ``precision="float64"`` is recommended.
        env: Index of the environment.
        closed: Largest gap of a closed contact [m].

    Raises:
        TypeError: If ``model`` is not a model.
        ValueError: If an argument is out of range, or a contact has a friction model without Coulomb coefficients.
        RuntimeError: If a shape contact did not converge.
    """
    max_gap = float(checks.numbers("closed", closed, (), checks.limits("m", at_least=0.0)))
    assembler = Assembler(model, env)
    snapshot = assembler.environment.read()
    with assembler.environment.preserved_state():
        measured = assembler.candidates.measure(snapshot)
        return assembler.assembly(snapshot, measured, np.flatnonzero(measured.gap <= max_gap))
