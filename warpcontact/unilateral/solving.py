"""Solution of static contact problems, given by displacements or by their Delassus matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.unilateral import intake
from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.elimination import eliminate, is_regular
from warpcontact.unilateral.enumeration import check_size
from warpcontact.unilateral.methods import check_options, run
from warpcontact.unilateral.residual import ResidualEvaluator
from warpcontact.unilateral.search import SolverOptions, search
from warpcontact.unilateral.solution import (
    RawSolution,
    Solution,
    Termination,
    solution_of_delassus,
    solution_of_displacements,
)
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem


def solve_problem(
    problem: Problem,
    method: str,
    tolerance: float,
    iterations: int | None,
    initial: ArrayLike | None,
    parameter: float | None,
    device: str,
) -> Solution:
    """Returns a solution of ``problem``."""
    check_options(method, tolerance, iterations, parameter)
    evaluator, single, flat = ResidualEvaluator.of(problem), problem.count is None, problem.dim == 1
    if method == "enumeration":
        check_size(problem.contacts, problem.dim if np.asarray(problem.mu).any() else 1)
    count = 1 if problem.count is None else problem.count
    shape = (problem.contacts, problem.dim)
    guess = None if initial is None else _guess(initial, (count, *shape), single, flat)
    if guess is not None and method == "enumeration":
        raise ValueError("initial must not be given with method 'enumeration'")
    found = RawSolution(
        np.zeros((count, problem.K.shape[-1])),
        np.zeros((count, *shape)),
        np.zeros(count, dtype=np.int64),
        np.full(count, int(Termination.NOT_CONVERGED)),
        np.zeros((count, problem.K.shape[-1])),
    )
    invertible, method_converged = is_regular(problem, evaluator), np.zeros(count, dtype=bool)
    indices = np.flatnonzero(invertible)
    if len(indices):
        part = problem if len(indices) == count else problem.part(indices)
        system, u_free, by_contact = eliminate(part)
        start = None if guess is None else guess[indices]
        lam, taken = run(system, method, tolerance, iterations, start, parameter, device)
        found.lam[indices], found.iterations[indices] = lam, taken
        found.u[indices] = u_free - (by_contact @ lam.reshape(len(indices), -1, 1))[..., 0]
        measured = system if system.mu.any() else system.normals()
        method_converged[indices] = measured.residual(lam[..., : measured.dim]) <= tolerance
    solved = invertible & (evaluator.residual(found.u, found.lam) <= tolerance)
    found.termination[solved] = Termination.CONVERGED
    options = SolverOptions(method, tolerance, iterations, parameter, device)
    for k in np.flatnonzero(~solved):
        first = (found.u[k], found.lam[k]) if invertible[k] else None
        start = None if guess is None else guess[k : k + 1]
        u, lam, result = search(
            problem.one(int(k)), options, start, first, int(found.iterations[k]), bool(method_converged[k])
        )
        found.u[k], found.lam[k], found.iterations[k] = u, lam, result.number
        found.termination[k] = result.termination
        if result.direction is not None:
            found.direction[k] = result.direction
    return solution_of_displacements(problem, evaluator, found, tolerance, method)


@explain_keywords
def solve_delassus(
    W: ArrayLike,
    q: ArrayLike,
    mu: ArrayLike = 0.0,
    method: str = "projection",
    *,
    tolerance: float = 1e-10,
    iterations: int | None = None,
    initial: ArrayLike | None = None,
    parameter: float | None = None,
    device: str = "cpu",
) -> Solution:
    """Returns a solution of w = W λ + q with w_n ≥ 0, λ_n ≥ 0, w_n λ_n = 0, and Coulomb friction.

    w is a gap, a velocity or an acceleration of the contacts, and λ the corresponding forces or impulses. λ_t is
    opposite to w_t, with |λ_t| = μ λ_n if w_t is not 0.

    Args:
        W: Delassus matrix, symmetric, (rows, rows) or (m, dim, m, dim); positive semidefinite in mechanics.
        q: (m,) without friction, or (m, dim): for each of the m contacts the normal first, then 1 or 2 tangents.
            Like W and ``mu`` it may have one leading axis of problems.
        mu: Coefficients of friction, one or (m,).
        method: As in ``solve``.
        tolerance: Largest residual of a solution.
        iterations: Maximum number of steps or sweeps.
        initial: Initial λ, of the shape of q.
        parameter: c of "projection", r of "prox".
        device: Device of the iterative methods.

    Raises:
        ValueError: If an argument is not valid or the method does not support the problem.
    """
    check_options(method, tolerance, iterations, parameter)
    matrix, right, coefficients = (
        intake.values("W", W),
        intake.values("q", q),
        intake.values("mu", mu, at_least=0.0),
    )
    if matrix.ndim in (4, 5) and matrix.shape[-4:-2] == matrix.shape[-2:]:
        rows = matrix.shape[-1] * matrix.shape[-2]
        matrix = matrix.reshape(*matrix.shape[:-4], rows, rows)
    matrix = intake.symmetric("W", matrix, "rows")
    rows, friction = matrix.shape[-1], bool(coefficients.any())
    # (1, dim) is one contact with tangents, not one problem of dim contacts without.
    one_contact = right.shape in ((1, 2), (1, 3))
    flat = not friction and right.ndim in (1, 2) and right.shape[-1] == rows and not one_contact
    if flat:
        right = right[..., None]
    fits = right.ndim in (2, 3) and right.shape[-1] in (1, 2, 3) and right.shape[-1] * right.shape[-2] == rows
    if not fits or (friction and right.shape[-1] == 1):
        raise ValueError(
            "q must be of shape (m,), or with friction (m, dim) with dim 2 or 3, or have a leading axis of "
            f"problems, with {rows} numbers per problem (rows of W), got shape {np.shape(q)}"
        )
    m = right.shape[-2]
    coefficients = intake.fit("mu", coefficients, {"m": m}, spread=True)
    count = intake.count_of(
        {
            "W": len(matrix) if matrix.ndim == 3 else None,
            "q": len(right) if right.ndim == 3 else None,
            "mu": len(coefficients) if coefficients.ndim == 2 else None,
        }
    )
    problems = 1 if count is None else count
    system = Delassus(
        matrix if matrix.ndim == 3 else matrix[None],
        np.broadcast_to(right, (problems, *right.shape[-2:])),
        np.atleast_2d(coefficients),
    )
    guess = None if initial is None else _guess(initial, system.q.shape, count is None, flat)
    lam, taken = run(system, method, tolerance, iterations, guess, parameter, device)
    return solution_of_delassus(system, lam, taken, tolerance, method, count is None, flat or system.dim == 1)


def _guess(initial: ArrayLike, wanted: tuple[int, ...], single: bool, flat: bool) -> Array:
    """Returns the initial λ, of the shape ``wanted``: (problems, m, dim)."""
    shape = {"m": wanted[1]} if flat else {"m": wanted[1], "dim": wanted[2]}
    guess = intake.fit("initial", intake.values("initial", initial), shape)
    if single and guess.ndim > len(shape):
        raise ValueError(f"initial must be of shape {tuple(shape.values())}, got shape {guess.shape}")
    if flat:
        guess = guess[..., None]
    if guess.ndim == 3 and len(guess) != wanted[0]:
        raise ValueError(f"initial must have {wanted[0]} problems, got {len(guess)}")
    return np.broadcast_to(guess, wanted)
