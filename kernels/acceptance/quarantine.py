"""Checks the state after a step: non-finite, too fast or too far away."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import NO_CAUSE, NON_FINITE, TOO_FAR, TOO_FAST, structs


class GuardParts(NamedTuple):
    """Structs of the health check of a step, and its device function."""

    Guard: type  # limits of environments, and causes of failures
    Limits: type  # squared limits on the motion of the center of mass
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
