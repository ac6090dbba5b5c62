"""End of a step: checks the proposed state and advances clocks.

A state that is not finite, too fast or too far away fails. Failed and stopped environments keep their last valid
state.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_FAILED,
    ENV_FROZEN,
    ENV_HALTED,
    ENV_STOPPED,
    NO_CAUSE,
    NON_FINITE,
    TOO_FAR,
    TOO_FAST,
    LaunchRange,
    Struct,
    first_env,
    structs,
    task_count,
)


class GuardParts(NamedTuple):
    """Structs of the health check of a step, and its device function."""

    Guard: Struct  # limits of environments, and causes of failures
    Limits: Struct  # squared limits on the motion of the center of mass
    failure_cause: wp.Function  # failure cause of a proposed state, or NO_CAUSE


@functools.cache
def guard(real: type) -> GuardParts:
    """Returns the struct ``Guard`` and the device function ``failure_cause`` for one precision."""
    vec3 = structs(real).vec3

    @wp.struct
    class Limits:
        """Squared limits on the motion of the center of mass."""

        speed: real  # [m²/s²]
        distance: real  # from the origin of W [m²]

    @wp.struct
    class Guard:
        """Limits of environments, and the causes of failures."""

        suspect: wp.array2d(dtype=real)  # [env, 0] if the sum of all squares is below this, the state is valid
        limits: wp.array2d(dtype=Limits)  # [env, 0] checked otherwise
        cause: wp.array(dtype=wp.int32)  # [env] NO_CAUSE, NON_FINITE, …

    @wp.func
    def failure_cause(position: vec3, velocity: vec3, spin: vec3, limits: Limits):
        """Returns the failure cause of a proposed state, or NO_CAUSE."""
        distance = wp.length_sq(position)
        speed = wp.length_sq(velocity)
        # A sum of squares is finite only if every term is.
        if not wp.isfinite(distance + speed + wp.length_sq(spin)):
            return NON_FINITE
        if speed > limits.speed:
            return TOO_FAST
        if distance > limits.distance:
            return TOO_FAR
        return NO_CAUSE

    return GuardParts(Guard=Guard, Limits=Limits, failure_cause=failure_cause)


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
