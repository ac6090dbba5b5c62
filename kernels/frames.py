"""Poses and velocities of what is fixed to a body or to the world, rotation vectors, and vectors in float64."""

import functools
import math
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import structs


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, quat, mat33, Model, State = t.vec3, t.quat, t.mat33, t.Model, t.State
    one, two, half = wp.constant(real(1.0)), wp.constant(real(2.0)), wp.constant(real(0.5))
    # Of (sin √x)/√x and cos √x, to the fourth power of x.
    s_1, s_2, s_3, s_4 = (wp.constant(real((-1) ** k / math.factorial(2 * k + 1))) for k in range(1, 5))
    c_1, c_2, c_3, c_4 = (wp.constant(real((-1) ** k / math.factorial(2 * k))) for k in range(1, 5))
    # Newton's step to unit length leaves 3/8 of the square of the excess: below a rounding, this near.
    nearly = wp.constant(real(t.epsilon**0.5 / 4.0))

    @wp.func
    def matrix(q: quat):
        """The rotation that ``wp.quat_rotate`` does, of any length of ``q``, for many vectors.

        That of Warp rotates three vectors, with their zeros.
        """
        x = two * q[0]
        y = two * q[1]
        z = two * q[2]
        xx = x * q[0]
        xy = x * q[1]
        xz = x * q[2]
        xw = x * q[3]
        yy = y * q[1]
        yz = y * q[2]
        yw = y * q[3]
        zz = z * q[2]
        zw = z * q[3]
        ww = two * q[3] * q[3] - one
        return mat33(
            ww + xx, xy - zw, xz + yw,
            xy + zw, ww + yy, yz - xw,
            xz - yw, yz + xw, ww + zz,
        )  # fmt: skip

    @wp.func
    def unit(q: quat):
        """A quaternion of about unit length with unit length, to a rounding."""
        excess = wp.dot(q, q) - one
        if wp.abs(excess) < nearly:
            return (one - half * excess) * q
        return wp.normalize(q)

    @wp.func
    def apart(model: Model, state: State, env: int, point: int, surface: int):
        """From the origin of what carries ``surface`` to that of what carries ``point``, W.

        The origin of a body is its centre of mass; of what is fixed to the world, its anchor. Bodies that touch
        are near each other, wherever in the world: the difference is as fine as they are, positions are not.
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
    def turned(state: State, env: int, body: int, v_B: vec3):
        """A vector given in the axes of ``body`` (WORLD: already in W), in W."""
        if body < 0:
            return v_B
        return wp.quat_rotate(state.body_orientation[env, body], v_B)

    @wp.func
    def facing(model: Model, env: int, point: int, R_WB: mat33, n_W: vec3):
        """Part of the area of ``point`` that faces a surface with the normal ``n_W``: a cosine, or nothing."""
        return wp.max(-wp.dot(R_WB * model.point_normal[env, point], n_W), real(0.0))

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
        return matrix(state.body_orientation[env, body])

    @wp.func
    def velocity_at(state: State, env: int, body: int, arm_W: vec3):
        """Velocity in W of the point of ``body`` at ``arm_W`` from its centre of mass; 0 for the world."""
        if body < 0:
            return vec3()
        return state.body_linear_velocity[env, body] + wp.cross(state.body_angular_velocity[env, body], arm_W)

    @wp.func
    def copy_body(source: State, target: State, env: int, body: int):
        """Copies the state of one body."""
        target.body_position[env, body] = source.body_position[env, body]
        target.body_position_remainder[env, body] = source.body_position_remainder[env, body]
        target.body_orientation[env, body] = source.body_orientation[env, body]
        target.body_linear_velocity[env, body] = source.body_linear_velocity[env, body]
        target.body_angular_velocity[env, body] = source.body_angular_velocity[env, body]

    @wp.func
    def rotated(q: quat, angle_W: vec3):
        """Turns orientation ``q`` by the rotation vector ``angle_W`` given in W: exp(angle/2) q, unit length."""
        squared = real(0.25) * wp.dot(angle_W, angle_W)
        sinc = one
        cosine = one
        if squared < real(0.01):
            # A step turns a body by little: to a rounding.
            sinc = one + squared * (s_1 + squared * (s_2 + squared * (s_3 + squared * s_4)))
            cosine = one + squared * (c_1 + squared * (c_2 + squared * (c_3 + squared * c_4)))
        else:
            angle = wp.sqrt(squared)
            sinc = wp.sin(angle) / angle
            cosine = wp.cos(angle)
        axis = (half * sinc) * angle_W
        return unit(quat(axis[0], axis[1], axis[2], cosine) * q)

    @wp.func
    def rotation_vector(q: quat):
        """Axis times angle of a rotation, the shorter way round: what ``rotated`` takes."""
        v = vec3(q[0], q[1], q[2])
        cosine = q[3]
        if cosine < real(0.0):
            v = -v
            cosine = -cosine
        sine = wp.length(v)
        if sine < real(1.0e-4):
            # asin(s)/s to a rounding.
            return (two + sine * sine / real(3.0)) * v
        return (two * wp.atan2(sine, cosine) / sine) * v

    @wp.func
    def wide(v: vec3):
        """A vector in float64."""
        return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))

    @wp.func
    def narrow(v: wp.vec3d):
        """A vector of float64, rounded."""
        return vec3(real(v[0]), real(v[1]), real(v[2]))

    return SimpleNamespace(
        matrix=matrix,
        apart=apart,
        turned=turned,
        facing=facing,
        orientation_to_world=orientation_to_world,
        rotation_to_world=rotation_to_world,
        velocity_at=velocity_at,
        copy_body=copy_body,
        rotated=rotated,
        rotation_vector=rotation_vector,
        wide=wide,
        narrow=narrow,
    )
