"""Semismooth Newton methods on the projections of all contacts at once: method "projection"."""

import numpy as np
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.unilateral.delassus import Delassus, project
from warpcontact.unilateral.iterations import iterate

# Steps of Newton's method before another method looks for a better start, which, and how many of its sweeps.
_STEPS = 30
_OTHERS = (("gauss_seidel", 50), ("prox", 1000))
# Exchanges of all that is wrong that may fail to help before one by one is exchanged.
_PATIENCE = 10
_ROUNDING = 1e-15
# Rows from which on it pays to leave open contacts out of each system.
_LARGE = 90
# Forces over those that q asks for, beyond which a step is taken to have failed.
_FARTHEST = 1e10
# A pivot of W this small, over the contact's own flexibility, says that W is singular.
_SINGULAR = 1e-12
# How much of its diagonal such a W is lifted by, and how often the lift is taken back.
_LIFT = 1e-7
_LIFTS = 30


def newton(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None, device: str
) -> tuple[Array, Array]:
    """Returns l and the Newton steps taken of each problem. ``parameter``: c, the ρ of the projections."""
    if problem.dim == 1:
        return _lifted(problem, lam, tolerance, iterations, parameter)
    return _with_friction(problem, lam, tolerance, iterations, parameter, device)


def _lifted(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None
) -> tuple[Array, Array]:
    """Solves without friction; a singular W is lifted, and each solution is where the next one is lifted from."""
    singular = np.broadcast_to(_is_singular(problem), problem.count)
    regular = np.flatnonzero(~singular)
    found, taken = lam.copy(), np.zeros(problem.count, dtype=int)
    if len(regular):
        found[regular], taken[regular] = _active_sets(
            problem.part(regular), lam[regular], tolerance, iterations, parameter
        )
    left = np.flatnonzero(singular)
    for _ in range(_LIFTS):
        left = left[problem.part(left).residual(found[left]) > tolerance]
        most = iterations - int(taken[left].max(initial=0))
        if not len(left) or most <= 0:
            break
        part = problem.part(left)
        lift = _LIFT / part.rho
        near = Delassus(
            part.W + lift[:, :, None] * np.eye(part.contacts),
            part.q - lift[..., None] * found[left],
            part.mu,
            part.rounding,
        )
        found[left], steps = _active_sets(near, found[left], tolerance, most, parameter)
        taken[left] += steps
    for k in np.flatnonzero(problem.residual(found) > tolerance):
        one = problem.part(np.array([k]))
        other = _least_distance(one)
        if other is not None and one.residual(other[None])[0] < one.residual(found[k : k + 1])[0]:
            found[k] = other
    return found, taken


def _least_distance(problem: Delassus) -> Array | None:
    """Returns l (contacts, 1) of a single problem without friction, None if W is not positive semidefinite.

    With W = AᵀA it is the point y = A l nearest to 0 with Aᵀy ≥ −q, by nonnegative least squares (Lawson and
    Hanson, 1974). These end for any redundancy of the contacts.
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
    # Without a rest there is no such point.
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
    """Newton's method for l − max(0, l − c w) = 0: those with l − c w > 0 are closed in the next step.

    When that goes round in circles, one contact at a time is exchanged, the last that is wrong: with W positive
    definite that ends (Júdice and Pires, 1994).
    """
    c = problem.rho if parameter is None else np.full_like(problem.rho, parameter)
    lam, taken = lam[..., 0].copy(), np.zeros(problem.count, dtype=int)
    left = np.arange(problem.count)
    size = problem.contacts
    part, rho = problem, np.broadcast_to(c, (problem.count, size))
    closed = lam - rho * part.velocity(lam[..., None])[..., 0] > 0.0
    fewest, patience = np.full(len(left), size + 1), np.full(len(left), _PATIENCE)
    for _ in range(iterations):
        W = np.broadcast_to(part.W, (len(left), size, size))
        both = closed[:, :, None] & closed[:, None, :]
        matrix = np.where(both, W, np.eye(size))
        lam[left] = _solve(matrix, np.where(closed, -part.q[..., 0], 0.0))
        taken[left] += 1
        w = part.velocity(lam[left][..., None])[..., 0]
        # Rounding is not what makes a contact open or close.
        slack = 1e-14 * part.unit
        wrong = np.where(closed, lam[left] < -slack, rho * w < -slack)
        number = wrong.sum(axis=1)
        better = number < fewest
        fewest = np.where(better, number, fewest)
        patience = np.where(better, _PATIENCE, patience - 1)
        last = size - 1 - np.argmax(wrong[:, ::-1], axis=1)
        single = patience < 0
        change = np.where(single[:, None], np.arange(size) == last[:, None], wrong)
        closed = np.where(number[:, None] > 0, closed ^ change, closed)
        go_on = number > 0
        if not go_on.any():
            break
        left, closed, rho = left[go_on], closed[go_on], rho[go_on]
        fewest, patience, part = fewest[go_on], patience[go_on], problem.part(left)
    return np.maximum(lam, 0.0)[..., None], taken


def _solve(matrix: Array, right: Array) -> Array:
    """Returns the solutions of many systems, some of which may be singular."""
    try:
        found = np.linalg.solve(matrix, right[..., None])
    except np.linalg.LinAlgError:
        size = np.abs(matrix).max(axis=(1, 2))
        lift = np.where(np.linalg.slogdet(matrix)[0] == 0.0, 1e-10 * np.where(size > 0.0, size, 1.0), 0.0)
        found = np.linalg.solve(matrix + lift[:, None, None] * np.eye(matrix.shape[-1]), right[..., None])
    return np.asarray(found, dtype=np.float64)[..., 0]


def _with_friction(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None, device: str
) -> tuple[Array, Array]:
    """Newton's method from l; where it fails, in turn from sweeps of others and from anywhere in the cones."""
    found, taken = lam.copy(), np.zeros(problem.count, dtype=int)
    reached, left = problem.residual(found), np.arange(problem.count)
    random, start, effort = np.random.default_rng(0), found, 1
    for trial, steps in enumerate(range(0, iterations, _STEPS)):
        part = problem.part(left)
        most = min(_STEPS, iterations - steps)
        new, more = _friction_steps(part, start, tolerance, most, parameter, damped=trial % 3 > 0 or trial == 0)
        taken[left] += more
        residual = part.residual(new)
        better = residual < reached[left]
        found[left[better]], reached[left[better]] = new[better], residual[better]
        left = left[reached[left] > tolerance]
        if not len(left):
            break
        part = problem.part(left)
        if trial % 3 < 2:
            method, sweeps = _OTHERS[trial % 3]
            start, _ = iterate(method, part, found[left], tolerance, effort * sweeps, None, device)
        else:
            effort *= 2
            # The same of each problem, whatever others there are.
            shape = random.exponential(1.0, (problem.contacts, 1)) * random.normal(0.0, 1.0, problem.q.shape[1:])
            start = project(part.scale[:, None, None] * shape, part.mu)
    return found, taken


def _friction_steps(
    problem: Delassus, lam: Array, tolerance: float, iterations: int, parameter: float | None, damped: bool
) -> tuple[Array, Array]:
    """Newton's method on Alart and Curnier's projections; ``damped``: steps that do not lead closer are cut."""
    best, taken = lam.copy(), np.zeros(problem.count, dtype=int)
    reached = problem.residual(best)
    left = np.flatnonzero(reached > tolerance)
    now = best[left]
    for _ in range(iterations):
        if not len(left):
            break
        part = problem.part(left)
        step, size = _direction(part, now, parameter)
        # The shortest of these is taken if none leads closer: it gets out of a corner.
        length, ahead = np.ones(len(left)), now + step
        after = _misfit(part, ahead, parameter)
        for _ in range(5 if damped else 0):
            worse = ~(after < (1.0 - 1e-4 * length) * size)
            if not worse.any():
                break
            length[worse] *= 0.4
            ahead[worse] = now[worse] + length[worse][:, None, None] * step[worse]
            after[worse] = _misfit(part.part(np.flatnonzero(worse)), ahead[worse], parameter)
        # What a nearly singular step threw away does not come back by itself.
        size = np.abs(ahead).max(axis=(1, 2))
        now = np.where((size < _FARTHEST * part.scale)[:, None, None], ahead, 0.0)
        taken[left] += 1
        # Into the cone: what a step leaves outside is less than the residual, or is none of ours.
        inside = _into_cone(part, now)
        residual = part.residual(inside)
        better = residual < reached[left]
        best[left[better]], reached[left[better]] = inside[better], residual[better]
        go_on = reached[left] > tolerance
        left, now = left[go_on], now[go_on]
    return best, taken


def _into_cone(problem: Delassus, lam: Array) -> Array:
    lam = lam.copy()
    lam[..., 0] = np.maximum(lam[..., 0], 0.0)
    across = np.linalg.norm(lam[..., 1:], axis=-1)
    share = np.minimum(1.0, problem.mu * lam[..., 0] / np.where(across > 0.0, across, 1.0))
    lam[..., 1:] *= share[..., None]
    return lam


def _projected(problem: Delassus, lam: Array, parameter: float | None) -> tuple[Array, Array, Array]:
    """Returns (max(0, z_n), the point of the disc of radius μ z_n nearest z_t), z = l − ρ w, and ρ."""
    rho = problem.rho if parameter is None else np.full_like(problem.rho, parameter)
    z = lam - rho[..., None] * problem.velocity(lam)
    normal = np.maximum(z[..., 0], 0.0)
    across = np.linalg.norm(z[..., 1:], axis=-1)
    share = np.minimum(1.0, problem.mu * normal / np.where(across > 0.0, across, 1.0))
    return np.concatenate([normal[..., None], share[..., None] * z[..., 1:]], axis=-1), z, rho


def _misfit(problem: Delassus, lam: Array, parameter: float | None) -> Array:
    away, flat = lam - _projected(problem, lam, parameter)[0], (problem.count, -1)
    # A step to where everything drowns in rounding is none.
    drowned = _ROUNDING * np.linalg.norm(lam.reshape(flat), axis=1)
    size = np.linalg.norm(away.reshape(flat), axis=1) + drowned
    return np.where(np.isfinite(size), size, np.inf)


def _direction(problem: Delassus, lam: Array, parameter: float | None) -> tuple[Array, Array]:
    """Returns Newton's step for l − P(l − ρ w) = 0 and the size of the left side."""
    count, contacts, dim = lam.shape
    target, z, rho = _projected(problem, lam, parameter)
    F = lam - target
    radius = problem.mu * np.maximum(z[..., 0], 0.0)
    across = np.linalg.norm(z[..., 1:], axis=-1)
    closed, stick = z[..., 0] > 0.0, across <= radius
    d = z[..., 1:] / np.where(across > 0.0, across, 1.0)[..., None]
    # Derivative of the projections by z, one block for each contact.
    D = np.zeros((count, contacts, dim, dim))
    D[..., 0, 0] = closed
    ratio = np.where(closed & ~stick, radius / np.where(across > 0.0, across, 1.0), 0.0)
    turn = ratio[..., None, None] * (np.eye(dim - 1) - d[..., :, None] * d[..., None, :])
    D[..., 1:, 1:] = np.where((closed & stick)[..., None, None], np.eye(dim - 1), turn)
    slip = closed & ~stick
    D[..., 1:, 0] = np.where(slip[..., None], problem.mu[..., None] * d, 0.0)
    size = np.linalg.norm(F.reshape(count, -1), axis=1)
    # dF = dl − D (dl − ρ W dl)
    if contacts * dim > _LARGE:
        steps = [
            _closed_step(problem.W[k % len(problem.W)], F[k], D[k], rho[k % len(rho)], closed[k])
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


def _closed_step(W: Array, F: Array, D: Array, rho: Array, closed: NDArray[np.bool_]) -> Array:
    """Returns Newton's step of a single problem. What is open goes to 0; a system is left for what is closed."""
    step, dim = -F, F.shape[1]
    rows = np.repeat(closed, dim)
    count = int(closed.sum())
    across = W[rows].reshape(count, dim, -1)
    A = ((D[closed] * rho[closed, None, None]) @ across).reshape(count * dim, -1)
    J = A[:, rows]
    k = np.arange(count * dim).reshape(count, dim)
    J[k[:, :, None], k[:, None, :]] += np.eye(dim) - D[closed]
    right = -F[closed].reshape(-1) - A[:, ~rows] @ step.reshape(-1)[~rows]
    step[closed] = _solve(J[None], right[None])[0].reshape(count, dim)
    return step
