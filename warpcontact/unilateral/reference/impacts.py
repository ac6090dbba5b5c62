"""Impacts of rigid bodies: simultaneous with friction or sequential, and series at decreasing intervals."""

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.nonsmooth.sequence import MAX_IMPACTS_PER_CONTACT, TIE
from warpcontact.unilateral.reference.acceleration import find_contact_modes
from warpcontact.unilateral.reference.assembly import Assembler, Assembly
from warpcontact.unilateral.reference.crossings import NO_FORCE, SPEED_TOLERANCE
from warpcontact.unilateral.reference.events import Event, EventKind
from warpcontact.unilateral.reference.snapshot import Snapshot
from warpcontact.validation.checks import Array

# Relative work of impulses that counts as rounding, and number of bisections for the largest restitution factor.
WORK_TOLERANCE = 1.0e-12
MAX_HALVINGS = 45
# Slip speed relative to that of the last impact of a series up to which slip ends with the series.
SLIDE_SPEED_RATIO = 20.0
# Approach speeds below this fraction of the largest are zero in sequential impacts.
SMALL_APPROACH = 1.0e-12


class Impacts:
    """Computes velocities after impacts; stores the times of past impacts.

    Args:
        assembler: Assembler of the environment.
        zeno: Impacts of a contact within this time, at decreasing intervals, are summed [s].
        method: Method of ``wc.unilateral.solve_delassus``.
        sequential: Whether pairs of bodies collide sequentially.
    """

    def __init__(self, assembler: Assembler, zeno: float, method: str, sequential: bool) -> None:
        self._assembler, self._zeno, self._method = assembler, zeno, method
        self._sequential = sequential
        self._last: dict[int, tuple[float, float]] = {}  # pair: (time of last impact, interval before it)

    def resolve(self, state: Snapshot, pairs: NDArray[np.int_]) -> tuple[Snapshot, NDArray[np.bool_], list[Event]]:
        """Returns the state after impacts of closed contacts, which of them open (contacts,), and the events."""
        candidates = self._assembler.candidates
        own = self._assembler.assembly(state, candidates.measure(state), pairs)
        speed = own.contact_velocity
        if not (speed[:, 0] < -SPEED_TOLERANCE).any():
            return state, speed[:, 0] > SPEED_TOLERANCE, []
        ending = self._series(state.time, pairs, speed[:, 0])
        ends = np.isin(pairs, list(ending))
        force = self._impulses(own, speed, np.where(ends, 0.0, own.restitution))
        velocity = state.velocity + own.inverse_mass @ (own.rows.T @ force.reshape(-1))
        if ending:
            velocity = _end_series(own, velocity, ends, -speed[:, 0].min())
        after = (own.rows @ velocity).reshape(-1, 3)[:, 0]
        impulse = (force[:, None, :] @ own.axes)[:, 0]
        events = [
            candidates.event(state.time, EventKind.IMPACT, pair, impulse[number], -speed[number, 0], after[number])
            for number, pair in enumerate(pairs)
            if force[number, 0] > NO_FORCE * force[:, 0].max()
        ]
        events += [candidates.event(time, EventKind.REST, pair) for pair, time in ending.items()]
        return state.with_velocity(velocity), after > SPEED_TOLERANCE, events

    def _impulses(self, own: Assembly, speed: Array, restitution: Array) -> Array:
        """Returns the impulses of an impact in local axes (contacts, 3) [N·s].

        Simultaneous impacts satisfy Newton's law with the velocities before; sequential ones have the separation
        speeds of the sequence. In both cases friction is solved in one problem. Newton's law alone may add energy
        if friction reverses a slip, or if contacts of different restitution are hit together. Restitution of all
        contacts is then reduced by a common factor until no energy is added.
        """
        none = np.zeros(own.count, dtype=bool)
        separation_speed = -restitution * np.minimum(speed[:, 0], 0.0)
        if self._sequential and restitution.any():
            normals = 3 * np.arange(own.count)
            W = own.delassus[np.ix_(normals, normals)]
            separation_speed = _parting_speeds(W, speed[:, 0], restitution, own.bodies, self._method)

        def solve_impact(factor: float) -> tuple[Array, float]:
            target = speed.copy()
            target[:, 0] -= factor * separation_speed
            slip = np.zeros((own.count, 2))
            found = find_contact_modes(own.delassus, target, own.mu, own.mu, slip, none, own.labels, self._method)
            after = speed + (own.delassus @ found.force.reshape(-1)).reshape(-1, 3)
            work = found.force * (speed + after)
            return found.force, float(work.sum() / (np.abs(work).sum() or 1.0))

        force, gain = solve_impact(1.0)
        if gain <= WORK_TOLERANCE or not restitution.any():
            return force
        low, high = 0.0, 1.0
        for _ in range(MAX_HALVINGS):
            factor = 0.5 * (low + high)
            low, high = (factor, high) if solve_impact(factor)[1] <= WORK_TOLERANCE else (low, factor)
        return solve_impact(low)[0]

    def _series(self, time: float, pairs: NDArray[np.int_], speed: Array) -> dict[int, float]:
        """Returns contacts whose series of impacts is summed, and the time at which the series ends."""
        limit = None
        for pair, approach in zip(pairs.tolist(), speed, strict=True):
            if approach >= -SPEED_TOLERANCE:
                continue
            last, interval = self._last.get(pair, (-np.inf, np.inf))
            since = time - last
            if np.isfinite(interval) and since <= self._zeno and since < interval:
                ratio = since / interval
                limit = max(limit or 0.0, time + since * ratio / (1.0 - ratio))
            self._last[pair] = (time, since)
        if limit is None:
            return {}
        # Contacts that hit alternately come to rest together.
        recent = [pair for pair, (last, _) in self._last.items() if time - last <= 2.0 * self._zeno]
        ending = {pair: limit for pair in recent if pair in pairs}
        for pair in ending:
            del self._last[pair]
        return ending


def _end_series(own: Assembly, velocity: Array, ending: NDArray[np.bool_], approach: float) -> Array:
    """Returns velocities (6 bodies,) at the end of a series of impacts: without separation speed.

    Slip that is slow relative to the last ``approach`` speed [m/s] ends, too (``SLIDE_SPEED_RATIO``).
    """
    U = (own.rows @ velocity).reshape(-1, 3)
    is_slow = (np.linalg.norm(U[:, 1:], axis=1) < SLIDE_SPEED_RATIO * approach) & (own.mu > 0.0)
    chosen = np.stack([ending, ending & is_slow, ending & is_slow], axis=1).reshape(-1)
    rows = own.rows[chosen]
    response = own.inverse_mass @ rows.T
    return velocity - response @ np.linalg.lstsq(rows @ response, rows @ velocity, rcond=1.0e-11)[0]


def _parting_speeds(W: Array, speed: Array, restitution: Array, bodies: NDArray[np.int_], method: str) -> Array:
    """Returns the normal velocities (contacts,) after sequential impacts; 0 for contacts that were not hit.

    ``kernels/nonsmooth/sequence.py`` implements the same rule.

    The pair of bodies with the largest approach speed collides first. Its contacts are solved together, without
    friction, by Newton's law with the current velocities. This repeats until no contact approaches. Contacts that
    still approach after ``MAX_IMPACTS_PER_CONTACT`` impacts per contact do not bounce.

    Args:
        W: Delassus matrix of the normals (contacts, contacts) [1/kg].
        speed: Normal velocities before, positive in separation (contacts,) [m/s].
        restitution: Newton's coefficients (contacts,).
        bodies: Indices of the first and the second body (contacts, 2).
        method: Method of ``wc.unilateral.solve_delassus``.
    """
    from warpcontact.unilateral.solving import solve_delassus

    pairs = np.sort(bodies, axis=1)
    can_move = np.diag(W) > 0.0
    speeds, was_hit = speed.copy(), np.zeros(len(speed), dtype=bool)
    small = SMALL_APPROACH * max(-speed.min(), 0.0)
    for _ in range(MAX_IMPACTS_PER_CONTACT * len(speed)):
        approach = np.where(can_move, -speeds, 0.0)
        if approach.max() <= small:
            break
        fastest, fastest_speed = 0, 0.0
        for contact, approach_speed in enumerate(approach.tolist()):
            if approach_speed > fastest_speed * (1.0 + TIE):
                fastest, fastest_speed = contact, approach_speed
        chosen = np.flatnonzero((pairs == pairs[fastest]).all(axis=1) & can_move)
        target = speeds[chosen] + restitution[chosen] * np.minimum(speeds[chosen], 0.0)
        impulse = np.asarray(solve_delassus(W[np.ix_(chosen, chosen)], target, method=method).lam)
        speeds = speeds + W[:, chosen] @ impulse
        was_hit[chosen[impulse > 0.0]] = True
    return np.where(was_hit, np.maximum(speeds, 0.0), 0.0)
