"""Motion between events: bodies in free motion, and in contacts with fixed modes.

``Step`` detects the end of such a motion: contacts that close, open, stick, slip or leave.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import cross
from warpcontact.kernels.types import MODE_SLIP, MODE_STICK, TIME_FUNCTION, WORLD
from warpcontact.unilateral.reference.acceleration import check_slides, forces_of_modes, normal_response, zero_rows
from warpcontact.unilateral.reference.contacts import Assembler, Assembly, MeasuredPairs, contact_rows
from warpcontact.unilateral.reference.environment import Snapshot
from warpcontact.validation.checks import Array

# Relative and absolute tolerance of a step of DOP853, a few roundings of float64.
RELATIVE, ABSOLUTE = 1.0e-12, 1.0e-13
# Both tolerances in contact with a body of prescribed motion: its accelerations are finite differences in time
# with an error of 1e-6; with a smaller tolerance the step length would shrink without end.
PRESCRIBED_ERROR = 1.0e-8
# Displacement for the differences of the rows of H [rad, m]: truncation (fourth order) and rounding error are both
# below 1e-12.
DIFFERENCE = 3.0e-4
# Speed below which the direction of slip is the initial one [m/s].
SLOW = 1.0e-10
# Gyroscopic acceleration below this fraction of ω² is rounding.
ROUNDING = 1.0e-13


@dataclass(frozen=True)
class HeldContacts:
    """Contacts that stay closed, and their modes; vectors in world axes, independent of the choice of tangents.

    Attributes:
        pairs: Indices of the candidates (contacts,).
        mode: STICK or SLIP of each (contacts,).
        direction: Direction of slip (contacts, 3), 0 without slip.
        force: Forces at the start of these modes (contacts, 3) [N].
    """

    pairs: NDArray[np.int_]
    mode: NDArray[np.int_]
    direction: Array
    force: Array

    @staticmethod
    def none() -> "HeldContacts":
        """Returns held contacts of bodies in free motion (none)."""
        return HeldContacts(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((0, 3)))


class LostContact(Exception):
    """Raised when a held contact leaves its surface: beyond the boundary there is no contact."""

    def __init__(self, pairs: NDArray[np.int_]) -> None:
        super().__init__()
        self.pairs = pairs


@dataclass(frozen=True)
class EvaluatedState:
    """Evaluation of a state.

    Attributes:
        measured: Contact geometry of all pairs.
        rate: Rates of their gaps (pairs,) [m/s].
        assembly: Assembly of the held contacts.
        force: Forces of the held contacts, in local axes (contacts, 3) [N].
        slide: Their speeds along the direction of slip (contacts,) [m/s].
        acceleration: Accelerations of all bodies (6 bodies,) [m/s², rad/s²].
        acceleration_bound: Bounds on the accelerations of the gaps of all pairs (pairs,) [m/s²].
    """

    measured: MeasuredPairs
    rate: Array
    assembly: Assembly
    force: Array
    slide: Array
    acceleration: Array
    acceleration_bound: Array


class Trajectory:
    """Motion of the bodies of one environment while contact modes do not change."""

    def __init__(self, assembler: Assembler) -> None:
        self.assembler = assembler
        scene, bodies = assembler.model.scene, assembler.bodies
        self.pairs = assembler.candidates.bodies
        self.prescribed = bodies.kinds == TIME_FUNCTION
        # Whether accelerations in free motion do not depend on poses, except for gyroscopic ones.
        self.uniform = not (
            assembler.candidates.coupling_sets
            or scene.contact_couplings
            or bodies.anchored.any()
            or assembler.candidates.environment.prescribed_motions
        )

    def evaluate(self, snapshot: Snapshot, held_contacts: HeldContacts) -> EvaluatedState:
        """Returns the evaluation of a state with ``held_contacts``."""
        measured = self.assembler.candidates.measure(snapshot)
        own = self.assembler.assembly(snapshot, measured, held_contacts.pairs)
        local = self._forces(snapshot, own, held_contacts)
        acceleration = own.accelerations(local)
        is_slipping = held_contacts.mode == MODE_SLIP
        speed = own.contact_velocity[:, None, :] @ own.axes
        slide = np.where(is_slipping, (speed[:, 0] * held_contacts.direction).sum(axis=1), 0.0)
        rows = self.normal_rows(snapshot, measured)
        # The common acceleration of both bodies counts little; rotation adds at most ω² times the arm of K.
        acceleration_bound = 2.0 * np.abs(rows @ acceleration) + 0.1 * np.abs(rows) @ np.abs(acceleration)
        arms = np.linalg.norm(
            np.nan_to_num(measured.point)[:, None] - snapshot.position[np.maximum(self.pairs, 0)], axis=2
        )
        fastest = (snapshot.angular_velocity**2).sum(axis=1)[np.maximum(self.pairs, 0)]
        acceleration_bound += (fastest * arms * (self.pairs >= 0)).sum(axis=1)
        return EvaluatedState(
            measured, rows @ snapshot.velocity, own, local, slide, acceleration, acceleration_bound
        )

    def normal_rows(self, snapshot: Snapshot, measured: MeasuredPairs) -> Array:
        """Returns the rows of H of all gaps (pairs, 6 bodies); zeros for pairs without possible contact."""
        valid = np.isfinite(measured.gap)
        normal = np.where(valid[:, None], measured.normal, 0.0)
        point = np.where(valid[:, None], measured.point, 0.0)
        return contact_rows(normal[:, None, :], point, self.pairs, snapshot.position)[:, 0]

    def free_relative(self, snapshot: Snapshot, own: Assembly, pairs: NDArray[np.int_]) -> Array:
        """Returns relative accelerations of contacts without contact forces (contacts, 3) [m/s²]."""
        b = (own.rows @ own.free_acceleration).reshape(-1, 3)
        return b + self._convective_acceleration(snapshot, own, pairs)

    def advance(self, snapshot: Snapshot, held_contacts: HeldContacts, duration: float) -> Snapshot:
        """Returns the state after ``duration`` [s] with ``held_contacts``.

        In closed form if accelerations are uniform; otherwise by DOP853, to rounding.

        Raises:
            LostContact: If a held contact leaves its surface before.
        """
        if duration == 0.0:
            return snapshot
        if self.uniform and not len(held_contacts.pairs):
            uniform = self._uniform(snapshot)
            if uniform is not None:
                displacement = duration * snapshot.velocity
                displacement[np.arange(len(displacement)) % 6 < 3] += (
                    (0.5 * duration**2 * uniform).reshape(-1, 6)[:, :3].reshape(-1)
                )
                moved = snapshot.displaced(displacement).with_velocity(snapshot.velocity + duration * uniform)
                return replace(moved, time=snapshot.time + duration)
        return self._integrated(snapshot, held_contacts, duration)

    def _uniform(self, snapshot: Snapshot) -> Array | None:
        """Returns the accelerations of bodies in free motion (6 bodies,), ``None`` if they are not constant."""
        model, env = self.assembler.model, self.assembler.env
        bodies = self.assembler.bodies
        if model.arrays.model.body_external_torque.numpy()[env].any():
            return None
        response = bodies.response(snapshot)
        spin = (snapshot.angular_velocity**2).sum(axis=1)
        if (np.abs(response.bias.reshape(-1, 6)).max(axis=1) > ROUNDING * spin).any():
            return None
        force = np.zeros((bodies.count, 6))
        force[:, :3] = model.arrays.model.body_external_force.numpy()[env] + bodies.mass[:, None] * bodies.gravity
        acceleration: Array = response.inverse_mass @ force.reshape(-1)
        return acceleration

    def _integrated(self, snapshot: Snapshot, held_contacts: HeldContacts, duration: float) -> Snapshot:
        from scipy.integrate import solve_ivp

        count = len(snapshot.position)
        normal = self.assembler.candidates.measure(snapshot).normal[held_contacts.pairs]
        start = np.concatenate(
            [snapshot.position.reshape(-1), snapshot.orientation.reshape(-1), snapshot.velocity]
        )

        def state(time: float, values: Array) -> Snapshot:
            orientation = values[3 * count : 7 * count].reshape(count, 4)
            moved = replace(
                snapshot,
                time=snapshot.time + time,
                position=values[: 3 * count].reshape(count, 3),
                orientation=orientation / np.linalg.norm(orientation, axis=1, keepdims=True),
            ).with_velocity(values[7 * count :])
            moved = self.assembler.bodies.project_anchors(moved)
            return self.assembler.environment.apply_prescribed_motion(moved)

        def derivatives(time: float, values: Array) -> Array:
            now = state(time, values)
            measured = self.assembler.candidates.measure(now)
            valid = _same_surface(measured, held_contacts.pairs, normal)
            if not valid.all():
                raise LostContact(held_contacts.pairs[np.logical_not(valid)])
            own = self.assembler.assembly(now, measured, held_contacts.pairs)
            acceleration = own.accelerations(self._forces(now, own, held_contacts))
            spin, q = now.angular_velocity, values[3 * count : 7 * count].reshape(count, 4)
            turn = np.hstack(
                [q[:, 3:] * spin + cross(spin, q[:, :3]), -(spin * q[:, :3]).sum(axis=1, keepdims=True)]
            )
            # Prescribed bodies are placed by ``apply_prescribed_motion``.
            parts = (now.linear_velocity, 0.5 * turn, acceleration.reshape(count, 6))
            return np.concatenate([np.where(self.prescribed[:, None], 0.0, part).reshape(-1) for part in parts])

        bodies = self.pairs[held_contacts.pairs]
        is_prescribed = bool(self.prescribed[bodies[bodies != WORLD]].any())
        relative, absolute = (PRESCRIBED_ERROR, PRESCRIBED_ERROR) if is_prescribed else (RELATIVE, ABSOLUTE)
        result = solve_ivp(
            derivatives, (0.0, duration), start, "DOP853", rtol=relative, atol=absolute, first_step=duration
        )
        if not result.success:
            raise RuntimeError(
                f"the motion from t = {snapshot.time:.9g} s could not be integrated: {result.message}"
            )
        return state(duration, result.y[:, -1])

    def _forces(self, snapshot: Snapshot, own: Assembly, held_contacts: HeldContacts) -> Array:
        """Returns the forces of held contacts, in local axes (contacts, 3) [N]."""
        if not len(held_contacts.pairs):
            return np.zeros((0, 3))
        b = self.free_relative(snapshot, own, held_contacts.pairs)
        guess = (own.axes @ held_contacts.force[..., None])[..., 0]
        return forces_of_modes(
            own.delassus, b, own.mu, held_contacts.mode, self.slide_directions(own, held_contacts), guess
        )

    def slide_directions(self, own: Assembly, held_contacts: HeldContacts) -> Array:
        """Returns the directions of slip in local axes (contacts, 2).

        The direction is continued beyond the end of slip, so that the end can be located as a root.
        """
        directions = (own.axes[:, 1:] @ held_contacts.direction[..., None])[..., 0]
        sizes = np.linalg.norm(directions, axis=1, keepdims=True)
        directions = np.divide(directions, sizes, out=np.zeros_like(directions), where=sizes > 0.0)
        slip = own.contact_velocity[:, 1:]
        speed = np.linalg.norm(slip, axis=1, keepdims=True)
        keeps_sliding = ((slip * directions).sum(axis=1, keepdims=True) > SLOW) & (sizes > 0.0)
        return np.where(keeps_sliding, slip / np.where(speed > 0.0, speed, 1.0), directions)

    def check(self, evaluated: EvaluatedState, held_contacts: HeldContacts) -> None:
        """Raises ``ParadoxError`` if slipping contacts do not determine their normal forces."""
        own = evaluated.assembly
        sliding = np.flatnonzero((held_contacts.mode == MODE_SLIP) & (own.mu > 0.0))
        if len(sliding):
            matrix = normal_response(own.delassus, own.mu, self.slide_directions(own, held_contacts), sliding)
            check_slides(matrix, [own.labels[i] for i in sliding])

    def projected(self, snapshot: Snapshot, held_contacts: HeldContacts) -> Snapshot:
        """Returns the state with gaps of closed contacts, and their velocities, set to zero."""
        if not len(held_contacts.pairs):
            return snapshot
        for _ in range(2):
            measured = self.assembler.candidates.measure(snapshot)
            own = self.assembler.assembly(snapshot, measured, held_contacts.pairs)
            normals = 3 * np.arange(own.count)
            snapshot = snapshot.displaced(_least_energy_change(own, normals, -own.gap))
            snapshot = self.assembler.bodies.project_anchors(snapshot)
        measured = self.assembler.candidates.measure(snapshot)
        own = self.assembler.assembly(snapshot, measured, held_contacts.pairs)
        rows = zero_rows(held_contacts.mode)
        change = _least_energy_change(own, rows, -own.contact_velocity.reshape(-1)[rows])
        return self.assembler.bodies.project_anchors(snapshot.with_velocity(snapshot.velocity + change))

    def _convective_acceleration(self, snapshot: Snapshot, own: Assembly, pairs: NDArray[np.int_]) -> Array:
        """Returns Ḣ v of contacts (contacts, 3): accelerations of K by rotation and rolling [m/s²].

        Computed by differences along the motion, so no curvature of the surfaces is needed.
        """
        velocity = snapshot.velocity
        rate = np.linalg.norm(snapshot.angular_velocity, axis=1).max(initial=0.0)
        rate = max(rate, np.linalg.norm(snapshot.linear_velocity, axis=1).max(initial=0.0))
        if rate == 0.0 or not len(pairs):
            return np.zeros((len(pairs), 3))
        step = DIFFERENCE / rate
        values = {0: (own.rows @ velocity).reshape(-1, 3)}
        valid = np.ones(len(pairs), dtype=bool)
        for steps in (-2, -1, 1, 2):
            moved = snapshot.displaced(steps * step * velocity)
            measured = self.assembler.candidates.measure(moved)
            if steps > 0:
                valid &= _same_surface(measured, pairs, own.axes[:, 0])
            axes = np.concatenate([measured.normal[pairs][:, None], own.axes[:, 1:]], axis=1)
            rows = contact_rows(axes, measured.point[pairs], self.pairs[pairs], moved.position)
            values[steps] = (rows.reshape(3 * len(pairs), -1) @ velocity).reshape(-1, 3)
        result = values[-2] - 8.0 * values[-1] + 8.0 * values[1] - values[2]
        # At the boundary of a surface, one-sided differences from the past.
        one_sided = 6.0 * (values[-2] - 4.0 * values[-1] + 3.0 * values[0])
        result = np.where(valid[:, None], result, one_sided)
        self.assembler.environment.write(snapshot)
        return result / (12.0 * step)


def _same_surface(measured: MeasuredPairs, pairs: NDArray[np.int_], normal: Array) -> NDArray[np.bool_]:
    """Returns whether contacts that had these normals slightly before are on the same part of a surface.

    Beyond the boundary of a surface, the normal has turned away.
    """
    same_side = (measured.normal[pairs] * normal).sum(axis=1) > 0.5
    result: NDArray[np.bool_] = np.isfinite(measured.gap[pairs]) & same_side
    return result


def _least_energy_change(own: Assembly, rows: NDArray[np.int_], targets: Array) -> Array:
    """Returns the change (6 bodies,) of least kinetic energy that changes rows of H by ``targets``."""
    H = own.rows[rows]
    response = own.inverse_mass @ H.T
    return response @ np.linalg.lstsq(H @ response, targets, rcond=1.0e-11)[0]


def contact_margins(evaluated: EvaluatedState, held_contacts: HeldContacts) -> tuple[Array, Array]:
    """Returns the margins of held contacts to opening and slip (contacts,) [N]; ∞ if impossible."""
    normal = evaluated.force[:, 0]
    sticks = (held_contacts.mode == MODE_STICK) & (evaluated.assembly.mu_static > 0.0)
    friction_reserve = evaluated.assembly.mu_static * normal - np.linalg.norm(evaluated.force[:, 1:], axis=1)
    return normal, np.where(sticks, friction_reserve, np.inf)


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
