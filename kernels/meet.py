"""Contacts looked at, and what they do computed at once, by one thread for a set of them.

Nothing else is computed than by ``near`` and ``contact_force``, by the same functions; but what a look finds goes
on to the force without a way through memory, and sensors are not told: they look for themselves.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import contact_force, frames, travel
from warpcontact.kernels import near as nearness
from warpcontact.kernels.closest_point import WHOLE
from warpcontact.kernels.strides import anew, telling
from warpcontact.kernels.touch import Parts, group_structs
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    Work,
    env_of,
    item_of,
    natural,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def functions(parts: Parts, real: type, moves: bool, projected: bool, part: str) -> SimpleNamespace:
    """Returns the structs and device functions of a contact; ``part`` is that of ``closest_point``.

    The other arguments are those of ``contact_force.kernel``.
    """
    t = structs(real)
    vec3, quat, Model, State, History, Cache = t.vec3, t.quat, t.Model, t.State, t.History, t.Cache
    Coefficients, Memory = group_structs(parts, real)
    of_block = nearness.functions(real, False, part)
    View, view_of, find = of_block.View, of_block.view_of, of_block.find
    of_contact = contact_force.functions(parts, real, moves, projected)
    push_of, forget = of_contact.push_of, of_contact.forget
    frame = frames.functions(real)
    apart, orientation_to_world = frame.apart, frame.orientation_to_world
    oriented = parts.oriented

    @wp.struct
    class Pair:
        """The two bodies of a set of contacts."""

        view: View
        body_1: wp.int32
        body_2: wp.int32
        apart_W: vec3  # from the centre of the surface's body to that of the points'
        q_WS: quat  # if the formulas ask for it

    @wp.struct
    class Met:
        """What a step finds of a contact."""

        free: real  # how far its point can move and not touch [m]
        status: wp.int32
        armed: wp.int32  # its latch
        approach_speed: real  # [m/s]
        force: vec3  # on the point's body, W [N]; on the surface's the opposite
        torque_1: vec3  # on the point's body about its centre of mass, W [N·m]
        torque_2: vec3  # on the surface's

    @wp.func
    def pair_of(model: Model, state: State, env: int, number: int):
        pair = Pair()
        pair.view = view_of(model, state, env, number)
        contact = natural(model.set_contact[number])
        surface = natural(model.patch_surface[natural(model.contact_patch[contact])])
        point = natural(model.contact_point[contact])
        pair.body_1 = model.point_body[point]
        pair.body_2 = model.surface_body[surface]
        pair.apart_W = apart(model, state, env, point, surface)
        if wp.static(oriented):
            pair.q_WS = orientation_to_world(state, env, pair.body_2, model.surface_orientation[env, surface])
        return pair

    @wp.func
    def meet(
        model: Model,
        state: State,
        pair: Pair,
        history: History,
        memory: Memory,
        dt: real,
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        env: int,
        contact: int,
        member: int,
    ):
        """Looks at a contact, and computes its force if it touches."""
        met = Met()
        found = find(model, pair.view, history, True, cache, env, contact)
        met.free = found.free
        met.status = found.status
        met.armed = found.armed
        # Returned early: of both sides of a branch Warp copies what they change.
        if found.status != CONTACT:
            return met
        push = push_of(
            model, state, memory, dt, coefficients, kept, env, contact, member, pair.body_1, pair.body_2,
            pair.apart_W, pair.q_WS, pair.view.R_WB, found.arm, found.normal, found.penetration,
            history.entry_speed[env, contact],
        )  # fmt: skip
        met.approach_speed = push.approach_speed
        met.force = push.force
        met.torque_1 = push.torque_1
        met.torque_2 = push.torque_2
        return met

    return SimpleNamespace(Pair=Pair, pair_of=pair_of, meet=meet, forget=forget)


@functools.cache
def of_sets(parts: Parts, real: type, moves: bool, projected: bool) -> wp.Function:
    """Returns the device function that sees to a set of contacts on a CPU.

    It adds up its travel, looks at those that may touch, as ``near.kernel`` with ``cached``, and leaves what
    blocks do to their bodies with them, as ``contact_force.kernel`` if ``ordered``. Contacts are told no more than
    the rest of a step asks for, and those that cease to touch that nothing acts: later looks leave them out.
    Arguments: those of the latter.
    """
    t = structs(real)
    vec3, Model, State, History = t.vec3, t.Model, t.State, t.History
    Contacts, Near, Cache = t.Contacts, t.Near, t.Cache
    Coefficients, Memory = group_structs(parts, real)
    of_contact = functions(parts, real, moves, projected, WHOLE)
    Pair, pair_of, meet = of_contact.Pair, of_contact.pair_of, of_contact.meet
    tell_nothing = contact_force.functions(parts, real, moves, projected).tell_nothing
    of_block = nearness.functions(real, False, WHOLE)
    around_of, free_around, longer_wake = of_block.around_of, of_block.free_around, of_block.longer_wake
    settle, settle_block = of_block.settle, of_block.settle_block
    add_travel, sleeps = travel.functions(real).add, travel.functions(real).sleeps

    @wp.func
    def meet_block(
        model: Model,
        state: State,
        pair: Pair,
        history: History,
        memory: Memory,
        dt: real,
        first_contact: int,
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        contacts: Contacts,
        near: Near,
        which: int,
        block: int,
        travel: real,
        travelled: real,
    ):
        env = anew(which)
        start = natural(model.block_start[block])
        stop = model.block_start[block + 1]
        around = around_of(model, pair.view, cache, env, block, start, stop, travel, travelled)
        of_use = wp.bool(False)
        first_wake = real(wp.inf)
        count = wp.int32(0)
        force = vec3()
        torque_1 = vec3()
        torque_2 = vec3()
        place = wp.int32(start)
        while place < stop:
            env = anew(which)
            contact = natural(model.block_contact[place])
            place += 1
            if travelled < cache.wake[env, contact]:
                wake = longer_wake(model, history, cache, env, block, contact, travel, around)
                first_wake = wp.min(first_wake, wake)
            else:
                before = contacts.status[env, contact]
                free = free_around(model, history, contacts, cache, env, block, contact, around)
                if free >= real(0.0):
                    of_use = True
                else:
                    met = meet(
                        model, state, pair, history, memory, dt, coefficients, kept, cache, env, contact,
                        contact - first_contact,
                    )  # fmt: skip
                    free = met.free
                    contacts.status[env, contact] = met.status
                    contacts.armed[env, contact] = met.armed
                    if met.status == CONTACT:
                        contacts.approach_speed[env, contact] = met.approach_speed
                        force += met.force
                        torque_1 += met.torque_1
                        torque_2 += met.torque_2
                wake = settle(history, contacts, cache, near, env, contact, travel, free, before)
                first_wake = wp.min(first_wake, wake)
            if near.news[env, contact] != 0:
                near.contact[env, start + count] = contact
                count += 1
                if contacts.status[env, contact] != CONTACT:
                    contacts.penetration[env, contact] = real(0.0)
                    tell_nothing(contacts, kept, env, contact, contact - first_contact, dt)
        near.count[env, block] = count
        settle_block(model, cache, env, block, start, stop, travel, around, of_use, count, first_wake)
        near.force[env, block] = force
        near.torque_1[env, block] = torque_1
        near.torque_2[env, block] = torque_2

    @wp.func
    def meet_set(
        model: Model,
        state: State,
        history: History,
        memory: Memory,
        dt: real,
        first_contact: int,
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        contacts: Contacts,
        near: Near,
        env: int,
        number: int,
    ):
        travelled = add_travel(model, state, cache, env, number)
        block = natural(model.set_block_start[number])
        stop = model.set_block_start[number + 1]
        if sleeps(model, cache, env, number, travelled):
            while block < stop:
                near.count[env, block] = 0
                block = natural(block + 1)
            return
        pair = pair_of(model, state, env, number)
        while block < stop:
            if travelled < cache.block_wake[env, block]:
                near.count[env, block] = 0
            else:
                meet_block(
                    model, state, pair, history, memory, dt, first_contact, coefficients, kept, cache, contacts,
                    near, env, block, cache.set_travel[env, number], travelled,
                )  # fmt: skip
            block = natural(block + 1)

    return meet_set


@functools.cache
def kernel(parts: Parts, real: type, moves: bool = False, projected: bool = False) -> wp.Kernel:
    """Returns the kernel that sees to sets of contacts on a CPU; items: sets of the group.

    Arguments: those of ``contact_force.kernel``.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache = t.Contacts, t.Near, t.Cache
    Coefficients, Memory = group_structs(parts, real)
    meet_set = of_sets(parts, real, moves, projected)
    tell_model, tell_state, tell_history = telling(Model), telling(State), telling(History)
    tell_cache, tell_contacts, tell_near = telling(Cache), telling(Contacts), telling(Near)
    tell_coefficients = telling(Coefficients)

    @unique_kernel()
    def meet_sets(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        memory: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] what the force acts over [s]
        first_set: wp.int32,
        first_contact: wp.int32,
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        contacts: Contacts,
        near: Near,
    ):
        tell_model(model)
        tell_state(state)
        tell_history(history)
        tell_coefficients(coefficients)
        tell_cache(cache)
        tell_contacts(contacts)
        tell_near(near)
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            number = natural(first_set + item_of(work, task))
            if status[env] != ENV_ACTIVE:
                continue
            meet_set(
                model, state, history, memory, step[env, 0], first_contact, coefficients, kept, cache, contacts,
                near, env, number,
            )  # fmt: skip

    return meet_sets
