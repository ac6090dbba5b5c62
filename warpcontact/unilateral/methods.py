"""Solution methods for problems in W and q: "projection", and iterations on the device; their options by name."""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.system.devices import find_device
from warpcontact.unilateral.delassus import Delassus, project
from warpcontact.unilateral.enumeration import check_size, enumerate_states
from warpcontact.validation.checks import Array, choice

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


#: Maximum number of matrix entries of all problems in one launch; limits memory.
_ENTRIES = 50_000_000
# Forces relative to the scale of the problem above which the iteration has diverged.
_DIVERGED = 1e100


def iterate(
    method: str,
    problem: Delassus,
    lam: Array,
    tolerance: float,
    iterations: int,
    parameter: float | None,
    device: str,
) -> tuple[Array, Array]:
    """Returns l and the number of iterations of each problem; l is 0 if the iteration diverged."""
    found, iteration_counts = np.empty_like(lam), np.zeros(problem.count, dtype=int)
    rows = max(problem.contacts * problem.dim, 1)
    size = max(_ENTRIES // rows**2, 1)
    for start in range(0, problem.count, size):
        part = np.arange(start, min(start + size, problem.count))
        found[part], iteration_counts[part] = _launch(
            method, problem.part(part), lam[part], tolerance, iterations, parameter, device
        )
    # The iteration diverges if W is not positive semidefinite.
    found[~(np.abs(found).max(axis=(1, 2), initial=0.0) < _DIVERGED * problem.scale)] = 0.0
    return found, iteration_counts


def _launch(
    method: str,
    problem: Delassus,
    lam: Array,
    tolerance: float,
    iterations: int,
    parameter: float | None,
    device: str,
) -> tuple[Array, Array]:
    import warp as wp

    from warpcontact.kernels.nonsmooth import dense

    count, contacts, dim = problem.q.shape
    device_field = functools.partial(wp.array, dtype=wp.float64, device=device)
    p = dense.Dense()
    p.W, p.mu, p.rho = device_field(problem.W), device_field(problem.mu), device_field(problem.rho)
    p.q, p.unit = device_field(problem.q.reshape(count, -1)), device_field(problem.unit)
    p.lam = device_field(lam.reshape(count, -1))
    p.w, p.extrapolated = wp.empty_like(p.q), wp.empty_like(p.q)
    p.step, p.shift = (wp.empty((count, contacts), dtype=wp.float64, device=device) for _ in range(2))
    p.residual = wp.empty(count, dtype=wp.float64, device=device)
    p.iterations = wp.empty(count, dtype=wp.int32, device=device)
    kernels: dict[str, Callable[[int], wp.Kernel]] = {
        "prox": dense.prox,
        "gauss_seidel": dense.gauss_seidel,
        "energy": dense.energy,
    }
    if parameter is not None:
        p.step.fill_(parameter)
    elif method != "gauss_seidel":
        wp.launch(dense.steps(dim), count, inputs=[p], device=device)
    wp.launch(kernels[method](dim), count, inputs=[p, tolerance, iterations], device=device)
    return p.lam.numpy().reshape(lam.shape), p.iterations.numpy().astype(int)


#: Default maximum number of iterations.
ITERATIONS = {"enumeration": 0, "energy": 50_000, "projection": 600, "prox": 100_000, "gauss_seidel": 20_000}
# Iterations are counted in 32 bits.
_MAX_ITERATIONS = 2**31 - 1
#: Methods with a parameter, and its name.
PARAMETERS = {"projection": "c", "prox": "r"}


def run(
    system: Delassus,
    method: str,
    tolerance: float,
    iterations: int | None,
    initial: Array | None,
    parameter: float | None,
    device: str,
) -> tuple[Array, Array]:
    """Returns l, shape (problems, contacts, dim), and the number of iterations, (problems,)."""
    check_options(method, tolerance, iterations, parameter)
    if device != "cpu":
        device = str(find_device(device))
    if system.dim > 1 and not system.mu.any():
        normals = None if initial is None else initial[..., :1]
        lam, iteration_counts = run(system.normals(), method, tolerance, iterations, normals, parameter, device)
        return np.concatenate([lam, np.zeros(system.q[..., 1:].shape)], axis=-1), iteration_counts
    if method == "enumeration":
        if initial is not None:
            raise ValueError("initial must not be given with method 'enumeration'")
        check_size(system.contacts, system.dim)
    lam = np.zeros(system.q.shape) if initial is None else np.array(initial)
    if not system.contacts or not system.count:
        return lam, np.zeros(system.count, dtype=int)
    if method == "enumeration":
        return enumerate_states(system, tolerance)
    max_iterations = ITERATIONS[method] if iterations is None else iterations
    # The residual here rounds differently from that of the methods.
    if method == "projection":
        return newton(system, lam, 0.5 * tolerance, max_iterations, parameter, device)
    return iterate(method, system, lam, 0.5 * tolerance, max_iterations, parameter, device)


def check_options(method: Any, tolerance: Any, iterations: Any, parameter: Any) -> None:
    """Raises ``ValueError`` if an option of a solution method is not valid."""
    choice("method", method, tuple(ITERATIONS))
    if not _is_number(tolerance) or not 0.0 < tolerance < 1.0:
        raise ValueError(f"tolerance must be a number between 0 and 1, got {tolerance!r}")
    if iterations is not None:
        if method == "enumeration":
            raise ValueError(f"iterations must not be given with method 'enumeration', got {iterations!r}")
        is_integer = isinstance(iterations, int | np.integer) and not isinstance(iterations, bool)
        if not is_integer or not 1 <= iterations <= _MAX_ITERATIONS:
            raise ValueError(
                f"iterations must be a whole number, at least 1 and at most {_MAX_ITERATIONS}, got {iterations!r}"
            )
    if parameter is not None:
        if method not in PARAMETERS:
            raise ValueError(f"parameter must not be given with method {method!r}, got {parameter!r}")
        if not _is_number(parameter) or not 0.0 < parameter < math.inf:
            raise ValueError(f"parameter {PARAMETERS[method]} must be a positive number, got {parameter!r}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)
