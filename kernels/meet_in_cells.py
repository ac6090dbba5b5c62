"""Contacts looked at in cells, and what they do computed at once: on a GPU, of one group of sets of one contact.

As ``near_cells`` and ``contact_force`` do, by the same functions; but what a look finds goes on to the force
without a way through memory, sensors are not told, and of what stays quiet hardly anything is written.
"""

import functools

import warp as wp
from warpcontact.kernels import contact_force, warps
from warpcontact.kernels import meet as meeting
from warpcontact.kernels import near as nearness
from warpcontact.kernels.closest_point import AWAY, EITHER, LATER, QUERY
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

# Registers of a thread of a GPU in float32; measured.
REGISTERS = 96


@functools.cache
def _take(parts: Parts, real: type, moves: bool, projected: bool, part: str) -> wp.Function:
    """Returns the device function that meets a contact and takes what it does into its block."""
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache, Wrenches = t.Contacts, t.Near, t.Cache, t.Wrenches
    Coefficients, Memory = group_structs(parts, real)
    of_contact = meeting.functions(parts, real, moves, projected, part)
    pair_of, meet, forget = of_contact.pair_of, of_contact.meet, of_contact.forget
    add_wrench = contact_force.functions(parts, real, moves, projected).add_wrench
    news = nearness.functions(real, False, part).news

    @wp.func
    def take(
        model: Model,
        state: State,
        history: History,
        memory: Memory,
        dt: real,
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        contacts: Contacts,
        near: Near,
        ordered: bool,
        wrenches: Wrenches,
        env: int,
        block: int,
    ):
        """Returns whether anything is known of the contact of a block: if not, it has to be searched for."""
        place = natural(model.block_start[block])
        contact = natural(model.block_contact[place])
        pair = pair_of(model, state, env, natural(model.block_set[block]))
        # Right before it is written, what this comes with would be long in coming.
        before = contacts.status[env, contact]
        met = meet(model, state, pair, history, memory, dt, coefficients, kept, cache, env, contact, contact)
        if wp.static(part == AWAY):  # noqa: SIM102  Warp would evaluate both sides
            if met.free == real(LATER):
                return False
        # One that was quiet, and is, has nothing to tell. A look may have listed it.
        if met.status != CONTACT and cache.block_quiet[env, block] != 0:  # noqa: SIM102
            if met.armed == history.armed[env, contact]:
                near.count[env, block] = 0
                return True
        contacts.status[env, contact] = met.status
        contacts.armed[env, contact] = met.armed
        new = news(contacts, history, env, contact, before)
        near.news[env, contact] = new
        near.contact[env, place] = contact
        near.count[env, block] = new
        cache.block_quiet[env, block] = 1 - new
        if met.status == CONTACT:
            contacts.approach_speed[env, contact] = met.approach_speed
        elif new != 0:
            forget(kept, env, contact, met.armed, dt)
        if ordered:
            near.force[env, block] = met.force
            near.torque_1[env, block] = met.torque_1
            near.torque_2[env, block] = met.torque_2
        elif met.status == CONTACT:
            add_wrench(wrenches, env, pair.body_1, met.force, met.torque_1)
            add_wrench(wrenches, env, pair.body_2, -met.force, met.torque_2)
        return True

    return take


@functools.cache
def kernel(parts: Parts, real: type, moves: bool, projected: bool, whole: bool) -> wp.Kernel:
    """Returns the kernel that sees to blocks of one contact; items: blocks.

    With ``whole`` it searches at once for what cells do not tell, and does not leave it to ``rest``. The other
    arguments are those of ``contact_force.kernel``.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache, Wrenches = t.Contacts, t.Near, t.Cache, t.Wrenches
    Coefficients, Memory = group_structs(parts, real)
    take = _take(parts, real, moves, projected, EITHER if whole else AWAY)
    registers = REGISTERS if real is wp.float32 else None

    @unique_kernel(registers)
    def meet_in_cells(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        memory: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] what the force acts over [s]
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        contacts: Contacts,
        near: Near,
        ordered: wp.bool,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            block = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            known = take(
                model, state, history, memory, step[env, 0], coefficients, kept, cache, contacts, near, ordered,
                wrenches, env, block,
            )  # fmt: skip
            if not known:
                cache.waiting_block[wp.atomic_add(cache.waiting, 0, 1)] = task

    return meet_in_cells


@functools.cache
def rest(parts: Parts, real: type, moves: bool, projected: bool) -> wp.Kernel:
    """Returns the kernel that searches for what ``kernel`` left; items: blocks."""
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache, Wrenches = t.Contacts, t.Near, t.Cache, t.Wrenches
    Coefficients, Memory = group_structs(parts, real)
    take = _take(parts, real, moves, projected, QUERY)

    @unique_kernel()
    def meet_the_rest(
        work: Work,
        model: Model,
        state: State,
        history: History,
        memory: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] what the force acts over [s]
        coefficients: Coefficients,
        kept: Memory,
        cache: Cache,
        contacts: Contacts,
        near: Near,
        ordered: wp.bool,
        wrenches: Wrenches,
    ):
        for i in range(warps.spread(wp.tid(), work.threads), cache.waiting[0], work.threads):
            task = cache.waiting_block[i]
            env = env_of(work, task)
            block = item_of(work, task)
            take(
                model, state, history, memory, step[env, 0], coefficients, kept, cache, contacts, near, ordered,
                wrenches, env, block,
            )  # fmt: skip

    return meet_the_rest
