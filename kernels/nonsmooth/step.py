"""Kernels of the Moreau–Jean scheme: half step, velocities without contact, full step.

Contacts and forces are evaluated at the middle of the step. Impulses are applied there, too, so a free body
conserves its angular momentum to rounding.
"""

import functools

import warp as wp
from warpcontact.kernels import rotations
from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.joints import bodies
from warpcontact.kernels.joints.bodies import (
    advance_velocity,
    anchor_arm,
    hinge_inertia,
    inertia_about,
    inertia_at,
    momentum_of,
    spin_of,
)
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth.rows import body_response_struct, row_structs, velocity_change_struct
from warpcontact.kernels.types import (
    BALL,
    ENV_ACTIVE,
    ENV_FAILED,
    FREE,
    HINGE,
    NO_CAUSE,
    PLANAR,
    SLIDER,
    TIME_FUNCTION,
    TRANSLATION,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)


@functools.cache
def half_step(real: type, has_joints: bool) -> wp.Kernel:
    """Returns the kernel that advances bodies by half a step with the velocities before it; items: bodies.

    The angular velocity at the half step has the same angular momentum. With ``has_joints`` some bodies have joints.
    Bodies with prescribed motion (TIME_FUNCTION) are skipped; the kernels of ``joints/driven.py`` set their
    pose. The thread of the first body also clears the rows of its environment and resets the restitution factor to
    1.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    SolveResult, RestitutionLimit = row_structs(real).SolveResult, record_structs(real).RestitutionLimit
    rotation_functions = rotations.functions(real)
    rotated, spin = rotation_functions.rotated, rotation_functions.spin
    f = bodies.functions(real)
    to_float64, matrix_to_float64, quat_to_float64 = f.to_float64, f.matrix_to_float64, f.quat_to_float64
    pose_after_step, set_position, set_velocity = f.pose_after_step, f.set_position, f.set_velocity

    @unique_kernel()
    def advance_half_step(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        state_in: State,
        state_out: State,
        solve_result: SolveResult,
        restitution_limit: RestitutionLimit,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            if body == 0:
                solve_result.count[env] = 0
                h = step[env, 0]
                solve_result.step[env] = h
                solve_result.slack[env] = h * h * wp.length(model.gravity[env, 0])
                restitution_limit.factor[env] = real(1.0)
            v_W = state_in.body_linear_velocity[env, body]
            w_W = state_in.body_angular_velocity[env, body]
            half = real(0.5) * step[env, 0]
            if wp.static(has_joints):
                motion = model.body_motion[env, body]
                if motion.kind != FREE:
                    if motion.kind == TIME_FUNCTION:
                        continue
                    v = to_float64(v_W)
                    w = to_float64(w_W)
                    base, displacement, orientation = pose_after_step(
                        state_in, env, body, motion, v, w, wp.float64(half)
                    )
                    if motion.kind == BALL:
                        q = quat_to_float64(state_in.body_orientation[env, body])
                        arm_B = wp.quat_rotate_inv(q, anchor_arm(motion, q))
                        mass = wp.float64(model.body_mass[env, body])
                        anchor_inertia_B = inertia_at(
                            matrix_to_float64(model.body_inertia[env, body]), mass, arm_B
                        )
                        w = spin_of(
                            wp.inverse(anchor_inertia_B),
                            quat_to_float64(orientation),
                            momentum_of(anchor_inertia_B, q, w),
                        )
                    if motion.kind == HINGE or motion.kind == BALL:
                        v = wp.cross(w, displacement)
                    set_position(state_out, env, body, base, displacement)
                    state_out.body_orientation[env, body] = orientation
                    set_velocity(state_out, env, body, v, w)
                    continue
            before = state_in.body_position[env, body]
            displacement_W = half * v_W + state_in.body_position_remainder[env, body]
            position = before + displacement_W
            applied = position - before
            state_out.body_position[env, body] = position
            state_out.body_position_remainder[env, body] = (before - (position - applied)) + (
                displacement_W - applied
            )
            q_WB = state_in.body_orientation[env, body]
            orientation_W = rotated(q_WB, half * w_W)
            if not model.body_isotropic_inertia[env, body]:
                momentum_W = wp.quat_rotate(q_WB, model.body_inertia[env, body] * wp.quat_rotate_inv(q_WB, w_W))
                w_W = spin(model.body_inverse_inertia[env, body], orientation_W, momentum_W)
            state_out.body_orientation[env, body] = orientation_W
            state_out.body_linear_velocity[env, body] = v_W
            state_out.body_angular_velocity[env, body] = w_W

    return advance_half_step


@functools.cache
def free_velocities(real: type, has_joints: bool) -> wp.Kernel:
    """Returns the kernel of the velocities without contact and of the response to impulses; items: bodies.

    With ``has_joints`` some bodies have joints; ``state_out`` holds the velocities of those with prescribed motion.
    """
    t = structs(real)
    vec3, mat33, Model, State, Wrenches = t.vec3, t.mat33, t.Model, t.State, t.Wrenches
    BodyResponse = wp.array2d(dtype=body_response_struct(real, has_joints))
    f = bodies.functions(real)
    to_float64, from_float64, matrix_to_float64, quat_to_float64 = (
        f.to_float64,
        f.from_float64,
        f.matrix_to_float64,
        f.quat_to_float64,
    )

    @wp.func
    def narrow_matrix(m: wp.mat33d):
        return mat33(
            real(m[0, 0]), real(m[0, 1]), real(m[0, 2]),
            real(m[1, 0]), real(m[1, 1]), real(m[1, 2]),
            real(m[2, 0]), real(m[2, 1]), real(m[2, 2]),
        )  # fmt: skip

    @wp.func
    def free_constrained(
        model: Model,
        state_in: State,
        half_step_state: State,
        state_out: State,
        wrenches: Wrenches,
        env: int,
        body: int,
        dt: wp.float64,
        body_response: BodyResponse,
    ):
        motion = model.body_motion[env, body]
        kind = motion.kind
        axis = motion.axis
        mass = wp.float64(model.body_mass[env, body])
        force = to_float64(wrenches.force[env, body]) + mass * to_float64(model.gravity[env, 0])
        torque = to_float64(wrenches.torque[env, body])
        inertia_B = matrix_to_float64(model.body_inertia[env, body])
        q = quat_to_float64(half_step_state.body_orientation[env, body])
        v = to_float64(state_in.body_linear_velocity[env, body])
        w = to_float64(state_in.body_angular_velocity[env, body])
        linear, angular = advance_velocity(motion, mass, inertia_B, q, v, w, force, torque, dt)
        inverse_mass_matrix = wp.mat33d()
        inverse_mass_coupling = wp.mat33d()
        inverse_inertia = wp.mat33d()
        if kind == TIME_FUNCTION:
            linear = to_float64(state_out.body_linear_velocity[env, body])
            angular = to_float64(state_out.body_angular_velocity[env, body])
        elif kind == TRANSLATION:
            inverse_mass_matrix = wp.identity(n=3, dtype=wp.float64) / mass
        elif kind == SLIDER:
            inverse_mass_matrix = wp.outer(axis, axis) / mass
        elif kind == PLANAR:
            along = wp.outer(axis, axis)
            inverse_mass_matrix = (wp.identity(n=3, dtype=wp.float64) - along) / mass
            inverse_inertia = along / inertia_about(axis, q, inertia_B)
        elif kind == HINGE:
            inertia, lever = hinge_inertia(motion, q, inertia_B, mass)
            inverse_mass_matrix = wp.outer(lever, lever) / inertia
            inverse_mass_coupling = wp.outer(lever, axis) / inertia
            inverse_inertia = wp.outer(axis, axis) / inertia
        elif kind == BALL:
            arm = anchor_arm(motion, q)
            anchor_inertia_B = inertia_at(inertia_B, mass, wp.quat_rotate_inv(q, arm))
            inverse_B = wp.inverse(anchor_inertia_B)
            q_in = quat_to_float64(state_in.body_orientation[env, body])
            momentum = momentum_of(anchor_inertia_B, q_in, w) + dt * (torque + wp.cross(arm, force))
            angular = spin_of(inverse_B, q, momentum)
            linear = wp.cross(angular, arm)
            R = wp.quat_to_matrix(q)
            inverse_inertia = R * inverse_B * wp.transpose(R)
            across = wp.skew(arm)
            inverse_mass_coupling = -(across * inverse_inertia)
            inverse_mass_matrix = inverse_mass_coupling * across
        body_response[env, body].linear = from_float64(linear)
        body_response[env, body].angular = from_float64(angular)
        body_response[env, body].inverse_mass_matrix = narrow_matrix(inverse_mass_matrix)
        body_response[env, body].inverse_mass_coupling = narrow_matrix(inverse_mass_coupling)
        body_response[env, body].inverse_inertia = narrow_matrix(inverse_inertia)

    @unique_kernel()
    def velocities_without_contact(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        state_in: State,
        half_step_state: State,
        wrenches: Wrenches,
        state_out: State,
        body_response: BodyResponse,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            dt = step[env, 0]
            if wp.static(has_joints):
                if model.body_motion[env, body].kind != FREE:
                    free_constrained(
                        model,
                        state_in,
                        half_step_state,
                        state_out,
                        wrenches,
                        env,
                        body,
                        wp.float64(dt),
                        body_response,
                    )
                    continue
            inverse_mass = real(1.0) / model.body_mass[env, body]
            acceleration = inverse_mass * wrenches.force[env, body] + model.gravity[env, 0]
            body_response[env, body].linear = state_in.body_linear_velocity[env, body] + dt * acceleration
            inverse_B = model.body_inverse_inertia[env, body]
            w_W = state_in.body_angular_velocity[env, body]
            R = wp.identity(n=3, dtype=real)
            inverse_inertia = inverse_B
            if model.body_isotropic_inertia[env, body]:
                body_response[env, body].angular = w_W + (dt * inverse_B[0, 0]) * wrenches.torque[env, body]
            else:
                R = wp.quat_to_matrix(half_step_state.body_orientation[env, body])
                inverse_inertia = R * inverse_B * wp.transpose(R)
                # The half-step state has the angular momentum of the start.
                w_middle = half_step_state.body_angular_velocity[env, body]
                body_response[env, body].angular = w_middle + inverse_inertia * (dt * wrenches.torque[env, body])
            body_response[env, body].inverse_inertia = inverse_inertia
            if wp.static(has_joints):
                body_response[env, body].inverse_mass_matrix = inverse_mass * wp.identity(n=3, dtype=real)
                body_response[env, body].inverse_mass_coupling = mat33()
            else:
                body_response[env, body].inverse_mass = inverse_mass
                is_at_rest = state_in.body_linear_velocity[env, body] == vec3() and w_W == vec3()
                body_response[env, body].at_rest = wp.where(is_at_rest, 1, 0)

    return velocities_without_contact


@functools.cache
def full_step(real: type, has_joints: bool) -> wp.Kernel:
    """Returns the kernel that advances each body over the step with the velocities after contact; items: bodies.

    Positions advance with θ times the velocities after contact plus 1 − θ times those before, and those that restore lost gaps. With
    ``has_joints`` some bodies have joints; those with prescribed motion are only checked.
    """
    t = structs(real)
    quat, Model, State, Wrenches = t.quat, t.Model, t.State, t.Wrenches
    BodyResponse = wp.array2d(dtype=body_response_struct(real, has_joints))
    VelocityChange = wp.array2d(dtype=velocity_change_struct(real))
    rotation_functions = rotations.functions(real)
    rotated, spin = rotation_functions.rotated, rotation_functions.spin
    f = bodies.functions(real)
    to_float64, matrix_to_float64, quat_to_float64, pose_after_step = (
        f.to_float64,
        f.matrix_to_float64,
        f.quat_to_float64,
        f.pose_after_step,
    )
    set_position, set_velocity, check_body = f.set_position, f.set_velocity, f.check_body
    of_guard = accept_step.guard(real)
    Guard, failure_cause = of_guard.Guard, of_guard.failure_cause

    @wp.func
    def advance_constrained(
        model: Model,
        state_in: State,
        half_step_state: State,
        body_response: BodyResponse,
        correction: VelocityChange,
        state_out: State,
        env: int,
        body: int,
        dt: wp.float64,
        theta: wp.float64,
    ):
        motion = model.body_motion[env, body]
        complement = wp.float64(1.0) - theta
        v = to_float64(body_response[env, body].linear)
        w = to_float64(body_response[env, body].angular)
        w_before = to_float64(half_step_state.body_angular_velocity[env, body])
        linear = theta * v + complement * to_float64(state_in.body_linear_velocity[env, body])
        linear += to_float64(correction[env, body].linear)
        anchor_inertia_B = wp.mat33d()
        momentum = wp.vec3d()
        if motion.kind == BALL:
            q = quat_to_float64(state_in.body_orientation[env, body])
            q_middle = quat_to_float64(half_step_state.body_orientation[env, body])
            arm_B = wp.quat_rotate_inv(q, anchor_arm(motion, q))
            inertia_B = matrix_to_float64(model.body_inertia[env, body])
            anchor_inertia_B = inertia_at(inertia_B, wp.float64(model.body_mass[env, body]), arm_B)
            momentum = momentum_of(anchor_inertia_B, q_middle, w)
        angular = theta * w + complement * w_before + to_float64(correction[env, body].angular)
        base, displacement, orientation = pose_after_step(state_in, env, body, motion, linear, angular, dt)
        if motion.kind == BALL:
            w = spin_of(wp.inverse(anchor_inertia_B), quat_to_float64(orientation), momentum)
        if motion.kind == HINGE or motion.kind == BALL:
            v = wp.cross(w, displacement)
        set_position(state_out, env, body, base, displacement)
        state_out.body_orientation[env, body] = orientation
        set_velocity(state_out, env, body, v, w)

    @unique_kernel()
    def advance_full_step(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        theta: real,
        model: Model,
        guard: Guard,
        state_in: State,
        half_step_state: State,
        body_response: BodyResponse,
        correction: VelocityChange,  # velocities that act on positions only
        wrenches: Wrenches,
        state_out: State,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            dt = step[env, 0]
            if wp.static(has_joints):
                kind = model.body_motion[env, body].kind
                if kind != FREE:
                    if kind != TIME_FUNCTION:
                        advance_constrained(
                            model, state_in, half_step_state, body_response, correction, state_out, env, body,
                            wp.float64(dt), wp.float64(theta),
                        )  # fmt: skip
                    check_body(guard, wrenches, state_out, env, body, status)
                    continue
            complement = real(1.0) - theta
            velocity = body_response[env, body].linear
            before = state_in.body_position[env, body]
            displacement = dt * (theta * velocity + complement * state_in.body_linear_velocity[env, body])
            displacement += dt * correction[env, body].linear
            displacement += state_in.body_position_remainder[env, body]
            position = before + displacement
            applied = position - before
            q_WB = state_in.body_orientation[env, body]
            w_W = state_in.body_angular_velocity[env, body]
            angular_velocity = body_response[env, body].angular
            orientation = q_WB
            if model.body_isotropic_inertia[env, body]:
                rotation = dt * (theta * angular_velocity + complement * w_W + correction[env, body].angular)
                if wp.length_sq(rotation) > real(0.0):
                    orientation = rotated(q_WB, rotation)
            else:
                inverse_B = model.body_inverse_inertia[env, body]
                inertia_B = model.body_inertia[env, body]
                q_middle = half_step_state.body_orientation[env, body]
                w_before = half_step_state.body_angular_velocity[env, body]
                momentum_change_B = inertia_B * wp.quat_rotate_inv(q_middle, angular_velocity - w_before)
                momentum = wp.quat_rotate(q_WB, inertia_B * wp.quat_rotate_inv(q_WB, w_W))
                rotation = dt * (theta * angular_velocity + complement * w_before + correction[env, body].angular)
                if wp.length_sq(rotation) > real(0.0):
                    orientation = rotated(q_WB, rotation)
                # Use the change of angular velocity: rounding of the quaternion norm scales rotated vectors, which
                # cancels in a difference and would otherwise accumulate.
                spin_before = spin(inverse_B, q_WB, momentum)
                momentum += wp.quat_rotate(q_middle, momentum_change_B)
                spin_after = spin(inverse_B, orientation, momentum)
                if wp.length_sq(angular_velocity) > real(0.0):
                    angular_velocity = w_W + (spin_after - spin_before)
            state_out.body_position[env, body] = position
            state_out.body_position_remainder[env, body] = (before - (position - applied)) + (
                displacement - applied
            )
            state_out.body_orientation[env, body] = orientation
            if state_out.body_orientation_remainder.shape[1] > 0:
                # That of a step with another integrator.
                state_out.body_orientation_remainder[env, body] = quat()
            state_out.body_linear_velocity[env, body] = velocity
            state_out.body_angular_velocity[env, body] = angular_velocity
            # The sum is finite only if every term is, because all terms are nonnegative.
            sizes = wp.length_sq(position) + wp.length_sq(velocity) + wp.length_sq(angular_velocity)
            if not sizes < guard.suspect[env, 0]:
                cause = failure_cause(position, velocity, angular_velocity, guard.limits[env, 0])
                if cause != NO_CAUSE:
                    status[env] = ENV_FAILED
                    guard.cause[env] = cause

    return advance_full_step
