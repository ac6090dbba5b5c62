"""A single static problem in scaled units, in which stiffness, load, gaps and rows are at most of order 1."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.unilateral.residual import ResidualEvaluator, ResidualScales, scaling
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
