"""Energy and momentum of every body."""

import functools

import warp as wp
from warpcontact.kernels.types import structs


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that measures each body. Launch with dim (env, body)."""
    t = structs(real)
    vec3, Model, State = t.vec3, t.Model, t.State

    @wp.kernel(module="unique", enable_backward=False)
    def measure_bodies(
        model: Model,
        state: State,
        kinetic_energy: wp.array2d(dtype=real),  # [J]
        potential_energy: wp.array2d(dtype=real),  # −m g·x, zero at the origin of W [J]
        linear_momentum: wp.array2d(dtype=vec3),  # W [kg·m/s]
        angular_momentum: wp.array2d(dtype=vec3),  # about the origin of W [kg·m²/s]
    ):
        env, body = wp.tid()
        mass = model.body_mass[env, body]
        p_W = state.body_position[env, body]
        q_WB = state.body_orientation[env, body]
        v_W = state.body_linear_velocity[env, body]
        w_B = wp.quat_rotate_inv(q_WB, state.body_angular_velocity[env, body])
        spin_B = model.body_inertia[env, body] * w_B
        kinetic_energy[env, body] = real(0.5) * (mass * wp.dot(v_W, v_W) + wp.dot(w_B, spin_B))
        potential_energy[env, body] = -mass * wp.dot(model.gravity[env, 0], p_W)
        linear_momentum[env, body] = mass * v_W
        angular_momentum[env, body] = wp.cross(p_W, mass * v_W) + wp.quat_rotate(q_WB, spin_B)

    return measure_bodies
