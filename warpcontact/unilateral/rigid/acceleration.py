"""What closed contacts do next: the complementarity problem of accelerations, with Coulomb friction.

Relative accelerations of contacts are w = W λ + b. Where nothing slides, λ is in the cone of friction at rest and
w = 0 or opposite to it; where a contact slides already, its friction has the direction of sliding. From the
solution follows what each contact does, and with that the forces once more, by a linear system, to rounding.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.kernels.types import MODE_OPEN, MODE_SLIP, MODE_STICK

# Accelerations below this share of the largest without contact are none: more than what a solver leaves, whatever
# that is. What follows from it is checked.
SMALL = (1.0e-7, 1.0e-5, 1.0e-3)
# What forces may be outside of their cones, as a share of the largest: those of redundant contacts are a solver's.
OUTSIDE = 1.0e-7
# What a linear system may leave, as a share of that: rounding, of bodies as unlike as 1 to 1e6.
LEFT = 1.0e-8
# Singular values below this share of the largest are zero: of redundant contacts.
SINGULAR = 1.0e-11
# Steps of Newton's method from the answer of a solver: a few bring it to rounding.
NEWTON = 20
# Methods that take friction in space: the first are asked after the one that is wanted.
METHODS = ("projection", "gauss_seidel", "prox", "energy")
ASKED = METHODS[:3]
# Most sliding contacts of which all sets are looked at.
MOST_MINORS = 10
# Turns of the friction of contacts that slide.
TURNS = 30


class ParadoxError(RuntimeError):
    """Rigid bodies with Coulomb friction have no acceleration there, or several.

    As Painlevé found: a contact that slides pushes so that it presses itself together.

    Attributes:
        run: What was computed up to there, of ``EventDriven.run``; ``None`` otherwise.
    """

    run: object = None


@dataclass(frozen=True)
class Modes:
    """What closed contacts do from an instant on.

    Attributes:
        mode: ``ContactMode`` of each (contacts,).
        direction: Of sliding that goes on or begins, unit vectors (t1, t2), (contacts, 2); 0 of others.
        force: λ (contacts, 3) [N].
        acceleration: w (contacts, 3) [m/s²].
    """

    mode: NDArray[np.int_]
    direction: Array
    force: Array
    acceleration: Array


def find_modes(
    W: Array,
    b: Array,
    mu_static: Array,
    mu: Array,
    slip: Array,
    sliding: NDArray[np.bool_],
    labels: list[str],
    method: str = "gauss_seidel",
) -> Modes:
    """Returns what closed contacts do.

    Args:
        W: Delassus matrix (3 contacts, 3 contacts) [1/kg].
        b: Relative accelerations without contact forces (contacts, 3) [m/s²].
        mu_static: Coefficients of friction at rest (contacts,).
        mu: Coefficients of friction in sliding (contacts,).
        slip: Tangential velocities (contacts, 2) [m/s].
        sliding: Whether each slides already.
        labels: What to call the contacts in messages.
        method: Of ``wc.unilateral.solve_delassus``.

    Raises:
        ParadoxError: If there is no solution, or more than one where contacts slide.
    """
    count = len(b)
    direction = np.zeros((count, 2))
    rubs = sliding & (mu > 0.0)
    direction[rubs] = slip[rubs] / np.linalg.norm(slip[rubs], axis=1, keepdims=True)
    if not count:
        return Modes(np.zeros(0, dtype=int), direction, np.zeros((0, 3)), np.zeros((0, 3)))
    check_slides(bent(W, mu, direction, np.flatnonzero(rubs)), [labels[i] for i in np.flatnonzero(rubs)])
    holding = np.where(sliding, 0.0, mu_static)
    for guess in _guesses(W, b, mu, direction, rubs, holding, method):
        # What is checked to rounding needs no word of a solver.
        for small in SMALL:
            found = _exact(W, b, mu_static, mu, direction, guess, sliding, small)
            if found is not None:
                return found
    rigid = [labels[i] for i in np.flatnonzero((np.diag(W)[::3] == 0.0) & (b[:, 0] < 0.0))]
    if rigid:
        raise ParadoxError(
            f"{', '.join(rigid)} must open, but neither body can give way: both are driven or fixed"
        )
    raise ParadoxError(
        f"no accelerations were found of {', '.join(labels)} that agree with Coulomb friction. Where friction is "
        "strong there may be none"
    )


def _guesses(
    W: Array,
    b: Array,
    mu: Array,
    direction: Array,
    rubs: NDArray[np.bool_],
    holding: Array,
    method: str,
) -> Iterator[Array]:
    """Iterates over forces (contacts, 3) that may be near the solution, what is likely first."""
    count = len(b)
    for name in dict.fromkeys((method, *ASKED)):
        force = np.zeros((count, 3))
        # The friction of contacts that slide follows their normal forces, one turn behind.
        for _ in range(TURNS if rubs.any() else 1):
            given = np.zeros((count, 3))
            given[rubs, 1:] = -mu[rubs, None] * force[rubs, :1] * direction[rubs]
            last = force[:, 0].copy()
            force = _solved(W, b + (W @ given.reshape(-1)).reshape(-1, 3), holding, name)
            force[rubs, 1:] = -mu[rubs, None] * force[rubs, :1] * direction[rubs]
            yield force
            if np.abs(force[:, 0] - last).max() <= LEFT * np.abs(force[:, 0]).max():
                break
    if not (holding > 0.0).any() and count <= MOST_MINORS:
        # Every set of contacts that press.
        matrix = bent(W, mu, direction, np.arange(count))
        for subset in range(2**count):
            chosen = [i for i in range(count) if subset >> i & 1]
            force = np.zeros((count, 3))
            force[chosen, 0] = np.linalg.lstsq(matrix[np.ix_(chosen, chosen)], -b[chosen, 0], rcond=SINGULAR)[0]
            force[:, 1:] = -mu[:, None] * force[:, :1] * direction
            yield force


def _solved(W: Array, b: Array, mu: Array, method: str) -> Array:
    """Returns forces (contacts, 3) of ``wc.unilateral.solve_delassus``; without friction of normal parts alone."""
    from warpcontact.unilateral.solving import solve_delassus

    if (mu > 0.0).any():
        return np.array(solve_delassus(W, b, mu, method=method).lam).reshape(-1, 3)
    normals = 3 * np.arange(len(b))
    force = np.zeros((len(b), 3))
    force[:, 0] = solve_delassus(W[np.ix_(normals, normals)], b[:, 0], method=method).lam
    return force


def bent(W: Array, mu: Array, direction: Array, chosen: NDArray[np.int_]) -> Array:
    """Returns normal accelerations by normal forces, with the friction that these bring along in sliding."""
    blocks = W.reshape(len(mu), 3, len(mu), 3)[chosen][:, 0][:, chosen]
    result: Array = blocks[..., 0] - mu[chosen] * (blocks[..., 1:] * direction[chosen]).sum(axis=-1)
    return result


def columns(mode: NDArray[np.int_], direction: Array, mu: Array) -> Array:
    """Returns the forces that unknowns stand for, as columns (3 contacts, unknowns).

    Three of a contact that sticks, the normal force with the friction of it of one that slides.
    """
    found = []
    for contact, what in enumerate(mode):
        block = np.zeros((len(mode), 3, 3))
        block[contact] = np.eye(3)
        if what == MODE_STICK:
            found.append(block.reshape(-1, 3))
        elif what == MODE_SLIP:
            block[contact, 1:, 0] = -mu[contact] * direction[contact]
            found.append(block.reshape(-1, 3)[:, :1])
    return np.hstack(found) if found else np.zeros((3 * len(mode), 0))


def equations(mode: NDArray[np.int_]) -> NDArray[np.int_]:
    """Returns the rows of w that are zero: those of contacts that stick, the first of those that slide."""
    each = [range(3 * i, 3 * i + (3 if what == MODE_STICK else 1)) for i, what in enumerate(mode) if what]
    return np.array([row for rows in each for row in rows], dtype=int)


def forces_of_modes(W: Array, b: Array, mu: Array, mode: NDArray[np.int_], direction: Array, near: Array) -> Array:
    """Returns the forces (contacts, 3) with which contacts do what their modes say.

    Of those that do it, the one nearest to ``near`` (contacts, 3).
    """
    push, rows = columns(mode, direction, mu), equations(mode)
    start = np.where((mode == MODE_OPEN)[:, None], 0.0, near)
    slides = mode == MODE_SLIP
    start[slides, 1:] = -mu[slides, None] * start[slides, :1] * direction[slides]
    lacking = (W @ start.reshape(-1) + b.reshape(-1))[rows]
    change = np.linalg.lstsq((W @ push)[rows], -lacking, rcond=SINGULAR)[0]
    return start + (push @ change).reshape(-1, 3)


def _exact(
    W: Array,
    b: Array,
    mu_static: Array,
    mu: Array,
    direction: Array,
    force: Array,
    sliding: NDArray[np.bool_],
    small: float,
) -> Modes | None:
    """Returns the solution that has the modes of ``force`` to rounding, ``None`` if there is none of those.

    Accelerations under ``force`` below the part ``small`` of the largest without are none.
    """
    scale = np.abs(b).max() or 1.0
    w = (W @ force.reshape(-1)).reshape(-1, 3) + b
    starts = ~sliding & (np.linalg.norm(w[:, 1:], axis=1) > small * scale)
    mode = np.where(sliding | starts | (mu_static == 0.0), MODE_SLIP, MODE_STICK)
    mode[w[:, 0] > small * scale] = MODE_OPEN
    starts &= (mode == MODE_SLIP) & (mu > 0.0)
    direction = direction.copy()
    # The friction of a slide that starts is unknown like that of a contact that sticks.
    unknown = np.where(starts, MODE_STICK, mode)
    push, rows = columns(unknown, direction, mu), equations(unknown)
    if starts.any():
        # In sliding friction may be less than what held.
        direction[starts] = w[starts, 1:] / np.linalg.norm(w[starts, 1:], axis=1, keepdims=True)
        force = forces_of_modes(W, b, mu, mode, direction, force)
    force = np.where((mode == MODE_OPEN)[:, None], 0.0, force)
    last = np.inf
    for _ in range(NEWTON):
        w = (W @ force.reshape(-1)).reshape(-1, 3) + b
        left, slopes = w.copy(), W.copy()
        for contact in np.flatnonzero(starts).tolist():
            _oppose(contact, W, mu[contact], force, w, left, slopes)
        change = push @ np.linalg.lstsq(slopes[rows] @ push, -left.reshape(-1)[rows], rcond=SINGULAR)[0]
        size = np.abs(change).max(initial=0.0)
        if size >= last:
            break
        last = size
        force = force + change.reshape(-1, 3)
    w = (W @ force.reshape(-1)).reshape(-1, 3) + b
    sizes = np.linalg.norm(w[starts, 1:], axis=1, keepdims=True)
    direction[starts] = w[starts, 1:] / np.where(sizes > 0.0, sizes, 1.0)
    force = forces_of_modes(W, b, mu, mode, direction, force)
    w = (W @ force.reshape(-1)).reshape(-1, 3) + b
    found = Modes(mode, np.where((mode == MODE_SLIP)[:, None], direction, 0.0), force, w)
    heaviest = scale / max(np.diag(W).max(), np.finfo(np.float64).tiny)
    most = max(np.abs(force).max(), heaviest)
    return found if _agrees(found, mu_static, starts, scale, most) else None


def _agrees(found: Modes, mu_static: Array, starts: NDArray[np.bool_], scale: float, most: float) -> bool:
    """Whether a solution fulfils all conditions, in comparison with the largest acceleration and force."""
    w, force, mode = found.acceleration, found.force, found.mode
    sticks = mode == MODE_STICK
    pulled = np.linalg.norm(force[sticks, 1:], axis=1) - mu_static[sticks] * force[sticks, 0]
    along = (w[starts, 1:] * found.direction[starts]).sum(axis=1)
    return bool(
        np.abs(w.reshape(-1)[equations(mode)]).max(initial=0.0) <= LEFT * scale
        and (w[:, 0] >= -LEFT * scale).all()
        and (force[:, 0] >= -OUTSIDE * most).all()
        and (pulled <= OUTSIDE * most).all()
        and (np.linalg.norm(w[starts, 1:], axis=1) - along <= OUTSIDE * scale).all()
    )


def _oppose(contact: int, W: Array, mu: float, force: Array, w: Array, left: Array, slopes: Array) -> None:
    """Writes that friction is opposite to sliding, λ_t |w_t| + μ λ_n w_t = 0, and its slopes, in place of w_t."""
    own = slice(3 * contact + 1, 3 * contact + 3)
    l_n, l_t, w_t = force[contact, 0], force[contact, 1:], w[contact, 1:]
    speed = np.linalg.norm(w_t)
    if speed == 0.0:
        return
    left[contact, 1:] = l_t * speed + mu * l_n * w_t
    slopes[own] = np.outer(l_t, w_t / speed) @ W[own] + mu * l_n * W[own]
    slopes[own, 3 * contact] += mu * w_t
    slopes[own, own] += speed * np.eye(2)


def check_slides(matrix: Array, labels: list[str]) -> None:
    """Raises ``ParadoxError`` if contacts that slide do not determine their normal forces.

    They do if every principal minor is positive (a P-matrix); of redundant contacts some are zero.
    """
    count = len(matrix)
    scale = np.abs(np.diag(matrix)).max(initial=0.0)
    for subset in range(1, 2 ** min(count, MOST_MINORS)):
        chosen = [i for i in range(count) if subset >> i & 1]
        if np.linalg.det(matrix[np.ix_(chosen, chosen)] / (scale or 1.0)) < -LEFT:
            raise ParadoxError(
                f"sliding, {', '.join(labels[i] for i in chosen)} would press itself on: friction makes the "
                "accelerations ambiguous, or leaves none (Painlevé)"
            )
