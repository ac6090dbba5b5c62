"""Solves single static problems that elimination does not solve: singular or ill-conditioned K, failed methods."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.unilateral import methods
from warpcontact.unilateral.elimination import SingularError, eliminate
from warpcontact.unilateral.freedom import free_motion, gaps_infeasible, null_space, unopposed_motion
from warpcontact.unilateral.polish import refine
from warpcontact.unilateral.residual import ResidualEvaluator
from warpcontact.unilateral.scaled import ScaledProblem
from warpcontact.unilateral.solution import Termination
from warpcontact.unilateral.states import candidates, solutions
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem

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
    problem: "Problem",
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
    problem: "Problem", scaled: ScaledProblem, result: SearchResult, options: SolverOptions, guess: Array | None
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
            most = _NEWTON_STEPS[scaled.dim > 1]
            remaining = most if remaining is None else min(remaining, most)
        added = relative_stiffness / scaled.scale**2
        proximal.K, proximal.f = _with_diagonal(problem.K, added), f + added * u
        try:
            system, u_free, by_contact = eliminate(proximal)
        except SingularError:
            return
        lam, taken = methods.run(
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
