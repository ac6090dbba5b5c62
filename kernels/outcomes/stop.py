"""Holds environments at the state at which a condition holds."""

import functools

import warp as wp
from warpcontact.kernels.outcomes.source import Form, value
from warpcontact.kernels.types import ENV_ACTIVE, ENV_HALTED, Work, first_env, task_count
from warpcontact.kernels.unique import unique_kernel

#: Clocks are sums: a time is reached within this share of a step.
NEARLY = wp.constant(wp.float64(1.0e-6))


@wp.struct
class Condition:
    """``sign`` (x − ``limit``) > 0 for ``lasting``."""

    limit: wp.float64
    sign: wp.float64
    lasting: wp.float64  # [s]
    number: wp.int32  # of the condition


@wp.struct
class Stops:
    """What is known of the conditions of an environment."""

    since: wp.array2d(dtype=wp.float64)  # [env, condition] when it came to hold [s]; NaN: it does not
    stopped_by: wp.array(dtype=wp.int32)  # [env] number of the condition; −1: none


@functools.cache
def kernel(form: Form) -> wp.Kernel:
    """Returns the kernel that looks at a condition before a step; items: one."""
    seen = value(form)
    dtype = form.dtype

    @unique_kernel()
    def stop(
        work: Work,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] before the step [s]
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        condition: Condition,
        a: wp.array3d(dtype=dtype),
        stops: Stops,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] != ENV_ACTIVE:
                continue
            x = condition.sign * (seen(a, env, 0, 0) - condition.limit)
            since = wp.float64(wp.nan)
            if x > wp.float64(0.0):
                since = stops.since[env, condition.number]
                if wp.isnan(since):
                    since = time[env]
                if time[env] - since >= condition.lasting - NEARLY * step[env, 0]:
                    status[env] = ENV_HALTED
                    stops.stopped_by[env] = condition.number
            stops.since[env, condition.number] = since

    return stop


@functools.cache
def restart() -> wp.Kernel:
    """Returns the kernel that forgets conditions. Launch with dim env."""

    @unique_kernel()
    def forget_conditions(mask: wp.array(dtype=wp.bool), count: wp.int32, stops: Stops):
        env = wp.tid()
        if mask[env]:
            stops.stopped_by[env] = -1
            for number in range(count):
                stops.since[env, number] = wp.float64(wp.nan)

    return forget_conditions
