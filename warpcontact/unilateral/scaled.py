"""A single static problem in scaled units: motions without elastic resistance, and refinement to rounding.

In these units stiffness, load, gaps and rows are at most of order 1. With the columns of R a basis of the null
space of K, equilibrium requires Rᵀ(f − Gᵀλ) = 0: only contacts balance the load along R. The least-squares solution
λ in the friction cones either balances it, or leaves p ≠ 0; then the load does work along R p and no admissible
contact force opposes it. A second least-squares problem yields either displacements that all gaps permit, or
weights y ≥ 0 of the gaps with Gᵀy = 0 and d·y < 0 (Farkas' lemma).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.solution import ResidualEvaluator, ResidualScales, scaling
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem


@dataclass(frozen=True)
class ScaledProblem:
    """K u + Gᵀλ = f with gaps and slips targets − G u, in units computed from the problem.

    Without friction G and the targets contain only the normals. The units are powers of two, so that scaling does
    not round.

    Attributes:
        K: Stiffness (n, n), dense or sparse.
        f: Load (n,).
        G: Rows of the contacts (contacts, dim, n).
        targets: Gaps and tangential displacements at rest (contacts, dim).
        mu: Coefficients of friction (contacts,).
        scale: Unit of each displacement over ``size`` (n,).
        root: Unit of the forces over ``size``.
        size: Largest entry of load and targets before division by it.
        evaluator: Computes residuals of scaled displacements and forces.
        rows: Rows of a contact in the original problem.
    """

    K: Any
    f: Array
    G: Array
    targets: Array
    mu: Array
    scale: Array
    root: float
    size: float
    evaluator: ResidualEvaluator
    rows: int

    @staticmethod
    def of(problem: "Problem") -> "ScaledProblem":
        """Returns a single problem, scaled."""
        mu = np.asarray(problem.mu)
        dim = problem.dim if mu.any() else 1
        G, targets = np.asarray(problem.G)[:, :dim], problem.targets()[:, :dim]
        K, f = problem.K, np.asarray(problem.f)
        given = K if hasattr(K, "tocsc") else K[None]
        (scale,), (rho,) = scaling(given, f[None], G[None], targets[None], loaded=True)
        # An even power of two, so that its square root is a power of two as well.
        root = 2.0 ** round(0.5 * np.log2(rho))
        loads, gaps = scale * f, root * targets
        size = max(np.abs(loads).max(), np.abs(gaps).max(initial=0.0))
        size = 2.0 ** round(np.log2(size)) if size > 0.0 else 1.0
        if hasattr(K, "tocsc"):
            from scipy.sparse import diags_array

            K = (diags_array(scale) @ K @ diags_array(scale)).tocsc()
        else:
            K = scale[:, None] * K * scale
        f, G, targets = loads / size, root * G * scale, gaps / size
        evaluator = ResidualEvaluator(
            K if hasattr(K, "tocsc") else K[None], f[None], G[None], targets[None], mu[None]
        )
        return ScaledProblem(K, f, G, targets, mu, scale, root, size, evaluator, problem.dim)

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return len(self.mu)

    @property
    def dim(self) -> int:
        """Number of rows of a contact used here: 1 without friction."""
        return self.G.shape[1]

    def flat_rows(self) -> Array:
        """Returns all rows of G, (contacts · dim, n)."""
        return self.G.reshape(self.contacts * self.dim, self.G.shape[2])

    def dense(self) -> Array:
        """Returns K as a dense matrix."""
        return np.asarray(self.K.toarray() if hasattr(self.K, "tocsc") else self.K)

    def residual(self, u: Array, lam: Array) -> float:
        """Returns the residual of scaled displacements (n,) and forces (contacts, dim)."""
        return float(self.evaluator.residual(u[None], lam[None])[0])

    def scales(self, u: Array, lam: Array) -> ResidualScales:
        """Returns the scales of the residual at scaled displacements and forces."""
        return self.evaluator.scales(u[None], lam[None])

    def to_scaled(self, u: Array, lam: Array) -> tuple[Array, Array]:
        """Returns displacements (…, n) and forces (…, contacts, rows) of the problem in the scaled units."""
        return u / (self.size * self.scale), lam[..., : self.dim] / (self.size * self.root)

    def from_scaled(self, u: Array, lam: Array) -> tuple[Array, Array]:
        """Returns scaled displacements (…, n) and forces (…, contacts, dim) in the units of the problem."""
        forces = np.zeros((*lam.shape[:-1], self.rows))
        forces[..., : self.dim] = self.size * self.root * lam
        return self.size * self.scale * u, forces


#: Eigenvalues below this fraction of the largest are zero.
ZERO_EIGENVALUE = 1e-12
# A residual of a least-squares problem below this is rounding, in scaled units.
_RESIDUAL_TOLERANCE = 1e-10
# Number of tangents of the polygon around the friction cone in space.
_TANGENTS = 32
# Maximum number of displacements for which the null space of a sparse K is computed densely.
_DENSE = 1000
# Shift and number of steps of the subspace iteration for larger K.
_SUBSPACE_SHIFT = 1e-10
_SUBSPACE_STEPS = 6


def null_space(problem: ScaledProblem, scale: Array) -> Array:
    """Returns an orthonormal basis of the null space of the scaled K, (n, null space dimension).

    Args:
        problem: The problem.
        scale: D of ``scaling`` (n,), the scale of the stiffness, in which eigenvalues of K are compared.
    """
    K, n = problem.K, len(problem.f)
    rescale = scale / problem.scale
    if hasattr(K, "tocsc"):
        from scipy.sparse import diags_array

        K = diags_array(rescale) @ K @ diags_array(rescale)
        basis = _sparse_null_space(K) if n > _DENSE else _dense_null_space(K.toarray())
    else:
        basis = _dense_null_space(rescale[:, None] * K * rescale)
    return np.asarray(np.linalg.qr(rescale[:, None] * basis)[0])


def _dense_null_space(K: Array) -> Array:
    sizes, vectors = np.linalg.eigh(K)
    return np.asarray(vectors[:, np.abs(sizes) <= ZERO_EIGENVALUE * np.abs(sizes).max()])


def _sparse_null_space(K: Any) -> Array:
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    n = K.shape[0]
    factors = splu((K + _SUBSPACE_SHIFT * eye_array(n)).tocsc())
    size = float(abs(K).max())
    count = 8
    while True:
        basis = np.linalg.qr(np.random.default_rng(0).normal(size=(n, min(count, n))))[0]
        for _ in range(_SUBSPACE_STEPS):
            basis = np.linalg.qr(factors.solve(basis))[0]
        sizes, rescale = np.linalg.eigh(basis.T @ (K @ basis))
        zero = np.abs(sizes) <= 1e-12 * size
        if not zero.all() or count >= n:
            return np.asarray((basis @ rescale)[:, zero])
        count *= 2


def unopposed_motion(problem: ScaledProblem, free: Array) -> Array | None:
    """Returns a motion (n,) in ``free`` along which the load acts and which no contact opposes, or None."""
    if not free.shape[1]:
        return None
    load = free.T @ problem.f
    directions = _cone_edges(problem) @ free
    lengths = np.linalg.norm(directions, axis=1)
    directions = directions[lengths > _RESIDUAL_TOLERANCE] / lengths[lengths > _RESIDUAL_TOLERANCE, None]
    remainder = load - directions.T @ _nonnegative(directions.T, load)
    if np.linalg.norm(remainder) <= _RESIDUAL_TOLERANCE * np.linalg.norm(problem.f):
        return None
    return np.asarray(free @ remainder / np.linalg.norm(remainder))


def _cone_edges(problem: ScaledProblem) -> Array:
    """Returns vectors Gᵀλ (edges, n) whose nonnegative combinations are all loads that contacts can balance.

    In space they span a polygonal cone around the friction cone.
    """
    if problem.dim == 1:
        return problem.G[:, 0]
    if problem.dim == 2:
        tangential = np.array([[-1.0], [1.0]])
    else:
        angles = 2.0 * np.pi * np.arange(_TANGENTS) / _TANGENTS
        tangential = np.stack([np.cos(angles), np.sin(angles)], axis=1) / np.cos(np.pi / _TANGENTS)
    # Divided by √(1 + μ²), for large μ.
    cos = 1.0 / np.hypot(1.0, problem.mu)
    normal = cos[:, None] * problem.G[:, 0]
    tangents = (cos * problem.mu)[:, None, None] * np.einsum("ta,man->mtn", tangential, problem.G[:, 1:])
    return np.asarray((normal[:, None] + tangents).reshape(-1, problem.G.shape[2]))


def gaps_infeasible(problem: ScaledProblem) -> bool:
    """Returns whether no displacements make all gaps nonnegative."""
    rows, gaps = problem.G[:, 0], problem.targets[:, 0]
    if not (gaps < 0.0).any():
        return False
    lengths = np.linalg.norm(rows, axis=1)
    fixed = lengths <= _RESIDUAL_TOLERANCE
    if (gaps[fixed] < 0.0).any():
        return True
    rows, gaps = rows[~fixed] / lengths[~fixed, None], gaps[~fixed] / lengths[~fixed]
    matrix = np.vstack([rows.T, gaps / np.abs(gaps).max()])
    goal = np.append(np.zeros(rows.shape[1]), -1.0)
    return bool(np.linalg.norm(goal - matrix @ _nonnegative(matrix, goal)) <= _RESIDUAL_TOLERANCE)


def free_motion(problem: ScaledProblem, free: Array, u: Array, lam: Array, tolerance: float) -> Array | None:
    """Returns a motion (n,) in ``free`` that changes no force of a solution, None if u is unique.

    Closed contacts with a force stay closed, closed ones without a force may open, sticking ones stick, and
    slipping ones slip along the same line.
    """
    if not free.shape[1]:
        return None
    scales, w = problem.scales(u, lam), problem.targets - problem.G @ u
    closed_below = np.maximum(10.0 * tolerance * scales.length[0], scales.rounding[0])
    is_pressing = lam[:, 0] > 10.0 * tolerance * scales.force[0]
    is_touching = ~is_pressing & (w[:, 0] <= closed_below)
    constraints = [problem.G[is_pressing, 0] @ free]
    for i in np.flatnonzero(is_pressing & (problem.mu > 0.0)) if problem.dim > 1 else []:
        tangential, slip = problem.G[i, 1:] @ free, np.linalg.norm(w[i, 1:])
        if slip > closed_below[i]:
            e = w[i, 1:] / slip
            tangential = tangential - np.outer(e, e @ tangential)
        constraints.append(tangential)
    motions = free @ row_null_space(np.concatenate(constraints))
    if not motions.shape[1]:
        return None
    rows = problem.G[is_touching, 0] @ motions
    lengths = np.linalg.norm(rows, axis=1)
    rows = rows[lengths > _RESIDUAL_TOLERANCE] / lengths[lengths > _RESIDUAL_TOLERANCE, None]
    fixed = row_null_space(rows)
    if fixed.shape[1]:
        return np.asarray(motions @ fixed[:, 0])
    # If no motion opens some of these and closes none, positive weights balance them (Stiemke's theorem).
    opening = rows.sum(axis=0)
    remainder = -opening - rows.T @ _nonnegative(rows.T, -opening)
    size = np.linalg.norm(remainder)
    return np.asarray(motions @ remainder / size) if size > _RESIDUAL_TOLERANCE * max(1, len(rows)) else None


def row_null_space(rows: Array) -> Array:
    """Returns an orthonormal basis of the null space of ``rows``."""
    n = rows.shape[1]
    if not len(rows) or not n:
        return np.eye(n)
    _, sizes, right = np.linalg.svd(rows)
    rank = int((sizes > _RESIDUAL_TOLERANCE * max(sizes.max(initial=0.0), 1.0)).sum())
    return np.asarray(right[rank:].T)


def _nonnegative(matrix: Array, goal: Array) -> NDArray[np.float64]:
    """Returns x ≥ 0 that minimizes |matrix x − goal|."""
    from scipy.optimize import nnls

    if not matrix.shape[1]:
        return np.zeros(0)
    return np.asarray(nnls(matrix, goal, maxiter=30 * (sum(matrix.shape) + 10))[0])


# Maximum number of steps: few are needed near a solution, further ones reduce rounding.
_STEPS = 12
# Residual at which refinement stops, and residual below which a step must halve it to continue.
_ROUNDING = 1e-15
_LAST_STEP_BELOW = 1e-12
# Pivots below this fraction of the largest are zero (redundant contacts, unconstrained displacements).
_SINGULAR = 1e-12
# Maximum number of unknowns for orthogonal factorization; shift and refinement steps of larger systems.
_SMALL = 150
_SHIFT = 1e-8
_REFINEMENTS = 3


def refine(problem: ScaledProblem, u: Array, lam: Array) -> tuple[Array, Array, float]:
    """Returns displacements (n,), forces (contacts, dim) and their residual, which does not increase.

    Each step solves K u + Gᵀλ = f with the linearized equations of the state of each contact: open, closed,
    sticking or slipping. For a singular system it takes a small change. The right side is computed from u and λ
    themselves, so each step also refines the previous one.
    """
    best_u, best_lam, smallest_residual = u, lam, problem.residual(u, lam)
    for _ in range(_STEPS):
        change = _step(problem, u, lam)
        if change is None:
            break
        u, lam = u + change[0], lam + change[1]
        inside, before = _into_cone(problem.mu, lam), smallest_residual
        found = problem.residual(u, inside)
        if found < smallest_residual:
            best_u, best_lam, smallest_residual = u, inside, found
        if smallest_residual <= _ROUNDING or (before <= _LAST_STEP_BELOW and found > 0.5 * before):
            break
    return best_u, best_lam, smallest_residual


def _step(problem: ScaledProblem, u: Array, lam: Array) -> tuple[Array, Array] | None:
    """Returns the changes of u and λ in a step of Newton's method, None if the system cannot be solved."""
    n, dim = len(u), problem.dim
    scales = problem.scales(u, lam)
    rho = scales.force[0] / scales.length[0]
    w = problem.targets - problem.G @ u
    z = lam - rho[:, None] * w
    closed = np.flatnonzero(z[:, 0] > 0.0)
    change = -lam
    rows = problem.G[closed].reshape(len(closed) * dim, n)
    A, B, right = _linearized_law(problem, lam, w, z, rho, closed)
    residual = problem.f - problem.K @ u - problem.flat_rows().T @ lam.reshape(-1)
    # Forces of open contacts vanish.
    is_open = np.ones(problem.contacts, dtype=bool)
    is_open[closed] = False
    residual = residual + problem.G[is_open].reshape(-1, n).T @ lam[is_open].reshape(-1)
    right_side = np.concatenate([residual, right.reshape(-1)])
    if not (np.isfinite(right_side).all() and np.isfinite(A).all() and np.isfinite(B).all()):
        return None
    x = _solve(problem.K, rows, A, B, right_side)
    if x is None or not np.isfinite(x).all():
        return None
    change[closed] = x[n:].reshape(len(closed), dim)
    return x[:n], change


def _linearized_law(
    problem: ScaledProblem, lam: Array, w: Array, z: Array, rho: Array, closed: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Returns the linearized laws of closed contacts, A G Δu + B Δλ = right, in blocks (closed, dim, dim).

    The law is λ = (z_n, projection of z_t onto the disc of radius μ z_n), z = λ − ρ w. Rows without λ are divided
    by ρ.
    """
    dim, count = problem.dim, len(closed)
    lam, w, z, rho, mu = lam[closed], w[closed], z[closed], rho[closed], problem.mu[closed]
    A, B, right = np.zeros((count, dim, dim)), np.zeros((count, dim, dim)), np.zeros((count, dim))
    A[:, 0, 0], right[:, 0] = 1.0, w[:, 0]
    if dim == 1:
        return A, B, right
    radius, across = mu * z[:, 0], np.linalg.norm(z[:, 1:], axis=1)
    stick = across <= radius
    A[stick, 1:, 1:], right[stick, 1:] = np.eye(dim - 1), w[stick, 1:]
    for k in np.flatnonzero(~stick):
        e = z[k, 1:] / across[k]
        # λ_t − μ z_n e(z_t) = 0 with the derivative of e.
        turn = radius[k] / across[k] * (np.eye(dim - 1) - np.outer(e, e))
        B[k, 1:, 1:] = np.eye(dim - 1) - turn
        B[k, 1:, 0] = -mu[k] * e
        A[k, 1:, 1:] = -rho[k] * turn
        A[k, 1:, 0] = -rho[k] * mu[k] * e
        right[k, 1:] = -(lam[k, 1:] - radius[k] * e)
        size = max(1.0, mu[k], rho[k], rho[k] * mu[k])
        A[k, 1:], B[k, 1:], right[k, 1:] = A[k, 1:] / size, B[k, 1:] / size, right[k, 1:] / size
    return A, B, right


def _solve(K: Any, rows: Array, A: Array, B: Array, right: Array) -> Array | None:
    """Returns a small solution of [[K, rowsᵀ], [A rows, B]] x = right, None on failure.

    A large matrix is made regular by a shift, +ε in the first block and −ε in the second; refinement removes the
    effect of the shift.
    """
    count, dim = A.shape[:2]
    n, active = rows.shape[1], len(rows)
    lower = (A @ rows.reshape(count, dim, n)).reshape(active, n)
    shift = np.append(np.full(n, _SHIFT), np.full(active, -_SHIFT))
    if hasattr(K, "tocsc") and n + active > _SMALL:
        from scipy.sparse import block_array, block_diag, csc_array, diags_array
        from scipy.sparse.linalg import splu

        matrix: Any = K
        if active:
            blocks = [[K, csc_array(rows.T)], [csc_array(lower), block_diag(list(B), format="csc")]]
            matrix = block_array(blocks, format="csc")
        try:
            return _refined(matrix, splu((matrix + diags_array(shift)).tocsc()).solve, right)
        except RuntimeError:
            return None
    matrix = np.zeros((n + active, n + active))
    matrix[:n, :n] = K.toarray() if hasattr(K, "tocsc") else K
    matrix[:n, n:], matrix[n:, :n] = rows.T, lower
    k = np.arange(active).reshape(count, dim)
    matrix[n + k[:, :, None], n + k[:, None, :]] = B
    if n + active > _SMALL:
        from scipy.linalg.lapack import dgetrf, dgetrs

        factors, pivots, info = dgetrf(matrix + np.diag(shift))
        return _refined(matrix, lambda x: dgetrs(factors, pivots, x)[0], right) if info == 0 else None
    from scipy.linalg import lstsq

    return np.asarray(lstsq(matrix, right, cond=_SINGULAR, lapack_driver="gelsy")[0])


def _refined(matrix: Any, inverse: Callable[[Array], Array], right: Array) -> Array:
    """Returns x with matrix x = right, from the inverse of a nearby matrix."""
    x = inverse(right)
    for _ in range(_REFINEMENTS):
        x = x + inverse(right - matrix @ x)
    return np.asarray(x)


def _into_cone(mu: Array, lam: Array) -> Array:
    """Returns forces with nonnegative normals and friction of at most μ times these."""
    lam = lam.copy()
    lam[:, 0] = np.maximum(lam[:, 0], 0.0)
    across = np.linalg.norm(lam[:, 1:], axis=1)
    share = np.minimum(1.0, mu * lam[:, 0] / np.where(across > 0.0, across, 1.0))
    lam[:, 1:] *= share[:, None]
    return lam
