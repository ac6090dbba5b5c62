"""Residuals and solutions of static contact problems.

``ResidualEvaluator`` takes displacements u and forces λ from any method. The residual is the largest of three
dimensionless violations: of equilibrium, row by row; of gaps and slips, relative to the lengths of the problem; of
forces, relative to the terms of equilibrium that they enter. ``docs/unilateral.md`` has the formulas.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.scene.status import ContactMode
from warpcontact.unilateral.delassus import Delassus, length
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem
EPS = float(np.finfo(np.float64).eps)
#: Rounding error of d, G u and their difference.
ROUNDINGS = 16.0 * EPS
# Entries of G below this fraction of the largest of the contact, in scaled units, are zero to rounding.
_NO_ENTRY = 1e-6


@dataclass(frozen=True)
class ResidualScales:
    """Lengths and forces that the residual of each problem is relative to.

    Attributes:
        length: Length of gaps and slips, (problems,).
        force: Force of each contact, (problems, contacts).
        rounding: Rounding of gaps and slips, (problems, contacts).
    """

    length: Array
    force: Array
    rounding: Array


class ResidualEvaluator:
    """Evaluates the residual of problems K u + Gᵀλ = f with gaps and slips targets − G u.

    Every array has one leading axis: problems, or length 1 if shared.

    Args:
        K: Stiffness (1 or problems, n, n), or sparse (n, n).
        f: Load (…, n).
        G: Rows of the contacts (…, contacts, dim, n).
        targets: Gaps and tangential displacements at rest (…, contacts, dim).
        mu: Coefficients of friction (…, contacts).
    """

    def __init__(self, K: Any, f: Array, G: Array, targets: Array, mu: Array) -> None:
        self.K, self.f, self.targets, self.mu = K, f, targets, mu
        # Without friction the tangents have no force.
        self.dim = G.shape[-2] if mu.any() else 1
        self.G, self.targets = G[..., : self.dim, :], targets[..., : self.dim]
        self.scale, _ = scaling(K, f, self.G, self.targets)
        self._sizes = abs(K), np.abs(self.G)
        entries = self._sizes[1].max(axis=-2)
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = entries * self.scale[:, None]
            counts = scaled > _NO_ENTRY * scaled.max(axis=-1, keepdims=True)
        # Rows that a contact enters in any problem, contact by contact.
        contact, self._entered = counts.any(axis=0).nonzero()
        self._entering, self._starts = np.unique(contact, return_index=True)
        self._counts = counts[:, contact, self._entered]
        self._entries = np.where(counts, entries, 1.0)[:, contact, self._entered]

    @staticmethod
    def of(problem: Problem) -> ResidualEvaluator:
        """Returns the evaluator of one problem or of all."""
        K, n = problem.K, problem.K.shape[-1]
        G, targets = np.asarray(problem.G), problem.targets()
        return ResidualEvaluator(
            K if hasattr(K, "tocsc") else K.reshape(-1, n, n),
            np.asarray(problem.f).reshape(-1, n),
            G if G.ndim == 4 else G[None],
            targets if targets.ndim == 3 else targets[None],
            np.atleast_2d(problem.mu),
        )

    def residual(self, u: Array, lam: Array) -> Array:
        """Returns the residual (problems,) of u (problems, n) and λ (problems, contacts, dim)."""
        lam = lam[..., : self.dim]
        with np.errstate(over="ignore", invalid="ignore"):
            terms, load, contact_terms = self._terms(u, lam)
            imbalance = np.abs(_times(self.K, u) + _forces(self.G, lam) - self.f)
            allowed = self._row_rounding(terms)
            residual = _ratio(np.maximum(imbalance - allowed, 0.0), terms).max(axis=1)
            # Forces that are much larger than the load hide it in their rounding.
            hidden = EPS * (self.scale * contact_terms).max(axis=1)
            residual = np.maximum(residual, _ratio(hidden, (self.scale * load).max(axis=1)))
            if lam.shape[1]:
                residual = np.maximum(residual, self._law_violation(u, lam).max(axis=1))
        return np.where(np.isfinite(residual), residual, np.inf)

    def scales(self, u: Array, lam: Array) -> ResidualScales:
        """Returns the scales at displacements and forces."""
        lam = lam[..., : self.dim]
        terms, _, contact_terms = self._terms(u, lam)
        size = self._sizes[1]
        moved = _rows(self.G, u)
        rounding = ROUNDINGS * (np.abs(self.targets) + _rows(size, np.abs(u))).max(axis=-1)
        given = np.maximum(_largest(self.targets), np.zeros(len(u)))
        length_scale = np.maximum(given, _largest(moved))
        diagonal = np.abs(_diagonal(self.K))
        springs = _ratio(np.abs(self.f) + contact_terms, np.broadcast_to(diagonal, terms.shape))
        deflection = np.maximum(_rows(size, springs).max(axis=(1, 2), initial=0.0), 0.0)
        # The only length of a problem without gaps.
        lengths = np.where(given == 0.0, np.maximum(length_scale, deflection), length_scale)
        return ResidualScales(np.where(lengths > 0.0, lengths, 1.0), self._force(terms), rounding)

    def _terms(self, u: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Returns the sums of the magnitudes of all terms of equilibrium, of load and springs, and of contacts."""
        load = np.abs(self.f) + _times(self._sizes[0], np.abs(u))
        contact_terms = _forces(self._sizes[1], np.abs(lam))
        return load + contact_terms, load, contact_terms

    def _row_rounding(self, terms: Array) -> Array:
        """Returns the rounding of each row, in comparable units."""
        return 4.0 * EPS * (self.scale * terms).max(axis=1, keepdims=True) / self.scale

    def _force(self, terms: Array) -> Array:
        """Returns for each contact the smallest force that equals the terms of a row that it enters."""
        rows = np.maximum(terms, self._row_rounding(terms))
        force = np.full((len(terms), self.G.shape[1]), np.inf)
        if len(self._entering):
            shares = np.where(self._counts, rows[:, self._entered] / self._entries, np.inf)
            force[:, self._entering] = np.minimum.reduceat(shares, self._starts, axis=1)
        largest = np.where(np.isfinite(force), force, 0.0).max(axis=1, initial=0.0)[:, None]
        force = np.where(np.isfinite(force) & (force > 0.0), force, largest)
        return np.where(force > 0.0, force, 1.0)

    def _law_violation(self, u: Array, lam: Array) -> Array:
        """Returns the violation of the law of each contact, (problems, contacts)."""
        scales = self.scales(u, lam)
        length_scale, force, rounding = scales.length[:, None], scales.force, scales.rounding
        w = self.targets - _rows(self.G, u)
        gap = np.sign(w[..., 0]) * np.maximum(np.abs(w[..., 0]) - rounding, 0.0)
        residual = np.abs(np.minimum(lam[..., 0] / force, gap / length_scale))
        if self.dim > 1:
            slip = length(w[..., 1:])
            # Friction acts along the displacement since rest, −w_t.
            direction = -w[..., 1:] / np.where(slip > 0.0, slip, 1.0)[..., None]
            limit = self.mu * np.maximum(lam[..., 0], 0.0)
            residual = np.maximum(residual, (length(lam[..., 1:]) - limit) / force)
            imbalance = length(lam[..., 1:] - limit[..., None] * direction)
            residual = np.maximum(
                residual, np.minimum(imbalance / force, np.maximum(slip - rounding, 0.0) / length_scale)
            )
        return np.asarray(residual, dtype=np.float64)


def scaling(K: Any, f: Array, G: Array, targets: Array, loaded: bool = False) -> tuple[Array, Array]:
    """Returns D (…, n) that scales displacements u = D v to one unit, and a stiffness of the contacts (…,).

    Rows and columns of D K D and √ρ G D are at most of order 1: D is 1/√(diagonal of K + ρ Σ G²). ρ is the largest
    stiffness of a displacement at the contacts or, without stiffness, load over gap; the larger of both if
    ``loaded``. All factors are powers of two, so that scaling does not round.
    """
    diagonal, row_squares = np.abs(_diagonal(K)), (G**2).sum(axis=(-3, -2))
    touched = row_squares > 0.0
    rho = np.where(touched, diagonal / np.where(touched, row_squares, 1.0), 0.0).max(axis=-1)
    load_ratio = np.where(touched, np.abs(f) / np.sqrt(np.where(touched, row_squares, 1.0)), 0.0).max(axis=-1)
    largest_gap = _largest(targets)
    load_stiffness = np.where(largest_gap > 0.0, load_ratio / np.where(largest_gap > 0.0, largest_gap, 1.0), 0.0)
    rho = np.maximum(rho, load_stiffness) if loaded else np.where(rho > 0.0, rho, load_stiffness)
    rho = _power_of_two(np.where(rho > 0.0, rho, 1.0))
    size = diagonal + rho[..., None] * row_squares
    # A displacement without stiffness and contact gets the scale of its neighbors.
    largest = abs(K).max(axis=-1)
    largest = np.asarray(largest.toarray() if hasattr(largest, "tocsc") else largest).reshape(-1, size.shape[-1])
    size = np.where(size > 0.0, size, largest)
    return _power_of_two(1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))), rho


def _power_of_two(values: Array) -> Array:
    return np.exp2(np.round(np.log2(values)))


def _diagonal(K: Any) -> Array:
    if hasattr(K, "tocsc"):
        return np.asarray(K.diagonal())[None]
    return np.diagonal(K, axis1=-2, axis2=-1)


def _times(K: Any, u: Array) -> Array:
    """Returns K u of each problem."""
    if hasattr(K, "tocsc"):
        return np.asarray((K @ u.T).T)
    return np.asarray(u @ K[0]) if len(K) == 1 else (K @ u[..., None])[..., 0]


def _rows(G: Array, u: Array) -> Array:
    """Returns G u, (problems, contacts, dim)."""
    rows = _flat(G)
    moved = u @ rows[0].T if len(G) == 1 else (rows @ u[..., None])[..., 0]
    return np.asarray(moved.reshape(len(u), *G.shape[1:3]))


def _forces(G: Array, lam: Array) -> Array:
    """Returns Gᵀλ, (problems, n)."""
    rows, flat = _flat(G), lam.reshape(len(lam), G.shape[1] * G.shape[2])
    return np.asarray(flat @ rows[0] if len(G) == 1 else (flat[:, None] @ rows)[:, 0])


def _flat(G: Array) -> Array:
    return G.reshape(len(G), G.shape[1] * G.shape[2], G.shape[3])


def _largest(vectors: Array) -> Array:
    """Returns the largest normal or tangential component (…, contacts, dim) of each problem."""
    normal = np.abs(vectors[..., 0]).max(axis=-1, initial=0.0)
    return np.maximum(normal, length(vectors[..., 1:]).max(axis=-1, initial=0.0))


def _ratio(part: Array, whole: Array) -> Array:
    return np.where(whole > 0.0, part / np.where(whole > 0.0, whole, 1.0), 0.0)


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
    termination: Any,
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
    arrays: dict[str, Any] = {"u": u, "lam": lam, "w": w, "gap": gap, "slip": slip, "residual": residual}
    arrays |= {"iterations": iteration_counts, "converged": converged, "status": status}
    if single:
        arrays = {name: _first(array) for name, array in arrays.items()}
        termination, direction = Termination(int(termination[0])), _first(direction)
    return Solution(**arrays, method=method, problem=problem, termination=termination, direction=direction)


def _first(batch: NDArray[Any] | None) -> Any:
    """Returns the entry of the first problem, as a Python number if it is a scalar."""
    return None if batch is None else batch[0] if batch.ndim > 1 else batch[0].item()


def _modes(system: Delassus, lam: Array, w: Array, residual: Array, tolerance: float) -> NDArray[np.int64]:
    """Returns the ``ContactMode`` of each contact; forces and slips within residual or rounding count as zero."""
    small = np.maximum(np.maximum(residual, tolerance)[:, None] * system.unit, system.rho * system.rounding)
    status = np.full(lam.shape[:2], int(ContactMode.STICK))
    slips = system.rho * length(w[..., 1:]) > 2.0 * small
    status[slips | (system.mu == 0.0)] = ContactMode.SLIP
    status[lam[..., 0] <= small] = ContactMode.OPEN
    return status
