"""Steps of bodies that are alone in their environment, in place: any number in one launch on a CPU.

An environment takes its steps one after the other, before the next has its turn: what they read of it, and of the
surface about it, stays in the nearest cache of the core, which also foresees branches better. Nothing else is
computed than in the launches of ``schedule``, by the same functions.
"""

import functools

import warp as wp
from warpcontact.kernels import history, integrate, meet
from warpcontact.kernels import wrenches as of_wrenches
from warpcontact.kernels.strides import anew, telling
from warpcontact.kernels.touch import Parts, group_structs
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_FROZEN,
    NO_CAUSE,
    Work,
    first_env,
    natural,
    step_count,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def kernel(parts: Parts, real: type, projected: bool, pushed: bool) -> wp.Kernel:
    """Returns the kernel of accepted semi-implicit Euler steps, as many as the slice says; items: one.

    Args:
        parts: The classes of law and friction models, of all contacts.
        real: Type of a real number.
        projected: Whether contacts are weighed by the normals of their points.
        pushed: Whether there are forces from outside.
    """
    t = structs(real)
    Model, State, History, Contacts, Near, Cache, Ends = (
        t.Model, t.State, t.History, t.Contacts, t.Near, t.Cache, t.Ends,
    )  # fmt: skip
    Coefficients, Memory = group_structs(parts, real)
    meet_set = meet.of_sets(parts, real, False, projected)
    total = of_wrenches.functions(real, False, pushed).total
    of_body = integrate.euler(real)
    Guard, moved_by, put, failure_of = of_body.Guard, of_body.moved_by, of_body.put, of_body.failure_of
    advance, remember = history.advance(real, False), history.remembering(parts, real)
    remembers = any(part.memories for part in parts)
    tell_model, tell_state, tell_history = telling(Model), telling(State), telling(History)
    tell_cache, tell_contacts, tell_near = telling(Cache), telling(Contacts), telling(Near)
    tell_coefficients = telling(Coefficients)

    @wp.func
    def accept(
        time: wp.array(dtype=wp.float64),
        step: wp.array2d(dtype=real),
        model: Model,
        history: History,
        memory: Memory,
        kept: Memory,
        contacts: Contacts,
        near: Near,
        cache: Cache,
        which: int,
        block: int,
    ):
        """Takes the contacts of a block into the history."""
        env = anew(which)
        advance(time, step, model, contacts, near, history, cache, env, block)
        if wp.static(remembers):
            start = natural(model.block_start[block])
            for place in range(start, start + near.count[env, block]):
                remember(memory, kept, env, natural(near.contact[env, place]))

    @unique_kernel()
    def step_in_place(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        model: Model,
        guard: Guard,
        history: History,
        memory: Memory,
        coefficients: Coefficients,
        kept: Memory,
        contacts: Contacts,
        near: Near,
        cache: Cache,
        ends: Ends,
        sets: wp.int32,
        blocks: wp.int32,
        state: State,
    ):
        tell_model(model)
        tell_state(state)
        tell_history(history)
        tell_coefficients(coefficients)
        tell_cache(cache)
        tell_contacts(contacts)
        tell_near(near)
        for task in range(wp.tid(), task_count(work), work.threads):
            which = first_env(work) + task
            left = step_count(work)
            while left > 0:
                env = anew(which)
                if status[env] != ENV_ACTIVE:
                    break
                left -= 1
                number = natural(0)
                while number < sets:
                    meet_set(
                        model, state, history, memory, step[env, 0], 0, coefficients, kept, cache, contacts, near,
                        env, number,
                    )  # fmt: skip
                    number = natural(number + 1)
                env = anew(which)
                wrench = total(model, near, ends, env, 0)
                moved = moved_by(model, state, env, 0, wrench.force, wrench.torque, step[env, 0])
                cause = failure_of(guard, env, moved)
                if cause != NO_CAUSE:
                    # It stays where it was.
                    status[env] = ENV_FROZEN
                    guard.cause[env] = cause
                    break
                put(state, env, 0, moved)
                time[env] = time[env] + clock_step[env, 0]
                block = natural(0)
                while block < blocks:
                    accept(time, step, model, history, memory, kept, contacts, near, cache, which, block)
                    block = natural(block + 1)

    return step_in_place
