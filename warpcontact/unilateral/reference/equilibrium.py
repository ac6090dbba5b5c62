"""Static equilibrium of rigid bodies in contact: whether they stay at rest, and the contact forces."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.scene.status import ContactMode
from warpcontact.unilateral.reference.acceleration import (
    FRICTION_METHODS,
    SINGULAR,
    find_contact_modes,
    force_basis,
)
from warpcontact.unilateral.reference.contacts import Assembler, Assembly
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

# Accelerations below this fraction of the largest one without contact count as rest.
AT_REST = 1.0e-8


@dataclass(frozen=True)
class Equilibrium:
    """Result of ``equilibrium``: whether bodies in contact stay at rest, and the contact forces.

    The forces are one admissible choice: redundant contacts may share a load in many ways; ``determined`` marks
    unique forces. Accelerations, and sums that are determined, are the same for all choices.

    Attributes:
        assembly: The closed contacts and the bodies.
        holds: Whether all bodies stay at rest.
        mode: ``ContactMode`` of each contact (contacts,): STICK if it holds, SLIP and OPEN if it will slip or
            open. A contact without friction that has a normal force is SLIP.
        force: Forces on the first body of each contact (contacts, 3), world [N].
        normal_force: Their normal part (contacts,) [N].
        determined: Whether the force is unique (contacts,).
        normal_determined: Whether its normal part is unique (contacts,).
        linear_acceleration: Accelerations of the bodies (bodies, 3), world [m/s²].
        angular_acceleration: Angular accelerations of the bodies (bodies, 3), world axes [rad/s²].
        residual: Largest normal acceleration of a contact with a force, over the largest acceleration without
            contact [-].
    """

    assembly: Assembly
    holds: bool
    mode: NDArray[np.int_]
    force: Array
    normal_force: Array
    determined: NDArray[np.bool_]
    normal_determined: NDArray[np.bool_]
    linear_acceleration: Array
    angular_acceleration: Array
    residual: float

    def force_of(self, name: str) -> Array:
        """Returns the sum of the forces of a contact on its first bodies (3,), world [N].

        Raises:
            KeyError: If no item of a contact of that name is closed.
        """
        own = self.assembly.names == name
        if not own.any():
            there = ", ".join(dict.fromkeys(self.assembly.names)) or "none"
            raise KeyError(f"contact {name!r} is not closed; closed contacts: {there}")
        total: Array = self.force[own].sum(axis=0)
        return total

    @property
    def body_force(self) -> Array:
        """Sum of the contact forces on each body (bodies, 3), world [N]; unique for free bodies."""
        return self._wrench[:, :3]

    @property
    def body_torque(self) -> Array:
        """Sum of their torques about the center of mass (bodies, 3), world axes [N·m]."""
        return self._wrench[:, 3:]

    @property
    def _wrench(self) -> Array:
        own = (self.assembly.axes @ self.force[..., None])[..., 0]
        return (self.assembly.rows.T @ own.reshape(-1)).reshape(-1, 6)

    def __str__(self) -> str:
        own = self.assembly
        if self.holds:
            lines = [f"in equilibrium: {own.count} closed contacts, {len(own.body_names)} bodies at rest"]
        else:
            moves = np.linalg.norm(self.linear_acceleration, axis=1) + np.linalg.norm(
                self.angular_acceleration, axis=1
            )
            largest = moves.max()
            names = [name for name, size in zip(own.body_names, moves, strict=True) if size > AT_REST * largest]
            shown = ", ".join(names[:6]) + (", …" if len(names) > 6 else "")
            lines = [f"not in equilibrium: {shown} would move, under {own.count} closed contacts"]
            for name, a, alpha in zip(
                own.body_names, self.linear_acceleration, self.angular_acceleration, strict=True
            ):
                if name in names[:6]:
                    lines.append(f"  {name}: {_vector(a)} m/s², {_vector(alpha)} rad/s²")
        for label, mode, force, only in zip(own.labels, self.mode, self.force, self.determined, strict=True):
            if mode != ContactMode.OPEN:
                choice = "" if only else ", not unique"
                lines.append(f"  {label}: {ContactMode(mode).name}, {_vector(force)} N{choice}")
        return "\n".join(lines)


@explain_keywords
def equilibrium(model: Any, env: int = 0, closed: float = 1.0e-6, method: str = "gauss_seidel") -> Equilibrium:
    """Returns whether the bodies of one environment, assumed at rest in their current poses, stay at rest.

    All contacts are rigid, with Coulomb friction; see ``assemble`` for contacts and coefficients. Loads are
    gravity, couplings, external wrenches and reactions of joints.

    Args:
        model: From ``Scene.build``; its state is not changed. ``precision="float64"`` is recommended.
        env: Index of the environment.
        closed: Largest gap of a closed contact [m].
        method: Method of ``wc.unilateral.solve_delassus`` that supports friction in space.

    Returns:
        Whether it holds, the contact forces, and the accelerations of all bodies.

    Raises:
        TypeError: If ``model`` is not a model.
        ValueError: If an argument is out of range, or a contact has a friction model without Coulomb coefficients.
        RuntimeError: If a shape contact did not converge.
        ParadoxError: If no accelerations were found.
    """
    max_gap = float(checks.numbers("closed", closed, (), checks.limits("m", at_least=0.0)))
    checks.choice("method", method, FRICTION_METHODS)
    assembler = Assembler(model, env)
    at_rest = assembler.environment.read().with_velocity(np.zeros(6 * assembler.bodies.count))
    with assembler.environment.preserved_state():
        measured = assembler.candidates.measure(at_rest)
        own = assembler.assembly(at_rest, measured, np.flatnonzero(measured.gap <= max_gap))
    # At rest: without accelerations of prescribed motion.
    own = replace(own, free_acceleration=own.inverse_mass @ own.force)
    return _solved(own, method)


def _solved(own: Assembly, method: str) -> Equilibrium:
    count = own.count
    b = (own.rows @ own.free_acceleration).reshape(count, 3)
    found = find_contact_modes(
        own.delassus,
        b,
        own.mu_static,
        own.mu,
        np.zeros((count, 2)),
        np.zeros(count, dtype=bool),
        own.labels,
        method,
    )
    acceleration = own.accelerations(found.force)
    scale = np.abs(own.free_acceleration).max(initial=0.0) or 1.0
    pressed = found.force[:, 0] > 0.0
    violation = np.where(pressed, found.acceleration[:, 0], np.minimum(found.acceleration[:, 0], 0.0))
    free = _undetermined(own, found.mode, found.direction)
    return Equilibrium(
        assembly=own,
        holds=bool(np.abs(acceleration).max(initial=0.0) <= AT_REST * scale),
        mode=found.mode,
        force=(found.force[:, None, :] @ own.axes)[:, 0],
        normal_force=found.force[:, 0],
        determined=np.logical_not(free.any(axis=1)),
        normal_determined=np.logical_not(free[:, 0]),
        linear_acceleration=acceleration.reshape(-1, 6)[:, :3],
        angular_acceleration=acceleration.reshape(-1, 6)[:, 3:],
        residual=float(np.abs(violation).max(initial=0.0) / scale),
    )


def _undetermined(own: Assembly, mode: NDArray[np.int_], direction: Array) -> NDArray[np.bool_]:
    """Returns the force components that differ in another solution (contacts, 3)."""
    basis = force_basis(mode, direction, own.mu)
    effect = own.inverse_mass @ own.rows.T @ basis
    if not basis.shape[1]:
        return np.zeros((own.count, 3), dtype=bool)
    _, sizes, right = np.linalg.svd(effect)
    rank = int((sizes > SINGULAR * sizes.max(initial=0.0)).sum())
    undetermined = np.abs(basis @ right[rank:].T).max(axis=1, initial=0.0).reshape(own.count, 3)
    # Far above the rounding of a null space of unit vectors.
    return undetermined > 1.0e-8


def _vector(values: Array) -> str:
    # Components within rounding of the largest are shown as 0.
    shown = np.where(np.abs(values) > AT_REST * np.abs(values).max(), values, 0.0)
    return "(" + ", ".join(f"{value:.6g}" for value in shown) + ")"
