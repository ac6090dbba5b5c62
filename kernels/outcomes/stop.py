"""Stops environments at the state at which a condition holds."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.outcomes.source import SourceForm, value
from warpcontact.kernels.types import ENV_ACTIVE, ENV_HALTED, LaunchRange, first_env, task_count

#: Tolerance for the duration of a condition, as a fraction of a step, because clocks are rounded sums.
TIME_TOLERANCE = wp.constant(wp.float64(1.0e-6))


@wp.struct
class Condition:
    """Stop condition: ``sign`` (x − ``limit``) > 0 for the duration ``lasting``."""

    limit: wp.float64
    sign: wp.float64
    lasting: wp.float64  # [s]
    number: wp.int32  # index of the condition


@wp.struct
class StopStates:
    """State of the stop conditions."""

    since: wp.array2d(dtype=wp.float64)  # [env, condition] time since which it holds [s]; NaN: does not hold
    stopped_by: wp.array(dtype=wp.int32)  # [env] index of the condition; −1: none


@functools.cache
def kernel(form: SourceForm) -> wp.Kernel:
    """Returns the kernel that checks a condition before a step; items: one per environment."""
    source_value = value(form)
    dtype = form.dtype

    @unique_kernel()
    def stop(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] before the step [s]
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        condition: Condition,
        a: wp.array3d(dtype=dtype),
        stops: StopStates,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            x = condition.sign * (source_value(a, env, 0, 0) - condition.limit)
            since = wp.float64(wp.nan)
            if x > wp.float64(0.0):
                since = stops.since[env, condition.number]
                if wp.isnan(since):
                    since = time[env]
                if time[env] - since >= condition.lasting - TIME_TOLERANCE * step[env, 0]:
                    status[env] = ENV_HALTED
                    stops.stopped_by[env] = condition.number
            stops.since[env, condition.number] = since

    return stop


@functools.cache
def restart() -> wp.Kernel:
    """Returns the kernel that resets conditions. Launch with dim env."""

    @unique_kernel()
    def reset_conditions(mask: wp.array(dtype=wp.bool), count: wp.int32, stops: StopStates):
        env = wp.tid()
        if mask[env]:
            stops.stopped_by[env] = -1
            for number in range(count):
                stops.since[env, number] = wp.float64(wp.nan)

    return reset_conditions
