"""Solutions of static contact problems, and the result of the search for them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.scene.status import ContactMode
from warpcontact.unilateral.delassus import Delassus, length
from warpcontact.unilateral.residual import ResidualEvaluator
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem


class Termination(IntEnum):
    """Result of the search for a solution.

    CONVERGED: A solution to the tolerance. NOT_UNIQUE: A solution, but K is singular and u can move along
    ``direction`` with the same forces. NOT_CONVERGED: The method found no solution; there may be one.
    UNBOUNDED: No equilibrium exists, because the load acts along ``direction``, which neither K nor any contact
    opposes. INFEASIBLE: No displacements satisfy all gaps. NO_SOLUTION: All states of the contacts were checked,
    and none is a solution.
    """

    CONVERGED = 0
    NOT_UNIQUE = 1
    NOT_CONVERGED = 2
    UNBOUNDED = 3
    INFEASIBLE = 4
    NO_SOLUTION = 5


@dataclass(frozen=True, eq=False)
class Solution:
    """Displacements, contact forces, their residual and the result of the search.

    With several problems every array has one leading axis. Units are those of the problem.

    Attributes:
        u: Displacements, shape (n,); ``None`` for a problem given by its Delassus matrix.
        lam: Contact forces λ, shape (contacts,), or (contacts, dim) if contacts have tangents, the normal first.
        w: w = W λ + q, of the shape of ``lam``: the gap, and the tangential velocity or displacement.
        gap: Normal part of ``w``, shape (contacts,).
        slip: Tangential part, (contacts, dim − 1), or ``None``. For a problem in u: displacement since the contact
            was at rest, G_t u − previous, parallel to λ_t. For a problem in W and q: w_t, opposite to λ_t.
        residual: Violation of equilibrium and of the law of contact, relative to the lengths and forces of the
            problem; ``docs/unilateral.md`` defines it.
        iterations: Number of steps, sweeps or states of the method.
        converged: Whether ``residual`` is within the tolerance, for a solution whose existence is not excluded.
        status: ``ContactMode`` of each contact, (contacts,). A closed contact without friction is SLIP.
        active: Whether each contact is closed, that is, has a normal force.
        method: Name of the method.
        problem: The problem, or ``None`` if it was given by its Delassus matrix.
        termination: ``Termination`` of the search: kind of solution, or reason why there is none.
        direction: Displacements (n,) of largest component 1 along which a problem is ``UNBOUNDED`` or a solution
            ``NOT_UNIQUE``, zero in other problems; ``None`` if no problem has one.
    """

    u: Array | None
    lam: Array
    w: Array
    gap: Array
    slip: Array | None
    residual: Any
    iterations: Any
    converged: Any
    status: NDArray[np.int64]
    method: str
    problem: Problem | None = field(default=None, repr=False)
    termination: Any = Termination.NOT_CONVERGED
    direction: Array | None = None

    @property
    def active(self) -> NDArray[np.bool_]:
        """Whether each contact has a normal force."""
        return self.status != ContactMode.OPEN


@dataclass
class RawSolution:
    """Displacements and forces of a batch of problems, before conversion to a ``Solution``.

    Attributes:
        u: Displacements (problems, n).
        lam: Forces (problems, contacts, dim).
        iterations: Iterations (problems,).
        termination: ``Termination`` (problems,).
        direction: Directions (problems, n), zero if there is none.
    """

    u: Array
    lam: Array
    iterations: NDArray[np.int64]
    termination: NDArray[np.int64]
    direction: Array


def solution_of_displacements(
    problem: Problem, evaluator: ResidualEvaluator, found: RawSolution, tolerance: float, method: str
) -> Solution:
    """Returns the solution of problems in displacements, in the shapes of their arguments."""
    u, lam = found.u, found.lam
    w = problem.targets() - np.einsum("...mdn,...n->...md", problem.G, u)
    residual, scales = evaluator.residual(u, lam), evaluator.scales(u, lam)
    # Forces and slips within the residual or rounding count as zero.
    allowed = np.minimum(np.maximum(residual, tolerance), 1.0)[:, None]
    status = np.full(lam.shape[:2], int(ContactMode.STICK))
    slips = length(w[..., 1:]) > 2.0 * (allowed * scales.length[:, None] + scales.rounding)
    status[slips | (np.atleast_2d(problem.mu) == 0.0)] = ContactMode.SLIP
    status[lam[..., 0] <= allowed * scales.force] = ContactMode.OPEN
    direction = found.direction if found.direction.any() else None
    return _shaped(
        u, lam, w, -1.0, residual, found.iterations, found.termination, direction, status, method, problem
    )


def solution_of_delassus(
    system: Delassus,
    lam: Array,
    iteration_counts: NDArray[Any],
    tolerance: float,
    method: str,
    single: bool,
    flat: bool,
) -> Solution:
    """Returns the solution of problems in W and q, in the shapes of their arguments."""
    w = system.velocity(lam)
    measured = system if system.mu.any() else system.normals()
    residual = measured.residual(lam[..., : measured.dim], w[..., : measured.dim])
    termination = np.where(residual <= tolerance, Termination.CONVERGED, Termination.NOT_CONVERGED)
    status = _modes(system, lam, w, residual, tolerance)
    return _shaped(
        None, lam, w, 1.0, residual, iteration_counts, termination, None, status, method, None, single, flat
    )


def _shaped(
    u: Array | None,
    lam: Array,
    w: Array,
    sign: float,
    residual: Array,
    iteration_counts: NDArray[Any],
    termination: NDArray[Any],
    direction: Array | None,
    status: NDArray[np.int64],
    method: str,
    problem: Problem | None,
    single: bool | None = None,
    flat: bool | None = None,
) -> Solution:
    if problem is not None:
        single, flat = problem.count is None, problem.dim == 1
    gap, slip = w[..., 0], None if flat else sign * w[..., 1:]
    if flat:
        lam, w = lam[..., 0], w[..., 0]
    converged = termination <= Termination.NOT_UNIQUE
    if not single:
        return Solution(
            u,
            lam,
            w,
            gap,
            slip,
            residual,
            iteration_counts,
            converged,
            status,
            method,
            problem,
            termination,
            direction,
        )
    return Solution(
        None if u is None else u[0],
        lam[0],
        w[0],
        gap[0],
        None if slip is None else slip[0],
        float(residual[0]),
        int(iteration_counts[0]),
        bool(converged[0]),
        status[0],
        method,
        problem,
        Termination(int(termination[0])),
        None if direction is None else direction[0],
    )


def _modes(system: Delassus, lam: Array, w: Array, residual: Array, tolerance: float) -> NDArray[np.int64]:
    """Returns the ``ContactMode`` of each contact; forces and slips within residual or rounding count as zero."""
    small = np.maximum(np.maximum(residual, tolerance)[:, None] * system.unit, system.rho * system.rounding)
    status = np.full(lam.shape[:2], int(ContactMode.STICK))
    slips = system.rho * length(w[..., 1:]) > 2.0 * small
    status[slips | (system.mu == 0.0)] = ContactMode.SLIP
    status[lam[..., 0] <= small] = ContactMode.OPEN
    return status
