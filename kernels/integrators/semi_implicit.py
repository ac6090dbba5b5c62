"""Time integration of rigid bodies: one kernel per scheme, from ``state_in`` to ``state_out``."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames, rotations
from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.contact import history
from warpcontact.kernels.contact import wrenches as wrench_functions
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative, hide_from_optimizer
from warpcontact.kernels.lowlevel.static_strides import assume_strides
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.particles import sums as particle_sum_functions
from warpcontact.kernels.particles.base import particle_structs
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_FAILED,
    FREE,
    NO_CAUSE,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)

# Register limit per GPU thread in float32 with particle sums (measured): more resident threads hide memory
# latency.
REGISTERS = 72


class EulerParts(NamedTuple):
    """Device functions of a semi-implicit Euler step of a free body, and the struct of its health check."""

    Guard: Struct  # limits of environments, and causes of failures: ``accept_step.py``
    stepped_body: wp.Function  # state of a body after a step
    write_body: wp.Function  # writes that state
    step_failure_cause: wp.Function  # failure cause of that state, or NO_CAUSE


@functools.cache
def euler(real: type, splits_orientation: bool = False) -> EulerParts:
    """Returns the device functions of a semi-implicit Euler step of a free body.

    With ``splits_orientation``, the state has rounding remainders of orientations.

    Velocities are advanced first, from the wrenches at ``state_in``; positions follow with the new velocities.
    Rotation advances the angular momentum L, which includes the gyroscopic term exactly, and rotates the body by
    the exponential of the mid-step angular velocity. A free body conserves L to rounding and its energy to second
    order. A body with isotropic inertia needs its angular velocity only.
    """
    t = structs(real)
    vec3, quat, Model, State = t.vec3, t.quat, t.Model, t.State
    rotation_functions = rotations.functions(real)
    rotated, rotated_split = rotation_functions.rotated, rotation_functions.rotated_split
    spin = rotation_functions.spin
    guard_functions = accept_step.guard(real)
    Guard, failure_cause = guard_functions.Guard, guard_functions.failure_cause

    @wp.struct
    class BodyStep:
        """State of a body after a step."""

        position: vec3
        remainder: vec3
        orientation: quat
        orientation_remainder: quat  # unused without ``splits_orientation``
        velocity: vec3
        spin: vec3

    @wp.func
    def stepped_body(model: Model, state: State, env: int, body: int, force: vec3, torque: vec3, dt: real):
        """Returns the state after a step under gravity and a wrench about the center of mass."""
        acceleration = (real(1.0) / model.body_mass[env, body]) * force + model.gravity[env, 0]
        velocity = state.body_linear_velocity[env, body] + dt * acceleration
        # Compensated sum: a displacement per step is often smaller than the rounding of the position.
        before = state.body_position[env, body]
        displacement = dt * velocity + state.body_position_remainder[env, body]
        position = before + displacement
        rounded_displacement = position - before

        q_WB = state.body_orientation[env, body]
        w_W = state.body_angular_velocity[env, body]
        inverse_B = model.body_inverse_inertia[env, body]
        new_spin = w_W + (dt * inverse_B[0, 0]) * torque
        orientation = q_WB
        if wp.static(splits_orientation):
            angle_W = dt * new_spin
        if model.body_isotropic_inertia[env, body]:
            orientation = rotated(q_WB, dt * new_spin)
        else:
            inertia_B = model.body_inertia[env, body]
            last_momentum = wp.quat_rotate(q_WB, inertia_B * wp.quat_rotate_inv(q_WB, w_W))
            momentum = last_momentum + dt * torque
            start = spin(inverse_B, q_WB, momentum)
            q_middle = rotated(q_WB, real(0.5) * dt * start)
            if wp.static(splits_orientation):
                angle_W = dt * spin(inverse_B, q_middle, momentum)
            orientation = rotated(q_WB, dt * spin(inverse_B, q_middle, momentum))
            # Add the change of the angular velocity instead of replacing it: a quaternion is not exactly of unit
            # length and scales the vectors that it rotates. In a difference this error cancels instead of
            # accumulating.
            new_spin = w_W + (spin(inverse_B, orientation, momentum) - spin(inverse_B, q_WB, last_momentum))
        body_step = BodyStep()
        body_step.position = position
        body_step.remainder = (before - (position - rounded_displacement)) + (displacement - rounded_displacement)
        body_step.orientation = orientation
        if wp.static(splits_orientation):
            split = rotated_split(q_WB, state.body_orientation_remainder[env, body], angle_W)
            body_step.orientation = split.rounded
            body_step.orientation_remainder = split.remainder
        body_step.velocity = velocity
        body_step.spin = new_spin
        return body_step

    @wp.func
    def write_body(state: State, env: int, body: int, body_step: BodyStep):
        state.body_position[env, body] = body_step.position
        state.body_position_remainder[env, body] = body_step.remainder
        state.body_orientation[env, body] = body_step.orientation
        if wp.static(splits_orientation):
            state.body_orientation_remainder[env, body] = body_step.orientation_remainder
        state.body_linear_velocity[env, body] = body_step.velocity
        state.body_angular_velocity[env, body] = body_step.spin

    @wp.func
    def step_failure_cause(guard: Guard, env: int, body_step: BodyStep):
        """Returns the failure cause of a step, or NO_CAUSE."""
        # A sum of squares is finite only if every term is.
        sizes = wp.length_sq(body_step.position) + wp.length_sq(body_step.velocity) + wp.length_sq(body_step.spin)
        if sizes < guard.suspect[env, 0]:
            return NO_CAUSE
        return failure_cause(body_step.position, body_step.velocity, body_step.spin, guard.limits[env, 0])

    return EulerParts(
        Guard=Guard, stepped_body=stepped_body, write_body=write_body, step_failure_cause=step_failure_cause
    )


@functools.cache
def semi_implicit_euler(
    real: type,
    has_joints: bool = False,
    sources: tuple[bool, bool] | None = None,
    accepts: bool = False,
    has_particles: bool = False,
    splits_orientation: bool = False,
) -> wp.Kernel:
    """Returns the semi-implicit Euler kernel; items: bodies.

    With ``has_joints``, bodies with joints are skipped. With ``sources``, the options of
    ``wrenches.functions``, the kernel sums the wrenches first, with those of particles if ``has_particles``, and
    writes them if ``write_outputs``. With ``accepts``, for environments of one body, it accepts the step and
    advances the history. ``splits_orientation`` is that of ``euler``.
    """
    t = structs(real)
    vec3, Model, State, ActiveContacts, EndWrenches, Wrenches = (
        t.vec3,
        t.Model,
        t.State,
        t.ActiveContacts,
        t.EndWrenches,
        t.Wrenches,
    )
    sums = sources is not None
    History, Contacts, Cache = t.History, t.Contacts, t.Cache
    accept, advance = accept_step.accept_step(real), history.advance(real, False)
    body_wrench = wrench_functions.functions(real, *(sources or (False, False))).body_wrench
    reset_queues = wrench_functions.reset_queues
    body_functions = euler(real, splits_orientation)
    Guard, stepped_body, write_body, step_failure_cause = (
        body_functions.Guard,
        body_functions.stepped_body,
        body_functions.write_body,
        body_functions.step_failure_cause,
    )
    p, particle_sums = particle_structs(real), particle_sum_functions.functions(real)
    Particles, NeighborLists, PairRecords, WrenchSum, add_particle = (
        p.Particles,
        p.NeighborLists,
        p.PairRecords,
        particle_sums.WrenchSum,
        particle_sums.add_particle,
    )
    registers = REGISTERS if has_particles and real is wp.float32 else None
    assume_model_strides, assume_state_strides, assume_active_strides = (
        assume_strides(Model),
        assume_strides(State),
        assume_strides(ActiveContacts),
    )
    assume_contacts_strides, assume_history_strides, assume_cache_strides = (
        assume_strides(Contacts),
        assume_strides(History),
        assume_strides(Cache),
    )

    @unique_kernel(registers)
    def semi_implicit_euler(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        guard: Guard,
        state_in: State,
        queue_count: wp.array(dtype=wp.int32),
        active_contacts: ActiveContacts,
        ends: EndWrenches,
        particles: Particles,
        neighbor_lists: NeighborLists,
        pair_records: PairRecords,
        write_outputs: wp.bool,
        wrenches: Wrenches,
        clock_step: wp.array2d(
            dtype=wp.float64
        ),  # [env, 0] [s]; this and the next arguments are used with ``accepts``
        time: wp.array(dtype=wp.float64),  # [env] [s]
        clusters: wp.int32,
        contacts: Contacts,
        contact_history: History,
        cache: Cache,
        state_out: State,
    ):
        assume_model_strides(model)
        assume_state_strides(state_in)
        assume_state_strides(state_out)
        assume_active_strides(active_contacts)
        assume_contacts_strides(contacts)
        assume_history_strides(contact_history)
        assume_cache_strides(cache)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if wp.static(sums):
                if task == 0:
                    reset_queues(queue_count)
            if status[env] != ENV_ACTIVE:
                continue
            force = vec3()
            torque = vec3()
            if wp.static(sums):
                wrench = body_wrench(model, active_contacts, ends, env, body)
                force = wrench.force
                torque = wrench.torque
                if wp.static(has_particles):
                    particle = particles.particle_of_body[body]
                    if particle >= 0:
                        particle_wrench = add_particle(
                            WrenchSum(), state_in, particles, neighbor_lists, pair_records, env, particle
                        )
                        force += particle_wrench.force
                        torque += particle_wrench.torque
                if write_outputs:
                    wrenches.force[env, body] = force
                    wrenches.torque[env, body] = torque
            else:
                force = wrenches.force[env, body]
                torque = wrenches.torque[env, body]
            if wp.static(has_joints):
                if model.body_motion[env, body].kind != FREE:
                    continue
            body_step = stepped_body(model, state_in, env, body, force, torque, step[env, 0])
            write_body(state_out, env, body, body_step)
            cause = step_failure_cause(guard, env, body_step)
            if cause != NO_CAUSE:
                status[env] = ENV_FAILED
                guard.cause[env] = cause
            if wp.static(accepts):
                found = status[env]
                accept(status, clock_step, time, 1, state_in, state_out, env, found)
                if found == ENV_ACTIVE:
                    cluster = assume_nonnegative(0)
                    while cluster < clusters:
                        advance(
                            time,
                            step,
                            model,
                            contacts,
                            active_contacts,
                            contact_history,
                            cache,
                            hide_from_optimizer(env),
                            cluster,
                        )
                        cluster = assume_nonnegative(cluster + 1)

    return semi_implicit_euler


@functools.cache
def change_step(real: type, has_joints: bool = False) -> wp.Kernel:
    """Returns the kernel that adapts velocities to a change of the time step; items: bodies.

    With ``has_joints``, bodies with joints are skipped; ``joints`` handles them.

    The velocities of semi-implicit Euler belong to half a step before the positions. A step that is longer by
    ``change`` therefore starts from the velocities of change/2 earlier. Without the correction the energy of a
    contact would jump.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    spin = rotations.functions(real).spin

    @unique_kernel()
    def change_step(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        change: wp.array2d(dtype=real),  # [env, 0] next time step minus last [s]
        model: Model,
        wrenches: Wrenches,  # at this instant
        state: State,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            if wp.static(has_joints):
                if model.body_motion[env, body].kind != FREE:
                    continue
            earlier = real(0.5) * change[env, 0]
            acceleration = wrenches.force[env, body] / model.body_mass[env, body] + model.gravity[env, 0]
            new_spin = spin(
                model.body_inverse_inertia[env, body],
                state.body_orientation[env, body],
                wrenches.torque[env, body],
            )
            state.body_linear_velocity[env, body] = state.body_linear_velocity[env, body] - earlier * acceleration
            state.body_angular_velocity[env, body] = state.body_angular_velocity[env, body] - earlier * new_spin

    return change_step


@functools.cache
def copy_state(real: type) -> wp.Kernel:
    """Returns the kernel that copies the active environments of a state; items: bodies."""
    State = structs(real).State
    copy_body = frames.functions(real).copy_body

    @unique_kernel()
    def copy_state(launch: LaunchRange, status: wp.array(dtype=wp.int32), source: State, target: State):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            copy_body(source, target, env, body)

    return copy_state
