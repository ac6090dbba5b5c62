"""Warning about a time step that is unstable for the couplings of all bodies together.

Stiffness and damping of the couplings add up. With the Jacobian J, stiffness k and damping c of each direction of a coupling,
K = Σ k Jᵀ J, C = Σ c Jᵀ J and the mass matrix M, a step h is stable if the largest eigenvalue of M⁻¹ (f h² K + 2 h C) is
below 4, where f is the factor of the integrator. Derivation for one motion of the mass m: with a = h c/m and b = h² k/m,
a step of ``SemiImplicitEuler`` has the eigenvalues λ² − (2 − a − b) λ + 1 − a = 0, and one of ``MoreauJean``
λ² − (2 − a − (½ + θ) b) λ + 1 − a + (½ − θ) b = 0. For a, b ≥ 0 and θ ≥ ½ they leave the unit circle at λ = −1, for
b + 2 a = 4 and 2 θ b + 2 a = 4: the velocity changes sign in each step. Each eigenvector x of the whole system fulfills
these equations with m = xᴴ M x, k = xᴴ K x and c = xᴴ C x, so the largest eigenvalue decides.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.forces.couplings.coupling_rows import CouplingRows, coupling_rows
from warpcontact.scene.elements import Body
from warpcontact.scene.mobility import inverse_mass
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments

#: Value of f h² k/m + 2 h c/m at the limit of stability.
LIMIT = 4.0
# Largest number of steps of power iteration, and relative change of the eigenvalue in a step at which it ends.
_ITERATIONS, _CHANGE = 300, 1.0e-5
# Number of refinements of the longest stable step; the error is squared in each.
_REFINEMENTS = 6
# Largest number of rows of a dense eigenvalue problem.
_DENSE = 36
# Number of rows in all environments that are solved together, which limits the memory.
_CHUNK = 200_000
# Part of the energy of the unstable mode from which on a coupling is named, and number of names.
_SHARE, _NAMED = 0.05, 4


@dataclass(frozen=True)
class _Modes:
    """Fastest motion of each environment.

    Attributes:
        mass: Modal mass xᵀ M x (envs,).
        stiffness: Modal stiffness xᵀ K x (envs,).
        damping: Modal damping xᵀ C x (envs,).
        energy: Part of each row in xᵀ (f h² K + 2 h C) x, (envs, rows).
    """

    mass: Array
    stiffness: Array
    damping: Array
    energy: Array

    def longest_step(self, factor: float) -> Array:
        """Returns the step at the limit of stability of this motion, (envs,) [s]; infinite without forces."""
        root = np.sqrt(self.damping**2 + LIMIT * factor * self.stiffness * self.mass)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = LIMIT * self.mass / (self.damping + root)
        return np.where(self.damping + root > 0.0, step, np.inf)


class _System:
    """All couplings of some environments; rows are their directions.

    Args:
        couplings: The couplings.
        responses: Inverse mass matrices of the bodies, (all envs, 6, 6).
        envs: Environments (n,).
    """

    def __init__(
        self, couplings: list[CouplingRows], responses: dict[Body, Array], envs: NDArray[np.intp]
    ) -> None:
        numbers: dict[Body | None, int] = {body: number for number, body in enumerate(responses)}
        # The last one stands for the world.
        numbers[None] = len(responses)
        self.response = np.stack([*(one[envs] for one in responses.values()), np.zeros((len(envs), 6, 6))], axis=1)
        self.names = [one.name for one in couplings for _ in range(one.count)]
        self.sides = [
            np.array([numbers[one.bodies[side]] for one in couplings for _ in range(one.count)]) for side in (0, 1)
        ]
        self.jacobians = [
            np.concatenate([one.jacobians[side][envs] for one in couplings], axis=1) for side in (0, 1)
        ]
        self.stiffness = np.concatenate([one.stiffness[envs] for one in couplings], axis=1)
        self.damping = np.concatenate([one.damping[envs] for one in couplings], axis=1)

    def _start(self, root: Array) -> Array:
        """Returns the row forces at which power iteration starts, (envs, rows); ``root``: square roots of the weights.

        Few rows have the eigenvector itself, because power iteration is slow if eigenvalues are close.
        """
        envs, rows = root.shape
        if rows > _DENSE:
            return np.random.default_rng(0).normal(size=root.shape)
        dense = np.zeros((envs, rows, *self.response.shape[1:3]))
        for side, jacobian in zip(self.sides, self.jacobians, strict=True):
            dense[:, np.arange(rows), side] += root[:, :, None] * jacobian
        responses = np.einsum("erbi,ebij->erbj", dense, self.response).reshape(envs, rows, -1)
        _, vectors = np.linalg.eigh(responses @ np.swapaxes(dense.reshape(envs, rows, -1), 1, 2))
        return np.asarray(vectors[:, :, -1], dtype=np.float64)

    def fastest(self, steps: Array, factor: float) -> _Modes:
        """Returns the motions with the largest eigenvalue at the time steps (envs,) [s]."""
        jacobians, response, stiffness, damping = self.jacobians, self.response, self.stiffness, self.damping
        root = np.sqrt(_weights(stiffness, damping, steps, factor))
        force = self._start(root)
        eigenvalue = np.zeros(len(steps))
        for _ in range(_ITERATIONS):
            force /= np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-300)
            wrenches = np.zeros((response.shape[1], len(steps), 6))
            for side, jacobian in zip(self.sides, jacobians, strict=True):
                np.add.at(wrenches, side, np.swapaxes(jacobian * (root * force)[:, :, None], 0, 1))
            motion = np.einsum("ebij,bej->bei", response, wrenches)
            mass = (motion * wrenches).sum(axis=(0, 2))
            speed = np.zeros_like(root)
            for side, jacobian in zip(self.sides, jacobians, strict=True):
                speed += np.einsum("eri,rei->er", jacobian, motion[side])
            force = root * speed
            before, eigenvalue = eigenvalue, (force**2).sum(axis=1) / np.maximum(mass, 1e-300)
            if (eigenvalue - before <= _CHANGE * eigenvalue).all():
                break
        energy = force**2
        total = np.maximum(energy.sum(axis=1, keepdims=True), 1e-300)
        return _Modes(mass, (stiffness * speed**2).sum(axis=1), (damping * speed**2).sum(axis=1), energy / total)


def stability_warnings(model: "Environments", dt: float, factor: float) -> list[str]:
    """Returns the warning that the time step is unstable for the couplings of a scene together, at the initial state.

    Args:
        model: The model.
        dt: Time step [s].
        factor: That of the integrator, see ``Integrator.stiffness_factor``.
    """
    couplings = [
        rows
        for one in model.scene.couplings
        if (rows := coupling_rows(model, one)) is not None and (rows.stiffness.any() or rows.damping.any())
    ]
    if not couplings:
        return []
    responses = {body: inverse_mass(model, body) for one in couplings for body in one.bodies if body is not None}
    suspects = np.flatnonzero(_bound(couplings, responses, np.full(model.envs, dt), factor) > LIMIT)
    shortest, worst = dt, -1
    size = max(1, _CHUNK // sum(one.count for one in couplings))
    for first in range(0, len(suspects), size):
        envs = suspects[first : first + size]
        steps = _System(couplings, responses, envs).fastest(np.full(len(envs), dt), factor).longest_step(factor)
        if steps.min() < shortest:
            shortest, worst = float(steps.min()), int(envs[np.argmin(steps)])
    if worst < 0:
        return []
    system = _System(couplings, responses, np.array([worst]))
    for _ in range(_REFINEMENTS):
        modes = system.fastest(np.array([shortest]), factor)
        before, shortest = shortest, min(float(modes.longest_step(factor)[0]), shortest)
        if before - shortest <= _CHANGE * shortest:
            break
    return [
        f"{_names(system, modes.energy[0])}: dt = {dt:g} s is unstable: their stiffness and damping together are stable for "
        f"dt < {shortest:.2g} s in environment {model.first_env + worst}. Use a tenth of this limit or less"
    ]


def _weights(stiffness: Array, damping: Array, steps: Array, factor: float) -> Array:
    """Returns f h² k + 2 h c of rows for time steps (envs,) [s], (envs, rows)."""
    h = steps[:, None]
    return factor * h * h * stiffness + 2.0 * h * damping


def _bound(couplings: list[CouplingRows], responses: dict[Body, Array], steps: Array, factor: float) -> Array:
    """Returns an upper bound of the largest eigenvalue at time steps (envs,) [s], (envs,).

    It is the largest sum of the traces of both bodies of a coupling. Divide each body among its couplings in proportion to
    their traces there: then each coupling with its parts of the bodies has at most this eigenvalue, and the largest
    eigenvalue of a part bounds that of the whole.
    """
    traces: dict[Body | None, Array] = {body: np.zeros(len(steps)) for body in (None, *responses)}
    for one in couplings:
        weights = _weights(one.stiffness, one.damping, steps, factor)
        for body, jacobian in zip(one.bodies, one.jacobians, strict=True):
            if body is not None:
                traces[body] += (weights * np.einsum("eri,eij,erj->er", jacobian, responses[body], jacobian)).sum(
                    axis=1
                )
    return np.max([traces[one.bodies[0]] + traces[one.bodies[1]] for one in couplings], axis=0)


def _names(system: _System, energy: Array) -> str:
    """Returns the names of the couplings with the largest parts of the energy (rows,) of a motion."""
    parts: dict[str, float] = {}
    for name, part in zip(system.names, energy.tolist(), strict=True):
        parts[name] = parts.get(name, 0.0) + part
    chosen = sorted(parts, key=lambda name: -parts[name])
    chosen = [name for name in chosen if parts[name] >= _SHARE * parts[chosen[0]]]
    more = len(chosen) - _NAMED
    return ", ".join(chosen[:_NAMED]) + (f" and {more} more" if more > 0 else "")
