"""Saves the impulses of a step: warm starts, dissipated energy, reactions and sensor values; skips sleeping steps.

A step is a function of state, contact history and parameters. If the last steps changed none of these, the next
step does not either, until the user changes something. Such steps are counted, and an environment sleeps: its steps
are skipped, with bitwise identical results.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.contact.impulse_records import acting_impulse, record_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth.rows import row_structs, solve_types
from warpcontact.kernels.nonsmooth.velocity_update import relative_velocities
from warpcontact.kernels.particles.base import IN_CONTACT, particle_structs
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_SLEEPING,
    MODE_OPEN,
    MODE_SLIP,
    MODE_STICK,
    LaunchRange,
    first_env,
    structs,
    task_count,
    task_env,
    task_item,
)


@functools.cache
def kernel(real: type, has_joints: bool, rolls: bool) -> wp.Kernel:
    """Returns the kernel that stores the rows of an accepted step as warm starts of their contacts; items: 1.

    With ``has_joints`` some bodies have joints, with ``rolls`` some contacts have rolling or spinning resistance.
    Environments that slept in the step (``skip_sleeping``) become active again.

    An impulse P at a contact with relative velocities U⁻ before and U⁺ after dissipates −P·(U⁻ + U⁺)/2. With θ =
    ½, this and the work of the forces equal the change of the kinetic energy of free bodies. The potential energy that bodies get
    by displacements of ``lost_gaps.py`` is negative dissipation by impacts.
    """
    t = structs(real)
    vec3, Model, State, Wrenches = t.vec3, t.Model, t.State, t.Wrenches
    records = record_structs(real)
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    StoredImpulse, StoredImpulses, StepStatistics = (
        records.StoredImpulse,
        records.StoredImpulses,
        records.StepStatistics,
    )
    RestitutionLimit = records.RestitutionLimit
    f = relative_velocities(real, has_joints)
    velocity_before, velocity_after = f.before, f.after
    spin_before, spin_after = f.spin_before, f.spin_after
    # Distance to the boundary of the cone at which a contact slips: rounding, and the error of the solver.
    ROUNDING = wp.constant(real(64.0 * t.epsilon))
    UNSOLVED = wp.constant(real(20.0))

    @wp.func
    def add_wrench(wrenches: Wrenches, env: int, body: int, force: vec3, torque: vec3):
        if body >= 0:
            wrenches.force[env, body] = wrenches.force[env, body] + force
            wrenches.torque[env, body] = wrenches.torque[env, body] + torque

    @unique_kernel()
    def save_rows(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        tolerance: real,
        model: Model,
        bodies: wp.int32,
        half_step_state: State,
        rows: Rows,
        body_response: BodyResponse,
        correction: VelocityChange,  # velocities that act on positions only
        solve_result: SolveResult,
        restitution_limit: RestitutionLimit,
        stored_impulses: StoredImpulses,
        statistics: StepStatistics,
        reactions: Wrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] == ENV_SLEEPING:
                status[env] = ENV_ACTIVE
                continue
            if status[env] != ENV_ACTIVE:
                continue
            number = statistics.step[env] + 1
            statistics.step[env] = number
            if restitution_limit.factor[env] < real(1.0):
                statistics.restitution_limited[env] = statistics.restitution_limited[env] + 1
            statistics.failures[env] = statistics.failures[env] + 1 - solve_result.converged[env]
            if solve_result.converged[env] == 0:
                statistics.largest_residual[env] = wp.max(
                    statistics.largest_residual[env], solve_result.residual[env]
                )
            by_friction = wp.float64(0.0)
            by_impact = wp.float64(0.0)
            unchanged_steps = wp.min(statistics.unchanged_steps[env] + 1, 2)
            if (
                solve_result.converged[env] == 0
                or solve_result.iterations[env] > 0
                or restitution_limit.factor[env] < real(1.0)
            ):
                unchanged_steps = wp.int32(0)
            for body in range(bodies):
                reactions.force[env, body] = vec3()
                reactions.torque[env, body] = vec3()
                # A body that is at rest before and after a step keeps its pose.
                is_at_rest = (
                    half_step_state.body_linear_velocity[env, body] == vec3()
                    and body_response[env, body].linear == vec3()
                )
                is_at_rest = is_at_rest and half_step_state.body_angular_velocity[env, body] == vec3()
                lift = correction[env, body].linear
                if wp.length_sq(lift) > real(0.0):
                    # Potential energy that the body gets by displacements.
                    is_at_rest = wp.bool(False)
                    weight = model.body_mass[env, body] * model.gravity[env, 0]
                    by_impact += wp.float64(step[env, 0] * wp.dot(weight, lift))
                if not (is_at_rest and body_response[env, body].angular == vec3()):
                    unchanged_steps = wp.int32(0)
            per_second = real(1.0) / step[env, 0]
            stick_fraction = real(1.0) - wp.max(ROUNDING, UNSOLVED * tolerance)
            for row_index in range(solve_result.count[env]):
                row = rows[env, row_index]
                impulse = row.impulse
                along = wp.dot(impulse, row.normal)
                across = impulse - along * row.normal
                u_after = velocity_after(body_response, env, row.body_1, row.body_2, row.arm_1, row.arm_2)
                u_before = velocity_before(half_step_state, env, row.body_1, row.body_2, row.arm_1, row.arm_2)
                mean = real(0.5) * (u_after + u_before)
                by_impact -= wp.float64(along * wp.dot(mean, row.normal))
                by_friction -= wp.float64(wp.dot(across, mean))
                angular_impulse_1 = wp.cross(row.arm_1, impulse)
                angular_impulse_2 = wp.cross(row.arm_2, impulse)
                if wp.static(rolls):
                    spin_sum = spin_before(half_step_state, env, row.body_1, row.body_2)
                    spin_sum += spin_after(body_response, env, row.body_1, row.body_2)
                    by_friction -= wp.float64(real(0.5) * wp.dot(row.couple, spin_sum))
                    angular_impulse_1 += row.couple
                    angular_impulse_2 += row.couple
                add_wrench(reactions, env, row.body_1, per_second * impulse, per_second * angular_impulse_1)
                add_wrench(reactions, env, row.body_2, -per_second * impulse, -per_second * angular_impulse_2)
                parting = wp.dot(u_after, row.normal)
                limit = stick_fraction * row.mu * along
                stored = StoredImpulse()
                stored.impulse = impulse
                stored.couple = row.couple
                stored.normal = row.normal
                stored.approach_speed = -parting
                stored.slip_speed = wp.length(u_after - parting * row.normal)
                stored.held_gap = row.held_gap
                stored.mode = wp.int32(MODE_SLIP)
                if along <= real(0.0):
                    stored.mode = wp.int32(MODE_OPEN)
                elif limit > real(0.0) and wp.length_sq(across) < limit * limit:
                    stored.mode = wp.int32(MODE_STICK)
                stored.stamp = number
                # The mode selects the coefficient of friction of the next step.
                if (
                    stored.mode != stored_impulses[env, row.contact].mode
                    or stored_impulses[env, row.contact].stamp != number - 1
                ):
                    unchanged_steps = wp.int32(0)
                stored_impulses[env, row.contact] = stored
            statistics.unchanged_steps[env] = unchanged_steps
            statistics.friction_dissipation[env] = statistics.friction_dissipation[env] + by_friction
            statistics.impact_dissipation[env] = statistics.impact_dissipation[env] + by_impact

    return save_rows


@functools.cache
def display_contacts(real: type, Contacts: Any) -> wp.Kernel:
    """Returns the kernel that writes the impulses of the last step to the contact sensors of active environments.

    Items: nonsmooth contacts. ``Contacts`` is the struct of the contact arrays.
    """
    acting = acting_impulse(real)
    records = record_structs(real)
    StoredImpulses, StepStatistics, DisplayedImpulses = (
        records.StoredImpulses,
        records.StepStatistics,
        records.DisplayedImpulses,
    )

    @unique_kernel()
    def show_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        first: wp.int32,  # index of the first contact of the arrays
        items: wp.array(dtype=wp.int32),  # [item] nonsmooth contacts of the arrays
        stored_impulses: StoredImpulses,
        statistics: StepStatistics,
        contacts: Contacts,
        displayed: DisplayedImpulses,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            item = items[task_item(launch, task)]
            if status[env] != ENV_ACTIVE:
                continue
            contact = first + item
            stored = acting(stored_impulses, statistics, env, contact)
            along = wp.dot(stored.impulse, stored.normal)
            per_second = real(1.0) / step[env, 0]
            displayed.impulse[env, contact] = stored.impulse
            displayed.mode[env, contact] = stored.mode
            contacts.normal_force[env, item] = per_second * along
            contacts.friction_force[env, item] = per_second * (stored.impulse - along * stored.normal)
            contacts.torque[env, item] = per_second * stored.couple
            contacts.approach_speed[env, item] = stored.approach_speed
            contacts.slip_speed[env, item] = stored.slip_speed

    return show_contacts


@functools.cache
def display_particles(real: type) -> wp.Kernel:
    """Returns the kernel that writes the impulses of the last step to pair records.

    Launch with dim (env, particle). A pair with an impulse is reported as in contact, even if it has opened since.
    """
    acting = acting_impulse(real)
    p = particle_structs(real)
    records = record_structs(real)
    StoredImpulses, StepStatistics = records.StoredImpulses, records.StepStatistics

    @unique_kernel()
    def show_particles(
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        first: wp.int32,  # contact index of the first record
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        stored_impulses: StoredImpulses,
        statistics: StepStatistics,
        pair_records: p.PairRecords,
    ):
        env, particle = wp.tid()
        if pair_records.particle_flags[env, particle] == 0:
            return
        per_second = real(1.0) / step[env, 0]
        start = particles.slot_start[particle]
        for slot in range(start, start + neighbor_lists.owned[env, particle]):
            flags = pair_records.flags[env, slot]
            if flags == 0:
                continue
            stored = acting(stored_impulses, statistics, env, first + slot)
            force = per_second * stored.impulse
            if stored.mode != MODE_OPEN:
                pair_records.normal[env, slot] = stored.normal
                pair_records.flags[env, slot] = flags | IN_CONTACT
            pair_records.force[env, slot] = force
            pair_records.normal_force[env, slot] = wp.dot(force, stored.normal)
            pair_records.approach_speed[env, slot] = stored.approach_speed

    return show_particles


@functools.cache
def reaction_forces(real: type) -> wp.Kernel:
    """Returns the kernel that adds the mean forces of the last step to wrenches. Launch with dim (env, body)."""
    Wrenches = structs(real).Wrenches

    @unique_kernel()
    def add_reactions(reactions: Wrenches, wrenches: Wrenches):
        env, body = wp.tid()
        wrenches.force[env, body] = wrenches.force[env, body] + reactions.force[env, body]
        wrenches.torque[env, body] = wrenches.torque[env, body] + reactions.torque[env, body]

    return add_reactions


@functools.cache
def reset(real: type) -> wp.Kernel:
    """Returns the kernel that clears stored impulses of masked environments. Launch with dim env."""
    Wrenches = structs(real).Wrenches
    vec3 = structs(real).vec3
    SolveResult, StepStatistics = row_structs(real).SolveResult, record_structs(real).StepStatistics

    @unique_kernel(runs_rarely=True)
    def reset_statistics(
        mask: wp.array(dtype=wp.bool),
        all_statistics: wp.int32,  # 0: keep statistics, clear only the impulses
        bodies: wp.int32,
        solve_result: SolveResult,
        statistics: StepStatistics,
        reactions: Wrenches,
    ):
        env = wp.tid()
        if not mask[env]:
            return
        # No contact has the stamp of a step that has not been taken.
        statistics.step[env] = statistics.step[env] + 1
        statistics.unchanged_steps[env] = 0
        if all_statistics == 1:
            statistics.failures[env] = 0
            statistics.largest_residual[env] = real(0.0)
            statistics.restitution_limited[env] = 0
            statistics.friction_dissipation[env] = wp.float64(0.0)
            statistics.impact_dissipation[env] = wp.float64(0.0)
        solve_result.count[env] = 0
        solve_result.residual[env] = real(0.0)
        solve_result.iterations[env] = 0
        solve_result.converged[env] = 1
        for body in range(bodies):
            reactions.force[env, body] = vec3()
            reactions.torque[env, body] = vec3()

    return reset_statistics


@functools.cache
def skip_sleeping(real: type) -> wp.Kernel:
    """Returns the kernel that excludes sleeping environments from a step, except for their clocks; items: 1.

    Requires that all contacts are nonsmooth contacts with surfaces, and that there are no other force elements.
    """
    StepStatistics = record_structs(real).StepStatistics

    @unique_kernel()
    def skip_sleeping_environments(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        statistics: StepStatistics,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] == ENV_ACTIVE and statistics.unchanged_steps[env] == 2:
                time[env] = time[env] + step[env, 0]
                status[env] = ENV_SLEEPING

    return skip_sleeping_environments
