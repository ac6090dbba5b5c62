"""Event-driven motion of rigid bodies with hard contacts: reference solutions for few of them."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact import checks
from warpcontact.checks import Array
from warpcontact.kernels.types import MODE_OPEN, MODE_STICK
from warpcontact.unilateral.acceleration import ParadoxError, find_modes
from warpcontact.unilateral.assembly import Assembler, Assembly
from warpcontact.unilateral.events import Event, EventKind, EventRun, in_order
from warpcontact.unilateral.snapshot import Snapshot
from warpcontact.unilateral.trajectory import Gone, Hold, Trajectory, View, held

# Speeds below this are zero: above the rounding of speeds, below those of impacts that are not summed up [m/s].
STILL = 1.0e-9
# Part of the length that is closed by which a gap must be closed for an impact.
UNSEEN = 1.0e-3
# Forces below this share of the largest are zero.
NO_FORCE = 1.0e-9
# Most that a body turns between two looks at contacts [rad].
TURN = 0.5
# How far beyond where a contact may close at the earliest the next look is, so that it is seen closed.
BEYOND = 1.3
# Parts of a step after an event at which it is looked what the contacts do: at the event itself it is undecided.
AFTER = (1.0e-6, 1.0e-5, 1.0e-4, 1.0e-3, 1.0e-2)
# Work of impulses over that of all single ones that is rounding, and halvings of the restitution that brings more.
NO_GAIN = 1.0e-12
PARTS = 45
# Speed of sliding over that of the last impact of a series up to which both end together.
SLENDER = 20.0
# Halvings of a step in search of where a contact was still open.
HALVINGS = 45


# No pairs.
NOTHING = np.zeros(0, dtype=int)


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


class EventDriven:
    """The motion of one environment with hard contacts, from event to event.

    All contacts of the scene are rigid: they close without penetration, bounce by Newton's law with the
    ``restitution`` of their law (0 if it has none; less where that would bring energy), and slide or stick by
    Coulomb's with the ``mu`` of their friction (``mu_static`` and ``mu_dynamic`` if it has two). Couplings, and
    contact couplings, are forces, as the model computes them; what these remember stays as it is.

    Flight is in closed form where accelerations are uniform, else by DOP853 to 1e-12. Times at which a gap closes,
    or a contact parts, slides or stops, are roots, to rounding. Contacts that impact together do so in one problem
    with friction, and impacts that come ever closer are summed up as a geometric series. What is smooth must be
    so: where a ball rolls over the edges of a tessellated surface, its acceleration is that of the faces.

    Args:
        model: From ``Scene.build``, best with ``precision="float64"`` and few environments: each evaluation of
            forces is one of all of them. Its state stays as it is.
        env: Number of the environment.
        closed: Gaps up to this are zero [m].
        step: Longest time between two looks at the contacts [s].
        zeno: Impacts of a contact that follow one another within this time, ever closer, are summed up [s].
        method: Of ``wc.unilateral.solve_delassus``.
        most_events: After so many events a run is given up.

    Attributes:
        state: The state that the run has come to, at first that of the model.

    Raises:
        TypeError: If ``model`` is none.
        ValueError: If an argument is out of range, or a contact has a friction that a cone cannot take.
    """

    def __init__(
        self,
        model: Any,
        env: int = 0,
        *,
        closed: float = 1.0e-9,
        step: float = 0.02,
        zeno: float = 1.0e-5,
        method: str = "gauss_seidel",
        most_events: int = 10_000,
    ) -> None:
        seconds = checks.limits("s", above=0.0)
        self.closed = float(checks.numbers("closed", closed, (), checks.limits("m", above=0.0)))
        self.step = float(checks.numbers("step", step, (), seconds))
        self.zeno = float(checks.numbers("zeno", zeno, (), seconds))
        self.method, self.most_events = method, most_events
        self.assembler = Assembler(model, env)
        self.trajectory = Trajectory(self.assembler)
        self.state = self.assembler.bodies.settled(self.assembler.place.read())
        self._hold: Hold | None = None
        self._impacts: dict[int, tuple[float, float]] = {}  # of a pair: when it was last, and how long before that
        self._events: list[Event] = []

    def run(self, duration: float, every: float | None = None) -> EventRun:
        """Goes on for ``duration`` [s].

        Args:
            duration: Simulated time [s].
            every: Time between the states that are kept [s]; ``None``: those of all steps, and before and after
                each event.

        Raises:
            ValueError: If a time is not positive, or a contact begins in overlap.
            ParadoxError: If at some time no accelerations agree with rigid bodies and Coulomb friction, or
                several; ``error.run`` has what was computed up to there.
            RuntimeError: If there are too many events, or the motion could not be integrated.
        """
        seconds = checks.limits("s", above=0.0)
        end = self.state.time + float(checks.numbers("duration", duration, (), seconds))
        if every is not None:
            every = float(checks.numbers("every", every, (), seconds))
        kept = _Kept(self.state.time, every)
        self._events = []
        before = self.assembler.place.read()
        try:
            self._go(end, kept)
        except ParadoxError as error:
            told = ParadoxError(f"t = {self.state.time:.9g} s: {error}")
            told.run = self._result(kept)
            raise told from error
        finally:
            self.assembler.place.write(before)
        return self._result(kept)

    def _result(self, kept: "_Kept") -> EventRun:
        times = np.array([state.time for state in kept.states])
        return EventRun(times, tuple(kept.states), in_order(self._events), self.assembler.model.scene)

    def _go(self, end: float, kept: "_Kept") -> None:
        if self._hold is None:
            self.state = self.assembler.place.follow(self.state)
            self._hold = Hold.nothing()
            self._refuse_overlaps()
            self._meet(self.state)
            self._events = []
        kept.first(self.state)
        view = self.trajectory.view(self.state, self._hold)
        while self.state.time < end:
            self.trajectory.check(view, self._hold)
            length = min(self._safe_step(view), end - self.state.time)
            state, hold = self.state, self._hold

            def advanced(time: float, state: Snapshot = state, hold: Hold = hold) -> Snapshot:
                return self.trajectory.advance(state, hold, time)

            length, after, gone = _as_far_as_held(advanced, length)
            seen = self.trajectory.view(after, hold)
            found = self._first_crossing(view, seen, length, advanced)
            if found is None and len(gone):
                kept.between(state, length, advanced)
                self.state = after
                kept.step(self.state)
                self._meet(self.state, gone)
                kept.step(self.state)
            elif found is None:
                kept.between(state, length, advanced)
                # The last step of a run ends there, whatever the sum of times is rounded to.
                self.state = self.trajectory.projected(after, hold)
                if length == end - state.time:
                    self.state = _at(self.state, end)
                kept.step(self.state)
            else:
                time, decided = found
                kept.between(state, time, advanced)
                self.state = advanced(time)
                kept.step(self.state)
                if decided:
                    self._meet(self.state)
                else:
                    self._change(time, length, advanced)
                kept.step(self.state)
                if len(self._events) > self.most_events:
                    raise RuntimeError(
                        f"more than {self.most_events} events up to t = {self.state.time:.9g} s; "
                        "zeno= may be too small for them, or most_events="
                    )
            view = self.trajectory.view(self.state, self._hold)

    def _refuse_overlaps(self) -> None:
        gap = self.assembler.candidates.measure(self.state).gap
        deep = np.flatnonzero(gap < -self.closed)
        if len(deep):
            label = self.assembler.candidates.labels[deep[0]]
            raise ValueError(
                f"{label} begins in overlap, {-gap[deep[0]]:.3g} m deep; hard contacts begin apart or closed"
            )

    def _safe_step(self, view: View) -> float:
        """Returns a time [s] within which no contact that is open closes unseen by more than ``closed``."""
        assert self._hold is not None
        longest = self.step
        spin = np.linalg.norm(self.state.angular_velocity, axis=1).max(initial=0.0)
        if spin > 0.0:
            longest = min(longest, TURN / spin)
        is_open = np.isfinite(view.measured.gap)
        is_open[self._hold.pairs] = False
        gap, rate, change = (values[is_open] for values in (view.measured.gap, view.rate, view.change))
        gap = np.maximum(gap, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            bent = (rate + np.sqrt(rate**2 + 2.0 * change * gap)) / change
            straight = np.where(rate < 0.0, -gap / rate, np.inf)
            earliest = np.where(change > 0.0, bent, straight)
            shortest = np.sqrt(8.0 * self.closed / change)
        return float(np.maximum(BEYOND * earliest, shortest).min(initial=longest))

    def _first_crossing(
        self, view: View, seen: View, length: float, advanced: Callable[[float], Snapshot]
    ) -> tuple[float, bool] | None:
        """Returns when within a step the first event is, and whether velocities say what comes next."""
        hold = self._hold
        assert hold is not None
        first: tuple[float, bool] | None = None
        for crossing in self._crossings(view, seen, hold):
            end: float | None = length if first is None else first[0]
            late = seen if first is None else self.trajectory.view(advanced(first[0]), hold)
            if crossing.value(late, hold) >= -crossing.threshold:
                end = self._dip(crossing, view, late, end, advanced)
            if end is None:
                continue

            def value(time: float, one: _Crossing = crossing) -> float:
                return one.value(self.trajectory.view(advanced(time), hold), hold)

            time = self._root(value, crossing.value(view, hold), end)
            if first is None or time < first[0]:
                first = (time, crossing.decided)
        return first

    def _crossings(self, view: View, seen: View, hold: Hold) -> list[_Crossing]:
        """Returns what may have turned negative within a step."""
        found: list[_Crossing] = []
        tiny = UNSEEN * self.closed
        is_open = np.isfinite(view.measured.gap) | np.isfinite(seen.measured.gap)
        is_open[hold.pairs] = False
        dips = (view.rate < 0.0) & (seen.rate > 0.0)
        for pair in np.flatnonzero(is_open & ((seen.measured.gap < -tiny) | dips)).tolist():
            found.append(_Crossing(_Watched.GAP, pair, tiny))
        scale = NO_FORCE * max(np.abs(view.force).max(initial=0.0), np.abs(seen.force).max(initial=0.0))
        press, grip = held(seen, hold)
        for number in range(len(hold.pairs)):
            if press[number] < -scale:
                found.append(_Crossing(_Watched.PRESS, number, scale))
            if grip[number] < -scale:
                found.append(_Crossing(_Watched.GRIP, number, scale))
            if seen.slide[number] < -STILL:
                found.append(_Crossing(_Watched.SLIDE, number, STILL))
        return found

    def _dip(
        self, crossing: _Crossing, view: View, seen: View, end: float | None, advanced: Callable[[float], Snapshot]
    ) -> float | None:
        """Returns when a gap that closes and opens within a step is least, if it is closed then."""
        from scipy.optimize import brentq

        pair, hold = crossing.number, self._hold
        assert hold is not None
        if crossing.watched is not _Watched.GAP or end is None or not view.rate[pair] < 0.0 < seen.rate[pair]:
            return None

        def rate(time: float) -> float:
            return float(self.trajectory.view(advanced(time), hold).rate[pair])

        least = float(brentq(rate, 0.0, end, xtol=1.0e-3 * end))
        deep = crossing.value(self.trajectory.view(advanced(least), hold), hold) < -crossing.threshold
        return least if deep else None

    @staticmethod
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

    def _closed_pairs(self, state: Snapshot, before: Hold) -> NDArray[np.int_]:
        gap = self.assembler.candidates.measure(state).gap
        is_closed = np.abs(gap) <= self.closed
        is_closed[before.pairs] = np.isfinite(gap[before.pairs])
        return np.flatnonzero(is_closed)

    def _meet(self, state: Snapshot, gone: NDArray[np.int_] = NOTHING) -> None:
        """Lets contacts that are closed impact, and finds what they do from then on; ``gone`` do nothing more."""
        before = self._hold
        assert before is not None
        pairs = self._closed_pairs(state, before)
        pairs = pairs[np.isin(pairs, gone, invert=True)]
        state, parted = self._impact(state, pairs)
        self._hold = self._held_from(state, pairs[~parted])
        self._tell_changes(state.time, before, self._hold)
        self.state = self.trajectory.projected(state, self._hold)

    def _change(self, time: float, length: float, advanced: Callable[[float], Snapshot]) -> None:
        """Finds what contacts do after they came to the edge of what they did, within a step of ``length``.

        A little later, forces that they cannot have show what they do instead. Redundant contacts may share them
        out otherwise, and go on.
        """
        before = self._hold
        assert before is not None
        state = later = self.state
        for part in AFTER:
            later = advanced(time + part * length)
            found = self._held_from(later, self._closed_pairs(later, before))
            same = np.array_equal(found.pairs, before.pairs) and np.array_equal(found.mode, before.mode)
            if not same:
                self._tell_changes(state.time, before, found)
                later = state
                break
        self._hold = found
        self.state = self.trajectory.projected(later, found)

    def _impact(self, state: Snapshot, pairs: NDArray[np.int_]) -> tuple[Snapshot, NDArray[np.bool_]]:
        """Returns the state after the impacts of closed contacts, and which of these part (contacts,)."""
        measured = self.assembler.candidates.measure(state)
        own = self.assembler.assembly(state, measured, pairs)
        speed = own.contact_velocity
        if not (speed[:, 0] < -STILL).any():
            return state, speed[:, 0] > STILL
        ending = self._series(state.time, pairs, speed[:, 0])
        restitution = np.where(np.isin(pairs, list(ending)), 0.0, own.restitution)
        force = self._impulses(own, speed, restitution)
        velocity = state.velocity + own.inverse_mass @ (own.rows.T @ force.reshape(-1))
        after = (own.rows @ velocity).reshape(-1, 3)[:, 0]
        if ending:
            velocity = self._ended(own, velocity, np.isin(pairs, list(ending)), -speed[:, 0].min())
            after = (own.rows @ velocity).reshape(-1, 3)[:, 0]
        impulse = (force[:, None, :] @ own.axes)[:, 0]
        for number, pair in enumerate(pairs):
            if force[number, 0] > NO_FORCE * force[:, 0].max():
                self._tell(state.time, EventKind.IMPACT, pair, impulse[number], -speed[number, 0], after[number])
        for pair, time in ending.items():
            self._tell(time, EventKind.REST, pair)
        return state.with_velocity(velocity), after > STILL

    @staticmethod
    def _ended(own: Assembly, velocity: Array, ending: NDArray[np.bool_], approach: float) -> Array:
        """Returns velocities (6 bodies,) after all of a series of impacts: without what is left of parting.

        And of sliding that is no faster than the last ``approach`` [m/s] by more than bodies are longer than wide.
        """
        U = (own.rows @ velocity).reshape(-1, 3)
        slow = (np.linalg.norm(U[:, 1:], axis=1) < SLENDER * approach) & (own.mu > 0.0)
        chosen = np.stack([ending, ending & slow, ending & slow], axis=1).reshape(-1)
        rows = own.rows[chosen]
        response = own.inverse_mass @ rows.T
        return velocity - response @ np.linalg.lstsq(rows @ response, rows @ velocity, rcond=1.0e-11)[0]

    def _impulses(self, own: Assembly, speed: Array, restitution: Array) -> Array:
        """Returns the impulses of an impact by local axes (contacts, 3) [N·s].

        Newton's law alone may bring energy where friction turns a slip round, or contacts of different restitution
        are hit together: restitution is then lowered, of all contacts alike, until it brings none.
        """
        none = np.zeros(own.count, dtype=bool)

        def solved(part: float) -> tuple[Array, float]:
            asked = speed.copy()
            asked[:, 0] += part * restitution * np.minimum(speed[:, 0], 0.0)
            slip = np.zeros((own.count, 2))
            found = find_modes(own.delassus, asked, own.mu, own.mu, slip, none, own.labels, self.method)
            after = speed + (own.delassus @ found.force.reshape(-1)).reshape(-1, 3)
            work = found.force * (speed + after)
            return found.force, float(work.sum() / (np.abs(work).sum() or 1.0))

        force, gain = solved(1.0)
        if gain <= NO_GAIN or not restitution.any():
            return force
        low, high = 0.0, 1.0
        for _ in range(PARTS):
            part = 0.5 * (low + high)
            low, high = (part, high) if solved(part)[1] <= NO_GAIN else (low, part)
        return solved(low)[0]

    def _series(self, time: float, pairs: NDArray[np.int_], speed: Array) -> dict[int, float]:
        """Returns contacts of which impacts that come ever closer are summed up, and when these will have ended.

        Remembers the impacts.
        """
        limit = None
        for pair, approach in zip(pairs.tolist(), speed, strict=True):
            if approach >= -STILL:
                continue
            last, interval = self._impacts.get(pair, (-np.inf, np.inf))
            since = time - last
            if np.isfinite(interval) and since <= self.zeno and since < interval:
                ratio = since / interval
                limit = max(limit or 0.0, time + since * ratio / (1.0 - ratio))
            self._impacts[pair] = (time, since)
        if limit is None:
            return {}
        # Contacts that take turns come to rest together.
        recent = [pair for pair, (last, _) in self._impacts.items() if time - last <= 2.0 * self.zeno]
        ending = {pair: limit for pair in recent if pair in pairs}
        for pair in ending:
            del self._impacts[pair]
        return ending

    def _held_from(self, state: Snapshot, pairs: NDArray[np.int_]) -> Hold:
        """Returns what closed contacts that do not part do from a state on."""
        measured = self.assembler.candidates.measure(state)
        own = self.assembler.assembly(state, measured, pairs)
        b = self.trajectory.free_relative(state, own, pairs)
        slip = own.contact_velocity[:, 1:]
        sliding = np.linalg.norm(slip, axis=1) > STILL
        found = find_modes(own.delassus, b, own.mu_static, own.mu, slip, sliding, own.labels, self.method)
        stays = found.mode != MODE_OPEN
        tangents = own.axes[stays, 1:]
        return Hold(
            pairs=pairs[stays],
            mode=found.mode[stays],
            direction=(found.direction[stays, None, :] @ tangents)[:, 0],
            force=(found.force[stays, None, :] @ own.axes[stays])[:, 0],
        )

    def _tell_changes(self, time: float, before: Hold, after: Hold) -> None:
        """Adds the events of contacts that do something else than before."""
        was = dict(zip(before.pairs.tolist(), before.mode.tolist(), strict=True))
        now = dict(zip(after.pairs.tolist(), after.mode.tolist(), strict=True))
        for pair in was:
            if pair not in now:
                self._tell(time, EventKind.LIFT_OFF, pair)
        rubs = self.assembler.candidates.mu_static > 0.0
        for pair, mode in now.items():
            if rubs[pair] and was.get(pair) != mode:
                self._tell(time, EventKind.STICK if mode == MODE_STICK else EventKind.SLIP, pair)

    def _tell(
        self,
        time: float,
        kind: EventKind,
        pair: int,
        impulse: Array | None = None,
        approach: float = 0.0,
        separation: float = 0.0,
    ) -> None:
        own = self.assembler.candidates
        self._events.append(
            Event(
                time=float(time),
                kind=kind,
                contact=str(own.names[pair]),
                item=int(own.items[pair]),
                label=own.labels[pair],
                impulse=np.zeros(3) if impulse is None else impulse,
                approach_speed=float(approach),
                separation_speed=float(separation),
            )
        )


def _as_far_as_held(
    advanced: Callable[[float], Snapshot], length: float
) -> tuple[float, Snapshot, NDArray[np.int_]]:
    """Returns how far contacts that are held stay on their surfaces, the state then, and the pairs that leave."""
    try:
        return length, advanced(length), NOTHING
    except Gone as leaves:
        gone = leaves.pairs
    low, high = 0.0, length
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        try:
            advanced(middle)
        except Gone as leaves:
            high, gone = middle, leaves.pairs
        else:
            low = middle
    return low, advanced(low), gone


class _Kept:
    """The states that a run keeps."""

    def __init__(self, start: float, every: float | None) -> None:
        self.start, self.every = start, every
        self.states: list[Snapshot] = []

    def first(self, state: Snapshot) -> None:
        self.states.append(state)

    def between(self, state: Snapshot, length: float, advanced: Callable[[float], Snapshot]) -> None:
        """Keeps the states at whole intervals within a step."""
        if self.every is None:
            return
        # Of a time that a step ends at to rounding, the state at its end.
        while (next_time := self.start + len(self.states) * self.every) <= state.time + length * (1.0 + 1.0e-12):
            within = min(max(next_time - state.time, 0.0), length)
            self.states.append(_at(advanced(within), next_time))

    def step(self, state: Snapshot) -> None:
        """Keeps the state at the end of a step, or before or after an event."""
        if self.every is None:
            self.states.append(state)


def _at(state: Snapshot, time: float) -> Snapshot:
    return Snapshot(time, state.position, state.orientation, state.linear_velocity, state.angular_velocity)
