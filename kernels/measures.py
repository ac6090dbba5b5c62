"""Places, energy and momentum, in float64 whatever the precision: sums, and what is far from the origin."""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.types import ENV_ACTIVE, Work, first_env, structs, task_count


@wp.struct
class Bodies:
    """What is measured of bodies."""

    position: wp.array2d(dtype=wp.vec3d)  # [env, body] centre of mass, W [m]
    kinetic_energy: wp.array2d(dtype=wp.float64)  # [env, body] [J]
    potential_energy: wp.array2d(dtype=wp.float64)  # [env, body] −m g·x, zero at the origin of W [J]
    linear_momentum: wp.array2d(dtype=wp.vec3d)  # [env, body] W [kg·m/s]
    angular_momentum: wp.array2d(dtype=wp.vec3d)  # [env, body] about the origin of W [kg·m²/s]


@wp.struct
class Points:
    """What is measured of contacts."""

    position: wp.array2d(dtype=wp.vec3d)  # [env, contact] K, where the force acts, W [m]


@functools.cache
def bodies(real: type) -> wp.Kernel:
    """Returns the kernel that measures each body of the active environments; items: bodies."""
    t = structs(real)
    Model, State = t.Model, t.State
    wide = frames.functions(real).wide

    @wp.kernel(module="unique", enable_backward=False)
    def measure_bodies(work: Work, status: wp.array(dtype=wp.int32), model: Model, state: State, measured: Bodies):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task // work.items
            body = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            mass = wp.float64(model.body_mass[env, body])
            p_W = wide(state.body_position[env, body]) + wide(state.body_position_remainder[env, body])
            q_WB = state.body_orientation[env, body]
            v_W = wide(state.body_linear_velocity[env, body])
            w_W = state.body_angular_velocity[env, body]
            spin_W = wp.quat_rotate(q_WB, model.body_inertia[env, body] * wp.quat_rotate_inv(q_WB, w_W))
            turning = wp.dot(wide(w_W), wide(spin_W))
            measured.position[env, body] = p_W
            measured.kinetic_energy[env, body] = wp.float64(0.5) * (mass * wp.dot(v_W, v_W) + turning)
            measured.potential_energy[env, body] = -mass * wp.dot(wide(model.gravity[env, 0]), p_W)
            measured.linear_momentum[env, body] = mass * v_W
            measured.angular_momentum[env, body] = wp.cross(p_W, mass * v_W) + wide(spin_W)

    return measure_bodies


@functools.cache
def points(real: type) -> wp.Kernel:
    """Returns the kernel that places the points of the contacts of the active environments; items: contacts."""
    t = structs(real)
    Model, State, Contacts = t.Model, t.State, t.Contacts
    wide = frames.functions(real).wide

    @wp.kernel(module="unique", enable_backward=False)
    def measure_points(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        contacts: Contacts,
        measured: Points,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task // work.items
            contact = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            point = model.contact_point[contact]
            body = model.point_body[point]
            origin_W = wide(model.point_anchor[env, point])
            if body >= 0:
                origin_W = wide(state.body_position[env, body]) + wide(state.body_position_remainder[env, body])
            measured.position[env, contact] = origin_W + wide(contacts.arm[env, contact])

    return measure_points
