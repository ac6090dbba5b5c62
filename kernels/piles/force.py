"""What shapes of a pile do to each other: touches of the pairs that a shape owns.

The distance comes first, with little traffic; what a touch does is computed by ``touch.py``. A pure function of
model, state and history, whichever pairs beside those that touch are in the lists.
"""

import functools

import warp as wp
from warpcontact.kernels import touch
from warpcontact.kernels.memory import memory_struct
from warpcontact.kernels.piles import meeting
from warpcontact.kernels.piles.base import NONE, TOUCHED, TOUCHES, Form, pile_structs
from warpcontact.kernels.touch import Parts, group_structs, touch_structs
from warpcontact.kernels.types import ENV_ACTIVE, Work, env_of, item_of, natural, structs, task_count
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def _start_memory(parts: Parts, real: type) -> wp.Function:
    """Returns the function ``(memory, env, slot, dt)`` that empties the memory of a pair that did not touch."""
    _, Memory = group_structs(parts, real)
    law, friction, rolling, torsion = (bool(part.memories) for part in parts)
    LawMemory, FrictionMemory = memory_struct(parts.law, real), memory_struct(parts.friction, real)
    RollingMemory, TorsionMemory = memory_struct(parts.rolling, real), memory_struct(parts.torsion, real)

    @wp.func
    def start_memory(memory: Memory, env: int, slot: int, dt: real):
        if wp.static(law):
            of_law = LawMemory()
            of_law.elapsed = dt
            memory.law[env, slot] = of_law
        if wp.static(friction):
            of_friction = FrictionMemory()
            of_friction.elapsed = dt
            memory.friction[env, slot] = of_friction
        if wp.static(rolling):
            of_rolling = RollingMemory()
            of_rolling.elapsed = dt
            memory.rolling[env, slot] = of_rolling
        if wp.static(torsion):
            of_torsion = TorsionMemory()
            of_torsion.elapsed = dt
            memory.torsion[env, slot] = of_torsion

    return start_memory


@functools.cache
def kernel(parts: Parts, form: Form, real: type, moves: bool, alone: bool, hard: bool = False) -> wp.Kernel:
    """Returns the kernel of the touches that a shape owns; items: shapes.

    Args:
        parts: The classes of law and friction models.
        form: What is in the pile.
        real: Precision.
        moves: Whether bodies that are not free oppose to a force what their motions let them.
        alone: Whether one thread has all shapes of an environment, one after the other. It adds what touches do to
            the wrenches; else ``add`` does.
        hard: Whether touches have no force, and are only told where they are. So are those of the last step that
            have come apart: what pressed in it is shown.
    """
    t = structs(real)
    vec3, quat, Model, State, Wrenches = t.vec3, t.quat, t.Model, t.State, t.Wrenches
    p = pile_structs(real)
    Shapes, Lists, Touches, Grid, Settings = p.Shapes, p.Lists, p.Touches, p.Grid, p.Settings
    Coefficients, Memory = group_structs(parts, real)
    Place = touch_structs(real).Place
    act = touch.functions(parts, real, moves).act
    start_memory = _start_memory(parts, real)
    found = meeting.functions(form, real)
    Spot, Pair, spot, nearest = found.Spot, found.Pair, found.spot, found.nearest
    placed, long, fixed, oriented = form.placed, form.long, form.fixed, parts.oriented
    curvatures, needs_curvature = found.curvatures, parts.law.needs_curvature
    remembers = any(part.memories for part in parts)

    @wp.func
    def place_of(
        state: State,
        shapes: Shapes,
        settings: Settings,
        env: int,
        first: int,
        second: int,
        spot_1: Spot,
        spot_2: Spot,
        pair: Pair,
        distance: real,
        radius_1: real,
        radius_2: real,
    ):
        """Where two shapes touch."""
        n_W = vec3(real(0.0), real(0.0), real(1.0))
        if distance > real(0.0):
            n_W = (real(1.0) / distance) * pair.apart
        gap = distance - radius_1 - radius_2
        place = Place()
        place.body_1 = natural(shapes.body[first])
        place.body_2 = natural(shapes.body[second])
        # S on the second, D on the first; K between them.
        place.arm_1 = (-(radius_1 + (real(1.0) - settings.kappa) * gap)) * n_W
        place.arm_2 = (radius_2 + settings.kappa * gap) * n_W
        if wp.static(placed):
            place.arm_1 += spot_1.rest - state.body_position_remainder[env, place.body_1]
            place.arm_2 += spot_2.rest - state.body_position_remainder[env, place.body_2]
        if wp.static(long):
            place.arm_1 += pair.s * spot_1.axis
            place.arm_2 += pair.t * spot_2.axis
        place.normal = n_W
        place.penetration = -gap
        place.radius = radius_1 * radius_2 / (radius_1 + radius_2)
        if wp.static(needs_curvature):
            smaller, larger = curvatures(pair, spot_1, spot_2, radius_1, radius_2)
            place.curvature_1 = smaller
            place.curvature_2 = larger
        return place

    @wp.func
    def note(place: Place, touches: Touches, env: int, slot: int):
        """Writes where two shapes touch into the record of the pair."""
        touches.gap[env, slot] = -place.penetration
        touches.normal[env, slot] = place.normal
        touches.arm[env, slot] = place.arm_1

    @wp.func
    def touch_of(
        model: Model,
        state: State,
        place: Place,
        settings: Settings,
        touches: Touches,
        coefficients: Coefficients,
        remembered: Memory,
        kept: Memory,
        dt: real,
        env: int,
        slot: int,
        bits: int,
        told: bool,
        wrenches: Wrenches,
    ):
        """Computes what a touch does, into its record as far as it is to be ``told`` or added up."""
        entry_speed = real(-1.0)
        if (bits & TOUCHED) != 0:
            entry_speed = touches.entry_speed[env, slot]
        else:
            if wp.static(remembers):
                # Not of the history: nothing is known of a pair that did not touch, whether it was listed or not.
                start_memory(remembered, env, slot, dt)
        q_WS = quat()
        if wp.static(oriented):
            q_WS = state.body_orientation[env, place.body_2]
        acts = act(
            model, state, env, place, entry_speed, dt, coefficients, remembered, kept, slot,
            settings.torsion_radius, q_WS,
        )  # fmt: skip
        normal_force = settings.force_scale * acts.normal_force
        force = normal_force * place.normal + settings.force_scale * acts.friction_force
        torque = settings.force_scale * acts.torque
        touches.approach_speed[env, slot] = acts.approach_speed
        if told:
            touches.normal_force[env, slot] = normal_force
            note(place, touches, env, slot)
        if told or wp.static(not alone):
            touches.force[env, slot] = force
        torque_1 = wp.cross(place.arm_1, force) + torque
        if wp.static(alone):
            one = natural(place.body_1)
            other = natural(place.body_2)
            wrenches.force[env, one] = wrenches.force[env, one] + force
            wrenches.torque[env, one] = wrenches.torque[env, one] + torque_1
            wrenches.force[env, other] = wrenches.force[env, other] - force
            torque_2 = wp.cross(place.arm_2, force) + torque
            wrenches.torque[env, other] = wrenches.torque[env, other] - torque_2
        else:
            # Of the other that follows from it.
            touches.torque[env, slot] = torque_1

    @unique_kernel()
    def pile_force(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        shapes: Shapes,
        lists: Lists,
        grid: Grid,
        remembered: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] what the force acts over [s]; 0: the force of this instant
        coefficients: Coefficients,
        touches: Touches,
        kept: Memory,
        told: wp.bool,  # whether anyone may ask where pairs touch, and what each of them does
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            if wp.static(not fixed):  # noqa: SIM102  Warp would look at both sides
                if shape == 0:
                    grid.stale[env] = 0
                    grid.known[env] = 1
            owned = lists.owned[env, shape]
            if owned == 0:
                continue
            own = spot(shapes, state, env, shape)
            radius = shapes.radius[env, shape]
            settings = shapes.settings[env, 0]
            entry = natural(shapes.entry_start[shape])
            slot = natural(shapes.slot_start[shape])
            stop = entry + owned
            busy = touches.busy[env, shape]
            now = wp.int32(0)
            while entry < stop:
                # The next that touches, so that threads side by side compute touches together.
                looked_at = wp.bool(False)
                touching = wp.bool(False)
                partner = wp.int32(NONE)
                bits = wp.int32(0)
                first = shape
                spot_1 = own
                spot_2 = own
                radius_1 = radius
                radius_2 = radius
                pair = Pair()
                distance = real(0.0)
                while entry < stop and not looked_at:
                    partner = natural(lists.partner[env, natural(entry)])
                    radius_2 = shapes.radius[env, partner]
                    reach = radius + radius_2
                    touch_at = reach
                    if wp.static(hard):
                        touch_at = reach + settings.closed
                    spot_2 = spot(shapes, state, env, partner)
                    near = wp.bool(True)
                    if wp.static(long):
                        # By the spheres around capsules first; with room for rounding.
                        around = (own.base - spot_2.base) + (own.rest - spot_2.rest)
                        beyond = real(1.0001) * (reach + wp.length(own.axis) + wp.length(spot_2.axis))
                        near = wp.length_sq(around) < beyond * beyond
                    if near:
                        pair = nearest(own, spot_2)
                        squared = wp.length_sq(pair.apart)
                        if squared < touch_at * touch_at:
                            distance = wp.sqrt(squared)
                            touching = reach - distance <= settings.max_depth and settings.enabled != 0
                            touching = touching and distance < touch_at
                    if busy != 0:
                        bits = touches.bits[env, natural(slot)] & TOUCHED
                        now = now | bits
                        if not touching:
                            touches.bits[env, natural(slot)] = bits
                    looked_at = touching
                    if wp.static(hard):
                        looked_at = touching or bits != 0
                    entry += 1
                    slot += 1
                if looked_at:
                    record = natural(slot - 1)
                    if touching:
                        now = now | TOUCHES
                        touches.bits[env, record] = bits | TOUCHES
                    if wp.static(hard):
                        # One that has come apart may have been passed over.
                        pair = nearest(spot_1, spot_2)
                        distance = wp.length(pair.apart)
                    if partner < shape:
                        # The first is the lower; the same bits as if it had been taken first.
                        first = partner
                        partner = shape
                        spot_1 = spot_2
                        spot_2 = own
                        radius_1 = radius_2
                        radius_2 = radius
                        pair = nearest(spot_1, spot_2)
                        distance = wp.length(pair.apart)
                    place = place_of(
                        state, shapes, settings, env, first, partner, spot_1, spot_2, pair, distance, radius_1,
                        radius_2,
                    )  # fmt: skip
                    if wp.static(hard):
                        note(place, touches, env, record)
                        # For a law that is to act later it began at rest.
                        touches.approach_speed[env, record] = real(0.0)
                        if wp.static(remembers):  # noqa: SIM102
                            if bits == 0:
                                start_memory(remembered, env, record, step[env, 0])
                    else:
                        touch_of(
                            model, state, place, settings, touches, coefficients, remembered, kept, step[env, 0],
                            env, record, bits, told, wrenches,
                        )  # fmt: skip
            if now != busy:
                touches.busy[env, shape] = now

    return pile_force
