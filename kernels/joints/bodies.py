"""Device functions shared by the joint kernels: poses, rotations about an axis, inertia about an anchor.

Bodies with joints are computed in float64 for any precision, so that the pose after every step satisfies the joint
to the rounding of the state.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames, rotations
from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.types import (
    BALL,
    ENV_FAILED,
    HINGE,
    NO_CAUSE,
    NON_FINITE,
    PLANAR,
    PRESCRIBED,
    SLIDER,
    TRANSLATION,
    BodyMotion,
    Struct,
    structs,
)

ONE = wp.constant(wp.float64(1.0))
ZERO = wp.constant(wp.float64(0.0))
# Lower bound on the inverse mass [1/kg] of an immovable body, because laws divide by it.
MIN_INVERSE_MASS = wp.constant(wp.float64(1.0e-20))
# Angular velocity of a body from its angular momentum.
spin_of = rotations.functions(wp.float64).spin


@wp.func
def half_angle(axis: wp.vec3d, q: wp.quatd, q_initial: wp.quatd):
    """Returns sine and cosine of half the rotation angle about ``axis`` from ``q_initial`` to ``q``."""
    relative_rotation = q * wp.quat_inverse(q_initial)
    sine = axis[0] * relative_rotation[0] + axis[1] * relative_rotation[1] + axis[2] * relative_rotation[2]
    size = wp.sqrt(sine * sine + relative_rotation[3] * relative_rotation[3])
    if size == ZERO:
        return ZERO, ONE
    return sine / size, relative_rotation[3] / size


@wp.func
def add_half_angle(sine: wp.float64, cosine: wp.float64, angle: wp.float64):
    """Returns sine and cosine of half the angle after a further rotation by ``angle``."""
    s = wp.sin(wp.float64(0.5) * angle)
    c = wp.cos(wp.float64(0.5) * angle)
    return sine * c + cosine * s, cosine * c - sine * s


@wp.func
def quat_about(axis: wp.vec3d, sine: wp.float64, cosine: wp.float64):
    """Returns the rotation about ``axis`` with this sine and cosine of half its angle."""
    return wp.quatd(sine * axis[0], sine * axis[1], sine * axis[2], cosine)


@wp.func
def inertia_about(axis: wp.vec3d, q: wp.quatd, inertia_B: wp.mat33d):
    """Returns the moment of inertia about an axis through the center of mass [kg·m²]."""
    axis_B = wp.quat_rotate_inv(q, axis)
    return wp.dot(axis_B, inertia_B * axis_B)


@wp.func
def inertia_at(inertia_B: wp.mat33d, mass: wp.float64, arm_B: wp.vec3d):
    """Returns the inertia about a point from which the center of mass is at ``arm_B`` [kg·m²]."""
    parallel_axis = wp.dot(arm_B, arm_B) * wp.identity(n=3, dtype=wp.float64) - wp.outer(arm_B, arm_B)
    return inertia_B + mass * parallel_axis


@wp.func
def momentum_of(inertia_B: wp.mat33d, q: wp.quatd, w: wp.vec3d):
    """Returns the angular momentum in W of a body with angular velocity ``w`` in W."""
    return wp.quat_rotate(q, inertia_B * wp.quat_rotate_inv(q, w))


@wp.func
def anchor_arm(motion: BodyMotion, q: wp.quatd):
    """Returns the vector from the anchor to the center of mass on a hinge or ball, for orientation ``q``, W."""
    if motion.kind == HINGE:
        sine, cosine = half_angle(motion.axis, q, motion.orientation)
        return wp.quat_rotate(quat_about(motion.axis, sine, cosine), motion.position - motion.anchor)
    return wp.quat_rotate(q, wp.quat_rotate_inv(motion.orientation, motion.position - motion.anchor))


@wp.func
def hinge_inertia(motion: BodyMotion, q: wp.quatd, inertia_B: wp.mat33d, mass: wp.float64):
    """Returns the moment of inertia about the axis of a hinge [kg·m²], and the lever of the center of mass, W [m].

    The lever is the velocity of the center of mass over the rate of rotation.
    """
    lever = wp.cross(motion.axis, anchor_arm(motion, q))
    return inertia_about(motion.axis, q, inertia_B) + mass * wp.dot(lever, lever), lever


@wp.func
def advance_velocity(
    motion: BodyMotion,
    mass: wp.float64,
    inertia_B: wp.mat33d,
    q: wp.quatd,
    v: wp.vec3d,
    w: wp.vec3d,
    force: wp.vec3d,
    torque: wp.vec3d,
    dt: wp.float64,
):
    """Returns the velocities after ``dt`` under a force and a torque about the center of mass, W.

    For a body with prescribed velocities or with a joint other than a ball; zero for other bodies.
    """
    kind = motion.kind
    axis = motion.axis
    linear = wp.vec3d()
    angular = wp.vec3d()
    if kind == PRESCRIBED:
        linear = v
        angular = w
    elif kind == TRANSLATION:
        linear = v + (dt / mass) * force
    elif kind == SLIDER:
        linear = wp.dot(axis, v + (dt / mass) * force) * axis
    elif kind == PLANAR:
        linear = v + (dt / mass) * force
        linear -= wp.dot(axis, linear) * axis
        rate = wp.dot(axis, w) + dt * wp.dot(axis, torque) / inertia_about(axis, q, inertia_B)
        angular = rate * axis
    elif kind == HINGE:
        inertia, lever = hinge_inertia(motion, q, inertia_B, mass)
        rate = wp.dot(axis, w) + dt * wp.dot(axis, torque + wp.cross(anchor_arm(motion, q), force)) / inertia
        linear = rate * lever
        angular = rate * axis
    return linear, angular


class Functions(NamedTuple):
    """Device functions that read and write states and models of one precision, and the struct ``Guard``."""

    to_float64: wp.Function  # vector in float64
    from_float64: wp.Function  # float64 vector, rounded
    matrix_to_float64: wp.Function  # matrix in float64
    quat_to_float64: wp.Function  # rotation in float64, normalized
    quat_from_float64: wp.Function  # float64 rotation, rounded
    set_position: wp.Function  # sets the center of mass, with its rounding remainder
    set_velocity: wp.Function  # sets the linear and angular velocity
    check_body: wp.Function  # marks the step as failed if the state is invalid or a load is NaN
    Guard: Struct  # limits of environments, and causes of failures: ``accept_step.py``
    pose_after_step: wp.Function  # pose on the joint after a step with given mean velocities
    mobility: wp.Function  # inverse effective mass of a body with a joint for a force along a direction [1/kg]
    rotated: wp.Function  # float64 rotation, rotated by a rotation vector in W


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions that read and write states and models of precision ``real``."""
    t = structs(real)
    vec3, quat, mat33, Model, State, Wrenches = t.vec3, t.quat, t.mat33, t.Model, t.State, t.Wrenches
    frame = frames.functions(real)
    to_float64, from_float64 = frame.to_float64, frame.from_float64
    rotated = rotations.functions(wp.float64).rotated
    guard_functions = accept_step.guard(real)
    Guard, failure_cause = guard_functions.Guard, guard_functions.failure_cause

    @wp.func
    def matrix_to_float64(m: mat33):
        return wp.mat33d(
            wp.float64(m[0, 0]), wp.float64(m[0, 1]), wp.float64(m[0, 2]),
            wp.float64(m[1, 0]), wp.float64(m[1, 1]), wp.float64(m[1, 2]),
            wp.float64(m[2, 0]), wp.float64(m[2, 1]), wp.float64(m[2, 2]),
        )  # fmt: skip

    @wp.func
    def quat_to_float64(q: quat):
        """Returns the rotation in float64, normalized."""
        return wp.normalize(wp.quatd(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]), wp.float64(q[3])))

    @wp.func
    def quat_from_float64(q: wp.quatd):
        return quat(real(q[0]), real(q[1]), real(q[2]), real(q[3]))

    @wp.func
    def set_position(state: State, env: int, body: int, base: wp.vec3d, offset: wp.vec3d):
        """Sets the center of mass to ``base + offset``, with the rounding remainder of both precisions."""
        position = base + offset
        rounded_offset = position - base
        remainder = (base - (position - rounded_offset)) + (offset - rounded_offset)
        rounded = from_float64(position)
        state.body_position[env, body] = rounded
        state.body_position_remainder[env, body] = from_float64((position - to_float64(rounded)) + remainder)

    @wp.func
    def set_velocity(state: State, env: int, body: int, v: wp.vec3d, w: wp.vec3d):
        state.body_linear_velocity[env, body] = from_float64(v)
        state.body_angular_velocity[env, body] = from_float64(w)

    @wp.func
    def check_body(
        guard: Guard, wrenches: Wrenches, state: State, env: int, body: int, status: wp.array(dtype=wp.int32)
    ):
        """Marks the step as failed if the state is invalid or a load is NaN, even one that the joint carries."""
        loads = wp.length_sq(wrenches.force[env, body]) + wp.length_sq(wrenches.torque[env, body])
        cause = failure_cause(
            state.body_position[env, body],
            state.body_linear_velocity[env, body],
            state.body_angular_velocity[env, body],
            guard.limits[env, 0],
        )
        if wp.isnan(loads):
            cause = NON_FINITE
        if cause != NO_CAUSE:
            status[env] = ENV_FAILED
            guard.cause[env] = cause

    @wp.func
    def pose_after_step(
        state: State,
        env: int,
        body: int,
        motion: BodyMotion,
        linear: wp.vec3d,
        angular: wp.vec3d,
        dt: wp.float64,
    ):
        """Returns the pose on the joint after a step with these mean velocities, as base, offset and orientation.

        The center of mass is at base + offset; for a hinge or ball the base is the anchor. A pose that violates
        the joint is projected onto it. Coordinates that do not move remain bitwise identical.
        """
        kind = motion.kind
        axis = motion.axis
        base = to_float64(state.body_position[env, body])
        offset = to_float64(state.body_position_remainder[env, body])
        orientation = state.body_orientation[env, body]
        q = quat_to_float64(orientation)
        if kind == PRESCRIBED:
            offset += dt * linear
            if wp.dot(angular, angular) > ZERO:
                orientation = quat_from_float64(rotated(q, dt * angular))
        elif kind == TRANSLATION:
            offset += dt * linear
        elif kind == SLIDER:
            deviation = (base - motion.position) + offset
            offset += dt * linear - (deviation - wp.dot(axis, deviation) * axis)
        elif kind == PLANAR:
            deviation = (base - motion.position) + offset
            offset += dt * linear - wp.dot(axis, deviation) * axis
            sine, cosine = half_angle(axis, q, motion.orientation)
            sine, cosine = add_half_angle(sine, cosine, dt * wp.dot(axis, angular))
            orientation = quat_from_float64(quat_about(axis, sine, cosine) * motion.orientation)
        elif kind == HINGE:
            sine, cosine = half_angle(axis, q, motion.orientation)
            sine, cosine = add_half_angle(sine, cosine, dt * wp.dot(axis, angular))
            rotation = quat_about(axis, sine, cosine)
            orientation = quat_from_float64(rotation * motion.orientation)
            base = motion.anchor
            offset = wp.quat_rotate(rotation, motion.position - motion.anchor)
        elif kind == BALL:
            orientation = quat_from_float64(rotated(q, dt * angular))
            base = motion.anchor
            start_B = wp.quat_rotate_inv(motion.orientation, motion.position - motion.anchor)
            offset = wp.quat_rotate(quat_to_float64(orientation), start_B)
        return base, offset, orientation

    @wp.func
    def mobility(model: Model, state: State, env: int, body: int, motion: BodyMotion, arm_W: vec3, n_W: vec3):
        """Returns the inverse effective mass of a body with a joint for a force along ``n_W`` [1/kg].

        ``arm_W``: From the center of mass to the point of the force.
        """
        n = to_float64(n_W)
        arm = to_float64(arm_W)
        axis = motion.axis
        mass = wp.float64(model.body_mass[env, body])
        q = quat_to_float64(state.body_orientation[env, body])
        result = MIN_INVERSE_MASS
        if motion.kind == TRANSLATION:
            result = ONE / mass
        elif motion.kind == SLIDER:
            along = wp.dot(axis, n)
            result = along * along / mass
        elif motion.kind == PLANAR:
            across = n - wp.dot(axis, n) * axis
            lever = wp.dot(axis, wp.cross(arm, n))
            inertia = inertia_about(axis, q, matrix_to_float64(model.body_inertia[env, body]))
            result = wp.dot(across, across) / mass + lever * lever / inertia
        elif motion.kind == HINGE:
            lever = wp.dot(axis, wp.cross(anchor_arm(motion, q) + arm, n))
            inertia, _ = hinge_inertia(motion, q, matrix_to_float64(model.body_inertia[env, body]), mass)
            result = lever * lever / inertia
        elif motion.kind == BALL:
            center_arm = anchor_arm(motion, q)
            center_arm_B = wp.quat_rotate_inv(q, center_arm)
            inertia_B = inertia_at(matrix_to_float64(model.body_inertia[env, body]), mass, center_arm_B)
            lever_B = wp.quat_rotate_inv(q, wp.cross(center_arm + arm, n))
            result = wp.dot(lever_B, wp.inverse(inertia_B) * lever_B)
        return real(wp.max(result, MIN_INVERSE_MASS))

    return Functions(
        to_float64=to_float64,
        from_float64=from_float64,
        matrix_to_float64=matrix_to_float64,
        quat_to_float64=quat_to_float64,
        quat_from_float64=quat_from_float64,
        set_position=set_position,
        set_velocity=set_velocity,
        check_body=check_body,
        Guard=Guard,
        pose_after_step=pose_after_step,
        mobility=mobility,
        rotated=rotated,
    )
