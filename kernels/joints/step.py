"""Steps of bodies with joints: equations of motion in their degrees of freedom.

The kernels of ``integrators/semi_implicit.py`` skip these bodies. Velocities advance first, then the pose, which
is recomputed from the joint coordinates, so it does not drift. ``driven.py`` moves bodies with functions of time.
Initial velocities are projected onto the degrees of freedom.
"""

import functools

import warp as wp
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
from warpcontact.kernels.types import (
    BALL,
    ENV_ACTIVE,
    FIXED,
    FREE,
    HINGE,
    PLANAR,
    PRESCRIBED,
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
def semi_implicit_euler(real: type) -> wp.Kernel:
    """Returns the semi-implicit Euler kernel of bodies with joints; items: ``members``.

    A body on a ball joint advances its angular momentum about the anchor, as a free body does about its center of
    mass. A pose set by the user that violates the joint is projected onto it.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    f = bodies.functions(real)
    to_float64, matrix_to_float64, quat_to_float64, pose_after_step = (
        f.to_float64,
        f.matrix_to_float64,
        f.quat_to_float64,
        f.pose_after_step,
    )
    set_position, set_velocity, rotated = f.set_position, f.set_velocity, f.rotated
    check_body, Guard = f.check_body, f.Guard

    @unique_kernel()
    def step_constrained(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        guard: Guard,
        members: wp.array(dtype=wp.int32),  # [item] body
        state_in: State,
        wrenches: Wrenches,
        state_out: State,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = members[task_item(launch, task)]
            if status[env] != ENV_ACTIVE:
                continue
            motion = model.body_motion[env, body]
            kind = motion.kind
            dt = wp.float64(step[env, 0])
            mass = wp.float64(model.body_mass[env, body])
            force = to_float64(wrenches.force[env, body]) + mass * to_float64(model.gravity[env, 0])
            torque = to_float64(wrenches.torque[env, body])
            inertia_B = matrix_to_float64(model.body_inertia[env, body])
            q = quat_to_float64(state_in.body_orientation[env, body])
            v = to_float64(state_in.body_linear_velocity[env, body])
            w = to_float64(state_in.body_angular_velocity[env, body])

            linear, angular = advance_velocity(motion, mass, inertia_B, q, v, w, force, torque, dt)
            anchor_inertia_B = wp.mat33d()
            momentum = wp.vec3d()
            if kind == BALL:
                arm = anchor_arm(motion, q)
                anchor_inertia_B = inertia_at(inertia_B, mass, wp.quat_rotate_inv(q, arm))
                momentum = momentum_of(anchor_inertia_B, q, w) + dt * (torque + wp.cross(arm, force))
                inverse_B = wp.inverse(anchor_inertia_B)
                q_middle = rotated(q, wp.float64(0.5) * dt * spin_of(inverse_B, q, momentum))
                angular = spin_of(inverse_B, q_middle, momentum)

            base, offset, orientation = pose_after_step(state_in, env, body, motion, linear, angular, dt)
            if kind == BALL:
                angular = spin_of(wp.inverse(anchor_inertia_B), quat_to_float64(orientation), momentum)
            if kind == HINGE or kind == BALL:  # noqa: SIM109
                linear = wp.cross(angular, offset)
            set_position(state_out, env, body, base, offset)
            state_out.body_orientation[env, body] = orientation
            set_velocity(state_out, env, body, linear, angular)
            check_body(guard, wrenches, state_out, env, body, status)

    return step_constrained


@functools.cache
def change_step(real: type) -> wp.Kernel:
    """Returns the kernel that adapts velocities of constrained bodies to a change of the time step.

    Like ``semi_implicit.change_step``, in the degrees of freedom of the joints; items: ``members``.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    f = bodies.functions(real)
    to_float64, set_velocity = f.to_float64, f.set_velocity
    accelerations_of = accelerations(real)

    @unique_kernel()
    def change_constrained(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        change: wp.array2d(dtype=real),  # [env, 0] next time step minus last [s]
        model: Model,
        members: wp.array(dtype=wp.int32),  # [item] body
        wrenches: Wrenches,  # at this instant
        state: State,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = members[task_item(launch, task)]
            if status[env] != ENV_ACTIVE:
                continue
            earlier = wp.float64(0.5) * wp.float64(change[env, 0])
            force = wrenches.force[env, body]
            torque = wrenches.torque[env, body]
            linear, angular, arm = accelerations_of(model, state, env, body, force, torque)
            w = to_float64(state.body_angular_velocity[env, body]) - earlier * angular
            v = to_float64(state.body_linear_velocity[env, body]) - earlier * linear
            kind = model.body_motion[env, body].kind
            if kind == HINGE or kind == BALL:  # noqa: SIM109
                v = wp.cross(w, arm)
            set_velocity(state, env, body, v, w)

    return change_constrained


@functools.cache
def accelerations(real: type) -> wp.Function:
    """Returns the device function of the accelerations of bodies with joints."""
    t = structs(real)
    vec3, Model, State = t.vec3, t.Model, t.State
    f = bodies.functions(real)
    to_float64, matrix_to_float64, quat_to_float64 = f.to_float64, f.matrix_to_float64, f.quat_to_float64

    @wp.func
    def accelerations_of(model: Model, state: State, env: int, body: int, force_W: vec3, torque_W: vec3):
        """Returns the accelerations under gravity and a wrench about the center of mass, and the arm; W.

        The linear acceleration is that of the center of mass. The arm points to it from the anchor of a hinge or
        ball.
        """
        motion = model.body_motion[env, body]
        kind = motion.kind
        axis = motion.axis
        mass = wp.float64(model.body_mass[env, body])
        force = to_float64(force_W) + mass * to_float64(model.gravity[env, 0])
        torque = to_float64(torque_W)
        inertia_B = matrix_to_float64(model.body_inertia[env, body])
        q = quat_to_float64(state.body_orientation[env, body])
        w = to_float64(state.body_angular_velocity[env, body])
        linear = wp.vec3d()
        angular = wp.vec3d()
        arm = wp.vec3d()
        if kind == TRANSLATION:
            linear = force / mass
        elif kind == SLIDER:
            linear = (wp.dot(axis, force) / mass) * axis
        elif kind == PLANAR:
            linear = (force - wp.dot(axis, force) * axis) / mass
            angular = (wp.dot(axis, torque) / inertia_about(axis, q, inertia_B)) * axis
        elif kind == HINGE:
            arm = anchor_arm(motion, q)
            inertia, _ = hinge_inertia(motion, q, inertia_B, mass)
            angular = (wp.dot(axis, torque + wp.cross(arm, force)) / inertia) * axis
            linear = wp.cross(angular, arm) + wp.cross(w, wp.cross(w, arm))
        elif kind == BALL:
            arm = anchor_arm(motion, q)
            anchor_inertia_B = inertia_at(inertia_B, mass, wp.quat_rotate_inv(q, arm))
            moment = torque + wp.cross(arm, force) - wp.cross(w, momentum_of(anchor_inertia_B, q, w))
            angular = spin_of(wp.inverse(anchor_inertia_B), q, moment)
            linear = wp.cross(angular, arm) + wp.cross(w, wp.cross(w, arm))
        return linear, angular, arm

    return accelerations_of


@functools.cache
def project_velocities(real: type) -> wp.Kernel:
    """Returns the kernel that projects velocities onto the joints. Launch with dim (env, body).

    On a hinge or ball the angular velocity is kept, and the linear velocity follows from it.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    f = bodies.functions(real)
    to_float64, quat_to_float64, set_velocity = f.to_float64, f.quat_to_float64, f.set_velocity

    @unique_kernel()
    def project_onto_joints(mask: wp.array(dtype=wp.bool), model: Model, state: State):
        env, body = wp.tid()
        motion = model.body_motion[env, body]
        kind = motion.kind
        if not mask[env] or kind == FREE or kind == PRESCRIBED or kind == TIME_FUNCTION:  # noqa: SIM109
            return
        axis = motion.axis
        v = to_float64(state.body_linear_velocity[env, body])
        w = to_float64(state.body_angular_velocity[env, body])
        along = wp.dot(axis, w) * axis
        if kind == PLANAR:
            v -= wp.dot(axis, v) * axis
            w = along
        elif kind == HINGE or kind == BALL:  # noqa: SIM109
            if kind == HINGE:
                w = along
            v = wp.cross(w, anchor_arm(motion, quat_to_float64(state.body_orientation[env, body])))
        else:
            w = wp.vec3d()
            if kind == SLIDER:
                v = wp.dot(axis, v) * axis
            elif kind == FIXED:
                v = wp.vec3d()
        set_velocity(state, env, body, v, w)

    return project_onto_joints
