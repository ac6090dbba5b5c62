"""A step of the motion between two events, and what ends it: contacts that close, part, stick, slide or leave."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.reference.snapshot import Snapshot
from warpcontact.unilateral.reference.trajectory import (
    EvaluatedState,
    HeldContacts,
    LostContact,
    Trajectory,
    contact_margins,
)

# Speeds below this are zero: above the rounding of speeds, below those of impacts that are not summed up [m/s].
SPEED_TOLERANCE = 1.0e-9
# Forces below this share of the largest are zero.
NO_FORCE = 1.0e-9
# Part of the length that is closed by which a gap must be closed for an impact.
GAP_FRACTION = 1.0e-3
# Halvings of a step in search of where a contact was still open, or still on its surface.
MAX_HALVINGS = 45


class _Monitored(IntEnum):
    """What is positive as long as contacts do what they do."""

    GAP = 0  # of a pair that is open
    NORMAL_FORCE = 1  # normal force of a contact that is held
    FRICTION_RESERVE = 2  # what is left until it slides
    SLIDE = 3  # speed in the direction in which it slides


@dataclass(frozen=True)
class _Crossing:
    """A function of the state that turns negative within a step.

    Attributes:
        monitored: What.
        number: Of the pair, or of the contact that is held.
        threshold: Below its negative the function is negative.
    """

    monitored: _Monitored
    number: int
    threshold: float

    @property
    def velocities_decide(self) -> bool:
        """Whether velocities say what comes next; if not, contacts must be seen a little later."""
        return self.monitored not in (_Monitored.NORMAL_FORCE, _Monitored.FRICTION_RESERVE)

    def value(self, evaluated: EvaluatedState, held_contacts: HeldContacts) -> float:
        """Returns the function in a state."""
        if self.monitored is _Monitored.GAP:
            # Where nothing can touch it is large.
            return float(min(evaluated.measured.gap[self.number], 1.0e9))
        if self.monitored is _Monitored.SLIDE:
            return float(evaluated.slide[self.number])
        normal_force, friction_reserve = contact_margins(evaluated, held_contacts)
        return float(
            (normal_force if self.monitored is _Monitored.NORMAL_FORCE else friction_reserve)[self.number]
        )


class Step:
    """A step in which contacts that are held go on with what they do.

    Args:
        trajectory: How bodies move.
        evaluated: What is seen of ``start``.
        start: The state at its start.
        held_contacts: What contacts do.
        length: How long it is to be [s]; it ends sooner where a contact that is held leaves its surface.

    Attributes:
        length: How long it is [s].
        end: The state at its end.
        lost: Pairs that leave their surfaces there (contacts,).
    """

    def __init__(
        self,
        trajectory: Trajectory,
        evaluated: EvaluatedState,
        start: Snapshot,
        held_contacts: HeldContacts,
        length: float,
    ) -> None:
        self.start, self.held_contacts = start, held_contacts
        self._trajectory, self._first = trajectory, evaluated
        self.length, self.end, self.lost = self._until_contact_lost(length)
        self._last = self.evaluate(self.end)

    def at(self, time: float) -> Snapshot:
        """Returns the state at a time after the start [s]."""
        return self._trajectory.advance(self.start, self.held_contacts, time)

    def evaluate(self, state: Snapshot) -> EvaluatedState:
        """Returns what is seen of a state in which contacts do what they do."""
        return self._trajectory.evaluate(state, self.held_contacts)

    def first_crossing(self, closed: float) -> tuple[float, bool] | None:
        """Returns when the first event is [s], and if velocities say what comes next; ``None`` if there is none.

        Args:
            closed: Gaps up to this are zero [m].
        """
        first: tuple[float, bool] | None = None
        for crossing in self._crossings(GAP_FRACTION * closed):
            end: float | None = self.length if first is None else first[0]
            final = self._last if first is None else self.evaluate(self.at(first[0]))
            if crossing.value(final, self.held_contacts) >= -crossing.threshold:
                end = self._minimum_gap_time(crossing, final, end)
            if end is None:
                continue

            def value(time: float, one: _Crossing = crossing) -> float:
                return one.value(self.evaluate(self.at(time)), self.held_contacts)

            time = _root(value, crossing.value(self._first, self.held_contacts), end)
            if first is None or time < first[0]:
                first = (time, crossing.velocities_decide)
        return first

    def _until_contact_lost(self, length: float) -> tuple[float, Snapshot, NDArray[np.int_]]:
        """Returns how long held contacts stay on their surfaces, the state then, and the pairs that leave."""
        try:
            return length, self.at(length), np.zeros(0, dtype=int)
        except LostContact as lost_contact:
            lost = lost_contact.pairs
        low, high = 0.0, length
        for _ in range(MAX_HALVINGS):
            middle = 0.5 * (low + high)
            try:
                self.at(middle)
            except LostContact as lost_contact:
                high, lost = middle, lost_contact.pairs
            else:
                low = middle
        return low, self.at(low), lost

    def _crossings(self, gap_tolerance: float) -> Iterator[_Crossing]:
        """Iterates over what may have turned negative; gaps up to ``gap_tolerance`` [m] are rounding."""
        first, last, held_contacts = self._first, self._last, self.held_contacts
        is_open = np.isfinite(first.measured.gap) | np.isfinite(last.measured.gap)
        is_open[held_contacts.pairs] = False
        has_minimum = (first.rate < 0.0) & (last.rate > 0.0)
        for pair in np.flatnonzero(is_open & ((last.measured.gap < -gap_tolerance) | has_minimum)).tolist():
            yield _Crossing(_Monitored.GAP, pair, gap_tolerance)
        scale = NO_FORCE * max(np.abs(first.force).max(initial=0.0), np.abs(last.force).max(initial=0.0))
        normal_force, friction_reserve = contact_margins(last, held_contacts)
        for number in range(len(held_contacts.pairs)):
            if normal_force[number] < -scale:
                yield _Crossing(_Monitored.NORMAL_FORCE, number, scale)
            if friction_reserve[number] < -scale:
                yield _Crossing(_Monitored.FRICTION_RESERVE, number, scale)
            if last.slide[number] < -SPEED_TOLERANCE:
                yield _Crossing(_Monitored.SLIDE, number, SPEED_TOLERANCE)

    def _minimum_gap_time(self, crossing: _Crossing, final: EvaluatedState, end: float | None) -> float | None:
        """Returns when a gap that closes and opens before ``end`` is least, if it is closed then."""
        from scipy.optimize import brentq

        pair = crossing.number
        if (
            crossing.monitored is not _Monitored.GAP
            or end is None
            or not self._first.rate[pair] < 0.0 < final.rate[pair]
        ):
            return None

        def rate(time: float) -> float:
            return float(self.evaluate(self.at(time)).rate[pair])

        least = float(brentq(rate, 0.0, end, xtol=1.0e-3 * end))
        return (
            least
            if crossing.value(self.evaluate(self.at(least)), self.held_contacts) < -crossing.threshold
            else None
        )


def _root(value: Callable[[float], float], at_start: float, end: float) -> float:
    """Returns the root of a function that is negative at ``end``, 0 if it is nowhere positive before."""
    from scipy.optimize import brentq

    start = 0.0
    if at_start <= 0.0:
        start = end
        for _ in range(MAX_HALVINGS):
            start *= 0.5
            if value(start) > 0.0:
                break
        else:
            return 0.0
    return float(brentq(value, start, end, xtol=1.0e-16, rtol=8.9e-16, maxiter=200))
