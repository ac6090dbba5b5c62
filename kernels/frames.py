"""Poses and velocities of what is fixed to a body or to the world, and rotation by an exponential map."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import structs


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, quat, State = t.vec3, t.quat, t.State

    @wp.func
    def point_to_world(state: State, env: int, body: int, p_B: vec3):
        """Position in W of a point given in the frame of ``body`` (WORLD: already in W)."""
        if body < 0:
            return p_B
        return state.body_position[env, body] + wp.quat_rotate(state.body_orientation[env, body], p_B)

    @wp.func
    def orientation_to_world(state: State, env: int, body: int, q_BS: quat):
        """Rotation S → W of what is fixed to ``body`` with rotation ``q_BS``."""
        if body < 0:
            return q_BS
        return state.body_orientation[env, body] * q_BS

    @wp.func
    def velocity_at(state: State, env: int, body: int, p_W: vec3):
        """Velocity in W of the material point of ``body`` at ``p_W``; 0 for the world."""
        if body < 0:
            return vec3()
        arm = p_W - state.body_position[env, body]
        return state.body_linear_velocity[env, body] + wp.cross(state.body_angular_velocity[env, body], arm)

    @wp.func
    def rotated(q: quat, angle_W: vec3):
        """Turns orientation ``q`` by the rotation vector ``angle_W`` given in W: exp(angle/2) q, unit length."""
        angle = wp.length(angle_W)
        half = real(0.5) * angle
        # sin(x)/x, by its series where the quotient would lose digits: the error is x⁴/120.
        sinc = real(1.0) - half * half / real(6.0)
        if half > real(1.0e-3):
            sinc = wp.sin(half) / half
        axis = real(0.5) * sinc * angle_W
        return wp.normalize(quat(axis[0], axis[1], axis[2], wp.cos(half)) * q)

    return SimpleNamespace(
        point_to_world=point_to_world,
        orientation_to_world=orientation_to_world,
        velocity_at=velocity_at,
        rotated=rotated,
    )
