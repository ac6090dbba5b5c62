"""Positions, energies and momenta of bodies and contact points, in float64 for any precision."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item


@wp.struct
class Positions:
    """Positions of bodies."""

    position: wp.array2d(dtype=wp.vec3d)  # [env, body] center of mass, W [m]


@wp.struct
class Energies:
    """Energies of bodies."""

    kinetic_energy: wp.array2d(dtype=wp.float64)  # [env, body] [J]
    potential_energy: wp.array2d(dtype=wp.float64)  # [env, body] −m g·x, zero at the origin of W [J]


@wp.struct
class Momenta:
    """Momenta of bodies."""

    linear_momentum: wp.array2d(dtype=wp.vec3d)  # [env, body] W [kg·m/s]
    angular_momentum: wp.array2d(dtype=wp.vec3d)  # [env, body] about the origin of W [kg·m²/s]


@wp.struct
class Points:
    """Positions of contact points."""

    position: wp.array2d(dtype=wp.vec3d)  # [env, contact] K, where the force acts, W [m]


class _Functions(NamedTuple):
    """Device functions of the motion of a body."""

    to_float64: wp.Function  # vector in float64
    position: wp.Function  # center of mass, W, float64 [m]
    spin: wp.Function  # angular momentum about the center of mass, W [kg·m²/s]


@functools.cache
def _functions(real: type) -> _Functions:
    """Returns the device functions for position and angular momentum of a body."""
    t = structs(real)
    Model, State = t.Model, t.State
    to_float64 = frames.functions(real).to_float64

    @wp.func
    def position(state: State, env: int, body: int):
        """Returns the center of mass of a body, W [m]."""
        return to_float64(state.body_position[env, body]) + to_float64(state.body_position_remainder[env, body])

    @wp.func
    def spin(model: Model, state: State, env: int, body: int):
        """Returns the angular momentum of a body about its center of mass, W [kg·m²/s]."""
        q_WB = state.body_orientation[env, body]
        w_W = state.body_angular_velocity[env, body]
        return wp.quat_rotate(q_WB, model.body_inertia[env, body] * wp.quat_rotate_inv(q_WB, w_W))

    return _Functions(to_float64=to_float64, position=position, spin=spin)


@functools.cache
def positions(real: type) -> wp.Kernel:
    """Returns the kernel that computes body positions in active environments; items: bodies."""
    t, f = structs(real), _functions(real)
    Model, State, position = t.Model, t.State, f.position

    @unique_kernel()
    def measure_positions(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), model: Model, state: State, measured: Positions
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            measured.position[env, body] = position(state, env, body)

    return measure_positions


@functools.cache
def energies(real: type) -> wp.Kernel:
    """Returns the kernel that computes body energies in active environments; items: bodies."""
    t, f = structs(real), _functions(real)
    Model, State, to_float64, position = t.Model, t.State, f.to_float64, f.position

    @unique_kernel()
    def measure_energies(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), model: Model, state: State, measured: Energies
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            mass = wp.float64(model.body_mass[env, body])
            v_W = to_float64(state.body_linear_velocity[env, body])
            w_B = wp.quat_rotate_inv(state.body_orientation[env, body], state.body_angular_velocity[env, body])
            turning = wp.dot(to_float64(w_B), to_float64(model.body_inertia[env, body] * w_B))
            measured.kinetic_energy[env, body] = wp.float64(0.5) * (mass * wp.dot(v_W, v_W) + turning)
            measured.potential_energy[env, body] = -mass * wp.dot(
                to_float64(model.gravity[env, 0]), position(state, env, body)
            )

    return measure_energies


@functools.cache
def momenta(real: type) -> wp.Kernel:
    """Returns the kernel that computes body momenta in active environments; items: bodies."""
    t, f = structs(real), _functions(real)
    Model, State, to_float64, position, spin = t.Model, t.State, f.to_float64, f.position, f.spin

    @unique_kernel()
    def measure_momenta(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), model: Model, state: State, measured: Momenta
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            mv_W = wp.float64(model.body_mass[env, body]) * to_float64(state.body_linear_velocity[env, body])
            spin_W = to_float64(spin(model, state, env, body))
            measured.linear_momentum[env, body] = mv_W
            measured.angular_momentum[env, body] = wp.cross(position(state, env, body), mv_W) + spin_W

    return measure_momenta


#: Measures of bodies by the requirement of a sensor: output struct and kernel.
BODY_MEASURES = {
    "positions": (Positions, positions),
    "energies": (Energies, energies),
    "momenta": (Momenta, momenta),
}


@functools.cache
def points(real: type) -> wp.Kernel:
    """Returns the kernel that computes contact points K in active environments; items: contacts."""
    t = structs(real)
    Model, State, Contacts = t.Model, t.State, t.Contacts
    to_float64 = frames.functions(real).to_float64

    @unique_kernel()
    def measure_points(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        contacts: Contacts,
        measured: Points,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            point = model.contact_point[contact]
            body = model.point_body[point]
            origin_W = to_float64(model.point_anchor[env, point])
            if body >= 0:
                origin_W = to_float64(state.body_position[env, body]) + to_float64(
                    state.body_position_remainder[env, body]
                )
            measured.position[env, contact] = origin_W + to_float64(contacts.arm[env, contact])

    return measure_points
