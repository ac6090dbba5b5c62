"""End of a step: advances clocks; failed and stopped environments keep their last valid state."""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_FAILED,
    ENV_FROZEN,
    ENV_HALTED,
    ENV_STOPPED,
    LaunchRange,
    first_env,
    structs,
    task_count,
)


@functools.cache
def accept_step(real: type) -> wp.Function:
    """Returns the device function that ends a step of an environment, given its status after integration.

    Clocks of active environments advance. For failed and halted environments it copies the last accepted state, so
    that both state buffers hold it and frozen or stopped environments need no further work.
    """
    State = structs(real).State
    copy_body = frames.functions(real).copy_body

    @wp.func
    def accept_step(
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=wp.float64),
        time: wp.array(dtype=wp.float64),
        bodies: int,
        state_in: State,
        state_out: State,
        env: int,
        previous_status: int,
    ):
        if previous_status == ENV_ACTIVE:
            time[env] = time[env] + step[env, 0]
        if previous_status == ENV_FAILED or previous_status == ENV_HALTED:  # noqa: SIM109
            for body in range(bodies):
                copy_body(state_in, state_out, env, body)
            status[env] = wp.where(previous_status == ENV_FAILED, ENV_FROZEN, ENV_STOPPED)

    return accept_step


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that ends a step in all environments."""
    State = structs(real).State
    accept = accept_step(real)

    @unique_kernel()
    def accept_steps(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        bodies: wp.int32,
        state_in: State,
        state_out: State,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            accept(status, step, time, bodies, state_in, state_out, env, status[env])

    return accept_steps
