"""Static contact problems K u + Gᵀλ = f with gaps d − G u ≥ 0; single problems and batches."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels.catalogue.keywords import explain_keywords, explain_keywords_of
from warpcontact.unilateral import arguments
from warpcontact.unilateral.solution import Solution
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.diagnosis import Diagnosis


@explain_keywords_of
@dataclass(eq=False)
class Problem:
    """K u + Gᵀλ = f with gap = d − G u ≥ 0, λ_n ≥ 0, gap·λ_n = 0, and Coulomb friction.

    There are n displacements and m contacts, in any consistent units, for example m and N. λ_n is positive in
    compression: the contacts exert −Gᵀλ. With friction λ_t has the direction of the slip G_t u − previous, and
    |λ_t| ≤ μ λ_n. Every argument may have one leading axis of problems; an argument without it is shared by all
    problems. For one displacement and one contact, all arguments may be numbers.

    Args:
        K: Stiffness, (n, n), symmetric; dense, or a sparse matrix of SciPy, which is factorized once for all
            problems.
        f: Load, (n,).
        G: Rows that map displacements to gap closure, (m, n). With friction (m, dim, n), dim 2 or 3: for each
            contact the row of its normal, then those of its tangents.
        d: Gaps at u = 0, (m,).
        mu: Coefficients of friction, one or (m,).
        previous: Displacements G_t u at which the contacts are at rest, one or (m, dim − 1).
        dim: Rows of a contact, 1, 2 or 3; 0: inferred from G. Only needed if ``mu`` is 0 and a ``G`` of three axes
            could be both (problems, m, n) and (m, dim, n); by default it is the first.

    Attributes:
        count: Number of problems, or ``None`` for a single problem without that axis.

    Raises:
        ValueError: If shapes do not match, K is not symmetric, or a value is out of range.
    """

    K: Any
    f: ArrayLike
    G: Any
    d: ArrayLike
    mu: ArrayLike = 0.0
    previous: ArrayLike = 0.0
    dim: int = 0
    count: int | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.K = arguments.stiffness(self.K)
        n = self.K.shape[-1]
        mu, d = arguments.values("mu", self.mu, at_least=0.0), np.atleast_1d(arguments.values("d", self.d))
        self.G, self.dim = arguments.gap_rows(self.G, n, d, bool(mu.any()), self.dim)
        m = self.G.shape[-3]
        self.f = arguments.fit("f", np.atleast_1d(arguments.values("f", self.f)), {"n": n})
        self.d = arguments.fit("d", d, {"m": m})
        self.mu = arguments.fit("mu", mu, {"m": m}, spread=True)
        across = {"m": m, "dim − 1": self.dim - 1}
        self.previous = arguments.fit("previous", arguments.values("previous", self.previous), across, spread=True)
        self.count = arguments.count_of(
            {
                "K": len(self.K) if self.K.ndim == 3 else None,
                "f": len(self.f) if self.f.ndim == 2 else None,
                "G": len(self.G) if self.G.ndim == 4 else None,
                "d": len(self.d) if self.d.ndim == 2 else None,
                "mu": len(self.mu) if self.mu.ndim == 2 else None,
                "previous": len(self.previous) if self.previous.ndim == 3 else None,
            }
        )

    def solve(
        self,
        method: str = "projection",
        *,
        tolerance: float = 1e-10,
        iterations: int | None = None,
        initial: ArrayLike | None = None,
        parameter: float | None = None,
        device: str = "cpu",
    ) -> Solution:
        """Returns a solution; arguments are those of ``solve``."""
        from warpcontact.unilateral.solving import solve_problem

        return solve_problem(self, method, tolerance, iterations, initial, parameter, device)

    def all_solutions(self, *, tolerance: float = 1e-10) -> list[Solution]:
        """Returns every solution of a single problem, by enumerating all states of its contacts.

        If solutions are not isolated, for example for contacts that share a load in any proportion, one is
        returned per state. K may be indefinite or singular.

        Raises:
            ValueError: If there are several problems, too many contacts, or friction in space.
        """
        from warpcontact.unilateral.enumeration import all_solutions

        return all_solutions(self, tolerance)

    def diagnose(self) -> Diagnosis:
        """Returns a diagnosis of existence and uniqueness for a single problem, without solving it.

        Raises:
            ValueError: If there are several problems.
        """
        from warpcontact.unilateral.diagnosis import diagnose

        return diagnose(self)

    def save(self, path: str | Path) -> Path:
        """Writes the problem to a NumPy archive that ``load`` reads, and returns its path.

        Raises:
            ValueError: If the name does not end in ``.npz``.
        """
        return arguments.save(self, path)

    @staticmethod
    def load(path: str | Path) -> Problem:
        """Returns the problem written by ``save``.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file was not written by ``save``, is damaged, or contains invalid values.
        """
        entries = arguments.read_arguments(path)
        try:
            return Problem(**entries)
        except (ValueError, TypeError, OverflowError) as error:
            raise ValueError(f"{path}: {error}") from None

    def part(self, which: NDArray[np.intp]) -> Problem:
        """Returns the problems of an index array; a single problem is repeated."""
        part = copy.copy(self)
        for name, axes in (("K", 2), ("f", 1), ("G", 3), ("d", 1), ("mu", 1), ("previous", 2)):
            array = getattr(self, name)
            if array.ndim > axes:
                setattr(part, name, array[which])
        part.count = len(which)
        return part

    def one(self, k: int) -> Problem:
        """Returns problem ``k`` as a single problem."""
        one = copy.copy(self)
        for name, axes in (("K", 2), ("f", 1), ("G", 3), ("d", 1), ("mu", 1), ("previous", 2)):
            array = getattr(self, name)
            if array.ndim > axes:
                setattr(one, name, array[k])
        one.count = None
        return one

    @property
    def contacts(self) -> int:
        """Number of contacts m."""
        return int(np.shape(self.G)[-3])

    def targets(self) -> Array:
        """Returns (d, previous), the values that G u is compared with, (…, m, dim)."""
        d, previous = np.asarray(self.d), np.asarray(self.previous)
        shape = np.broadcast_shapes(d.shape, previous.shape[:-1])
        return np.concatenate(
            [np.broadcast_to(d, shape)[..., None], np.broadcast_to(previous, (*shape, previous.shape[-1]))],
            axis=-1,
        )


@explain_keywords
def solve(
    K: Any,
    f: ArrayLike,
    G: Any,
    d: ArrayLike,
    mu: ArrayLike = 0.0,
    method: str = "projection",
    *,
    previous: ArrayLike = 0.0,
    tolerance: float = 1e-10,
    iterations: int | None = None,
    initial: ArrayLike | None = None,
    parameter: float | None = None,
    device: str = "cpu",
    dim: int = 0,
) -> Solution:
    """Returns a solution of K u + Gᵀλ = f with gap = d − G u ≥ 0, λ ≥ 0, gap·λ = 0, and Coulomb friction.

    ``Problem`` documents the shapes; there may be one problem or a batch. K may be singular or indefinite.
    ``Solution.termination`` reports for each problem whether a solution was found, whether others exist, or why
    there is none. All methods use the same residual.

    Args:
        K: Stiffness.
        f: Load.
        G: Rows that map displacements to gap closure.
        d: Gaps at u = 0.
        mu: Coefficients of friction.
        method: "enumeration": all states of the contacts, for few contacts without friction or in the plane.
            "energy": minimum of the energy by projected gradients; with friction a sequence of energies.
            "projection": semismooth Newton's method, active sets without friction. "prox": Uzawa's iteration.
            "gauss_seidel": contacts one after another, each solved exactly.
        previous: Tangential displacements at which the contacts are at rest.
        tolerance: Largest residual of a solution, dimensionless.
        iterations: Maximum number of steps or sweeps; the default is sufficient for most problems.
        initial: Initial λ, of the shape of ``Solution.lam``; zero by default.
        parameter: c of "projection" or r of "prox", one for all contacts, a stiffness; by default one per contact,
            from its compliance.
        device: Device of the iterative methods: "cpu", "cuda:0", or "auto".
        dim: Rows of a contact, if G does not determine it; see ``Problem``.

    Raises:
        ValueError: If an argument is not valid, or the method does not support the problem.

    Example:
        A spring of 1000 N/m is loaded with 30 N and reaches a wall after 20 mm, which carries the rest:

        >>> solution = wc.unilateral.solve([[1000.0]], [30.0], [[1.0]], [0.02])
        >>> solution.u.round(9), solution.lam.round(9), solution.converged
        (array([0.02]), array([10.]), True)
    """
    return Problem(K, f, G, d, mu, previous, dim).solve(
        method, tolerance=tolerance, iterations=iterations, initial=initial, parameter=parameter, device=device
    )
