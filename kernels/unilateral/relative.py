"""Relative velocities at a contact: of a state, and of bodies under impulses."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.types import structs
from warpcontact.kernels.unilateral.rows import row_structs


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, State = t.vec3, t.State
    Moving = row_structs(real).Moving
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def spin_of(state: State, env: int, body: int):
        if body < 0:
            return vec3()
        return state.body_angular_velocity[env, body]

    @wp.func
    def moving_spin_of(moving: Moving, env: int, body: int):
        if body < 0:
            return vec3()
        return moving.angular[env, body]

    @wp.func
    def moving_at(moving: Moving, env: int, body: int, arm: vec3):
        if body < 0:
            return vec3()
        return moving.linear[env, body] + wp.cross(moving.angular[env, body], arm)

    @wp.func
    def before(state: State, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """Velocity of the first relative to the second at K, and its angular velocity, in a state."""
        velocity = velocity_at(state, env, body_1, arm_1) - velocity_at(state, env, body_2, arm_2)
        return velocity, spin_of(state, env, body_1) - spin_of(state, env, body_2)

    @wp.func
    def after(moving: Moving, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """The same of bodies under impulses."""
        velocity = moving_at(moving, env, body_1, arm_1) - moving_at(moving, env, body_2, arm_2)
        return velocity, moving_spin_of(moving, env, body_1) - moving_spin_of(moving, env, body_2)

    return SimpleNamespace(before=before, after=after)
