"""Advances the memory of the contacts, once per accepted step; ``alone.py`` and ``in_place.py`` do so themselves.

The record belongs to the pair of point and surface, not to a triangle: a point that slides over a mesh edge does
not enter anew.
"""

import functools

import warp as wp
from warpcontact.kernels import finish
from warpcontact.kernels.formula import Formula
from warpcontact.kernels.memory import memory_struct
from warpcontact.kernels.touch import Parts, group_structs
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, Work, env_of, item_of, natural, structs, task_count
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def entering(real: type) -> wp.Function:
    """Returns the device function that takes whether a contact touches, and how fast, into ``history``."""
    t = structs(real)
    Model, History, Cache = t.Model, t.History, t.Cache

    @wp.func
    def enter(
        model: Model,
        cache: Cache,
        history: History,
        env: int,
        block: int,
        contact: int,
        touching: bool,
        approach_speed: real,
    ):
        before = history.entry_speed[env, contact]
        speed = real(-1.0)
        if touching:
            # Not below 0, which says "not touching".
            speed = wp.max(before, wp.max(approach_speed, real(0.0)))
            if before < real(0.0):
                # Whoever found it: what others know of distances must not leave it out when it ends.
                cache.wake[env, contact] = real(0.0)
                cache.block_wake[env, block] = real(0.0)
                cache.block_quiet[env, block] = 0
                cache.set_wake[env, natural(model.block_set[block])] = real(0.0)
        history.entry_speed[env, contact] = speed

    return enter


@functools.cache
def advance(real: type, follows: bool) -> wp.Function:
    """Returns the device function that takes the contacts of a block that are near into ``history``.

    ``follows``: whether any contact stays with the face that it touched, or crossed; it asks for the time then.
    """
    t = structs(real)
    Model, Contacts, Near, History, Cache = t.Model, t.Contacts, t.Near, t.History, t.Cache
    enter = entering(real)

    @wp.func
    def advance(
        time: wp.array(dtype=wp.float64),
        step: wp.array2d(dtype=real),
        model: Model,
        contacts: Contacts,
        near: Near,
        history: History,
        cache: Cache,
        env: int,
        block: int,
    ):
        start = natural(model.block_start[block])
        count = near.count[env, block]
        if wp.static(follows):
            count += near.crossed[env, block]
        place = natural(start)
        while place < start + count:
            contact = natural(near.contact[env, place])
            place = natural(place + 1)
            history.armed[env, contact] = contacts.armed[env, contact]
            touching = contacts.status[env, contact] == CONTACT
            near.news[env, contact] = wp.where(touching, 1, 0)
            enter(model, cache, history, env, block, contact, touching, contacts.approach_speed[env, contact])
            if wp.static(follows):
                face = wp.where(touching, contacts.face[env, contact], -1)
                crossed = contacts.crossed_face[env, contact]
                if crossed >= 0:
                    face = crossed
                    if history.crossings[env, contact] == 0:
                        left = (real(1.0) - contacts.crossed_at[env, contact]) * step[env, 0]
                        history.crossing_time[env, contact] = real(time[env] - wp.float64(left))
                    history.crossings[env, contact] = history.crossings[env, contact] + 1
                history.face[env, contact] = face

    return advance


@functools.cache
def remembering(parts: Parts, real: type) -> wp.Function:
    """Returns the device function that takes what the force kept of a contact into the memory of its formulas."""
    _, Memory = group_structs(parts, real)

    @wp.func
    def remember(memory: Memory, kept: Memory, env: int, member: int):
        if wp.static(bool(parts.law.memories)):
            memory.law[env, member] = kept.law[env, member]
        if wp.static(bool(parts.friction.memories)):
            memory.friction[env, member] = kept.friction[env, member]
        if wp.static(bool(parts.rolling.memories)):
            memory.rolling[env, member] = kept.rolling[env, member]
        if wp.static(bool(parts.torsion.memories)):
            memory.torsion[env, member] = kept.torsion[env, member]

    return remember


@functools.cache
def kernel(real: type, follows: bool, ends: bool = False) -> wp.Kernel:
    """Returns the kernel that takes contacts that are near into ``history``; items: blocks.

    With ``ends`` the first block of an environment ends its step before, as ``finish.kernel`` does; not with
    ``follows``, which asks for the time.
    """
    assert not (follows and ends)
    t = structs(real)
    Model, State, Contacts, Near, History, Cache = (
        t.Model, t.State, t.Contacts, t.Near, t.History, t.Cache,
    )  # fmt: skip
    end, take = finish.end_of_step(real), advance(real, follows)

    @unique_kernel()
    def advance_history(
        work: Work,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] at the end of the step [s]
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] the same for the clock [s]
        bodies: wp.int32,
        state_in: State,
        state_out: State,
        model: Model,
        contacts: Contacts,
        near: Near,
        history: History,
        cache: Cache,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            block = item_of(work, task)
            before = status[env]
            if wp.static(ends):  # noqa: SIM102  Warp would evaluate both sides
                # What it does to the status makes none active, whoever looks at it meanwhile.
                if block == 0:
                    end(status, clock_step, time, bodies, state_in, state_out, env, before)
            if before == ENV_ACTIVE:
                take(time, step, model, contacts, near, history, cache, env, block)

    return advance_history


@functools.cache
def memory_kernel(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that takes what the force stage kept into the memory of ``formula``.

    Items: blocks of the group.
    """
    t = structs(real)
    Model, Near = t.Model, t.Near
    Array = wp.array2d(dtype=memory_struct(formula, real))

    @unique_kernel()
    def advance_memory(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        near: Near,
        first_block: wp.int32,
        first_contact: wp.int32,
        kept: Array,
        memory: Array,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            block = item_of(work, task)
            block += first_block
            if status[env] != ENV_ACTIVE:
                continue
            start = natural(model.block_start[block])
            for place in range(start, start + near.count[env, block]):
                member = near.contact[env, place] - first_contact
                memory[env, member] = kept[env, member]

    return advance_memory
