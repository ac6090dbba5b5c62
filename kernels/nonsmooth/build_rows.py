"""Builds the contact problem of a step: one row per active contact, one thread per environment.

The warm start of a row is the impulse of the last step, if the contact was active in it.
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth.rows import row_structs
from warpcontact.kernels.particles.base import IN_CONTACT, particle_structs
from warpcontact.kernels.shapes.records import ContactShapes, ShapeContactSettings, shape_contact_structs
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    HERTZ_TORSION,
    MODE_SLIP,
    LaunchRange,
    first_env,
    structs,
    task_count,
)


@functools.cache
def add_row(real: type) -> wp.Function:
    """Returns the device function that adds a contact to the rows of its environment.

    Its arguments are ``(state, rows, solve_result, stored_impulses, statistics, env, contact, material, body_1,
    body_2, arm_1, arm_2, normal, gap, held_gap, recovery, radius, torsion_radius)``. ``state`` has the velocities before the
    step, from which restitution computes the approach speed. ``held_gap`` is the gap that other contacts of the same solids
    had kept, or −∞ [m]. ``recovery`` is the fraction of an overlap that is
    removed per second [1/s]. A gap that has become smaller since the contact closed is restored by ``lost_gaps.py``.
    """
    t = structs(real)
    vec3, State = t.vec3, t.State
    r, records = row_structs(real), record_structs(real)
    Row = r.Row
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def speed_of_arm(state: State, env: int, body: int, arm: vec3):
        """Returns the angular speed of a body times the length of an arm [m/s]."""
        if body < 0:
            return real(0.0)
        return wp.length(state.body_angular_velocity[env, body]) * wp.length(arm)

    @wp.func
    def add_row(
        state: State,
        rows: r.Rows,
        solve_result: r.SolveResult,
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        env: int,
        contact: int,
        material: records.NonsmoothMaterial,
        body_1: int,
        body_2: int,
        arm_1: vec3,
        arm_2: vec3,
        normal: vec3,
        gap: real,
        held_gap: real,
        recovery: real,
        radius: real,
        torsion_radius: real,
    ):
        new_row = Row()
        new_row.contact = contact
        new_row.body_1 = body_1
        new_row.body_2 = body_2
        new_row.arm_1 = arm_1
        new_row.arm_2 = arm_2
        new_row.normal = normal
        new_row.rolling = material.rolling * radius
        new_row.spinning = material.spinning * torsion_radius
        new_row.mu = material.mu_static
        new_row.is_new = 1
        new_row.held_gap = wp.max(wp.min(gap, real(0.0)), held_gap)
        if stored_impulses[env, contact].stamp == statistics.step[env]:
            new_row.is_new = 0
            new_row.impulse = stored_impulses[env, contact].impulse
            new_row.couple = stored_impulses[env, contact].couple
            if stored_impulses[env, contact].mode == MODE_SLIP:
                new_row.mu = material.mu_dynamic
            new_row.held_gap = wp.max(new_row.held_gap, stored_impulses[env, contact].held_gap)
        new_row.restitution = material.restitution
        if material.restitution > real(0.0):
            approach = velocity_at(state, env, body_2, arm_2) - velocity_at(state, env, body_1, arm_1)
            new_row.restitution_speed = material.restitution * wp.max(wp.dot(approach, normal), real(0.0))
        # Overlap up to g h² is not removed, so that a resting contact stays active.
        new_row.recovery = recovery * wp.max(-gap - solve_result.slack[env], real(0.0))
        lost_gap = new_row.held_gap - solve_result.slack[env] - gap
        if lost_gap > real(0.0):
            # Each step changes gaps by an error of second order in h.
            slip = velocity_at(state, env, body_1, arm_1) - velocity_at(state, env, body_2, arm_2)
            motion = speed_of_arm(state, env, body_1, arm_1) + speed_of_arm(state, env, body_2, arm_2)
            motion += wp.length(slip)
            new_row.lost_speed = wp.min(lost_gap / solve_result.step[env], motion)
            new_row.lost_speed = wp.max(new_row.lost_speed - new_row.recovery, real(0.0))
        if material.compliance > real(0.0):
            # A spring with the force −g/c at the end of the step.
            h = solve_result.step[env]
            new_row.softness = material.compliance / (h * h)
            new_row.recovery = -gap / h
            new_row.lost_speed = real(0.0)
            new_row.restitution = real(0.0)
            new_row.restitution_speed = real(0.0)
        row = solve_result.count[env]
        rows[env, row] = new_row
        solve_result.count[env] = row + 1

    return add_row


@functools.cache
def mesh_rows(real: type) -> wp.Kernel:
    """Returns the kernel that adds contacts with meshes; items: 1."""
    t = structs(real)
    Model, State, Contacts, ActiveContacts = t.Model, t.State, t.Contacts, t.ActiveContacts
    r, records = row_structs(real), record_structs(real)
    apart = frames.functions(real).offset_between
    add = add_row(real)

    @unique_kernel()
    def add_mesh_rows(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        clusters: wp.array(dtype=wp.int32),  # clusters of nonsmooth contacts
        block_count: wp.int32,
        recovery: real,  # [1/s]
        material: wp.array2d(dtype=records.NonsmoothMaterial),
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        rows: r.Rows,
        solve_result: r.SolveResult,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            for number in range(block_count):
                cluster = clusters[number]
                count = active_contacts.count[env, cluster]
                if count == 0:
                    continue
                start = model.cluster_start[cluster]
                contact = model.cluster_contact[start]
                surface = model.query_mesh_surface[model.contact_query_mesh[contact]]
                point = model.contact_point[contact]
                body_1 = model.point_body[point]
                body_2 = model.surface_body[surface]
                apart_W = apart(model, state, env, point, surface)
                for index in range(start, start + count):
                    contact = active_contacts.contact[env, index]
                    if contacts.status[env, contact] != CONTACT:
                        continue
                    geometry = model.contact_geometry[env, contact]
                    torsion_radius = geometry.torsion_radius
                    if (model.contact_options[contact] & HERTZ_TORSION) != 0:
                        # Rigid contact has no overlap and acts at a point.
                        torsion_radius = real(0.0)
                    arm_W = contacts.arm[env, contact]
                    add(
                        state, rows, solve_result, stored_impulses, statistics, env, contact,
                        material[env, contact],
                        body_1, body_2, arm_W, apart_W + arm_W, contacts.normal[env, contact],
                        contacts.gap[env, contact], -real(wp.inf), recovery, geometry.radius, torsion_radius,
                    )  # fmt: skip

    return add_mesh_rows


@functools.cache
def shape_rows(real: type, rolls: bool) -> wp.Kernel:
    """Returns the kernel that adds shape contacts of one group; items: 1.

    ``rolls``: whether the rolling radii of contacts are available.
    """
    State, ShapeContacts = structs(real).State, shape_contact_structs(real).ShapeContacts
    r, records = row_structs(real), record_structs(real)
    add = add_row(real)

    @unique_kernel()
    def collect_shape_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        state: State,
        first: wp.int32,  # index of the first contact of the group
        items: wp.array(dtype=wp.int32),  # nonsmooth contacts of the group
        item_count: wp.int32,
        contact_shapes: ContactShapes,
        settings: wp.array2d(dtype=ShapeContactSettings),
        shape_contacts: ShapeContacts,
        recovery: real,  # [1/s]
        material: wp.array2d(dtype=records.NonsmoothMaterial),
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        rows: r.Rows,
        solve_result: r.SolveResult,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            for index in range(item_count):
                item = items[index]
                # A compliant law that is switched on later starts at rest.
                shape_contacts.approach_speed[env, item] = real(0.0)
                if shape_contacts.status[env, item] != CONTACT:
                    continue
                radius = real(0.0)
                if wp.static(rolls):
                    radius = shape_contacts.radius[env, item]
                # Rigid contact has no overlap and acts at a point.
                torsion_radius = wp.max(real(settings[env, item].torsion_radius), real(0.0))
                contact = first + item
                add(
                    state, rows, solve_result, stored_impulses, statistics, env, contact,
                    material[env, contact], contact_shapes.body_a[item], contact_shapes.body_b[item],
                    shape_contacts.arm_a[env, item], shape_contacts.arm_b[env, item],
                    shape_contacts.normal[env, item], shape_contacts.gap[env, item], -real(wp.inf),
                    recovery, radius, torsion_radius,
                )  # fmt: skip

    return collect_shape_contacts


@functools.cache
def particle_rows(real: type) -> wp.Kernel:
    """Returns the kernel that adds particle pairs in the order of their records; items: 1."""
    State = structs(real).State
    p = particle_structs(real)
    Particles, NeighborLists, PairRecords = p.Particles, p.NeighborLists, p.PairRecords
    r, records = row_structs(real), record_structs(real)
    add = add_row(real)

    @unique_kernel()
    def add_particle_rows(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        state: State,
        particle_count: wp.int32,
        particles: Particles,
        neighbor_lists: NeighborLists,
        pair_records: PairRecords,
        first: wp.int32,  # contact index of the first record
        material_index: wp.int32,  # index of the material of all pairs
        recovery: real,  # [1/s]
        material: wp.array2d(dtype=records.NonsmoothMaterial),
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        rows: r.Rows,
        solve_result: r.SolveResult,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            pair_material = material[env, material_index]
            # Rigid contact has no overlap and acts at a point.
            torsion_radius = wp.max(particles.settings[env, 0].torsion_radius, real(0.0))
            for particle in range(particle_count):
                if (pair_records.particle_flags[env, particle] & IN_CONTACT) == 0:
                    continue
                start = particles.entry_start[particle]
                slot = particles.slot_start[particle]
                for k in range(neighbor_lists.owned[env, particle]):
                    if (pair_records.flags[env, slot + k] & IN_CONTACT) == 0:
                        continue
                    neighbor = neighbor_lists.neighbor[env, start + k]
                    body_1 = particles.body[wp.min(particle, neighbor)]
                    body_2 = particles.body[wp.max(particle, neighbor)]
                    separation = state.body_position[env, body_1] - state.body_position[env, body_2]
                    separation += (
                        state.body_position_remainder[env, body_1] - state.body_position_remainder[env, body_2]
                    )
                    arm = pair_records.arm[env, slot + k]
                    radius_1 = particles.radius[env, particle]
                    radius_2 = particles.radius[env, neighbor]
                    add(
                        state, rows, solve_result, stored_impulses, statistics, env, first + slot + k,
                        pair_material, body_1, body_2, arm, separation + arm,
                        pair_records.normal[env, slot + k], pair_records.gap[env, slot + k], -real(wp.inf), recovery,
                        radius_1 * radius_2 / (radius_1 + radius_2), torsion_radius,
                    )  # fmt: skip

    return add_particle_rows
