"""Poses and velocities of points and surfaces fixed to a body or to the world; float64 conversion of vectors."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import rotations
from warpcontact.kernels.types import structs


class Functions(NamedTuple):
    """Device functions of poses and velocities, for one precision."""

    offset_between: wp.Function  # vector from the carrier of a surface to that of a point, W [m]
    rotate_to_world: wp.Function  # vector in W, from the axes of a body
    facing_fraction: wp.Function  # cosine between the inward surface normal and the normal of a point, ≥ 0
    orientation_to_world: wp.Function  # rotation S → W of an element of a body
    rotation_to_world: wp.Function  # rotation matrix B → W of a body
    velocity_at: wp.Function  # velocity of a body at an arm from its center of mass, W [m/s]
    copy_body: wp.Function  # copies the state of one body
    to_float64: wp.Function  # vector in float64
    from_float64: wp.Function  # float64 vector, rounded


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, quat, mat33, Model, State = t.vec3, t.quat, t.mat33, t.Model, t.State
    matrix = rotations.functions(real).matrix

    @wp.func
    def offset_between(model: Model, state: State, env: int, point: int, surface: int):
        """Returns the vector from the origin of the carrier of ``surface`` to that of ``point``, W [m].

        The origin of a body is its center of mass; the origin of an element of the world is its anchor. Rounding
        is relative to the difference, not to the positions, so precision does not depend on the distance from the
        world origin.
        """
        body = model.point_body[point]
        remainder = vec3()
        difference = model.point_anchor[env, point]
        if body >= 0:
            difference = state.body_position[env, body]
            remainder = state.body_position_remainder[env, body]
        carrier = model.surface_body[surface]
        if carrier < 0:
            difference -= model.surface_anchor[env, surface]
        else:
            difference -= state.body_position[env, carrier]
            remainder -= state.body_position_remainder[env, carrier]
        return difference + remainder

    @wp.func
    def rotate_to_world(state: State, env: int, body: int, v_B: vec3):
        """Returns a vector given in the axes of ``body`` (WORLD: already in W) in W."""
        if body < 0:
            return v_B
        return wp.quat_rotate(state.body_orientation[env, body], v_B)

    @wp.func
    def facing_fraction(model: Model, env: int, point: int, R_WB: mat33, n_W: vec3):
        """Returns the cosine between the inward surface normal and the normal of ``point``, 0 if it faces away."""
        return wp.max(-wp.dot(R_WB * model.point_normal[env, point], n_W), real(0.0))

    @wp.func
    def orientation_to_world(state: State, env: int, body: int, q_BS: quat):
        """Returns the rotation S → W of an element fixed to ``body`` with rotation ``q_BS``."""
        if body < 0:
            return q_BS
        return state.body_orientation[env, body] * q_BS

    @wp.func
    def rotation_to_world(state: State, env: int, body: int):
        """Returns the rotation matrix B → W of ``body`` (WORLD: identity)."""
        if body < 0:
            return wp.identity(n=3, dtype=real)
        return matrix(state.body_orientation[env, body])

    @wp.func
    def velocity_at(state: State, env: int, body: int, arm_W: vec3):
        """Returns the velocity of ``body`` at ``arm_W`` from its center of mass, W [m/s]; 0 for the world."""
        if body < 0:
            return vec3()
        return state.body_linear_velocity[env, body] + wp.cross(state.body_angular_velocity[env, body], arm_W)

    @wp.func
    def copy_body(source: State, target: State, env: int, body: int):
        """Copies the state of one body."""
        target.body_position[env, body] = source.body_position[env, body]
        target.body_position_remainder[env, body] = source.body_position_remainder[env, body]
        target.body_orientation[env, body] = source.body_orientation[env, body]
        if target.body_orientation_remainder.shape[1] > 0:
            # Initial states have none.
            remainder = quat()
            if source.body_orientation_remainder.shape[1] > 0:
                remainder = source.body_orientation_remainder[env, body]
            target.body_orientation_remainder[env, body] = remainder
        target.body_linear_velocity[env, body] = source.body_linear_velocity[env, body]
        target.body_angular_velocity[env, body] = source.body_angular_velocity[env, body]

    @wp.func
    def to_float64(v: vec3):
        """Converts a vector to float64."""
        return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))

    @wp.func
    def from_float64(v: wp.vec3d):
        """Rounds a float64 vector to ``real``."""
        return vec3(real(v[0]), real(v[1]), real(v[2]))

    return Functions(
        offset_between=offset_between,
        rotate_to_world=rotate_to_world,
        facing_fraction=facing_fraction,
        orientation_to_world=orientation_to_world,
        rotation_to_world=rotation_to_world,
        velocity_at=velocity_at,
        copy_body=copy_body,
        to_float64=to_float64,
        from_float64=from_float64,
    )
