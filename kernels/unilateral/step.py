"""The Moreau–Jean scheme around its contact problem: the pose at half a step, velocities before, the pose after.

Contacts and forces are those of the middle of the step. What an impulse does to a body is told there, too, and so
a free body keeps its angular momentum to rounding.
"""

import functools

import warp as wp
from warpcontact.kernels import quarantine, rotations
from warpcontact.kernels.motions import bodies
from warpcontact.kernels.motions.bodies import (
    arm_of,
    inertia_about,
    inertia_at,
    momentum_of,
    spin_of,
)
from warpcontact.kernels.types import (
    BALL,
    DRIVEN,
    ENV_ACTIVE,
    ENV_FAILED,
    FREE,
    HINGE,
    NO_CAUSE,
    PLANAR,
    PRESCRIBED,
    SLIDER,
    TRANSLATION,
    Work,
    env_of,
    item_of,
    structs,
    task_count,
)
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def middle(real: type, moves: bool) -> wp.Kernel:
    """Returns the kernel that goes half a step with the velocities before it; items: bodies.

    The angular velocity there is that of the same angular momentum. With ``moves`` some bodies are not free; those
    that follow a function of time are left to ``driven``, which changes their pose alone. The first body of an
    environment empties its rows, and gives back the whole restitution.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    Outcome, Restraint = row_structs(real).Outcome, record_structs(real).Restraint
    rotated = rotations.functions(real).rotated
    f = bodies.functions(real)
    wide, wide_matrix, wide_quat = f.wide, f.wide_matrix, f.wide_quat
    moved, put, set_velocity = f.moved, f.put, f.set_velocity

    @unique_kernel()
    def go_half_way(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        state_in: State,
        state_out: State,
        outcome: Outcome,
        restraint: Restraint,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            if body == 0:
                outcome.count[env] = 0
                h = step[env, 0]
                outcome.slack[env] = h * h * wp.length(model.gravity[env, 0])
                restraint.part[env] = real(1.0)
            v_W = state_in.body_linear_velocity[env, body]
            w_W = state_in.body_angular_velocity[env, body]
            half = real(0.5) * step[env, 0]
            if wp.static(moves):
                motion = model.body_motion[env, body]
                if motion.kind != FREE:
                    if motion.kind == DRIVEN:
                        continue
                    v = wide(v_W)
                    w = wide(w_W)
                    base, way, orientation = moved(state_in, env, body, motion, v, w, wp.float64(half))
                    if motion.kind == BALL:
                        q = wide_quat(state_in.body_orientation[env, body])
                        arm_B = wp.quat_rotate_inv(q, arm_of(motion, q))
                        mass = wp.float64(model.body_mass[env, body])
                        whole_B = inertia_at(wide_matrix(model.body_inertia[env, body]), mass, arm_B)
                        w = spin_of(wp.inverse(whole_B), wide_quat(orientation), momentum_of(whole_B, q, w))
                    if motion.kind == HINGE or motion.kind == BALL:
                        v = wp.cross(w, way)
                    put(state_out, env, body, base, way)
                    state_out.body_orientation[env, body] = orientation
                    set_velocity(state_out, env, body, v, w)
                    continue
            before = state_in.body_position[env, body]
            way_W = half * v_W + state_in.body_position_remainder[env, body]
            position = before + way_W
            gone = position - before
            state_out.body_position[env, body] = position
            state_out.body_position_remainder[env, body] = (before - (position - gone)) + (way_W - gone)
            q_WB = state_in.body_orientation[env, body]
            orientation_W = rotated(q_WB, half * w_W)
            if not model.body_round[env, body]:
                last_B = model.body_inertia[env, body] * wp.quat_rotate_inv(q_WB, w_W)
                turned_B = wp.quat_rotate_inv(orientation_W, wp.quat_rotate(q_WB, last_B))
                w_W = wp.quat_rotate(orientation_W, model.body_inverse_inertia[env, body] * turned_B)
            state_out.body_orientation[env, body] = orientation_W
            state_out.body_linear_velocity[env, body] = v_W
            state_out.body_angular_velocity[env, body] = w_W

    return go_half_way


@functools.cache
def free(real: type, moves: bool) -> wp.Kernel:
    """Returns the kernel of the velocities without contact, and of what impulses do to each body; items: bodies.

    With ``moves`` some bodies are not free; ``state_out`` holds the velocities of those that follow a function of
    time.
    """
    t = structs(real)
    vec3, mat33, Model, State, Wrenches = t.vec3, t.mat33, t.Model, t.State, t.Wrenches
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    f = bodies.functions(real)
    wide, narrow, wide_matrix, wide_quat = f.wide, f.narrow, f.wide_matrix, f.wide_quat

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
        middle: State,
        state_out: State,
        wrenches: Wrenches,
        env: int,
        body: int,
        dt: wp.float64,
        moving: Moving,
    ):
        motion = model.body_motion[env, body]
        kind = motion.kind
        axis = motion.axis
        mass = wp.float64(model.body_mass[env, body])
        force = wide(wrenches.force[env, body]) + mass * wide(model.gravity[env, 0])
        torque = wide(wrenches.torque[env, body])
        inertia_B = wide_matrix(model.body_inertia[env, body])
        q = wide_quat(middle.body_orientation[env, body])
        v = wide(state_in.body_linear_velocity[env, body])
        w = wide(state_in.body_angular_velocity[env, body])
        linear = wp.vec3d()
        angular = wp.vec3d()
        by_force = wp.mat33d()
        across = wp.mat33d()
        by_torque = wp.mat33d()
        if kind == PRESCRIBED:
            linear = v
            angular = w
        elif kind == DRIVEN:
            linear = wide(state_out.body_linear_velocity[env, body])
            angular = wide(state_out.body_angular_velocity[env, body])
        elif kind == TRANSLATION:
            linear = v + (dt / mass) * force
            by_force = wp.identity(n=3, dtype=wp.float64) / mass
        elif kind == SLIDER:
            linear = wp.dot(axis, v + (dt / mass) * force) * axis
            by_force = wp.outer(axis, axis) / mass
        elif kind == PLANAR:
            linear = v + (dt / mass) * force
            linear -= wp.dot(axis, linear) * axis
            inertia = inertia_about(axis, q, inertia_B)
            angular = (wp.dot(axis, w) + dt * wp.dot(axis, torque) / inertia) * axis
            along = wp.outer(axis, axis)
            by_force = (wp.identity(n=3, dtype=wp.float64) - along) / mass
            by_torque = along / inertia
        elif kind == HINGE:
            arm = arm_of(motion, q)
            sweep = wp.cross(axis, arm)
            inertia = inertia_about(axis, q, inertia_B) + mass * wp.dot(sweep, sweep)
            rate = wp.dot(axis, w) + dt * wp.dot(axis, torque + wp.cross(arm, force)) / inertia
            angular = rate * axis
            linear = rate * sweep
            by_force = wp.outer(sweep, sweep) / inertia
            across = wp.outer(sweep, axis) / inertia
            by_torque = wp.outer(axis, axis) / inertia
        elif kind == BALL:
            arm = arm_of(motion, q)
            whole_B = inertia_at(inertia_B, mass, wp.quat_rotate_inv(q, arm))
            inverse_B = wp.inverse(whole_B)
            q_in = wide_quat(state_in.body_orientation[env, body])
            momentum = momentum_of(whole_B, q_in, w) + dt * (torque + wp.cross(arm, force))
            angular = spin_of(inverse_B, q, momentum)
            linear = wp.cross(angular, arm)
            R = wp.quat_to_matrix(q)
            by_torque = R * inverse_B * wp.transpose(R)
            lever = wp.skew(arm)
            across = -(lever * by_torque)
            by_force = across * lever
        moving[env, body].linear = narrow(linear)
        moving[env, body].angular = narrow(angular)
        moving[env, body].by_force = narrow_matrix(by_force)
        moving[env, body].across = narrow_matrix(across)
        moving[env, body].by_torque = narrow_matrix(by_torque)

    @unique_kernel()
    def velocities_without_contact(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        state_in: State,
        middle: State,
        wrenches: Wrenches,
        state_out: State,
        moving: Moving,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            dt = step[env, 0]
            if wp.static(moves):  # noqa: SIM102  Warp would evaluate both sides
                if model.body_motion[env, body].kind != FREE:
                    free_constrained(
                        model, state_in, middle, state_out, wrenches, env, body, wp.float64(dt), moving
                    )
                    continue
            inverse_mass = real(1.0) / model.body_mass[env, body]
            acceleration = inverse_mass * wrenches.force[env, body] + model.gravity[env, 0]
            moving[env, body].linear = state_in.body_linear_velocity[env, body] + dt * acceleration
            inverse_B = model.body_inverse_inertia[env, body]
            w_W = state_in.body_angular_velocity[env, body]
            R = wp.identity(n=3, dtype=real)
            by_torque = inverse_B
            if model.body_round[env, body]:
                moving[env, body].angular = w_W + (dt * inverse_B[0, 0]) * wrenches.torque[env, body]
            else:
                R = wp.quat_to_matrix(middle.body_orientation[env, body])
                by_torque = R * inverse_B * wp.transpose(R)
                # There the body has the angular momentum of the start.
                w_middle = middle.body_angular_velocity[env, body]
                moving[env, body].angular = w_middle + by_torque * (dt * wrenches.torque[env, body])
            moving[env, body].by_torque = by_torque
            if wp.static(moves):
                moving[env, body].by_force = inverse_mass * wp.identity(n=3, dtype=real)
                moving[env, body].across = mat33()
            else:
                moving[env, body].inverse_mass = inverse_mass
                still = state_in.body_linear_velocity[env, body] == vec3() and w_W == vec3()
                moving[env, body].still = wp.where(still, 1, 0)

    return velocities_without_contact


@functools.cache
def advance(real: type, moves: bool) -> wp.Kernel:
    """Returns the kernel that takes each body over the step with the velocities after contact; items: bodies.

    Positions go on with θ times the velocities after and 1 − θ times those before. With ``moves`` some bodies are
    not free; those that follow a function of time are left to ``driven``.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    rotated = rotations.functions(real).rotated
    f = bodies.functions(real)
    wide, wide_matrix, wide_quat, moved = f.wide, f.wide_matrix, f.wide_quat, f.moved
    put, set_velocity, judge = f.put, f.set_velocity, f.judge
    of_guard = quarantine.guard(real)
    Guard, cause_of = of_guard.Guard, of_guard.cause_of

    @wp.func
    def advance_constrained(
        model: Model,
        state_in: State,
        middle: State,
        moving: Moving,
        state_out: State,
        env: int,
        body: int,
        dt: wp.float64,
        theta: wp.float64,
    ):
        motion = model.body_motion[env, body]
        rest = wp.float64(1.0) - theta
        v = wide(moving[env, body].linear)
        w = wide(moving[env, body].angular)
        w_before = wide(middle.body_angular_velocity[env, body])
        linear = theta * v + rest * wide(state_in.body_linear_velocity[env, body])
        whole_B = wp.mat33d()
        momentum = wp.vec3d()
        if motion.kind == BALL:
            q = wide_quat(state_in.body_orientation[env, body])
            q_middle = wide_quat(middle.body_orientation[env, body])
            arm_B = wp.quat_rotate_inv(q, arm_of(motion, q))
            inertia_B = wide_matrix(model.body_inertia[env, body])
            whole_B = inertia_at(inertia_B, wp.float64(model.body_mass[env, body]), arm_B)
            momentum = momentum_of(whole_B, q_middle, w)
        angular = theta * w + rest * w_before
        base, way, orientation = moved(state_in, env, body, motion, linear, angular, dt)
        if motion.kind == BALL:
            w = spin_of(wp.inverse(whole_B), wide_quat(orientation), momentum)
        if motion.kind == HINGE or motion.kind == BALL:
            v = wp.cross(w, way)
        put(state_out, env, body, base, way)
        state_out.body_orientation[env, body] = orientation
        set_velocity(state_out, env, body, v, w)

    @unique_kernel()
    def go_whole_way(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        theta: real,
        model: Model,
        guard: Guard,
        state_in: State,
        middle: State,
        moving: Moving,
        wrenches: Wrenches,
        state_out: State,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            dt = step[env, 0]
            if wp.static(moves):
                kind = model.body_motion[env, body].kind
                if kind != FREE:
                    if kind != DRIVEN:
                        advance_constrained(
                            model, state_in, middle, moving, state_out, env, body, wp.float64(dt),
                            wp.float64(theta),
                        )  # fmt: skip
                    judge(guard, wrenches, state_out, env, body, status)
                    continue
            rest = real(1.0) - theta
            velocity = moving[env, body].linear
            before = state_in.body_position[env, body]
            way = dt * (theta * velocity + rest * state_in.body_linear_velocity[env, body])
            way += state_in.body_position_remainder[env, body]
            position = before + way
            gone = position - before
            q_WB = state_in.body_orientation[env, body]
            w_W = state_in.body_angular_velocity[env, body]
            turning = moving[env, body].angular
            orientation = q_WB
            if model.body_round[env, body]:
                turn = dt * (theta * turning + rest * w_W)
                if wp.length_sq(turn) > real(0.0):
                    orientation = rotated(q_WB, turn)
            else:
                inverse_B = model.body_inverse_inertia[env, body]
                inertia_B = model.body_inertia[env, body]
                q_middle = middle.body_orientation[env, body]
                w_before = middle.body_angular_velocity[env, body]
                gained_B = inertia_B * wp.quat_rotate_inv(q_middle, turning - w_before)
                momentum = wp.quat_rotate(q_WB, inertia_B * wp.quat_rotate_inv(q_WB, w_W))
                turn = dt * (theta * turning + rest * w_before)
                if wp.length_sq(turn) > real(0.0):
                    orientation = rotated(q_WB, turn)
                # The change of spin, not the spin itself: a quaternion is a little longer or shorter than one and
                # scales what it rotates, which in a difference from step to step cancels instead of adding up.
                last = wp.quat_rotate(q_WB, inverse_B * wp.quat_rotate_inv(q_WB, momentum))
                momentum += wp.quat_rotate(q_middle, gained_B)
                after = wp.quat_rotate(orientation, inverse_B * wp.quat_rotate_inv(orientation, momentum))
                if wp.length_sq(turning) > real(0.0):
                    turning = w_W + (after - last)
            state_out.body_position[env, body] = position
            state_out.body_position_remainder[env, body] = (before - (position - gone)) + (way - gone)
            state_out.body_orientation[env, body] = orientation
            state_out.body_linear_velocity[env, body] = velocity
            state_out.body_angular_velocity[env, body] = turning
            # One sum is finite only if every term is: squares have no opposite signs.
            sizes = wp.length_sq(position) + wp.length_sq(velocity) + wp.length_sq(turning)
            if not sizes < guard.suspect[env, 0]:
                cause = cause_of(position, velocity, turning, guard.limits[env, 0])
                if cause != NO_CAUSE:
                    status[env] = ENV_FAILED
                    guard.cause[env] = cause

    return go_whole_way
