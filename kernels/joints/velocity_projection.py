"""Projects initial velocities onto the degrees of freedom of the joints."""

import functools

import warp as wp
from warpcontact.kernels.joints import bodies
from warpcontact.kernels.joints.bodies import arm_of
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import BALL, FIXED, FREE, HINGE, PLANAR, PRESCRIBED, SLIDER, TIME_FUNCTION, structs


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that projects velocities onto the joints. Launch with dim (env, body).

    On a hinge or ball the angular velocity is kept, and the linear velocity follows from it.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    f = bodies.functions(real)
    wide, quat_to_float64, set_velocity = f.wide, f.quat_to_float64, f.set_velocity

    @unique_kernel()
    def project_velocities(mask: wp.array(dtype=wp.bool), model: Model, state: State):
        env, body = wp.tid()
        motion = model.body_motion[env, body]
        kind = motion.kind
        if not mask[env] or kind == FREE or kind == PRESCRIBED or kind == TIME_FUNCTION:  # noqa: SIM109
            return
        axis = motion.axis
        v = wide(state.body_linear_velocity[env, body])
        w = wide(state.body_angular_velocity[env, body])
        along = wp.dot(axis, w) * axis
        if kind == PLANAR:
            v -= wp.dot(axis, v) * axis
            w = along
        elif kind == HINGE or kind == BALL:  # noqa: SIM109
            if kind == HINGE:
                w = along
            v = wp.cross(w, arm_of(motion, quat_to_float64(state.body_orientation[env, body])))
        else:
            w = wp.vec3d()
            if kind == SLIDER:
                v = wp.dot(axis, v) * axis
            elif kind == FIXED:
                v = wp.vec3d()
        set_velocity(state, env, body, v, w)

    return project_velocities
