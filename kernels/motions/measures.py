"""What is measured of bodies that are not free: reactions of their joints, and how far they moved on them."""

import functools

import warp as wp
from warpcontact.kernels.motions import bodies, step
from warpcontact.kernels.motions.bodies import momentum_of, turn_about
from warpcontact.kernels.types import (
    DRIVEN,
    ENV_ACTIVE,
    FREE,
    HINGE,
    PLANAR,
    SLIDER,
    Work,
    env_of,
    item_of,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel


@wp.struct
class Reactions:
    """What joints do to their bodies, [env, body]; zero for free ones."""

    force: wp.array2d(dtype=wp.vec3d)  # W [N]
    torque: wp.array2d(dtype=wp.vec3d)  # about the anchor of a hinge or a ball, else the centre of mass; W [N·m]
    linear: wp.array2d(dtype=wp.vec3d)  # acceleration of the centre of mass of a body with a function of time, W
    angular: wp.array2d(dtype=wp.vec3d)  # its angular acceleration, W


@wp.struct
class Coordinates:
    """How far bodies moved on their joints, [env, body]."""

    angle: wp.array2d(dtype=wp.float64)  # of a hinge or in a plane, −π to π [rad]
    angle_rate: wp.array2d(dtype=wp.float64)  # [rad/s]
    displacement: wp.array2d(dtype=wp.float64)  # of a slider [m]
    displacement_rate: wp.array2d(dtype=wp.float64)  # [m/s]


@functools.cache
def reactions(real: type) -> wp.Kernel:
    """Returns the kernel that measures the reaction of each joint. Launch with dim (env, body).

    What the body lacks to its acceleration under all other forces, gravity among them. A prescribed body is taken
    to keep its velocities.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    f = bodies.functions(real)
    wide, wide_matrix, wide_quat = f.wide, f.wide_matrix, f.wide_quat
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
        if kind == DRIVEN:
            linear = measured.linear[env, body]
            angular = measured.angular[env, body]
        mass = wp.float64(model.body_mass[env, body])
        inertia_B = wide_matrix(model.body_inertia[env, body])
        q = wide_quat(state.body_orientation[env, body])
        w = wide(state.body_angular_velocity[env, body])
        reaction = mass * (linear - wide(model.gravity[env, 0])) - wide(force)
        moment = momentum_of(inertia_B, q, angular) + wp.cross(w, momentum_of(inertia_B, q, w)) - wide(torque)
        measured.force[env, body] = reaction
        measured.torque[env, body] = moment + wp.cross(arm, reaction)

    return measure_reactions


@functools.cache
def coordinates(real: type) -> wp.Kernel:
    """Returns the kernel that measures how far each body of the active environments moved; items: bodies."""
    t = structs(real)
    Model, State = t.Model, t.State
    f = bodies.functions(real)
    wide, wide_quat = f.wide, f.wide_quat

    @unique_kernel()
    def measure_coordinates(
        work: Work, status: wp.array(dtype=wp.int32), model: Model, state: State, measured: Coordinates
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            motion = model.body_motion[env, body]
            if motion.kind == HINGE or motion.kind == PLANAR:
                q = wide_quat(state.body_orientation[env, body])
                sine, cosine = turn_about(motion.axis, q, motion.orientation)
                # q and −q are the same rotation.
                if cosine < wp.float64(0.0):
                    sine = -sine
                    cosine = -cosine
                measured.angle[env, body] = wp.float64(2.0) * wp.atan2(sine, cosine)
                measured.angle_rate[env, body] = wp.dot(motion.axis, wide(state.body_angular_velocity[env, body]))
            elif motion.kind == SLIDER:
                way = wide(state.body_position[env, body]) - motion.position
                way += wide(state.body_position_remainder[env, body])
                measured.displacement[env, body] = wp.dot(motion.axis, way)
                measured.displacement_rate[env, body] = wp.dot(
                    motion.axis, wide(state.body_linear_velocity[env, body])
                )

    return measure_coordinates
