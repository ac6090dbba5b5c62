"""Bushings: springs and dampers in six directions between frames of two bodies."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames, rotations
from warpcontact.kernels.couplings import ends
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    COUPLING_ACTIVE,
    COUPLING_DISABLED,
    ENV_ACTIVE,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)


class BushingStructs(NamedTuple):
    """Structs of bushings, in one precision."""

    Settings: Struct  # parameters of a bushing
    Bushings: Struct  # measured quantities of bushings


@functools.cache
def bushing_structs(real: type) -> BushingStructs:
    """Returns the structs of bushings in one precision. Frame F: axes of the bushing, fixed to its first body."""
    t = structs(real)
    vec3, quat = t.vec3, t.quat

    @wp.struct
    class Settings:
        stiffness: vec3  # along the axes [N/m]
        damping: vec3  # [N·s/m]
        turn_stiffness: vec3  # about the axes [N·m/rad]
        turn_damping: vec3  # [N·m·s/rad]
        orientation_1: quat  # F → first body
        orientation_2: quat  # F in the reference pose → second body
        enabled: wp.int32  # 0 or 1

    @wp.struct
    class Bushings:
        displacement: wp.array2d(dtype=vec3)  # [env, bushing] second end relative to first, F [m]
        rotation: wp.array2d(dtype=vec3)  # [env, bushing] second body relative to first, rotation vector, F [rad]
        force: wp.array2d(dtype=vec3)  # [env, bushing] on the second body, F [N]
        torque: wp.array2d(dtype=vec3)  # [env, bushing] on the second body, F [N·m]
        status: wp.array2d(dtype=wp.int32)  # [env, bushing] COUPLING_*

    return BushingStructs(Settings=Settings, Bushings=Bushings)


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel of the forces of bushings; items: bushings.

    The force acts at the second end on both bodies, so the torque is the only net couple on the pair.
    """
    t = structs(real)
    s = bushing_structs(real)
    vec3, Model, State, EndWrenches = t.vec3, t.Model, t.State, t.EndWrenches
    Settings, Bushings = s.Settings, s.Bushings
    end = ends.functions(real)
    arm, separation, velocity = end.arm, end.separation, end.velocity
    orientation_to_world = frames.functions(real).orientation_to_world
    rotation_vector = rotations.functions(real).rotation_vector

    @wp.func
    def spin(state: State, env: int, body: int):
        if body < 0:
            return vec3()
        return state.body_angular_velocity[env, body]

    @unique_kernel()
    def bushing_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        first: wp.int32,  # coupling
        settings: wp.array2d(dtype=Settings),
        bushings: Bushings,
        ends: EndWrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            bushing = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            end_1 = 2 * (first + bushing)
            point_1 = model.end_point[end_1]
            point_2 = model.end_point[end_1 + 1]
            body_1 = model.point_body[point_1]
            body_2 = model.point_body[point_2]
            bushing_settings = settings[env, bushing]
            q_WF = orientation_to_world(state, env, body_1, bushing_settings.orientation_1)
            q_W2 = orientation_to_world(state, env, body_2, bushing_settings.orientation_2)
            arm_1 = arm(model, state, env, point_1)
            arm_2 = arm(model, state, env, point_2)
            offset_W = separation(model, state, env, point_1, point_2, arm_1, arm_2)
            # Velocity of the second end relative to the coincident point of the first body.
            relative_velocity = velocity(model, state, env, point_2, arm_2) - velocity(
                model, state, env, point_1, arm_1 + offset_W
            )
            relative_spin = spin(state, env, body_2) - spin(state, env, body_1)
            offset_F = wp.quat_rotate_inv(q_WF, offset_W)
            rotation_F = rotation_vector(wp.quat_inverse(q_WF) * q_W2)
            force = -wp.cw_mul(bushing_settings.stiffness, offset_F) - wp.cw_mul(
                bushing_settings.damping, wp.quat_rotate_inv(q_WF, relative_velocity)
            )
            couple = -wp.cw_mul(bushing_settings.turn_stiffness, rotation_F) - wp.cw_mul(
                bushing_settings.turn_damping, wp.quat_rotate_inv(q_WF, relative_spin)
            )
            coupling_status = COUPLING_ACTIVE
            if bushing_settings.enabled == 0:
                coupling_status = COUPLING_DISABLED
                force = vec3()
                couple = vec3()
            bushings.displacement[env, bushing] = offset_F
            bushings.rotation[env, bushing] = rotation_F
            bushings.force[env, bushing] = force
            bushings.torque[env, bushing] = couple
            bushings.status[env, bushing] = coupling_status
            force_W = wp.quat_rotate(q_WF, force)
            couple_W = wp.quat_rotate(q_WF, couple)
            ends.force[env, end_1] = -force_W
            ends.torque[env, end_1] = wp.cross(arm_1 + offset_W, -force_W) - couple_W
            ends.force[env, end_1 + 1] = force_W
            ends.torque[env, end_1 + 1] = wp.cross(arm_2, force_W) + couple_W

    return bushing_forces
