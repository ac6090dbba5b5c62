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
    one = wp.constant(real(1.0))

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
    def rotation_to_world(state: State, env: int, body: int):
        """Rotation B → W of ``body`` (WORLD: none), for many points."""
        if body < 0:
            return wp.identity(n=3, dtype=real)
        return wp.quat_to_matrix(state.body_orientation[env, body])

    @wp.func
    def origin(state: State, env: int, body: int):
        """Position in W of the centre of mass of ``body`` (WORLD: its origin)."""
        if body < 0:
            return vec3()
        return state.body_position[env, body]

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
        squared = real(0.25) * wp.dot(angle_W, angle_W)
        sinc = real(1.0)
        cosine = real(1.0)
        if squared < real(0.01):
            # Their series, to a rounding: a step turns a body by little.
            sinc = one - squared / real(6.0) * (
                one - squared / real(20.0) * (one - squared / real(42.0) * (one - squared / real(72.0)))
            )
            cosine = one - squared / real(2.0) * (
                one - squared / real(12.0) * (one - squared / real(30.0) * (one - squared / real(56.0)))
            )
        else:
            half = wp.sqrt(squared)
            sinc = wp.sin(half) / half
            cosine = wp.cos(half)
        axis = real(0.5) * sinc * angle_W
        return wp.normalize(quat(axis[0], axis[1], axis[2], cosine) * q)

    return SimpleNamespace(
        point_to_world=point_to_world,
        orientation_to_world=orientation_to_world,
        rotation_to_world=rotation_to_world,
        origin=origin,
        velocity_at=velocity_at,
        rotated=rotated,
    )
