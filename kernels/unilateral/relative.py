"""Relative velocities at a contact: of a state, and of bodies under impulses."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.types import structs
from warpcontact.kernels.unilateral.rows import row_structs


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``; all are of the first body relative to the second."""
    t = structs(real)
    vec3, State = t.vec3, t.State
    Moving = row_structs(real).Moving
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def before(state: State, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """Velocity at K in a state."""
        return velocity_at(state, env, body_1, arm_1) - velocity_at(state, env, body_2, arm_2)

    @wp.func
    def after(moving: Moving, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """Velocity at K of bodies under impulses."""
        velocity = vec3()
        if body_1 >= 0:
            velocity = moving.linear[env, body_1] + wp.cross(moving.angular[env, body_1], arm_1)
        if body_2 >= 0:
            velocity -= moving.linear[env, body_2] + wp.cross(moving.angular[env, body_2], arm_2)
        return velocity

    @wp.func
    def spin(angular: wp.array2d(dtype=vec3), env: int, body_1: int, body_2: int):
        """Angular velocity, of those of the bodies [env, body]."""
        difference = vec3()
        if body_1 >= 0:
            difference = angular[env, body_1]
        if body_2 >= 0:
            difference -= angular[env, body_2]
        return difference

    return SimpleNamespace(before=before, after=after, spin=spin)
