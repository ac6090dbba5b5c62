"""The whole step of bodies that are alone in their environment, with one set of contacts: in one launch on a GPU.

What a contact finds goes from its look to its force and on to the motion without a way through memory. Nothing
else is computed than in the launches of ``schedule``, by the same functions. Sensors are told nothing: they look
for themselves; and who watches steps has them taken in launches, from contacts that tell nothing.

A thread of a GPU sees to an environment: which of its contacts may touch. What these do is found by all threads of
its warp, a contact each, of whichever environment it is; and each thread takes the forces of its own contacts, in
their order, so that sums are those of one thread, and moves its body.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import finish, history, integrate, travel, warps
from warpcontact.kernels import meet as meeting
from warpcontact.kernels import near as nearness
from warpcontact.kernels import wrenches as of_wrenches
from warpcontact.kernels.closest_point import EITHER
from warpcontact.kernels.touch import Parts, group_structs
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    ENV_FAILED,
    NO_CAUSE,
    Work,
    first_env,
    natural,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel

# What the step has to do with a contact: nothing, or that it does not touch any more, or that it does.
NOTHING, ENDED, TOUCHES = 0, 1, 2
# Registers of a thread of a GPU in float32, of 190 that it would take: measured.
REGISTERS = 128


@functools.cache
def _functions(parts: Parts, real: type, projected: bool, width: int) -> SimpleNamespace:
    """Returns the structs and device functions of a contact, of what all of a step share, and of its end."""
    t = structs(real)
    vec3, Model, State, History = t.vec3, t.Model, t.State, t.History
    Near, Cache = t.Near, t.Cache
    of_body = integrate.euler(real)
    Guard, moved_by, put, failure_of = of_body.Guard, of_body.moved_by, of_body.put, of_body.failure_of
    end = finish.end_of_step(real)
    Coefficients, Memory = group_structs(parts, real)
    of_contact = meeting.functions(parts, real, False, projected, EITHER)
    pair_of, meet_pair, forget = of_contact.pair_of, of_contact.meet, of_contact.forget
    remembers = any(part.memories for part in parts)
    enter, remember = history.entering(real), history.remembering(parts, real)

    @wp.struct
    class Met:
        """What a step finds of a contact."""

        kind: wp.int32  # NOTHING, ENDED, TOUCHES
        free: real  # how far its point can move and not touch [m]
        armed: wp.int32  # its latch; only where formulas remember
        approach_speed: real  # [m/s]
        force: vec3  # on the body, W [N]
        torque: vec3  # about its centre of mass, W [N·m]

    @wp.func
    def awake_of(model: Model, cache: Cache, env: int, block: int, travelled: real):
        """The contacts of a block that may touch, as bits by their places in it."""
        start = natural(model.block_start[block])
        size = model.block_start[block + 1] - start
        those = wp.int32(0)
        # Unrolled: all are read at once.
        for place in range(wp.static(width)):
            if place < size:  # noqa: SIM102  Warp would evaluate both sides
                if not (travelled < cache.wake[env, natural(model.block_contact[start + place])]):
                    those = those | (1 << place)
        return those

    @wp.func
    def wake_of_block(model: Model, cache: Cache, env: int, block: int, news: bool):
        """Travel up to which no contact of a block can touch [m]; with ``news`` of one it is looked at again."""
        wake = real(wp.inf)
        if news:
            return real(0.0)
        start = natural(model.block_start[block])
        size = model.block_start[block + 1] - start
        for place in range(wp.static(width)):
            if place < size:
                wake = wp.min(wake, cache.wake[env, natural(model.block_contact[start + place])])
        return wake

    @wp.func
    def meet(
        model: Model,
        state: State,
        history: History,
        memory: Memory,
        dt: real,
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        env: int,
        contact: int,
        there: bool,
    ):
        """Looks at a contact, and computes its force if it touches; nothing if there is none."""
        met = Met()
        # Returned early: of both sides of a branch Warp copies what they change.
        if not there:
            return met
        pair = pair_of(model, state, env, 0)
        found = meet_pair(
            model, state, pair, history, memory, dt, coefficients, kept, cache, env, contact, contact
        )
        if found.status == CONTACT:
            met.kind = TOUCHES
            met.approach_speed = found.approach_speed
            if pair.body_1 >= 0:
                met.force = found.force
                met.torque = found.torque_1
            else:
                met.force = -found.force
                met.torque = found.torque_2
        elif history.entry_speed[env, contact] >= real(0.0):
            met.kind = ENDED
        if wp.static(remembers):
            met.armed = found.armed
            if met.kind == NOTHING and found.armed != history.armed[env, contact]:
                met.kind = ENDED
            if met.kind == ENDED:
                forget(kept, env, contact, met.armed, dt)
        met.free = found.free
        return met

    @wp.func
    def take(
        model: Model,
        history: History,
        memory: Memory,
        kept: Memory,
        near: Near,
        cache: Cache,
        env: int,
        block: int,
        contact: int,
        touching: bool,
        armed: int,
        approach_speed: real,
    ):
        """Takes a contact into the history, of a step that is accepted."""
        near.news[env, contact] = wp.where(touching, 1, 0)
        enter(model, cache, history, env, block, contact, touching, approach_speed)
        if wp.static(remembers):
            # Of others nobody asks for it, without latches.
            history.armed[env, contact] = armed
        remember(memory, kept, env, contact)

    @wp.func
    def move(
        status: wp.array(dtype=wp.int32),
        clock_step: wp.array2d(dtype=wp.float64),
        time: wp.array(dtype=wp.float64),
        model: Model,
        guard: Guard,
        state_in: State,
        state_out: State,
        env: int,
        force: vec3,
        torque: vec3,
        dt: real,
    ):
        """Moves the body of an environment, and ends its step; returns whether it is accepted."""
        moved = moved_by(model, state_in, env, 0, force, torque, dt)
        put(state_out, env, 0, moved)
        found = wp.int32(ENV_ACTIVE)
        cause = failure_of(guard, env, moved)
        if cause != NO_CAUSE:
            found = wp.int32(ENV_FAILED)
            guard.cause[env] = cause
        end(status, clock_step, time, 1, state_in, state_out, env, found)
        return cause == NO_CAUSE

    return SimpleNamespace(
        Guard=Guard,
        remembers=remembers,
        awake_of=awake_of,
        wake_of_block=wake_of_block,
        meet=meet,
        move=move,
        take=take,
    )


@functools.cache
def kernel(
    parts: Parts, real: type, projected: bool, pushed: bool, width: int, blocks: int, lanes: int
) -> wp.Kernel:
    """Returns the kernel of a semi-implicit Euler step; items: one, but ``own`` of them have a warp of threads.

    Args:
        parts: The classes of law and friction models.
        real: Type of a real number.
        projected: Whether contacts are weighed by the normals of their points.
        pushed: Whether there are forces from outside.
        width: Contacts that a block has room for, fewer than a number has bits.
        blocks: Blocks of contacts.
        lanes: Threads of a warp.
    """
    t = structs(real)
    vec3, Model, State, History, Contacts, Near, Cache, Ends = (
        t.vec3, t.Model, t.State, t.History, t.Contacts, t.Near, t.Cache, t.Ends,
    )  # fmt: skip
    Coefficients, Memory = group_structs(parts, real)
    of_set = _functions(parts, real, projected, width)
    Guard, awake_of, wake_of_block = of_set.Guard, of_set.awake_of, of_set.wake_of_block
    meet, move, take, remembers = of_set.meet, of_set.move, of_set.take, of_set.remembers
    of_travel = travel.functions(real)
    add_travel, sleeps = of_travel.add, of_travel.sleeps
    wake_of = nearness.functions(real, False, EITHER).wake_of
    start_of = of_wrenches.functions(real, False, pushed).start
    told_by, number_told_by = warps.telling(real), warps.telling(wp.int32)
    # What is kept of each block until the step is accepted: bits by the places of contacts.
    Bits = wp.types.vector(length=blocks, dtype=wp.int32)
    # A contact alone is met by the thread of its environment.
    single = width == 1 and blocks == 1
    registers = REGISTERS if real is wp.float32 else None

    @wp.func
    def told_vector(v: vec3, lane: int):
        return vec3(told_by(v[0], lane), told_by(v[1], lane), told_by(v[2], lane))

    @wp.func
    def slot_of(block: int):
        """Where it is kept what was found of a block."""
        if wp.static(blocks == 1):
            return 0
        return block

    @unique_kernel(registers)
    def step_alone(
        work: Work,
        own: wp.int32,  # environments of a warp
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        model: Model,
        guard: Guard,
        state_in: State,
        history: History,
        memory: Memory,
        coefficients: Coefficients,
        kept: Memory,
        contacts: Contacts,
        near: Near,
        cache: Cache,
        ends: Ends,
        state_out: State,
    ):
        lane = warps.lane()
        # All threads of a warp come by together where they tell each other, those without work as well.
        for warp in range(
            wp.tid() // wp.static(lanes), (task_count(work) + own - 1) // own, work.threads // wp.static(lanes)
        ):
            first = natural(first_env(work) + warp * own)
            env = first
            there = lane < own and warp * own + lane < task_count(work)
            if there:
                env = first + natural(lane)
                there = status[env] == ENV_ACTIVE
            force = vec3()
            torque = vec3()
            if there:
                wrench = start_of(model, ends, env, 0)
                force = wrench.force
                torque = wrench.torque
            touching = Bits()
            ended = Bits()
            armed = Bits()
            speed = real(0.0)
            if wp.static(single):
                met = meet(
                    model, state_in, history, memory, step[env, 0], coefficients, kept, cache, env, 0, there
                )
                force += met.force
                torque += met.torque
                touching[0] = wp.where(met.kind == TOUCHES, 1, 0)
                ended[0] = wp.where(met.kind == ENDED, 1, 0)
                armed[0] = met.armed
                speed = met.approach_speed
            else:
                travelled = real(0.0)
                awake = wp.bool(False)
                looked_at = wp.int32(0)
                if there:
                    travelled = add_travel(model, state_in, cache, env, 0)
                    awake = not sleeps(model, cache, env, 0, travelled)
                # What a thread wrote of its environment is there for the others.
                warps.sync()
                awakes = Bits()
                count = wp.int32(0)
                if awake:
                    for block in range(model.block_set.shape[0]):
                        if not (travelled < cache.block_wake[env, block]):
                            those = awake_of(model, cache, env, block, travelled)
                            awakes[slot_of(block)] = those
                            count += warps.count_of(those)
                            looked_at = looked_at | (1 << block)
                # Of the contacts of all environments of the warp, the next of this one: its block and those left.
                up_to = warps.sum_up_to(count)
                at = up_to - count
                start = at
                total = number_told_by(up_to, wp.static(lanes - 1))
                mine = wp.int32(0)
                left = awakes[0]
                sum_force = vec3()
                sum_torque = vec3()
                for base in range(0, total, wp.static(lanes)):
                    owner = warps.owner_of(start, base + lane)
                    number = base + lane - number_told_by(start, owner)
                    block = wp.int32(0)
                    those = number_told_by(awakes[0], owner)
                    for other in range(1, model.block_set.shape[0]):
                        one = number_told_by(awakes[slot_of(other)], owner)
                        if block == other - 1 and number >= warps.count_of(those):
                            number -= warps.count_of(those)
                            those = one
                            block = other
                    whose = first
                    contact = wp.int32(0)
                    found = base + lane < total
                    if found:
                        whose = first + natural(owner)
                        place = natural(model.block_start[block]) + warps.one_of(those, number)
                        contact = natural(model.block_contact[place])
                    met = meet(
                        model, state_in, history, memory, step[whose, 0], coefficients, kept, cache, whose,
                        contact, found,
                    )  # fmt: skip
                    if found:
                        cache.wake[whose, contact] = wake_of(cache.set_travel[whose, 0], met.free)
                        if met.kind == TOUCHES:
                            contacts.approach_speed[whose, contact] = met.approach_speed
                    touch_there = warps.lanes_with(met.kind == TOUCHES)
                    ended_there = warps.lanes_with(met.kind == ENDED)
                    armed_there = wp.int32(0)
                    if wp.static(remembers):
                        armed_there = warps.lanes_with(met.armed != 0)
                    waits = at < wp.min(up_to, base + wp.static(lanes))
                    while warps.lanes_with(waits) != 0:
                        lane_of_it = wp.where(waits, at - base, lane)
                        one_force = told_vector(met.force, lane_of_it)
                        one_torque = told_vector(met.torque, lane_of_it)
                        if waits:
                            while left == 0:
                                force += sum_force
                                torque += sum_torque
                                sum_force = vec3()
                                sum_torque = vec3()
                                mine += 1
                                left = awakes[slot_of(mine)]
                            sum_force += one_force
                            sum_torque += one_torque
                            bit = left & -left
                            left = left - bit
                            slot = slot_of(mine)
                            touching[slot] = touching[slot] | (bit * warps.some(touch_there, lane_of_it, 1))
                            ended[slot] = ended[slot] | (bit * warps.some(ended_there, lane_of_it, 1))
                            if wp.static(remembers):
                                armed[slot] = armed[slot] | (bit * warps.some(armed_there, lane_of_it, 1))
                            at += 1
                        waits = at < wp.min(up_to, base + wp.static(lanes))
                force += sum_force
                torque += sum_torque
                # And what others wrote of its contacts.
                warps.sync()
                for block in range(model.block_set.shape[0]):
                    if warps.some(looked_at, block, 1) != 0:
                        slot = slot_of(block)
                        cache.block_wake[env, block] = wake_of_block(
                            model, cache, env, block, (touching[slot] | ended[slot]) != 0
                        )
            if there:  # noqa: SIM102  Warp would evaluate both sides
                if move(
                    status, clock_step, time, model, guard, state_in, state_out, env, force,
                    torque, step[env, 0],
                ):  # fmt: skip
                    for block in range(model.block_set.shape[0]):
                        slot = slot_of(block)
                        left = touching[slot] | ended[slot]
                        while left != 0:
                            place = warps.one_of(left, 0)
                            left = left & (left - 1)
                            contact = natural(model.block_contact[natural(model.block_start[block]) + place])
                            if wp.static(not single):
                                speed = contacts.approach_speed[env, contact]
                            touches = warps.some(touching[slot], place, 1) != 0
                            take(
                                model, history, memory, kept, near, cache, env, block, contact, touches,
                                warps.some(armed[slot], place, 1), speed,
                            )  # fmt: skip

    return step_alone
