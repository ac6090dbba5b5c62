"""Solution of static contact problems, given by displacements or by their Delassus matrix.

Displacements are eliminated. Single problems for which this fails, with a singular or ill-conditioned K, and those
that a method does not solve, are solved by a search.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.unilateral import arguments
from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.enumeration import candidates, check_size, solutions
from warpcontact.unilateral.methods import check_options, run
from warpcontact.unilateral.scaled import (
    ScaledProblem,
    free_motion,
    gaps_infeasible,
    null_space,
    refine,
    unopposed_motion,
)
from warpcontact.unilateral.solution import (
    ROUNDINGS,
    RawSolution,
    ResidualEvaluator,
    Solution,
    Termination,
    solution_of_delassus,
    solution_of_displacements,
)
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

#: A scaled matrix is singular if an eigenvalue is below this fraction of the largest; entries round to less.
SINGULAR = 1e-12


class SingularError(ValueError):
    """Raised if K cannot be inverted: there are motions without elastic force."""


def eliminate(problem: Problem) -> tuple[Delassus, Array, Array]:
    """Returns the problem w = W λ + q with W = G K⁻¹ Gᵀ, the displacements K⁻¹ f, and K⁻¹ Gᵀ.

    Shapes: (problems, n) and (problems or 1, n, rows).

    Raises:
        SingularError: If any K is exactly singular, or a sparse K is singular to rounding.
    """
    n, contacts = problem.K.shape[-1], problem.contacts
    count = 1 if problem.count is None else problem.count
    G = np.asarray(problem.G)
    G = G.reshape(-1 if G.ndim == 4 else 1, contacts * problem.dim, n) if G.size else np.zeros((1, 0, n))
    f = np.asarray(problem.f).reshape(-1, n)
    transposed = np.swapaxes(G, -1, -2)
    if hasattr(problem.K, "tocsc"):
        inverse = _sparse(problem.K)
        by_contact = np.stack([inverse(one) for one in transposed])
        u_free = inverse(f.T).T
    else:
        K = np.asarray(problem.K).reshape(-1, n, n)
        try:
            by_contact = np.linalg.solve(K, transposed)
            u_free = np.linalg.solve(K, f[..., None])[..., 0]
        except np.linalg.LinAlgError:
            raise SingularError from None
    W = G @ by_contact
    W = 0.5 * (W + np.swapaxes(W, -1, -2))
    u_free = np.broadcast_to(u_free, (count, n))
    targets, shape = problem.targets(), (count, contacts, problem.dim)
    q = targets - (G @ u_free[..., None])[..., 0].reshape(shape)
    magnitudes = np.abs(targets) + (np.abs(G) @ np.abs(u_free)[..., None])[..., 0].reshape(shape)
    return Delassus(W, q, np.atleast_2d(problem.mu), ROUNDINGS * magnitudes.max(axis=2)), u_free, by_contact


def is_regular(problem: Problem, evaluator: ResidualEvaluator) -> NDArray[np.bool_]:
    """Returns whether the K of each problem can be inverted, independent of units; (problems,)."""
    count, n = 1 if problem.count is None else problem.count, problem.K.shape[-1]
    if hasattr(problem.K, "tocsc"):
        try:
            _sparse(problem.K)
        except SingularError:
            return np.zeros(count, dtype=bool)
        return np.ones(count, dtype=bool)
    K = np.asarray(problem.K).reshape(-1, n, n)
    scale = (
        evaluator.scale if len(evaluator.scale) == len(K) else np.broadcast_to(evaluator.scale[:1], (len(K), n))
    )
    found = np.empty(len(K), dtype=bool)
    for i, one in enumerate(scale[:, :, None] * K * scale[:, None, :]):
        try:
            # Fraction of each diagonal entry that is independent of the other displacements.
            pivots = np.diagonal(np.linalg.cholesky(one)) ** 2 / np.diagonal(one)
            found[i] = pivots.min() > SINGULAR
        except np.linalg.LinAlgError:
            sizes = np.abs(np.linalg.eigvalsh(one))
            found[i] = sizes.min() > SINGULAR * sizes.max()
    return np.broadcast_to(found, (count,))


def _sparse(K: Any) -> Any:
    """Returns a function that solves with K, which is factorized once."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    diagonal = np.abs(K.diagonal())
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    try:
        factors = splu((diags_array(scale) @ K @ diags_array(scale)).tocsc())
    except RuntimeError:
        raise SingularError from None
    pivots = np.abs(factors.U.diagonal())
    if pivots.min() <= SINGULAR * pivots.max():
        raise SingularError
    return lambda right: scale[:, None] * factors.solve(scale[:, None] * right)


# Stiffness added by each proximal step, relative to that of the displacement and its contacts, for "projection"
# and for iterative methods; its minimum; maximum number of steps.
_ADDED_DIRECT = 1e-6
_ADDED = 1e-3
_LEAST_ADDED = 1e-9
_STEPS = 40
# Factor on it if the method does not converge in a step, applied at most twice.
_STIFFENING = 30.0
# Maximum number of Newton steps of a proximal step, without and with friction.
_NEWTON_STEPS = (50, 120)
# Scaled displacements above which the steps have diverged.
_FARTHEST = 1e12
# Maximum number of contact states and displacements that "projection" enumerates if Newton's method fails.
_FEW_STATES = 4096
_FEW_DISPLACEMENTS = 100


@dataclass(frozen=True)
class SolverOptions:
    """Validated options of a method."""

    method: str
    tolerance: float
    iterations: int | None
    parameter: float | None
    device: str


@dataclass
class SearchResult:
    """Result of a single problem, in scaled units.

    Attributes:
        u: Displacements (n,).
        lam: Forces (contacts, dim).
        residual: Their residual.
        number: Number of iterations.
        termination: Result of the search.
        direction: Motion (n,) along which it is unbounded or not unique.
    """

    u: Array
    lam: Array
    residual: float
    number: int
    termination: Termination = Termination.NOT_CONVERGED
    direction: Array | None = None


def search(
    problem: Problem,
    options: SolverOptions,
    guess: Array | None,
    start: tuple[Array, Array] | None,
    taken: int,
    method_converged: bool,
) -> tuple[Array, Array, SearchResult]:
    """Returns displacements (n,), forces (contacts, dim), and the result of a single problem.

    Args:
        problem: The problem.
        options: Options of the method.
        guess: Initial forces, or None for zero.
        start: Displacements and forces that the method found by elimination, None if K is singular.
        taken: Number of iterations of the method so far.
        method_converged: Whether the method converged by its own residual.
    """
    scaled = ScaledProblem.of(problem)
    singular = start is None
    n, contacts = len(scaled.f), scaled.contacts
    if start is None:
        u, lam = np.zeros(n), np.zeros((contacts, scaled.dim))
    else:
        u, lam = scaled.to_scaled(*start)
    result = SearchResult(u, lam, scaled.residual(u, lam), taken)
    free = null_space(scaled, ResidualEvaluator.of(problem).scale[0]) if singular else np.zeros((n, 0))
    limited = options.iterations is not None and not method_converged
    if not singular and not limited:
        _keep_refined(scaled, result, u, lam)
    if result.residual > options.tolerance:
        _prove_no_solution(scaled, free, result)
    if result.termination == Termination.NOT_CONVERGED and result.residual > options.tolerance:
        can_enumerate = (2 * scaled.dim) ** contacts <= _FEW_STATES and scaled.dim < 3 and n <= _FEW_DISPLACEMENTS
        if options.method == "enumeration":
            _by_states(scaled, result, options.tolerance)
        else:
            if singular or method_converged:
                _by_proximal_steps(problem, scaled, result, options, guess)
            if (
                result.residual > options.tolerance
                and options.method == "projection"
                and can_enumerate
                and not limited
            ):
                _by_states(scaled, result, options.tolerance)
    if result.residual <= options.tolerance:
        result.termination = Termination.CONVERGED
        result.direction = free_motion(scaled, free, result.u, result.lam, options.tolerance)
        if result.direction is not None:
            result.termination = Termination.NOT_UNIQUE
    if result.direction is not None:
        motion = scaled.scale * result.direction
        result.direction = motion / np.abs(motion).max()
    return *scaled.from_scaled(result.u, result.lam), result


def _keep_refined(scaled: ScaledProblem, result: SearchResult, u: Array, lam: Array) -> None:
    """Polishes displacements and forces, and stores them if they have a smaller residual."""
    u, lam, residual = refine(scaled, u, lam)
    if residual <= result.residual:
        result.u, result.lam, result.residual = u, lam, residual


def _prove_no_solution(scaled: ScaledProblem, free: Array, result: SearchResult) -> None:
    """Stores the proof that there is no solution, if one is found."""
    if gaps_infeasible(scaled):
        result.termination = Termination.INFEASIBLE
        return
    result.direction = unopposed_motion(scaled, free)
    if result.direction is not None:
        result.termination = Termination.UNBOUNDED


def _by_states(scaled: ScaledProblem, result: SearchResult, tolerance: float) -> None:
    """Stores the first contact state that is a solution, or the one of least residual."""
    state = next(solutions(scaled, tolerance), None)
    if state is None:
        result.termination = Termination.NO_SOLUTION
        state = min(candidates(scaled), key=lambda one: one.residual)
        result.number += (2 * scaled.dim) ** scaled.contacts
    else:
        result.number += state.number
    if state.residual <= result.residual:
        result.u, result.lam, result.residual = state.u, state.lam, state.residual


def _by_proximal_steps(
    problem: Problem, scaled: ScaledProblem, result: SearchResult, options: SolverOptions, guess: Array | None
) -> None:
    """Repeats proximal steps: solves (K + δ) u' + Gᵀλ = f + δ u with the method, and continues from u = u'.

    Without friction and with K positive semidefinite, the steps converge to a solution if there is one
    (Rockafellar, 1976). Each is refined, which ends them once the contact states are right.
    """
    proximal, u, f = problem.one(0), np.zeros(len(scaled.f)), np.asarray(problem.f)
    relative_stiffness, last_state, stiffenings = _added_stiffness(scaled, options.method), None, 2
    for _ in range(_STEPS):
        remaining = None if options.iterations is None else options.iterations - result.number
        if remaining is not None and remaining <= 0:
            return
        if options.method == "projection":
            # If more Newton steps are needed, they cycle.
            max_steps = _NEWTON_STEPS[scaled.dim > 1]
            remaining = max_steps if remaining is None else min(remaining, max_steps)
        added = relative_stiffness / scaled.scale**2
        proximal.K, proximal.f = _with_diagonal(problem.K, added), f + added * u
        try:
            system, u_free, by_contact = eliminate(proximal)
        except SingularError:
            return
        lam, taken = run(
            system, options.method, options.tolerance, remaining, guess, options.parameter, options.device
        )
        result.number += int(taken[0])
        measured = system if system.mu.any() else system.normals()
        residual = measured.residual(lam[..., : measured.dim])[0]
        new = u_free[0] - by_contact[0] @ lam.reshape(-1)
        now = scaled.to_scaled(new, lam[0])
        if residual <= options.tolerance and np.abs(now[0]).max() < _FARTHEST:
            u, guess, state = new, lam, (lam[0, :, 0] > 0.0).tobytes()
            # Without friction, the same closed contacts lead to the same solution.
            if scaled.dim > 1 or state != last_state:
                _keep_refined(scaled, result, *now)
            last_state = state
            if result.residual <= options.tolerance:
                return
        elif stiffenings:
            # Shorter proximal steps are easier to solve.
            relative_stiffness, stiffenings = _STIFFENING * relative_stiffness, stiffenings - 1
        else:
            return


def _added_stiffness(scaled: ScaledProblem, method: str) -> float:
    """Returns the added stiffness, small enough for the load to close the gaps of unconstrained displacements."""
    load, gap = np.abs(scaled.f).max(), np.abs(scaled.targets).max(initial=0.0)
    relative_stiffness = _ADDED_DIRECT if method == "projection" else _ADDED
    return float(np.clip(0.01 * load / gap, _LEAST_ADDED, relative_stiffness)) if gap > 0.0 else relative_stiffness


def _with_diagonal(K: Any, added: Array) -> Any:
    if hasattr(K, "tocsc"):
        from scipy.sparse import diags_array

        return (K + diags_array(added)).tocsc()
    return K + np.diag(added)


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
        arguments.values("W", W),
        arguments.values("q", q),
        arguments.values("mu", mu, at_least=0.0),
    )
    if matrix.ndim in (4, 5) and matrix.shape[-4:-2] == matrix.shape[-2:]:
        rows = matrix.shape[-1] * matrix.shape[-2]
        matrix = matrix.reshape(*matrix.shape[:-4], rows, rows)
    matrix = arguments.symmetric("W", matrix, "rows")
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
    coefficients = arguments.fit("mu", coefficients, {"m": m}, spread=True)
    count = arguments.count_of(
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
    guess = arguments.fit("initial", arguments.values("initial", initial), shape)
    if single and guess.ndim > len(shape):
        raise ValueError(f"initial must be of shape {tuple(shape.values())}, got shape {guess.shape}")
    if flat:
        guess = guess[..., None]
    if guess.ndim == 3 and len(guess) != wanted[0]:
        raise ValueError(f"initial must have {wanted[0]} problems, got {len(guess)}")
    return np.broadcast_to(guess, wanted)
