"""A step of the motion between two events, and what ends it: contacts that close, part, stick, slide or leave."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from warpcontact.unilateral.rigid.snapshot import Snapshot
from warpcontact.unilateral.rigid.trajectory import Gone, Hold, Trajectory, View, held

# Speeds below this are zero: above the rounding of speeds, below those of impacts that are not summed up [m/s].
STILL = 1.0e-9
# Forces below this share of the largest are zero.
NO_FORCE = 1.0e-9
# Part of the length that is closed by which a gap must be closed for an impact.
UNSEEN = 1.0e-3
# Halvings of a step in search of where a contact was still open, or still on its surface.
HALVINGS = 45


class _Watched(IntEnum):
    """What is positive as long as contacts do what they do."""

    GAP = 0  # of a pair that is open
    PRESS = 1  # normal force of a contact that is held
    GRIP = 2  # what is left until it slides
    SLIDE = 3  # speed in the direction in which it slides


@dataclass(frozen=True)
class _Crossing:
    """A function of the state that turns negative within a step.

    Attributes:
        watched: What.
        number: Of the pair, or of the contact that is held.
        threshold: Below its negative the function is negative.
    """

    watched: _Watched
    number: int
    threshold: float

    @property
    def decided(self) -> bool:
        """Whether velocities say what comes next; if not, contacts must be seen a little later."""
        return self.watched not in (_Watched.PRESS, _Watched.GRIP)

    def value(self, view: View, hold: Hold) -> float:
        """Returns the function in a state."""
        if self.watched is _Watched.GAP:
            # Where nothing can touch it is large.
            return float(min(view.measured.gap[self.number], 1.0e9))
        if self.watched is _Watched.SLIDE:
            return float(view.slide[self.number])
        press, grip = held(view, hold)
        return float((press if self.watched is _Watched.PRESS else grip)[self.number])


class Step:
    """A step in which contacts that are held go on with what they do.

    Args:
        trajectory: How bodies move.
        view: What is seen of ``start``.
        start: The state at its start.
        hold: What contacts do.
        length: How long it is to be [s]; it ends sooner where a contact that is held leaves its surface.

    Attributes:
        length: How long it is [s].
        end: The state at its end.
        gone: Pairs that leave their surfaces there (contacts,).
    """

    def __init__(self, trajectory: Trajectory, view: View, start: Snapshot, hold: Hold, length: float) -> None:
        self.start, self.hold = start, hold
        self._trajectory, self._first = trajectory, view
        self.length, self.end, self.gone = self._as_far_as_held(length)
        self._last = self.seen(self.end)

    def at(self, time: float) -> Snapshot:
        """Returns the state at a time after the start [s]."""
        return self._trajectory.advance(self.start, self.hold, time)

    def seen(self, state: Snapshot) -> View:
        """Returns what is seen of a state in which contacts do what they do."""
        return self._trajectory.view(state, self.hold)

    def first_crossing(self, closed: float) -> tuple[float, bool] | None:
        """Returns when the first event is [s], and if velocities say what comes next; ``None`` if there is none.

        Args:
            closed: Gaps up to this are zero [m].
        """
        first: tuple[float, bool] | None = None
        for crossing in self._crossings(UNSEEN * closed):
            end: float | None = self.length if first is None else first[0]
            late = self._last if first is None else self.seen(self.at(first[0]))
            if crossing.value(late, self.hold) >= -crossing.threshold:
                end = self._dip(crossing, late, end)
            if end is None:
                continue

            def value(time: float, one: _Crossing = crossing) -> float:
                return one.value(self.seen(self.at(time)), self.hold)

            time = _root(value, crossing.value(self._first, self.hold), end)
            if first is None or time < first[0]:
                first = (time, crossing.decided)
        return first

    def _as_far_as_held(self, length: float) -> tuple[float, Snapshot, NDArray[np.int_]]:
        """Returns how long held contacts stay on their surfaces, the state then, and the pairs that leave."""
        try:
            return length, self.at(length), np.zeros(0, dtype=int)
        except Gone as leaves:
            gone = leaves.pairs
        low, high = 0.0, length
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            try:
                self.at(middle)
            except Gone as leaves:
                high, gone = middle, leaves.pairs
            else:
                low = middle
        return low, self.at(low), gone

    def _crossings(self, tiny: float) -> Iterator[_Crossing]:
        """Iterates over what may have turned negative; gaps up to ``tiny`` [m] are rounding."""
        first, last, hold = self._first, self._last, self.hold
        is_open = np.isfinite(first.measured.gap) | np.isfinite(last.measured.gap)
        is_open[hold.pairs] = False
        dips = (first.rate < 0.0) & (last.rate > 0.0)
        for pair in np.flatnonzero(is_open & ((last.measured.gap < -tiny) | dips)).tolist():
            yield _Crossing(_Watched.GAP, pair, tiny)
        scale = NO_FORCE * max(np.abs(first.force).max(initial=0.0), np.abs(last.force).max(initial=0.0))
        press, grip = held(last, hold)
        for number in range(len(hold.pairs)):
            if press[number] < -scale:
                yield _Crossing(_Watched.PRESS, number, scale)
            if grip[number] < -scale:
                yield _Crossing(_Watched.GRIP, number, scale)
            if last.slide[number] < -STILL:
                yield _Crossing(_Watched.SLIDE, number, STILL)

    def _dip(self, crossing: _Crossing, late: View, end: float | None) -> float | None:
        """Returns when a gap that closes and opens before ``end`` is least, if it is closed then."""
        from scipy.optimize import brentq

        pair = crossing.number
        if (
            crossing.watched is not _Watched.GAP
            or end is None
            or not self._first.rate[pair] < 0.0 < late.rate[pair]
        ):
            return None

        def rate(time: float) -> float:
            return float(self.seen(self.at(time)).rate[pair])

        least = float(brentq(rate, 0.0, end, xtol=1.0e-3 * end))
        return least if crossing.value(self.seen(self.at(least)), self.hold) < -crossing.threshold else None


def _root(value: Callable[[float], float], at_start: float, end: float) -> float:
    """Returns the root of a function that is negative at ``end``, 0 if it is nowhere positive before."""
    from scipy.optimize import brentq

    start = 0.0
    if at_start <= 0.0:
        start = end
        for _ in range(HALVINGS):
            start *= 0.5
            if value(start) > 0.0:
                break
        else:
            return 0.0
    return float(brentq(value, start, end, xtol=1.0e-16, rtol=8.9e-16, maxiter=200))
