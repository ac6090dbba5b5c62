"""Relative velocities at a contact, of a state and of the bodies of a solve."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.nonsmooth.rows import body_response_struct
from warpcontact.kernels.types import structs


class Functions(NamedTuple):
    """Device functions of the velocity of the first body relative to the second, W."""

    before: wp.Function  # at K, in a state [m/s]
    after: wp.Function  # at K, in a solve [m/s]
    spin_before: wp.Function  # angular, in a state [rad/s]
    spin_after: wp.Function  # angular, in a solve [rad/s]


@functools.cache
def functions(real: type, moves: bool) -> Functions:
    """Returns the device functions for ``real``; all give the first body relative to the second.

    With ``moves`` some bodies have joints.
    """
    t = structs(real)
    vec3, State = t.vec3, t.State
    BodyResponse = wp.array2d(dtype=body_response_struct(real, moves))
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def before(state: State, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """Returns the relative velocity at K in a state."""
        return velocity_at(state, env, body_1, arm_1) - velocity_at(state, env, body_2, arm_2)

    @wp.func
    def after(body_response: BodyResponse, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """Returns the relative velocity at K in a solve."""
        velocity = vec3()
        if body_1 >= 0:
            velocity = body_response[env, body_1].linear + wp.cross(body_response[env, body_1].angular, arm_1)
        if body_2 >= 0:
            velocity -= body_response[env, body_2].linear + wp.cross(body_response[env, body_2].angular, arm_2)
        return velocity

    @wp.func
    def spin_before(state: State, env: int, body_1: int, body_2: int):
        """Returns the relative angular velocity in a state."""
        difference = vec3()
        if body_1 >= 0:
            difference = state.body_angular_velocity[env, body_1]
        if body_2 >= 0:
            difference -= state.body_angular_velocity[env, body_2]
        return difference

    @wp.func
    def spin_after(body_response: BodyResponse, env: int, body_1: int, body_2: int):
        """Returns the relative angular velocity in a solve."""
        difference = vec3()
        if body_1 >= 0:
            difference = body_response[env, body_1].angular
        if body_2 >= 0:
            difference -= body_response[env, body_2].angular
        return difference

    return Functions(before=before, after=after, spin_before=spin_before, spin_after=spin_after)
