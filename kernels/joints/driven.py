"""Prescribed motion as a function of time: kernels for one class of motions.

The pose of a state is that of the function at the time of its environment. The velocities are those that a free
body at rest on it would have in the scheme: with semi-implicit Euler the mean over the last step, with Moreau–Jean
(θ = ½) the velocities at that instant.
"""

import functools
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels import rotations
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.joints import bodies
from warpcontact.kernels.joints.base import Motion
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    BodyMotion,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)

# Time differences for velocities and accelerations [s]: short compared with the motion of macroscopic bodies, long
# compared with float64 rounding.
VELOCITY_DT = wp.constant(wp.float64(1.0e-6))
ACCELERATION_DT = wp.constant(wp.float64(2.0e-5))


def coefficients_struct(motion: type[Motion]) -> Struct:
    """Returns the struct of the coefficients of ``motion``, in float64 for any precision."""
    return coefficient_struct(motion, wp.float64)


class _Functions(NamedTuple):
    """Device functions of a motion as a function of time, in float64."""

    rotation_at: wp.Function  # rotation from the initial orientation
    offset_at: wp.Function  # displacement of the center of mass, W [m]
    mean_velocities: wp.Function  # mean linear and angular velocity between two times
    accelerations: wp.Function  # linear and angular acceleration


@functools.cache
def _functions(motion: type[Motion]) -> _Functions:
    Coefficients = coefficients_struct(motion)
    rotation_functions = rotations.functions(wp.float64)
    rotated, rotation_vector = rotation_functions.rotated, rotation_functions.rotation_vector
    if motion.sampled:
        displacement, rotation = motion.displacement, motion.rotation
    else:
        displacement, rotation = _of_time(motion.displacement), _of_time(motion.rotation)

    @wp.func
    def rotation_at(p: Coefficients, samples: wp.array2d(dtype=wp.float64), t: wp.float64):
        """Returns the rotation from the initial orientation."""
        return rotated(wp.quat_identity(dtype=wp.float64), rotation(p, t, samples))

    @wp.func
    def offset_at(
        p: Coefficients,
        samples: wp.array2d(dtype=wp.float64),
        t: wp.float64,
        body: BodyMotion,
        rotation_W: wp.quatd,
    ):
        """Returns the displacement of the center of mass at ``t``, with rotation ``rotation_W``."""
        arm = body.position - body.anchor
        return (wp.quat_rotate(rotation_W, arm) - arm) + displacement(p, t, samples)

    @wp.func
    def mean_velocities(
        p: Coefficients,
        samples: wp.array2d(dtype=wp.float64),
        body: BodyMotion,
        before: wp.float64,
        after: wp.float64,
    ):
        """Returns the mean linear and angular velocity between two times."""
        first = rotation_at(p, samples, before)
        last = rotation_at(p, samples, after)
        offset = offset_at(p, samples, after, body, last) - offset_at(p, samples, before, body, first)
        duration = after - before
        return offset / duration, rotation_vector(last * wp.quat_inverse(first)) / duration

    @wp.func
    def accelerations(p: Coefficients, samples: wp.array2d(dtype=wp.float64), body: BodyMotion, t: wp.float64):
        """Returns the linear and angular acceleration at ``t``."""
        before = t - ACCELERATION_DT
        after = t + ACCELERATION_DT
        v_before, w_before = mean_velocities(p, samples, body, before, t)
        v_after, w_after = mean_velocities(p, samples, body, t, after)
        duration = wp.float64(0.5) * (after - before)
        return (v_after - v_before) / duration, (w_after - w_before) / duration

    return _Functions(
        rotation_at=rotation_at, offset_at=offset_at, mean_velocities=mean_velocities, accelerations=accelerations
    )


def _of_time(function: wp.Function) -> wp.Function:
    """Returns ``function`` with a third argument, which is ignored."""

    @wp.func
    def of_time(p: Any, t: wp.float64, samples: wp.array2d(dtype=wp.float64)):
        return function(p, t)

    return of_time


@functools.cache
def follow(motion: type[Motion], real: type) -> wp.Kernel:
    """Returns the kernel that moves the bodies of a class over a step; items: ``members``.

    Their velocities are the mean between the fractions ``first`` and ``last`` of the step.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    Coefficients = coefficients_struct(motion)
    f, motion_functions = bodies.functions(real), _functions(motion)
    quat_from_float64, set_position, set_velocity = f.quat_from_float64, f.set_position, f.set_velocity
    check_body, Guard = f.check_body, f.Guard
    rotation_at, offset_at, mean_velocities = (
        motion_functions.rotation_at,
        motion_functions.offset_at,
        motion_functions.mean_velocities,
    )

    @unique_kernel()
    def follow_motion(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env], before the step [s]
        model: Model,
        guard: Guard,
        members: wp.array(dtype=wp.int32),  # [item] body
        coefficients: wp.array2d(dtype=Coefficients),  # [env, item]
        samples: wp.array2d(dtype=wp.float64),
        first: wp.float64,
        last: wp.float64,
        wrenches: Wrenches,
        state_out: State,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            item = task_item(launch, task)
            body = members[item]
            if status[env] != ENV_ACTIVE:
                continue
            motion = model.body_motion[env, body]
            p = coefficients[env, item]
            before = time[env]
            # The same sum as that of the clock, so that both are bitwise identical.
            after = before + step[env, 0]
            rotation_W = rotation_at(p, samples, after)
            h = step[env, 0]
            v, w = mean_velocities(p, samples, motion, before + first * h, before + last * h)
            set_position(state_out, env, body, motion.position, offset_at(p, samples, after, motion, rotation_W))
            state_out.body_orientation[env, body] = quat_from_float64(rotation_W * motion.orientation)
            set_velocity(state_out, env, body, v, w)
            check_body(guard, wrenches, state_out, env, body, status)

    return follow_motion


@functools.cache
def start(motion: type[Motion], real: type) -> wp.Kernel:
    """Returns the kernel that sets the initial pose and velocities of a class. Launch with dim (env, item)."""
    t = structs(real)
    Model, State = t.Model, t.State
    Coefficients = coefficients_struct(motion)
    f, motion_functions = bodies.functions(real), _functions(motion)
    quat_from_float64, set_position, set_velocity = f.quat_from_float64, f.set_position, f.set_velocity
    rotation_at, offset_at, mean_velocities = (
        motion_functions.rotation_at,
        motion_functions.offset_at,
        motion_functions.mean_velocities,
    )

    @unique_kernel(runs_rarely=True)
    def start_motion(
        mask: wp.array(dtype=wp.bool),
        time: wp.array(dtype=wp.float64),  # [env] [s]
        model: Model,
        members: wp.array(dtype=wp.int32),  # [item] body
        coefficients: wp.array2d(dtype=Coefficients),  # [env, item]
        samples: wp.array2d(dtype=wp.float64),
        state: State,
    ):
        env, item = wp.tid()
        if not mask[env]:
            return
        body = members[item]
        motion = model.body_motion[env, body]
        p = coefficients[env, item]
        now = time[env]
        rotation_W = rotation_at(p, samples, now)
        v, w = mean_velocities(p, samples, motion, now - VELOCITY_DT, now + VELOCITY_DT)
        set_position(state, env, body, motion.position, offset_at(p, samples, now, motion, rotation_W))
        state.body_orientation[env, body] = quat_from_float64(rotation_W * motion.orientation)
        set_velocity(state, env, body, v, w)

    return start_motion


@functools.cache
def change_step(motion: type[Motion], real: type) -> wp.Kernel:
    """Returns the kernel that adapts velocities of a class to a change of the time step; items: ``members``.

    The mean velocity over a step is that of half a step before its end.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    Coefficients = coefficients_struct(motion)
    f = bodies.functions(real)
    to_float64, set_velocity = f.to_float64, f.set_velocity
    accelerations = _functions(motion).accelerations

    @unique_kernel()
    def change_motion(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        change: wp.array2d(dtype=real),  # [env, 0] next time step minus last [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        model: Model,
        members: wp.array(dtype=wp.int32),  # [item] body
        coefficients: wp.array2d(dtype=Coefficients),  # [env, item]
        samples: wp.array2d(dtype=wp.float64),
        state: State,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            item = task_item(launch, task)
            body = members[item]
            if status[env] != ENV_ACTIVE:
                continue
            earlier = wp.float64(0.5) * wp.float64(change[env, 0])
            motion = model.body_motion[env, body]
            linear, angular = accelerations(coefficients[env, item], samples, motion, time[env])
            v = to_float64(state.body_linear_velocity[env, body]) - earlier * linear
            w = to_float64(state.body_angular_velocity[env, body]) - earlier * angular
            set_velocity(state, env, body, v, w)

    return change_motion


@functools.cache
def accelerate(motion: type[Motion], real: type) -> wp.Kernel:
    """Returns the kernel that computes the accelerations of a class. Launch with dim (env, item)."""
    Model = structs(real).Model
    Coefficients = coefficients_struct(motion)
    accelerations = _functions(motion).accelerations

    @unique_kernel()
    def accelerate_motion(
        time: wp.array(dtype=wp.float64),  # [env] [s]
        model: Model,
        members: wp.array(dtype=wp.int32),  # [item] body
        coefficients: wp.array2d(dtype=Coefficients),  # [env, item]
        samples: wp.array2d(dtype=wp.float64),
        linear: wp.array2d(dtype=wp.vec3d),  # [env, body] W [m/s²]
        angular: wp.array2d(dtype=wp.vec3d),  # [env, body] W [rad/s²]
    ):
        env, item = wp.tid()
        body = members[item]
        a, alpha = accelerations(coefficients[env, item], samples, model.body_motion[env, body], time[env])
        linear[env, body] = a
        angular[env, body] = alpha

    return accelerate_motion
