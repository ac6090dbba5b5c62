"""What can be said of a static contact problem before it is solved: existence and uniqueness."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.unilateral import intake
from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.elimination import eliminate, is_regular
from warpcontact.unilateral.enumeration import MAX_CONTACTS
from warpcontact.unilateral.freedom import (
    ZERO_EIGENVALUE,
    free_motion,
    null_space,
    row_null_space,
    unopposed_motion,
)
from warpcontact.unilateral.residual import ResidualEvaluator
from warpcontact.unilateral.scaled import ScaledProblem
from warpcontact.unilateral.solution import Solution
from warpcontact.unilateral.states import all_states, as_solutions
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

#: Part of the largest eigenvalue below which one of the Delassus matrix counts as zero.
_RANK = 1e-11
#: Most displacements of a sparse K whose eigenvalues are looked at.
_DENSE = 2000
#: Most states for which all solutions are looked for.
_MAX_STATES = 5000


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is known of the solutions of a problem; ``str()`` says it in sentences.

    Attributes:
        stiffness: "positive definite", "singular" or "indefinite"; "unknown" of a large sparse K with an inverse.
        rows: Rows of the Delassus matrix W = G K⁻¹ Gᵀ: normals, and with friction tangents.
        rank: Its rank, or ``None`` if K is singular.
        undetermined: Forces λ that change nothing, W λ = 0, as columns: shape (rows, rows − rank). If K is
            singular, forces with Gᵀλ = 0.
        exists: Whether there is a solution; ``None``: not known.
        unique_u: Whether there is only one u.
        unique_lam: Whether there is only one λ.
        mu_bound: Friction below which the solution is unique: 1/√(largest over smallest eigenvalue) of √ρ W √ρ.
            Above it that is not known. 0 if W is singular; ``None`` if K is not positive definite.
        solutions: All of them, where they were looked for: where theory does not tell, and there are few states.
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
        """Returns whether Σ ``weights`` · λ is the same for all λ that belong to one w.

        Args:
            weights: Of the shape of λ: 1 for the forces that are summed, 0 for others, for example.
        """
        given = intake.values("weights", weights).reshape(-1)
        if given.size != self.rows:
            raise ValueError(f"weights must be {self.rows} numbers, one for each row of λ, got {given.size}")
        size = np.abs(given).max(initial=0.0)
        return bool(np.abs(given @ self.undetermined).max(initial=0.0) <= 1e-6 * size)

    def __str__(self) -> str:
        return "\n".join(self._text)


def diagnose(problem: Problem) -> Diagnosis:
    """Returns what can be said of a single problem."""
    if problem.count is not None:
        raise ValueError(f"one problem at a time is diagnosed, got {problem.count} problems")
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
            # A minimum over a convex set, if that is not empty.
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
        # Without friction a convex energy that has a lower bound has a minimum (Frank and Wolfe, 1956).
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
    """Returns the kind of the stiffness, and whether no eigenvalue is negative."""
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
    """Returns the rank of W, what it takes to zero, and its condition, in the metric of the contacts."""
    scale = np.sqrt(np.repeat(system.rho[0], system.dim))
    sizes, vectors = np.linalg.eigh(scale[:, None] * system.W[0] * scale)
    if not len(sizes):
        return 0, np.zeros((0, 0)), 1.0
    zero = np.abs(sizes) <= _RANK * np.abs(sizes).max()
    condition = np.inf if zero.any() else float(np.abs(sizes).max() / np.abs(sizes).min())
    return int((~zero).sum()), scale[:, None] * vectors[:, zero], condition


def _common_opening(problem: Problem, friction: bool) -> float:
    """Returns how open all gaps can be at once, in units of the largest, at most 1; negative: not even closed.

    With friction, at rest along the tangents: if all gaps can be open then, there is a solution whatever the
    friction (Acary and others, "A formulation of the linear discrete Coulomb friction problem via convex
    optimization", 2011).
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
    # What rounding leaves of a room is none.
    return 0.0 if abs(found.x[-1]) < 1e-9 else float(found.x[-1])


def _can_enumerate(problem: Problem, scaled: ScaledProblem) -> bool:
    """Returns whether there are few states of the contacts, and few displacements."""
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
            "singular": "K is singular: something can move without force.",
            "indefinite": "K is indefinite: equilibrium without contact is unstable, and no energy has a minimum.",
            "unknown": "K has an inverse; whether it is positive definite was not looked at, it is large.",
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
        text.append(
            f"The largest μ, {mu:g}, is {side} {bound:.3g}, up to which the solution is known to be unique."
        )
    if solutions is not None:
        text.append(
            {0: "No state of the contacts is admissible.", 1: "One state of the contacts is admissible."}.get(
                len(solutions), f"{len(solutions)} different solutions were found."
            )
        )
    text.append(
        {True: "There is a solution.", False: "There is no solution.", None: "Existence is not known."}[exists]
    )
    if exists is not False:
        for name, value in (("u", unique_u), ("λ", unique_lam)):
            known = {True: "is unique", False: "is not unique", None: "may or may not be unique"}[value]
            text.append(f"{name} {known}.")
    return text
