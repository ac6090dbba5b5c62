"""A step between two events, and the detection of events: contacts that close, open, stick, slip or leave."""

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

# Speeds below this are zero: above rounding, below the speeds of impacts that are not summed [m/s].
SPEED_TOLERANCE = 1.0e-9
# Forces below this fraction of the largest are zero.
NO_FORCE = 1.0e-9
# Fraction of ``closed`` by which a gap must be negative for an impact.
GAP_FRACTION = 1.0e-3
# Maximum number of bisections for the time at which a contact was still open, or still on its surface.
MAX_HALVINGS = 45


class _Monitored(IntEnum):
    """Quantities that are positive while the mode of a contact holds."""

    GAP = 0  # gap of an open pair
    NORMAL_FORCE = 1  # normal force of a held contact
    FRICTION_RESERVE = 2  # static friction limit minus friction of a sticking contact
    SLIDE = 3  # speed in the direction of slip


@dataclass(frozen=True)
class _Crossing:
    """A function of the state that becomes negative within a step.

    Attributes:
        monitored: Kind of the function.
        number: Index of the pair (GAP) or of the held contact.
        threshold: The function counts as negative below minus this value.
    """

    monitored: _Monitored
    number: int
    threshold: float

    @property
    def velocities_decide(self) -> bool:
        """Whether velocities determine the next modes; if not, contacts are evaluated slightly later."""
        return self.monitored not in (_Monitored.NORMAL_FORCE, _Monitored.FRICTION_RESERVE)

    def value(self, evaluated: EvaluatedState, held_contacts: HeldContacts) -> float:
        """Returns the value of the function in a state."""
        if self.monitored is _Monitored.GAP:
            # Large if contact is impossible.
            return float(min(evaluated.measured.gap[self.number], 1.0e9))
        if self.monitored is _Monitored.SLIDE:
            return float(evaluated.slide[self.number])
        normal_force, friction_reserve = contact_margins(evaluated, held_contacts)
        return float(
            (normal_force if self.monitored is _Monitored.NORMAL_FORCE else friction_reserve)[self.number]
        )


class Step:
    """A step in which held contacts keep their modes.

    Args:
        trajectory: Motion of the bodies.
        evaluated: Evaluation of ``start``.
        start: State at the start.
        held_contacts: Held contacts and their modes.
        length: Requested length [s]; the step ends earlier if a held contact leaves its surface.

    Attributes:
        length: Length [s].
        end: State at the end.
        lost: Pairs that leave their surfaces at the end (contacts,).
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
        """Returns the evaluation of a state with the held contacts."""
        return self._trajectory.evaluate(state, self.held_contacts)

    def first_crossing(self, closed: float) -> tuple[float, bool] | None:
        """Returns the time of the first event [s], and whether velocities determine the next modes.

        Returns ``None`` if there is no event.

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
        """Returns the time for which held contacts stay on their surfaces, the state then, and the lost pairs."""
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
        """Yields the functions that may have become negative; gaps up to ``gap_tolerance`` [m] are rounding."""
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
        """Returns the time of the minimum of a gap that closes and opens before ``end``, if it is negative then."""
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
    """Returns the root of a function that is negative at ``end``; 0 if it is not positive anywhere before."""
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
