"""When a step has failed: the body is no longer where numbers say, too fast, or too far away."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import NO_CAUSE, NON_FINITE, TOO_FAR, TOO_FAST, structs


@functools.cache
def guard(real: type) -> SimpleNamespace:
    """Returns the struct ``Guard`` and the device function ``failure_cause`` for one precision."""
    vec3 = structs(real).vec3

    @wp.struct
    class Limits:
        """What a centre of mass may do, squared."""

        speed: real  # [m²/s²]
        distance: real  # from the origin of W [m²]

    @wp.struct
    class Guard:
        """What environments may not do, and why they were frozen."""

        suspect: wp.array2d(dtype=real)  # [env, 0] what keeps all squares below this, in sum, has not failed
        limits: wp.array2d(dtype=Limits)  # [env, 0] to be looked at if not
        cause: wp.array(dtype=wp.int32)  # [env] NO_CAUSE, NON_FINITE, …

    @wp.func
    def failure_cause(position: vec3, velocity: vec3, spin: vec3, limits: Limits):
        """Why a body with such a proposed state has failed."""
        distance = wp.length_sq(position)
        speed = wp.length_sq(velocity)
        # One sum is finite only if every term is: squares have no opposite signs.
        if not wp.isfinite(distance + speed + wp.length_sq(spin)):
            return NON_FINITE
        if speed > limits.speed:
            return TOO_FAST
        if distance > limits.distance:
            return TOO_FAR
        return NO_CAUSE

    return SimpleNamespace(Guard=Guard, Limits=Limits, failure_cause=failure_cause)
