"""Event-driven motion of rigid bodies with nonsmooth contacts: reference solutions for few bodies.

Impacts are simultaneous with friction, or sequential; series of impacts at decreasing intervals are summed.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.nonsmooth.materials import CONTACT_GAP, IMPACT_LAWS
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.nonsmooth.sequence import MAX_IMPACTS_PER_CONTACT, TIE
from warpcontact.kernels.types import MODE_OPEN, MODE_STICK
from warpcontact.unilateral.reference.acceleration import FRICTION_METHODS, ParadoxError, find_contact_modes
from warpcontact.unilateral.reference.contacts import Assembler, Assembly
from warpcontact.unilateral.reference.environment import Snapshot
from warpcontact.unilateral.reference.events import Event, EventKind, EventRun
from warpcontact.unilateral.reference.trajectory import (
    NO_FORCE,
    SPEED_TOLERANCE,
    EvaluatedState,
    HeldContacts,
    Step,
    Trajectory,
)
from warpcontact.validation import checks
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


# Largest rotation of a body between two evaluations of contacts [rad].
MAX_TURN = 0.5
# Factor on the earliest time of closing at which contacts are evaluated next, so that the closing is detected.
OVERSHOOT = 1.3
# Fractions of a step after an event at which contact modes are evaluated; at the event they are undetermined.
TIME_FRACTIONS = (1.0e-6, 1.0e-5, 1.0e-4, 1.0e-3, 1.0e-2)
# Maximum number of consecutive events and steps of zero duration.
MAX_IDLE = 20
# No pairs.
NO_PAIRS = np.zeros(0, dtype=int)


@explain_keywords_of
class EventDriven:
    """Event-driven motion of one environment with nonsmooth contacts.

    All contacts of the scene are rigid. They close without penetration and bounce by Newton's law with the
    ``restitution`` of their law (0 if it has none; reduced if it would add energy). They slip or stick by
    Coulomb's law with the ``mu`` of their friction model (or ``mu_static`` and ``mu_dynamic``). Couplings and
    contact couplings are forces computed by the model; their history is not advanced. State, masses and
    coefficients are those of the model when this object is created.

    Free motion is in closed form if accelerations are uniform, else integrated by DOP853 to 1e-12. Times at which
    a gap closes, or a contact opens, slips or stops, are roots, to rounding. Simultaneous impacts are solved as
    one problem with friction. Impacts at decreasing intervals are summed as a geometric series. Surfaces must be
    smooth where the solution should be: a ball on a tessellated surface has the acceleration of its faces.

    Args:
        model: From ``Scene.build``, preferably with ``precision="float64"`` and few environments, because each
            evaluation of forces computes all of them. Its state is not changed.
        env: Index of the environment.
        closed: Gaps up to this are zero [m].
        step: Longest time between two evaluations of the contacts [s].
        zeno: Impacts of a contact within this time, at decreasing intervals, are summed [s].
        method: Method of ``wc.unilateral.solve_delassus`` that supports friction in space.
        most_events: Maximum number of events of a run.
        impacts: Law of multiple impacts, as in ``wc.integrators.MoreauJean``: ``"simultaneous"`` or
            ``"sequential"``.

    Attributes:
        state: Current state of the run, at first that of the model.

    Raises:
        TypeError: If ``model`` is not a model.
        ValueError: If an argument is out of range, or a contact has a friction model without Coulomb coefficients.
    """

    def __init__(
        self,
        model: Any,
        env: int = 0,
        *,
        closed: float = CONTACT_GAP[wp.float64],
        step: float = 0.02,
        zeno: float = 1.0e-5,
        method: str = "gauss_seidel",
        most_events: int = 10_000,
        impacts: str = "simultaneous",
    ) -> None:
        seconds = checks.limits("s", above=0.0)
        self.closed = float(checks.numbers("closed", closed, (), checks.limits("m", above=0.0)))
        self.step = float(checks.numbers("step", step, (), seconds))
        self.zeno = float(checks.numbers("zeno", zeno, (), seconds))
        self.method = checks.choice("method", method, FRICTION_METHODS)
        is_integer = isinstance(most_events, int | np.integer) and not isinstance(most_events, bool)
        if not is_integer or most_events < 1:
            raise ValueError(f"most_events must be a whole number, at least 1, got {most_events!r}")
        self.most_events = most_events
        self.impacts = checks.choice("impacts", impacts, IMPACT_LAWS)
        self.assembler = Assembler(model, env)
        self.trajectory = Trajectory(self.assembler)
        self.state = self.assembler.bodies.project_anchors(self.assembler.environment.read())
        self._held_contacts: HeldContacts | None = None
        self._impacts = Impacts(self.assembler, self.zeno, method, impacts == "sequential")
        self._events: list[Event] = []

    def run(self, duration: float, every: float | None = None) -> EventRun:
        """Advances the motion by ``duration`` [s].

        Args:
            duration: Simulated time [s].
            every: Interval of the stored states [s]; ``None``: states of all steps, and before and after each
                event.

        Raises:
            ValueError: If a time is not positive, or a contact starts in overlap.
            ParadoxError: If at some time no accelerations satisfy Coulomb's law for rigid bodies, or several;
                ``error.run`` contains the result up to then.
            RuntimeError: If there are too many events, contacts close and open without elapsed time, or the motion
                could not be integrated.
        """
        seconds = checks.limits("s", above=0.0)
        end = self.state.time + float(checks.numbers("duration", duration, (), seconds))
        if every is not None:
            every = float(checks.numbers("every", every, (), seconds))
        stored = _StoredStates(self.state.time, every)
        self._events = []
        try:
            with self.assembler.environment.preserved_state():
                self._advance_to(end, stored)
        except ParadoxError as error:
            located_error = ParadoxError(f"t = {self.state.time:.9g} s: {error}")
            located_error.run = self._result(stored)
            raise located_error from error
        return self._result(stored)

    def _result(self, stored: "_StoredStates") -> EventRun:
        times = np.array([state.time for state in stored.states])
        events = tuple(sorted(self._events, key=lambda event: event.time))
        return EventRun(times, tuple(stored.states), events, self.assembler.model.scene)

    def _advance_to(self, end: float, stored: "_StoredStates") -> None:
        if self._held_contacts is None:
            self.state = self.assembler.environment.apply_prescribed_motion(self.state)
            self._held_contacts = HeldContacts.none()
            self._check_overlaps()
            start = self.state
            stored.first(start)
            self._resolve_impacts(start)
            # Initial modes are not events, unless velocities jump.
            self._events = [one for one in self._events if one.kind is EventKind.IMPACT]
            if self._events:
                stored.step(self.state)
            else:
                stored.states[0] = self.state
        else:
            stored.first(self.state)
        evaluated = self.trajectory.evaluate(self.state, self._held_contacts)
        idle = 0
        while self.state.time < end:
            before = self.state.time
            self.trajectory.check(evaluated, self._held_contacts)
            length = min(self._safe_step(evaluated), end - self.state.time)
            step = Step(self.trajectory, evaluated, self.state, self._held_contacts, length)
            found = step.first_crossing(self.closed)
            if found is not None:
                self._advance_to_event(step, *found, stored)
            else:
                stored.between(step, step.length)
                # The last step of a run ends at ``end``, independent of rounding.
                last = step.length == end - self.state.time
                self.state = (
                    step.end if len(step.lost) else self.trajectory.projected(step.end, step.held_contacts)
                )
                self.state = self.state.at(end) if last else self.state
                stored.step(self.state)
                if len(step.lost):
                    self._resolve_impacts(self.state, step.lost)
                    stored.step(self.state)
            if len(self._events) > self.most_events:
                raise RuntimeError(
                    f"more than {self.most_events} events up to t = {self.state.time:.9g} s; "
                    "increase zeno= or most_events="
                )
            idle = idle + 1 if self.state.time == before else 0
            if idle > MAX_IDLE:
                self._raise_no_progress()
            evaluated = self.trajectory.evaluate(self.state, self._held_contacts)

    def _raise_no_progress(self) -> None:
        labels = ", ".join(dict.fromkeys(one.label for one in self._events[-MAX_IDLE:])) or "the contacts"
        raise RuntimeError(
            f"at t = {self.state.time:.9g} s {labels} close and open repeatedly: at a concave edge of a mesh a point "
            "contacts one face at a time; define the faces as separate surfaces"
        )

    def _advance_to_event(self, step: Step, time: float, velocities_decide: bool, stored: "_StoredStates") -> None:
        """Advances to the event ``time`` [s] after the start of a step, and finds the contact modes after it."""
        stored.between(step, time)
        self.state = step.at(time)
        stored.step(self.state)
        if velocities_decide:
            self._resolve_impacts(self.state)
        else:
            self._change_modes(step, time)
        stored.step(self.state)

    def _check_overlaps(self) -> None:
        gap = self.assembler.candidates.measure(self.state).gap
        deep = np.flatnonzero(gap < -self.closed)
        if len(deep):
            label = self.assembler.candidates.labels[deep[0]]
            raise ValueError(
                f"{label} starts with a penetration of {-gap[deep[0]]:.3g} m; nonsmooth contacts must start open or "
                "closed"
            )

    def _safe_step(self, evaluated: EvaluatedState) -> float:
        """Returns a time [s] within which no open contact closes by more than ``closed`` without detection."""
        assert self._held_contacts is not None
        longest = self.step
        spin = np.linalg.norm(self.state.angular_velocity, axis=1).max(initial=0.0)
        if spin > 0.0:
            longest = min(longest, MAX_TURN / spin)
        is_open = np.isfinite(evaluated.measured.gap)
        is_open[self._held_contacts.pairs] = False
        gap, rate, change = (
            values[is_open] for values in (evaluated.measured.gap, evaluated.rate, evaluated.acceleration_bound)
        )
        gap = np.maximum(gap, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            normal_response = (rate + np.sqrt(rate**2 + 2.0 * change * gap)) / change
            straight = np.where(rate < 0.0, -gap / rate, np.inf)
            earliest = np.where(change > 0.0, normal_response, straight)
            shortest = np.sqrt(8.0 * self.closed / change)
        return float(np.maximum(OVERSHOOT * earliest, shortest).min(initial=longest))

    def _closed_pairs(self, state: Snapshot, before: HeldContacts) -> NDArray[np.int_]:
        gap = self.assembler.candidates.measure(state).gap
        is_closed = np.abs(gap) <= self.closed
        is_closed[before.pairs] = np.isfinite(gap[before.pairs])
        return np.flatnonzero(is_closed)

    def _resolve_impacts(self, state: Snapshot, lost: NDArray[np.int_] = NO_PAIRS) -> None:
        """Resolves impacts of closed contacts and finds their modes afterwards; ``lost`` pairs are excluded."""
        before = self._held_contacts
        assert before is not None
        pairs = self._closed_pairs(state, before)
        pairs = pairs[np.isin(pairs, lost, invert=True)]
        state, parted, events = self._impacts.resolve(state, pairs)
        self._events += events
        self._held_contacts = self._held_contacts_from(state, pairs[~parted])
        self._record_changes(state.time, before, self._held_contacts)
        self.state = self.trajectory.projected(state, self._held_contacts)

    def _change_modes(self, step: Step, time: float) -> None:
        """Finds the contact modes after a force or friction limit was reached, ``time`` after the start.

        The modes are evaluated slightly later, when inadmissible forces show which contact changes. Redundant
        contacts may redistribute their forces and keep their modes.
        """
        before = self._held_contacts
        assert before is not None
        state = later = self.state
        for part in TIME_FRACTIONS:
            later = step.at(time + part * step.length)
            found = self._held_contacts_from(later, self._closed_pairs(later, before))
            same = np.array_equal(found.pairs, before.pairs) and np.array_equal(found.mode, before.mode)
            if not same:
                self._record_changes(state.time, before, found)
                later = state
                break
        self._held_contacts = found
        self.state = self.trajectory.projected(later, found)

    def _held_contacts_from(self, state: Snapshot, pairs: NDArray[np.int_]) -> HeldContacts:
        """Returns the held contacts and their modes, of closed contacts that do not open, from a state on."""
        measured = self.assembler.candidates.measure(state)
        own = self.assembler.assembly(state, measured, pairs)
        b = self.trajectory.free_relative(state, own, pairs)
        slip = own.contact_velocity[:, 1:]
        sliding = np.linalg.norm(slip, axis=1) > SPEED_TOLERANCE
        found = find_contact_modes(own.delassus, b, own.mu_static, own.mu, slip, sliding, own.labels, self.method)
        stays = found.mode != MODE_OPEN
        tangents = own.axes[stays, 1:]
        return HeldContacts(
            pairs=pairs[stays],
            mode=found.mode[stays],
            direction=(found.direction[stays, None, :] @ tangents)[:, 0],
            force=(found.force[stays, None, :] @ own.axes[stays])[:, 0],
        )

    def _record_changes(self, time: float, before: HeldContacts, after: HeldContacts) -> None:
        """Adds the events of contacts whose mode has changed."""
        candidates = self.assembler.candidates
        was = dict(zip(before.pairs.tolist(), before.mode.tolist(), strict=True))
        now = dict(zip(after.pairs.tolist(), after.mode.tolist(), strict=True))
        for pair in was:
            if pair not in now:
                self._events.append(candidates.event(time, EventKind.LIFT_OFF, pair))
        rubs = candidates.mu_static > 0.0
        for pair, mode in now.items():
            if rubs[pair] and was.get(pair) != mode:
                kind = EventKind.STICK if mode == MODE_STICK else EventKind.SLIP
                self._events.append(candidates.event(time, kind, pair))


class _StoredStates:
    """States stored by a run."""

    def __init__(self, start: float, every: float | None) -> None:
        self.start, self.every = start, every
        self.states: list[Snapshot] = []

    def first(self, state: Snapshot) -> None:
        self.states.append(state)

    def between(self, step: Step, length: float) -> None:
        """Stores the states at multiples of the interval within the first ``length`` [s] of a step."""
        if self.every is None:
            return
        # A time that equals the end of the step to rounding gets the state at the end.
        while (next_time := self.start + len(self.states) * self.every) <= step.start.time + length * (
            1.0 + 1.0e-12
        ):
            within = min(max(next_time - step.start.time, 0.0), length)
            self.states.append(step.at(within).at(next_time))

    def step(self, state: Snapshot) -> None:
        """Stores the state at the end of a step, or before or after an event."""
        if self.every is None:
            self.states.append(state)
