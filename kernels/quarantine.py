"""When a step has failed: the body is no longer where numbers say, too fast, or too far away."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import ENV_FAILED, NO_CAUSE, NON_FINITE, TOO_FAR, TOO_FAST, structs


@functools.cache
def guard(real: type) -> SimpleNamespace:
    """Returns the struct ``Guard`` and the device functions that use it, for one precision."""
    vec3 = structs(real).vec3

    @wp.struct
    class Guard:
        """What environments may not do, and why they were frozen."""

        max_speed: wp.array2d(dtype=real)  # [env, 0] of a centre of mass [m/s]
        max_distance: wp.array2d(dtype=real)  # [env, 0] of it from the origin of W [m]
        cause: wp.array(dtype=wp.int32)  # [env] NO_CAUSE, NON_FINITE, …

    @wp.func
    def cause_of(guard: Guard, env: int, position: vec3, velocity: vec3, spin: vec3):
        """Why a body with such a proposed state has failed."""
        distance = wp.length_sq(position)
        speed = wp.length_sq(velocity)
        # One sum is finite only if every term is: squares have no opposite signs.
        if not wp.isfinite(distance + speed + wp.length_sq(spin)):
            return NON_FINITE
        fastest = guard.max_speed[env, 0]
        if speed > fastest * fastest:
            return TOO_FAST
        farthest = guard.max_distance[env, 0]
        if distance > farthest * farthest:
            return TOO_FAR
        return NO_CAUSE

    @wp.func
    def blame(guard: Guard, env: int, cause: int, status: wp.array(dtype=wp.int32)):
        """Lets the step of an environment fail, if there is a cause."""
        if cause != NO_CAUSE:
            status[env] = ENV_FAILED
            guard.cause[env] = cause

    return SimpleNamespace(Guard=Guard, cause_of=cause_of, blame=blame)
