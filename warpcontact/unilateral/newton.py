"""Method "projection": semismooth Newton methods on the projections of all contacts."""

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.delassus import Delassus, project
from warpcontact.unilateral.iterations import iterate
from warpcontact.validation.checks import Array

# Newton steps before a restart, and the methods that compute the start, with their number of sweeps.
_STEPS = 30
_RESTART_METHODS = (("gauss_seidel", 50), ("prox", 1000))
# Number of steps without improvement of the active set before single contacts are exchanged.
_MAX_STALLED = 10
_ROUNDING = 1e-15
# Number of rows from which on open contacts are eliminated from each system.
_LARGE = 90
# Forces relative to the scale of the problem above which a step has failed.
_FARTHEST = 1e10
# W is singular if a pivot is below this, relative to the compliance of the contact.
_SINGULAR = 1e-12
# Shift of the diagonal of a singular W, and maximum number of proximal steps that remove its effect.
_SHIFT = 1e-7
_MAX_SHIFTS = 30


def newton(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None, device: str
) -> tuple[Array, Array]:
    """Returns l and the number of Newton steps of each problem. ``parameter``: c, the ρ of the projections."""
    if problem.dim == 1:
        return _regularized(problem, lam, tolerance, iterations, parameter)
    return _with_friction(problem, lam, tolerance, iterations, parameter, device)


def _regularized(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None
) -> tuple[Array, Array]:
    """Solves without friction; a singular W is shifted, with proximal steps from solution to solution."""
    singular = np.broadcast_to(_is_singular(problem), problem.count)
    regular = np.flatnonzero(~singular)
    found, iteration_counts = lam.copy(), np.zeros(problem.count, dtype=int)
    if len(regular):
        found[regular], iteration_counts[regular] = _active_sets(
            problem.part(regular), lam[regular], tolerance, iterations, parameter
        )
    remaining = np.flatnonzero(singular)
    for _ in range(_MAX_SHIFTS):
        remaining = remaining[problem.part(remaining).residual(found[remaining]) > tolerance]
        allowed = iterations - int(iteration_counts[remaining].max(initial=0))
        if not len(remaining) or allowed <= 0:
            break
        part = problem.part(remaining)
        shift = _SHIFT / part.rho
        shifted = Delassus(
            part.W + shift[:, :, None] * np.eye(part.contacts),
            part.q - shift[..., None] * found[remaining],
            part.mu,
            part.rounding,
        )
        found[remaining], steps = _active_sets(shifted, found[remaining], tolerance, allowed, parameter)
        iteration_counts[remaining] += steps
    for k in np.flatnonzero(problem.residual(found) > tolerance):
        one = problem.part(np.array([k]))
        other = _least_distance(one)
        if other is not None and one.residual(other[None])[0] < one.residual(found[k : k + 1])[0]:
            found[k] = other
    return found, iteration_counts


def _least_distance(problem: Delassus) -> Array | None:
    """Returns l (contacts, 1) of a single problem without friction, None if W is not positive semidefinite.

    With W = AᵀA, y = A l is the point nearest to 0 with Aᵀy ≥ −q, found by nonnegative least squares (Lawson and
    Hanson, 1974), which terminates for any redundancy of the contacts.
    """
    from scipy.optimize import nnls

    root = np.sqrt(problem.rho[0])
    sizes, vectors = np.linalg.eigh(root[:, None] * problem.W[0] * root)
    if sizes[0] < -_SINGULAR * sizes[-1]:
        return None
    counts = sizes > _SINGULAR * sizes[-1]
    q = root * problem.q[0, :, 0]
    size = np.abs(q).max(initial=0.0) or 1.0
    matrix = np.vstack([np.sqrt(sizes[counts])[:, None] * vectors[:, counts].T, -q / size])
    goal = np.append(np.zeros(int(counts.sum())), 1.0)
    try:
        weights = nnls(matrix, goal)[0]
    except RuntimeError:
        return None
    rest = (goal - matrix @ weights)[-1]
    # A zero residual means that no such point exists.
    return (size * root * weights / rest)[:, None] if rest > _SINGULAR else None


def _is_singular(problem: Delassus) -> NDArray[np.bool_]:
    """Returns whether each W is not positive definite to rounding, in the metric of the contacts."""
    out = np.ones(len(problem.W), dtype=bool)
    size = np.sqrt(problem.rho)
    for k, one in enumerate(size[:, :, None] * problem.W * size[:, None, :]):
        try:
            pivots = np.diagonal(np.linalg.cholesky(one)) ** 2
        except np.linalg.LinAlgError:
            continue
        out[k] = pivots.min(initial=np.inf) <= _SINGULAR
    return out


def _active_sets(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None
) -> tuple[Array, Array]:
    """Returns the result of Newton's method for l − max(0, l − c w) = 0 (active sets), and the number of steps.

    Contacts with l − c w > 0 are closed in the next step. If the method cycles, only the last wrong contact is
    exchanged; with W positive definite this terminates (Júdice and Pires, 1994).
    """
    c = problem.rho if parameter is None else np.full_like(problem.rho, parameter)
    lam, iteration_counts = lam[..., 0].copy(), np.zeros(problem.count, dtype=int)
    remaining = np.arange(problem.count)
    size = problem.contacts
    part, rho = problem, np.broadcast_to(c, (problem.count, size))
    closed = lam - rho * part.velocity(lam[..., None])[..., 0] > 0.0
    fewest, stalled_left = np.full(len(remaining), size + 1), np.full(len(remaining), _MAX_STALLED)
    for _ in range(iterations):
        W = np.broadcast_to(part.W, (len(remaining), size, size))
        both = closed[:, :, None] & closed[:, None, :]
        matrix = np.where(both, W, np.eye(size))
        lam[remaining] = _solve(matrix, np.where(closed, -part.q[..., 0], 0.0))
        iteration_counts[remaining] += 1
        w = part.velocity(lam[remaining][..., None])[..., 0]
        # Rounding must not open or close a contact.
        slack = 1e-14 * part.unit
        wrong = np.where(closed, lam[remaining] < -slack, rho * w < -slack)
        number = wrong.sum(axis=1)
        better = number < fewest
        fewest = np.where(better, number, fewest)
        stalled_left = np.where(better, _MAX_STALLED, stalled_left - 1)
        last = size - 1 - np.argmax(wrong[:, ::-1], axis=1)
        single = stalled_left < 0
        change = np.where(single[:, None], np.arange(size) == last[:, None], wrong)
        closed = np.where(number[:, None] > 0, closed ^ change, closed)
        unfinished = number > 0
        if not unfinished.any():
            break
        remaining, closed, rho = remaining[unfinished], closed[unfinished], rho[unfinished]
        fewest, stalled_left, part = fewest[unfinished], stalled_left[unfinished], problem.part(remaining)
    return np.maximum(lam, 0.0)[..., None], iteration_counts


def _solve(matrix: Array, right: Array) -> Array:
    """Returns the solutions of many systems, some of which may be singular."""
    try:
        found = np.linalg.solve(matrix, right[..., None])
    except np.linalg.LinAlgError:
        size = np.abs(matrix).max(axis=(1, 2))
        shift = np.where(np.linalg.slogdet(matrix)[0] == 0.0, 1e-10 * np.where(size > 0.0, size, 1.0), 0.0)
        found = np.linalg.solve(matrix + shift[:, None, None] * np.eye(matrix.shape[-1]), right[..., None])
    return np.asarray(found, dtype=np.float64)[..., 0]


def _with_friction(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None, device: str
) -> tuple[Array, Array]:
    """Runs Newton's method from l and, on failure, from iterates of other methods and from random points."""
    found, iteration_counts = lam.copy(), np.zeros(problem.count, dtype=int)
    residuals, remaining = problem.residual(found), np.arange(problem.count)
    random, start, sweep_factor = np.random.default_rng(0), found, 1
    for trial, steps in enumerate(range(0, iterations, _STEPS)):
        part = problem.part(remaining)
        allowed = min(_STEPS, iterations - steps)
        new, more = _friction_steps(part, start, tolerance, allowed, parameter, damped=trial % 3 > 0 or trial == 0)
        iteration_counts[remaining] += more
        residual = part.residual(new)
        better = residual < residuals[remaining]
        found[remaining[better]], residuals[remaining[better]] = new[better], residual[better]
        remaining = remaining[residuals[remaining] > tolerance]
        if not len(remaining):
            break
        part = problem.part(remaining)
        if trial % 3 < 2:
            method, sweeps = _RESTART_METHODS[trial % 3]
            start, _ = iterate(method, part, found[remaining], tolerance, sweep_factor * sweeps, None, device)
        else:
            sweep_factor *= 2
            # The same random numbers for each problem, independent of the number of problems.
            shape = random.exponential(1.0, (problem.contacts, 1)) * random.normal(0.0, 1.0, problem.q.shape[1:])
            start = project(part.scale[:, None, None] * shape, part.mu)
    return found, iteration_counts


def _friction_steps(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None, damped: bool
) -> tuple[Array, Array]:
    """Runs Newton's method on Alart and Curnier's projections; ``damped``: line search on the residual."""
    best, iteration_counts = lam.copy(), np.zeros(problem.count, dtype=int)
    residuals = problem.residual(best)
    remaining = np.flatnonzero(residuals > tolerance)
    now = best[remaining]
    for _ in range(iterations):
        if not len(remaining):
            break
        part = problem.part(remaining)
        step, size = _direction(part, now, parameter)
        # If no length decreases the residual, the shortest is used, to leave the point of stagnation.
        length, trial = np.ones(len(remaining)), now + step
        after = _residual_norm(part, trial, parameter)
        for _ in range(5 if damped else 0):
            worse = ~(after < (1.0 - 1e-4 * length) * size)
            if not worse.any():
                break
            length[worse] *= 0.4
            trial[worse] = now[worse] + length[worse][:, None, None] * step[worse]
            after[worse] = _residual_norm(part.part(np.flatnonzero(worse)), trial[worse], parameter)
        # Reset after a nearly singular step; the iteration would not return by itself.
        size = np.abs(trial).max(axis=(1, 2))
        now = np.where((size < _FARTHEST * part.scale)[:, None, None], trial, 0.0)
        iteration_counts[remaining] += 1
        # Project into the cone: a converged step leaves less than the residual outside.
        inside = _into_cone(part, now)
        residual = part.residual(inside)
        better = residual < residuals[remaining]
        best[remaining[better]], residuals[remaining[better]] = inside[better], residual[better]
        unfinished = residuals[remaining] > tolerance
        remaining, now = remaining[unfinished], now[unfinished]
    return best, iteration_counts


def _into_cone(problem: Delassus, lam: Array) -> Array:
    lam = lam.copy()
    lam[..., 0] = np.maximum(lam[..., 0], 0.0)
    tangential = np.linalg.norm(lam[..., 1:], axis=-1)
    scale = np.minimum(1.0, problem.mu * lam[..., 0] / np.where(tangential > 0.0, tangential, 1.0))
    lam[..., 1:] *= scale[..., None]
    return lam


def _projected(problem: Delassus, lam: Array, parameter: float | None) -> tuple[Array, Array, Array]:
    """Returns (max(0, z_n), projection of z_t onto the disc of radius μ z_n), z = l − ρ w, and ρ."""
    rho = problem.rho if parameter is None else np.full_like(problem.rho, parameter)
    z = lam - rho[..., None] * problem.velocity(lam)
    normal = np.maximum(z[..., 0], 0.0)
    tangential = np.linalg.norm(z[..., 1:], axis=-1)
    scale = np.minimum(1.0, problem.mu * normal / np.where(tangential > 0.0, tangential, 1.0))
    return np.concatenate([normal[..., None], scale[..., None] * z[..., 1:]], axis=-1), z, rho


def _residual_norm(problem: Delassus, lam: Array, parameter: float | None) -> Array:
    deviation, flat = lam - _projected(problem, lam, parameter)[0], (problem.count, -1)
    # Penalizes a step to forces so large that the residual is rounding.
    rounding = _ROUNDING * np.linalg.norm(lam.reshape(flat), axis=1)
    size = np.linalg.norm(deviation.reshape(flat), axis=1) + rounding
    return np.where(np.isfinite(size), size, np.inf)


def _direction(problem: Delassus, lam: Array, parameter: float | None) -> tuple[Array, Array]:
    """Returns Newton's step for l − P(l − ρ w) = 0 and the norm of the left side."""
    count, contacts, dim = lam.shape
    target, z, rho = _projected(problem, lam, parameter)
    F = lam - target
    radius = problem.mu * np.maximum(z[..., 0], 0.0)
    tangential = np.linalg.norm(z[..., 1:], axis=-1)
    closed, stick = z[..., 0] > 0.0, tangential <= radius
    d = z[..., 1:] / np.where(tangential > 0.0, tangential, 1.0)[..., None]
    # Derivative of the projections with respect to z, one block per contact.
    D = np.zeros((count, contacts, dim, dim))
    D[..., 0, 0] = closed
    ratio = np.where(closed & ~stick, radius / np.where(tangential > 0.0, tangential, 1.0), 0.0)
    turn = ratio[..., None, None] * (np.eye(dim - 1) - d[..., :, None] * d[..., None, :])
    D[..., 1:, 1:] = np.where((closed & stick)[..., None, None], np.eye(dim - 1), turn)
    slip = closed & ~stick
    D[..., 1:, 0] = np.where(slip[..., None], problem.mu[..., None] * d, 0.0)
    size = np.linalg.norm(F.reshape(count, -1), axis=1)
    # dF = dl − D (dl − ρ W dl)
    if contacts * dim > _LARGE:
        steps = [
            _active_step(problem.W[k % len(problem.W)], F[k], D[k], rho[k % len(rho)], closed[k])
            for k in range(count)
        ]
        step = np.stack(steps)
        return np.where(np.isfinite(step), step, 0.0), size
    W = problem.W.reshape(-1, contacts, dim, contacts * dim)
    J = np.einsum("biac,bicn->bian", D * rho[..., None, None], W).reshape(count, contacts * dim, -1)
    k = np.arange(contacts * dim).reshape(contacts, dim)
    J[:, k[:, :, None], k[:, None, :]] += np.eye(dim) - D
    step = -_solve(J, F.reshape(count, -1)).reshape(lam.shape)
    return np.where(np.isfinite(step), step, 0.0), size


def _active_step(W: Array, F: Array, D: Array, rho: Array, closed: NDArray[np.bool_]) -> Array:
    """Returns Newton's step of a single problem: open contacts go to 0, closed ones solve a system."""
    step, dim = -F, F.shape[1]
    rows = np.repeat(closed, dim)
    count = int(closed.sum())
    tangential = W[rows].reshape(count, dim, -1)
    A = ((D[closed] * rho[closed, None, None]) @ tangential).reshape(count * dim, -1)
    J = A[:, rows]
    k = np.arange(count * dim).reshape(count, dim)
    J[k[:, :, None], k[:, None, :]] += np.eye(dim) - D[closed]
    right = -F[closed].reshape(-1) - A[:, ~rows] @ step.reshape(-1)[~rows]
    step[closed] = _solve(J[None], right[None])[0].reshape(count, dim)
    return step
