"""Diagnosis of static contact problems: existence and uniqueness of solutions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.unilateral import arguments
from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.enumeration import MAX_CONTACTS, all_states, as_solutions
from warpcontact.unilateral.scaled import (
    ZERO_EIGENVALUE,
    ScaledProblem,
    free_motion,
    null_space,
    row_null_space,
    unopposed_motion,
)
from warpcontact.unilateral.solution import ResidualEvaluator, Solution
from warpcontact.unilateral.solving import eliminate, is_regular
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

#: Eigenvalues of the Delassus matrix below this fraction of the largest count as zero.
_RANK = 1e-11
#: Maximum number of displacements for which eigenvalues of a sparse K are computed.
_DENSE = 2000
#: Maximum number of contact states for which all solutions are enumerated.
_MAX_STATES = 5000


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Existence and uniqueness of solutions of a problem; ``str()`` gives sentences.

    Attributes:
        stiffness: "positive definite", "singular" or "indefinite"; "unknown" for a large sparse, invertible K.
        rows: Rows of the Delassus matrix W = G K⁻¹ Gᵀ: normals, and with friction tangents.
        rank: Its rank, or ``None`` if K is singular.
        undetermined: Forces λ without effect, W λ = 0, as columns: shape (rows, rows − rank). If K is singular,
            forces with Gᵀλ = 0.
        exists: Whether there is a solution; ``None``: undetermined.
        unique_u: Whether u is unique; ``None``: undetermined.
        unique_lam: Whether λ is unique; ``None``: undetermined.
        mu_bound: Friction below which the solution is unique: 1/√(condition number of √ρ W √ρ). A larger μ may or
            may not give a unique solution. 0 if W is singular; ``None`` if K is not positive definite.
        solutions: All solutions, if they were enumerated: if theory does not decide and there are few contact
            states.
    """

    stiffness: str
    rows: int
    rank: int | None
    undetermined: Array
    exists: bool | None
    unique_u: bool | None
    unique_lam: bool | None
    mu_bound: float | None
    solutions: list[Solution] | None
    _text: list[str] = field(repr=False)

    def unique_sum(self, weights: ArrayLike) -> bool:
        """Returns whether Σ ``weights`` · λ is the same for all λ with the same w.

        Args:
            weights: Array of the shape of λ; for example 1 for the forces to sum, 0 for others.
        """
        given = arguments.values("weights", weights).reshape(-1)
        if given.size != self.rows:
            raise ValueError(f"weights must be {self.rows} numbers, one for each row of λ, got {given.size}")
        size = np.abs(given).max(initial=0.0)
        return bool(np.abs(given @ self.undetermined).max(initial=0.0) <= 1e-6 * size)

    def __str__(self) -> str:
        return "\n".join(self._text)


def diagnose(problem: Problem) -> Diagnosis:
    """Returns the diagnosis of a single problem."""
    if problem.count is not None:
        raise ValueError(f"diagnose() supports a single problem only, got {problem.count} problems")
    scaled = ScaledProblem.of(problem)
    stiffness, definite = _kind(problem, scaled)
    friction = bool(np.asarray(problem.mu).any())
    system = None
    if stiffness != "singular":
        system = eliminate(problem)[0]
        system = system if friction else system.normals()
    rows = problem.contacts * problem.dim if friction else problem.contacts
    rank, free, bound = None, np.zeros((rows, 0)), None
    if system is not None:
        rank, free, condition = _spectrum(system)
        if stiffness == "positive definite":
            bound = 1.0 / np.sqrt(condition) if rank == rows else 0.0
    exists: bool | None = None
    unique_u: bool | None = None
    unique_lam: bool | None = None
    largest = float(np.asarray(problem.mu).max(initial=0.0))
    if stiffness == "positive definite":
        opening = np.inf if rank == rows else _common_opening(problem, friction)
        if not friction:
            # A minimum over a convex set, which exists if the set is not empty.
            exists = opening >= 0.0
            unique_u = True if exists else None
            unique_lam = True if rank == rows else None
        else:
            exists = True if opening > 0.0 else None
            if rank == rows and bound is not None and largest < bound:
                unique_u = unique_lam = True
    elif stiffness == "singular":
        free = row_null_space(scaled.flat_rows().T)
        motions = null_space(scaled, ResidualEvaluator.of(problem).scale[0])
        load_is_held = unopposed_motion(scaled, motions) is None and _common_opening(problem, False) >= 0.0
        # Without friction, a convex energy with a lower bound has a minimum (Frank and Wolfe, 1956).
        exists = False if not load_is_held else True if definite and not friction else None
    solutions = None
    if (exists is None or unique_u is None) and _can_enumerate(problem, scaled):
        found = all_states(problem, 1e-10)[1]
        solutions = as_solutions(problem, scaled, found, 1e-10)
        exists = bool(solutions) if exists is None else exists
        if found and stiffness == "singular" and definite and not friction:
            # Solutions without friction are a convex set.
            unique_u = free_motion(scaled, motions, found[0].u, found[0].lam, 1e-10) is None
            unique_lam = unique_u and not free.shape[1]
        elif len(found) > 1:
            unique_u = all(one.same_u(found[0]) for one in found)
            unique_lam = all(one.same_lam(found[0]) for one in found)
        elif found and rank == rows:
            unique_u = unique_lam = True
    text = _sentences(stiffness, friction, rows, rank, bound, largest, exists, unique_u, unique_lam, solutions)
    return Diagnosis(stiffness, rows, rank, free, exists, unique_u, unique_lam, bound, solutions, text)


def _kind(problem: Problem, scaled: ScaledProblem) -> tuple[str, bool]:
    """Returns the kind of the stiffness, and whether it has no negative eigenvalue."""
    if not is_regular(problem, ResidualEvaluator.of(problem)).all():
        kind = "singular"
    elif hasattr(problem.K, "tocsc") and problem.K.shape[0] > _DENSE:
        return "unknown", False
    else:
        kind = ""
    if hasattr(problem.K, "tocsc") and problem.K.shape[0] > _DENSE:
        return kind, False
    sizes = np.linalg.eigvalsh(scaled.dense())
    if kind:
        return kind, bool(sizes[0] >= -ZERO_EIGENVALUE * np.abs(sizes).max())
    return ("positive definite", True) if sizes[0] > 0.0 else ("indefinite", False)


def _spectrum(system: Delassus) -> tuple[int, Array, float]:
    """Returns rank, null space and condition number of W, in the metric of the contacts."""
    scale = np.sqrt(np.repeat(system.rho[0], system.dim))
    sizes, vectors = np.linalg.eigh(scale[:, None] * system.W[0] * scale)
    if not len(sizes):
        return 0, np.zeros((0, 0)), 1.0
    zero = np.abs(sizes) <= _RANK * np.abs(sizes).max()
    condition = np.inf if zero.any() else float(np.abs(sizes).max() / np.abs(sizes).min())
    return int((~zero).sum()), scale[:, None] * vectors[:, zero], condition


def _common_opening(problem: Problem, friction: bool) -> float:
    """Returns the largest gap that all contacts can have simultaneously, relative to the largest gap, at most 1.

    Negative: the gaps cannot even be closed. With friction the tangential displacements are those at rest. If all
    gaps can be open then, a solution exists for any friction (Acary et al., "A formulation of the linear discrete
    Coulomb friction problem via convex optimization", 2011).
    """
    from scipy.optimize import linprog

    G, targets, n = np.asarray(problem.G), problem.targets(), problem.K.shape[-1]
    size = np.abs(targets).max(initial=0.0) or 1.0
    lengths = np.linalg.norm(G, axis=-1, keepdims=True)
    G, targets = G / np.where(lengths > 0.0, lengths, 1.0), targets / np.where(lengths > 0.0, lengths, 1.0)[..., 0]
    equalities = {}
    if friction:
        across = G[:, 1:].reshape(-1, n)
        equalities = {
            "A_eq": np.hstack([across, np.zeros((len(across), 1))]),
            "b_eq": targets[:, 1:].reshape(-1) / size,
        }
    found = linprog(
        np.append(np.zeros(n), -1.0),
        A_ub=np.hstack([G[:, 0], np.ones((len(G), 1))]),
        b_ub=targets[:, 0] / size,
        bounds=[(None, None)] * n + [(None, 1.0)],
        **equalities,
    )
    if found.status != 0:
        return -np.inf
    # Values within rounding of 0 are 0.
    return 0.0 if abs(found.x[-1]) < 1e-9 else float(found.x[-1])


def _can_enumerate(problem: Problem, scaled: ScaledProblem) -> bool:
    """Returns whether contact states and displacements are few enough to enumerate."""
    dim, contacts = scaled.dim, scaled.contacts
    few = dim < 3 and contacts <= MAX_CONTACTS[dim] and (2 * dim) ** contacts <= _MAX_STATES
    return few and problem.K.shape[-1] <= 200


def _sentences(
    stiffness: str,
    friction: bool,
    rows: int,
    rank: int | None,
    bound: float | None,
    mu: float,
    exists: bool | None,
    unique_u: bool | None,
    unique_lam: bool | None,
    solutions: list[Solution] | None,
) -> list[str]:
    text = [
        {
            "positive definite": "K is positive definite: displacements without contact are unique.",
            "singular": "K is singular: there are motions without elastic force.",
            "indefinite": "K is indefinite: equilibrium without contact is unstable, and the energy has no minimum.",
            "unknown": "K is invertible. Its definiteness was not checked because K is large.",
        }[stiffness]
    ]
    if rank is not None and rows:
        if rank == rows:
            text.append(f"The Delassus matrix is regular, of rank {rank}.")
        else:
            text.append(
                f"The Delassus matrix is singular, of rank {rank} of {rows}: contacts may share forces in "
                "different ways. Sums that unique_sum() confirms are unique nevertheless."
            )
    if friction and bound is not None and rank == rows:
        side = "below" if mu < bound else "not below"
        text.append(f"The largest μ, {mu:g}, is {side} {bound:.3g}, the bound of guaranteed uniqueness.")
    if solutions is not None:
        text.append(
            {0: "No contact state is admissible.", 1: "One contact state is admissible."}.get(
                len(solutions), f"{len(solutions)} different solutions were found."
            )
        )
    text.append(
        {True: "There is a solution.", False: "There is no solution.", None: "Existence is undetermined."}[exists]
    )
    if exists is not False:
        for name, value in (("u", unique_u), ("λ", unique_lam)):
            known = {True: "is unique", False: "is not unique", None: "may or may not be unique"}[value]
            text.append(f"{name} {known}.")
    return text
