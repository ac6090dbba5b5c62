"""Keeps outcomes: their memory advances once per accepted step, before the step, and is never looked at in it."""

import functools

import warp as wp
from warpcontact.kernels.outcomes.source import Form, array_types, values
from warpcontact.kernels.types import ENV_ACTIVE, ENV_FROZEN, Work, env_of, first_env, item_of, task_count
from warpcontact.kernels.unique import unique_kernel


@wp.struct
class Sight:
    """How an outcome looks at its first source: ``sign`` (x − ``limit``), above 0 where its condition holds."""

    limit: wp.float64
    sign: wp.float64
    components: wp.int32  # of a result, of which an environment has one for each item


@functools.cache
def _seen(forms: tuple[Form, ...], single: bool) -> wp.Function:
    """Returns the device function that gives what an outcome sees through its ``Sight``; see ``observe``."""
    see = values(forms)
    type_0, type_1, type_2, type_3 = array_types(forms)
    alone = len(forms) == 1

    @wp.func
    def seen(
        sight: Sight,
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        env: int,
        result: int,
    ):
        item = wp.int32(0)
        component = wp.int32(0)
        if wp.static(not single):
            item = result // sight.components
            component = result % sight.components
        x = see(a, b, c, d, env, item, component)
        if wp.static(alone):
            x = sight.sign * (x - sight.limit)
        return x

    return seen


@functools.cache
def observe(update: wp.Function, length: int, forms: tuple[Form, ...], single: bool) -> wp.Kernel:
    """Returns the kernel that shows an outcome the state that a step begins from; items: results.

    Args:
        update: Of the outcome.
        length: Of its memory.
        forms: Of its sources.
        single: Whether an environment has one result: to divide takes longer than all the rest.
    """
    Memory = wp.types.vector(length=length, dtype=wp.float64)
    seen = _seen(forms, single)
    type_0, type_1, type_2, type_3 = array_types(forms)

    @unique_kernel()
    def observe(
        work: Work,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] before the step [s]
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        sight: Sight,
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        memory: wp.array2d(dtype=Memory),  # [env, result]
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            number = wp.int32(0)
            if wp.static(not single):
                env = env_of(work, task)
                number = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            x = seen(sight, a, b, c, d, env, number)
            memory[env, number] = update(memory[env, number], x, time[env], step[env, 0])

    return observe


@functools.cache
def report(update: wp.Function, result: wp.Function, length: int, forms: tuple[Form, ...]) -> wp.Kernel:
    """Returns the kernel that tells the results at the current state; items: results.

    That state is seen over no time, and nothing of it is kept. Where an environment was frozen it led to a step
    that has failed, and is only seen if it is finite.
    """
    Memory = wp.types.vector(length=length, dtype=wp.float64)
    seen = _seen(forms, False)
    type_0, type_1, type_2, type_3 = array_types(forms)

    @unique_kernel()
    def report(
        work: Work,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),
        sight: Sight,
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        memory: wp.array2d(dtype=Memory),
        results: wp.array2d(dtype=wp.float64),  # [env, result]
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            number = item_of(work, task)
            x = seen(sight, a, b, c, d, env, number)
            m = memory[env, number]
            if status[env] != ENV_FROZEN or wp.isfinite(x):
                m = update(m, x, time[env], wp.float64(0.0))
            results[env, number] = result(m, time[env])

    return report


@functools.cache
def restart(length: int) -> wp.Kernel:
    """Returns the kernel that puts memories to their start. Launch with dim (env, result)."""
    Memory = wp.types.vector(length=length, dtype=wp.float64)

    @unique_kernel()
    def restart_memory(mask: wp.array(dtype=wp.bool), start: Memory, memory: wp.array2d(dtype=Memory)):
        env, number = wp.tid()
        if mask[env]:
            memory[env, number] = start

    return restart_memory


@functools.cache
def forget_count() -> wp.Kernel:
    """Returns the kernel that sets counts to 0. Launch with dim env."""

    @unique_kernel()
    def forget(mask: wp.array(dtype=wp.bool), counts: wp.array(dtype=wp.int32)):
        env = wp.tid()
        if mask[env]:
            counts[env] = 0

    return forget
