"""Reaction forces of joints, and joint coordinates."""

import functools

import warp as wp
from warpcontact.kernels.joints import bodies, step
from warpcontact.kernels.joints.bodies import half_angle, momentum_of
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    FREE,
    HINGE,
    PLANAR,
    SLIDER,
    TIME_FUNCTION,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)


@wp.struct
class Reactions:
    """Reactions of joints on their bodies, [env, body]; zero for free bodies."""

    force: wp.array2d(dtype=wp.vec3d)  # W [N]
    torque: wp.array2d(
        dtype=wp.vec3d
    )  # about the anchor of a hinge or ball, else about the center of mass; W [N·m]
    linear: wp.array2d(dtype=wp.vec3d)  # acceleration of the center of mass, only of a function of time; W [m/s²]
    angular: wp.array2d(dtype=wp.vec3d)  # angular acceleration, likewise; W [rad/s²]


@wp.struct
class Coordinates:
    """Joint coordinates and their rates, [env, body]."""

    angle: wp.array2d(dtype=wp.float64)  # of a hinge or planar joint, −π to π [rad]
    angle_rate: wp.array2d(dtype=wp.float64)  # [rad/s]
    displacement: wp.array2d(dtype=wp.float64)  # of a slider [m]
    displacement_rate: wp.array2d(dtype=wp.float64)  # [m/s]


@functools.cache
def reactions(real: type) -> wp.Kernel:
    """Returns the kernel that computes the reaction of each joint. Launch with dim (env, body).

    The reaction balances the acceleration and all other forces, including gravity. The acceleration of a body with
    prescribed velocities is taken as zero.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    f = bodies.functions(real)
    to_float64, matrix_to_float64, quat_to_float64 = f.to_float64, f.matrix_to_float64, f.quat_to_float64
    accelerations = step.accelerations(real)

    @unique_kernel()
    def measure_reactions(model: Model, state: State, wrenches: Wrenches, measured: Reactions):
        env, body = wp.tid()
        kind = model.body_motion[env, body].kind
        if kind == FREE:
            return
        force = wrenches.force[env, body]
        torque = wrenches.torque[env, body]
        linear, angular, arm = accelerations(model, state, env, body, force, torque)
        if kind == TIME_FUNCTION:
            linear = measured.linear[env, body]
            angular = measured.angular[env, body]
        mass = wp.float64(model.body_mass[env, body])
        inertia_B = matrix_to_float64(model.body_inertia[env, body])
        q = quat_to_float64(state.body_orientation[env, body])
        w = to_float64(state.body_angular_velocity[env, body])
        reaction = mass * (linear - to_float64(model.gravity[env, 0])) - to_float64(force)
        moment = (
            momentum_of(inertia_B, q, angular) + wp.cross(w, momentum_of(inertia_B, q, w)) - to_float64(torque)
        )
        measured.force[env, body] = reaction
        measured.torque[env, body] = moment + wp.cross(arm, reaction)

    return measure_reactions


@functools.cache
def coordinates(real: type) -> wp.Kernel:
    """Returns the kernel that computes joint coordinates in active environments; items: bodies."""
    t = structs(real)
    Model, State = t.Model, t.State
    f = bodies.functions(real)
    to_float64, quat_to_float64 = f.to_float64, f.quat_to_float64

    @unique_kernel()
    def measure_coordinates(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), model: Model, state: State, measured: Coordinates
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            motion = model.body_motion[env, body]
            if motion.kind == HINGE or motion.kind == PLANAR:
                q = quat_to_float64(state.body_orientation[env, body])
                sine, cosine = half_angle(motion.axis, q, motion.orientation)
                # q and −q are the same rotation.
                if cosine < wp.float64(0.0):
                    sine = -sine
                    cosine = -cosine
                measured.angle[env, body] = wp.float64(2.0) * wp.atan2(sine, cosine)
                measured.angle_rate[env, body] = wp.dot(
                    motion.axis, to_float64(state.body_angular_velocity[env, body])
                )
            elif motion.kind == SLIDER:
                offset = to_float64(state.body_position[env, body]) - motion.position
                offset += to_float64(state.body_position_remainder[env, body])
                measured.displacement[env, body] = wp.dot(motion.axis, offset)
                measured.displacement_rate[env, body] = wp.dot(
                    motion.axis, to_float64(state.body_linear_velocity[env, body])
                )

    return measure_coordinates
