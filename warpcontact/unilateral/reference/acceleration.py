"""Modes of closed contacts: the complementarity problem of accelerations with Coulomb friction.

Relative accelerations of contacts are w = W λ + b. At a contact without slip, λ is in the static friction cone and
w_t is zero or opposite to λ_t. At a slipping contact, friction is opposite to the slip velocity. The solution
determines the mode of each contact; the forces of these modes are then computed again from a linear system, to
rounding.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.types import MODE_OPEN, MODE_SLIP, MODE_STICK
from warpcontact.validation.checks import Array

# Accelerations below this fraction of the largest one without contact are zero. The values cover the error of any
# solver; the resulting modes are checked.
SLIP_TOLERANCES = (1.0e-7, 1.0e-5, 1.0e-3)
# Largest distance of forces from their cones, relative to the largest force; for redundant contacts this is the
# error of the solver.
CONE_TOLERANCE = 1.0e-7
# Residual of a linear system, relative to its right side: rounding for mass ratios up to 1e6.
SOLVE_TOLERANCE = 1.0e-8
# Singular values below this fraction of the largest are zero (redundant contacts).
SINGULAR = 1.0e-11
# Newton steps from the result of a solver; a few reach rounding.
MAX_NEWTON_STEPS = 20
# Methods that support friction in space; the first ones are fallbacks of the requested method.
FRICTION_METHODS = ("projection", "gauss_seidel", "prox", "energy")
FALLBACK_METHODS = FRICTION_METHODS[:3]
# Maximum number of slipping contacts for which all subsets are tested.
MAX_MINOR_SIZE = 10
# Maximum number of iterations for the friction of slipping contacts.
MAX_FRICTION_STEPS = 30


class ParadoxError(RuntimeError):
    """Raised if rigid bodies with Coulomb friction have no acceleration, or several (Painlevé paradox).

    A slipping contact then increases its own normal force.

    Attributes:
        run: Result of ``EventDriven.run`` up to the error; ``None`` otherwise.
    """

    run: object = None


@dataclass(frozen=True)
class ContactModes:
    """Modes of closed contacts from an instant on.

    Attributes:
        mode: ``ContactMode`` of each (contacts,).
        direction: Direction of slip that continues or begins, unit vectors (t1, t2), (contacts, 2); 0 without
            slip.
        force: λ (contacts, 3) [N].
        acceleration: w (contacts, 3) [m/s²].
    """

    mode: NDArray[np.int_]
    direction: Array
    force: Array
    acceleration: Array


def find_contact_modes(
    W: Array,
    b: Array,
    mu_static: Array,
    mu: Array,
    slip: Array,
    sliding: NDArray[np.bool_],
    labels: list[str],
    method: str = "gauss_seidel",
) -> ContactModes:
    """Returns the modes, forces and accelerations of closed contacts.

    Args:
        W: Delassus matrix (3 contacts, 3 contacts) [1/kg].
        b: Relative accelerations without contact forces (contacts, 3) [m/s²].
        mu_static: Coefficients of static friction (contacts,).
        mu: Coefficients of dynamic friction (contacts,).
        slip: Slip velocities (contacts, 2) [m/s].
        sliding: Whether each contact slips already (contacts,).
        labels: Labels of the contacts in messages.
        method: Method of ``wc.unilateral.solve_delassus``.

    Raises:
        ParadoxError: If there is no solution, or more than one with slipping contacts.
    """
    count = len(b)
    direction = np.zeros((count, 2))
    slides_with_friction = sliding & (mu > 0.0)
    direction[slides_with_friction] = slip[slides_with_friction] / np.linalg.norm(
        slip[slides_with_friction], axis=1, keepdims=True
    )
    if not count:
        return ContactModes(np.zeros(0, dtype=int), direction, np.zeros((0, 3)), np.zeros((0, 3)))
    check_slides(
        normal_response(W, mu, direction, np.flatnonzero(slides_with_friction)),
        [labels[i] for i in np.flatnonzero(slides_with_friction)],
    )
    stick_mu = np.where(sliding, 0.0, mu_static)
    for guess in _guesses(W, b, mu, direction, slides_with_friction, stick_mu, method):
        # The result is checked to rounding, so convergence of the solver is not required.
        for tolerance in SLIP_TOLERANCES:
            found = _refine_modes(W, b, mu_static, mu, direction, guess, sliding, tolerance)
            if found is not None:
                return found
    immovable = [labels[i] for i in np.flatnonzero((np.diag(W)[::3] == 0.0) & (b[:, 0] < 0.0))]
    if immovable:
        raise ParadoxError(
            f"{', '.join(immovable)} must open, but neither body can move: both are fixed or have prescribed motion"
        )
    raise ParadoxError(
        f"no accelerations of {', '.join(labels)} were found that satisfy Coulomb's law. With strong friction there "
        "may be none"
    )


def _guesses(
    W: Array,
    b: Array,
    mu: Array,
    direction: Array,
    slides_with_friction: NDArray[np.bool_],
    stick_mu: Array,
    method: str,
) -> Iterator[Array]:
    """Yields candidate forces (contacts, 3), the most likely first."""
    count = len(b)
    for name in dict.fromkeys((method, *FALLBACK_METHODS)):
        force = np.zeros((count, 3))
        # The friction of slipping contacts lags their normal forces by one iteration.
        for _ in range(MAX_FRICTION_STEPS if slides_with_friction.any() else 1):
            friction = np.zeros((count, 3))
            friction[slides_with_friction, 1:] = (
                -mu[slides_with_friction, None] * force[slides_with_friction, :1] * direction[slides_with_friction]
            )
            last = force[:, 0].copy()
            force = _solved(W, b + (W @ friction.reshape(-1)).reshape(-1, 3), stick_mu, name)
            force[slides_with_friction, 1:] = (
                -mu[slides_with_friction, None] * force[slides_with_friction, :1] * direction[slides_with_friction]
            )
            yield force
            if np.abs(force[:, 0] - last).max() <= SOLVE_TOLERANCE * np.abs(force[:, 0]).max():
                break
    if not (stick_mu > 0.0).any() and count <= MAX_MINOR_SIZE:
        # Every subset of contacts with a normal force.
        matrix = normal_response(W, mu, direction, np.arange(count))
        for subset in range(2**count):
            chosen = [i for i in range(count) if subset >> i & 1]
            force = np.zeros((count, 3))
            force[chosen, 0] = np.linalg.lstsq(matrix[np.ix_(chosen, chosen)], -b[chosen, 0], rcond=SINGULAR)[0]
            force[:, 1:] = -mu[:, None] * force[:, :1] * direction
            yield force


def _solved(W: Array, b: Array, mu: Array, method: str) -> Array:
    """Returns forces (contacts, 3) of ``solve_delassus``; without friction only normal forces."""
    from warpcontact.unilateral.solving import solve_delassus

    if (mu > 0.0).any():
        return np.array(solve_delassus(W, b, mu, method=method).lam).reshape(-1, 3)
    normals = 3 * np.arange(len(b))
    force = np.zeros((len(b), 3))
    force[:, 0] = solve_delassus(W[np.ix_(normals, normals)], b[:, 0], method=method).lam
    return force


def normal_response(W: Array, mu: Array, direction: Array, chosen: NDArray[np.int_]) -> Array:
    """Returns normal accelerations per normal force, including the friction of slipping contacts."""
    blocks = W.reshape(len(mu), 3, len(mu), 3)[chosen][:, 0][:, chosen]
    result: Array = blocks[..., 0] - mu[chosen] * (blocks[..., 1:] * direction[chosen]).sum(axis=-1)
    return result


def force_basis(mode: NDArray[np.int_], direction: Array, mu: Array) -> Array:
    """Returns the basis of the unknown forces, as columns (3 contacts, unknowns).

    A sticking contact has three unknowns; a slipping one has its normal force, with proportional friction.
    """
    found = []
    for contact, contact_mode in enumerate(mode):
        block = np.zeros((len(mode), 3, 3))
        block[contact] = np.eye(3)
        if contact_mode == MODE_STICK:
            found.append(block.reshape(-1, 3))
        elif contact_mode == MODE_SLIP:
            block[contact, 1:, 0] = -mu[contact] * direction[contact]
            found.append(block.reshape(-1, 3)[:, :1])
    return np.hstack(found) if found else np.zeros((3 * len(mode), 0))


def zero_rows(mode: NDArray[np.int_]) -> NDArray[np.int_]:
    """Returns the rows of w that are zero: all of sticking contacts, the first of slipping ones."""
    each = [
        range(3 * i, 3 * i + (3 if contact_mode == MODE_STICK else 1))
        for i, contact_mode in enumerate(mode)
        if contact_mode
    ]
    return np.array([row for rows in each for row in rows], dtype=int)


def forces_of_modes(
    W: Array, b: Array, mu: Array, mode: NDArray[np.int_], direction: Array, guess: Array
) -> Array:
    """Returns the forces (contacts, 3) that realize the contact modes.

    If they are not unique, returns those nearest to ``guess`` (contacts, 3).
    """
    basis, rows = force_basis(mode, direction, mu), zero_rows(mode)
    start = np.where((mode == MODE_OPEN)[:, None], 0.0, guess)
    slides = mode == MODE_SLIP
    start[slides, 1:] = -mu[slides, None] * start[slides, :1] * direction[slides]
    residual = (W @ start.reshape(-1) + b.reshape(-1))[rows]
    change = np.linalg.lstsq((W @ basis)[rows], -residual, rcond=SINGULAR)[0]
    return start + (basis @ change).reshape(-1, 3)


def _refine_modes(
    W: Array,
    b: Array,
    mu_static: Array,
    mu: Array,
    direction: Array,
    force: Array,
    sliding: NDArray[np.bool_],
    tolerance: float,
) -> ContactModes | None:
    """Returns the solution, to rounding, with the modes implied by ``force``; ``None`` if it is inconsistent.

    Accelerations under ``force`` below ``tolerance`` times the largest one without contact are zero.
    """
    scale = np.abs(b).max() or 1.0
    w = (W @ force.reshape(-1)).reshape(-1, 3) + b
    starts_to_slip = ~sliding & (np.linalg.norm(w[:, 1:], axis=1) > tolerance * scale)
    mode = np.where(sliding | starts_to_slip | (mu_static == 0.0), MODE_SLIP, MODE_STICK)
    mode[w[:, 0] > tolerance * scale] = MODE_OPEN
    starts_to_slip &= (mode == MODE_SLIP) & (mu > 0.0)
    direction = direction.copy()
    # The friction of a contact that starts to slip is unknown, like that of a sticking one.
    unknown = np.where(starts_to_slip, MODE_STICK, mode)
    basis, rows = force_basis(unknown, direction, mu), zero_rows(unknown)
    if starts_to_slip.any():
        # Dynamic friction may be smaller than the static friction before.
        direction[starts_to_slip] = w[starts_to_slip, 1:] / np.linalg.norm(
            w[starts_to_slip, 1:], axis=1, keepdims=True
        )
        force = forces_of_modes(W, b, mu, mode, direction, force)
    force = np.where((mode == MODE_OPEN)[:, None], 0.0, force)
    last = np.inf
    for _ in range(MAX_NEWTON_STEPS):
        w = (W @ force.reshape(-1)).reshape(-1, 3) + b
        residual, slopes = w.copy(), W.copy()
        for contact in np.flatnonzero(starts_to_slip).tolist():
            _add_slip_equation(contact, W, mu[contact], force, w, residual, slopes)
        change = basis @ np.linalg.lstsq(slopes[rows] @ basis, -residual.reshape(-1)[rows], rcond=SINGULAR)[0]
        size = np.abs(change).max(initial=0.0)
        if size >= last:
            break
        last = size
        force = force + change.reshape(-1, 3)
    w = (W @ force.reshape(-1)).reshape(-1, 3) + b
    sizes = np.linalg.norm(w[starts_to_slip, 1:], axis=1, keepdims=True)
    direction[starts_to_slip] = w[starts_to_slip, 1:] / np.where(sizes > 0.0, sizes, 1.0)
    force = forces_of_modes(W, b, mu, mode, direction, force)
    w = (W @ force.reshape(-1)).reshape(-1, 3) + b
    found = ContactModes(mode, np.where((mode == MODE_SLIP)[:, None], direction, 0.0), force, w)
    heaviest = scale / max(np.diag(W).max(), np.finfo(np.float64).tiny)
    force_scale = max(np.abs(force).max(), heaviest)
    return found if _is_consistent(found, mu_static, starts_to_slip, scale, force_scale) else None


def _is_consistent(
    found: ContactModes, mu_static: Array, starts_to_slip: NDArray[np.bool_], scale: float, force_scale: float
) -> bool:
    """Returns whether a solution satisfies all conditions, relative to the largest acceleration and force."""
    w, force, mode = found.acceleration, found.force, found.mode
    sticks = mode == MODE_STICK
    friction_excess = np.linalg.norm(force[sticks, 1:], axis=1) - mu_static[sticks] * force[sticks, 0]
    along = (w[starts_to_slip, 1:] * found.direction[starts_to_slip]).sum(axis=1)
    return bool(
        np.abs(w.reshape(-1)[zero_rows(mode)]).max(initial=0.0) <= SOLVE_TOLERANCE * scale
        and (w[:, 0] >= -SOLVE_TOLERANCE * scale).all()
        and (force[:, 0] >= -CONE_TOLERANCE * force_scale).all()
        and (friction_excess <= CONE_TOLERANCE * force_scale).all()
        and (np.linalg.norm(w[starts_to_slip, 1:], axis=1) - along <= CONE_TOLERANCE * scale).all()
    )


def _add_slip_equation(
    contact: int, W: Array, mu: float, force: Array, w: Array, residual: Array, slopes: Array
) -> None:
    """Replaces the rows of w_t by λ_t |w_t| + μ λ_n w_t = 0 (friction opposite to slip) and their derivatives."""
    own = slice(3 * contact + 1, 3 * contact + 3)
    l_n, l_t, w_t = force[contact, 0], force[contact, 1:], w[contact, 1:]
    speed = np.linalg.norm(w_t)
    if speed == 0.0:
        return
    residual[contact, 1:] = l_t * speed + mu * l_n * w_t
    slopes[own] = np.outer(l_t, w_t / speed) @ W[own] + mu * l_n * W[own]
    slopes[own, 3 * contact] += mu * w_t
    slopes[own, own] += speed * np.eye(2)


def check_slides(matrix: Array, labels: list[str]) -> None:
    """Raises ``ParadoxError`` if slipping contacts do not determine their normal forces.

    They do if every principal minor is positive (P-matrix); with redundant contacts some are zero.
    """
    count = len(matrix)
    scale = np.abs(np.diag(matrix)).max(initial=0.0)
    for subset in range(1, 2 ** min(count, MAX_MINOR_SIZE)):
        chosen = [i for i in range(count) if subset >> i & 1]
        if np.linalg.det(matrix[np.ix_(chosen, chosen)] / (scale or 1.0)) < -SOLVE_TOLERANCE:
            raise ParadoxError(
                f"slip of {', '.join(labels[i] for i in chosen)} increases its own normal force: accelerations are "
                "not unique or do not exist (Painlevé paradox)"
            )
