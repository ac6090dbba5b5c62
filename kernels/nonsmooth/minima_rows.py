"""Nonsmooth contact of spheres at all local minima of the distance: one row per minimum.

Minima with similar normals, such as those of neighboring facets, would make the contact problem nearly singular, and count as
one: the closest of them. A minimum that had a row in the last step is preferred, so that rounding does not exchange the row.
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.contact import minima_geometry
from warpcontact.kernels.contact.impulse_records import acting_impulse, record_structs
from warpcontact.kernels.contact.minima_records import minima_structs, slot_count
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase import closest_point
from warpcontact.kernels.nonsmooth.build_rows import add_row
from warpcontact.kernels.nonsmooth.rows import row_structs
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    HERTZ_TORSION,
    MODE_OPEN,
    MODE_SLIP,
    OPEN,
    LaunchRange,
    first_env,
    structs,
    task_count,
    task_env,
    task_item,
)

# Distance by which another minimum of a group must be closer to take over its row, relative to the radius. Far below the
# overlap that a step leaves, and above rounding in float32.
HYSTERESIS = 1.0e-4


@functools.cache
def kernel(real: type, room: int) -> wp.Kernel:
    """Returns the kernel that adds rows of contacts with up to ``room`` minima of a sphere; items: 1."""
    t = structs(real)
    vec3, Model, State, Contacts, ActiveContacts = t.vec3, t.Model, t.State, t.Contacts, t.ActiveContacts
    r, records = row_structs(real), record_structs(real)
    MinimaSettings, MinimaHistory, MinimaResults = minima_structs(real)
    slots = slot_count(room)
    apart = frames.functions(real).offset_between
    add = add_row(real)
    narrow = closest_point.functions(real, False, closest_point.DETECT_ALL)
    SetFrames, frames_of_set = narrow.SetFrames, narrow.frames_of_set
    geometry_functions = minima_geometry.functions(real, room)
    center_arm, center_in_mesh, find_minima = (
        geometry_functions.center_arm,
        geometry_functions.center_in_mesh,
        geometry_functions.find_minima,
    )
    contact_arm, match_slots = geometry_functions.contact_arm, geometry_functions.match_slots
    hysteresis = wp.constant(real(HYSTERESIS))

    @wp.func
    def drop_similar(
        history: MinimaHistory,
        env: int,
        first: int,
        settings: MinimaSettings,
        tolerance: real,
        count: int,
        distance: wp.array(dtype=real),
        normal: wp.array(dtype=vec3),
        slot: wp.array(dtype=wp.int32),
    ):
        """Sets ``slot`` of minima to −1 that have similar normals to a preferred one; ``tolerance``: see HYSTERESIS."""
        if settings.cosine_none >= real(1.0):
            return
        # Preferred minima first. A dropped one drops no others.
        preference = wp.zeros(shape=(room,), dtype=real)
        is_done = wp.zeros(shape=(room,), dtype=wp.int32)
        for i in range(count):
            preference[i] = distance[i]
            if history.entry_speed[env, first + slot[i]] >= real(0.0):
                preference[i] = distance[i] - tolerance
        for _ in range(count):
            best = wp.int32(-1)
            for i in range(count):
                if is_done[i] == 0:
                    if best < 0 or preference[i] < preference[best]:
                        best = i
            if best < 0:
                break
            for i in range(count):
                if i != best and is_done[i] == 0:
                    if wp.dot(normal[i], normal[best]) >= settings.cosine_one:
                        is_done[i] = 1
                        slot[i] = -1
            is_done[best] = 1

    @wp.func
    def clear_slot(results: MinimaResults, env: int, member: int):
        """Writes an empty slot."""
        results.touching[env, member] = 0
        results.approach_speed[env, member] = real(0.0)
        results.penetration[env, member] = real(0.0)
        results.normal[env, member] = vec3()

    @wp.func
    def add_minima(
        model: Model,
        state: State,
        set_frames: SetFrames,
        contacts: Contacts,
        settings: MinimaSettings,
        history: MinimaHistory,
        results: MinimaResults,
        material: records.NonsmoothMaterial,
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        rows: r.Rows,
        solve_result: r.SolveResult,
        env: int,
        contact: int,
        item: int,
        first_stored: int,
        body_1: int,
        body_2: int,
        apart_W: vec3,
        recovery: real,
    ):
        """Adds the minima of one contact, and writes its results."""
        first = item * wp.static(slots)
        for slot in range(wp.static(slots)):
            clear_slot(results, env, first + slot)
        results.count[env, item] = 0
        if contacts.status[env, contact] != CONTACT:
            return
        geometry = model.contact_geometry[env, contact]
        torsion_radius = geometry.torsion_radius
        if (model.contact_options[contact] & HERTZ_TORSION) != 0:
            # Rigid contact has no overlap and acts at a point.
            torsion_radius = real(0.0)
        p = center_in_mesh(set_frames, center_arm(model, set_frames, env, contact))
        distance = wp.zeros(shape=(room,), dtype=real)
        normal = wp.zeros(shape=(room,), dtype=vec3)
        position = wp.zeros(shape=(room,), dtype=vec3)
        faces = wp.zeros(shape=(room,), dtype=wp.int32)
        slots_of = wp.zeros(shape=(room,), dtype=wp.int32)
        reach = geometry.radius + geometry.contact_tolerance
        minima = find_minima(
            model, set_frames, contacts, env, contact, p, reach, distance, normal, position, faces
        )
        results.count[env, item] = minima.found
        if minima.kept == 0:
            # Only a position outside a boundary is within reach.
            contacts.status[env, contact] = OPEN
            contacts.penetration[env, contact] = real(0.0)
            contacts.gap[env, contact] = real(0.0)
            return
        match_slots(history, env, first, normal, position, minima.kept, slots_of)
        tolerance = hysteresis * geometry.radius * set_frames.inverse_scale
        drop_similar(history, env, first, settings, tolerance, minima.kept, distance, normal, slots_of)
        # In the order of the slots: the order of rows affects the iterations of a solver.
        for slot in range(wp.static(slots)):
            i = wp.int32(-1)
            for j in range(minima.kept):
                if slots_of[j] == slot:
                    i = j
            if i < 0:
                continue
            is_closest = i == 0 and minima.closest_counts
            normal_W = contacts.normal[env, contact]
            gap = contacts.gap[env, contact]
            if not is_closest:
                normal_W = set_frames.R_WS * normal[i]
                gap = set_frames.scale * distance[i] - geometry.radius
            arm_W = contact_arm(model, set_frames, contacts, env, contact, p, normal[i], position[i], is_closest)
            member = first + slot
            results.touching[env, member] = 1
            results.normal_S[env, member] = normal[i]
            results.position[env, member] = position[i]
            results.arm[env, member] = arm_W
            results.penetration[env, member] = wp.max(-gap, real(0.0))
            results.normal[env, member] = normal_W
            add(
                state, rows, solve_result, stored_impulses, statistics, env, first_stored + member, material,
                body_1, body_2, arm_W, apart_W + arm_W, normal_W, gap, -real(wp.inf), recovery,
                geometry.radius, torsion_radius,
            )  # fmt: skip

    @unique_kernel(unrolled=1)
    def add_minima_rows(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        clusters: wp.array(dtype=wp.int32),  # clusters of the group with nonsmooth contacts
        block_count: wp.int32,
        first_contact: wp.int32,  # first contact of the group
        first_stored: wp.int32,  # stored impulse of the first slot of the group
        settings: wp.array2d(dtype=MinimaSettings),
        minima: MinimaHistory,
        results: MinimaResults,
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
                set_frames = frames_of_set(model, state, env, model.cluster_set[cluster])
                for index in range(start, start + count):
                    contact = active_contacts.contact[env, index]
                    item = contact - first_contact
                    add_minima(
                        model, state, set_frames, contacts, settings[env, item], minima, results,
                        material[env, contact], stored_impulses, statistics, rows, solve_result, env, contact, item,
                        first_stored, model.point_body[point], model.surface_body[surface],
                        apart(model, state, env, point, surface), recovery,
                    )  # fmt: skip

    return add_minima_rows


@functools.cache
def display(real: type, room: int) -> wp.Kernel:
    """Returns the kernel that writes the impulses of the last step to the sensors of contacts and minima.

    Items: nonsmooth contacts of the group.
    """
    t = structs(real)
    vec3, Model, State, Contacts = t.vec3, t.Model, t.State, t.Contacts
    world_position = minima_geometry.functions(real, room).world_position
    acting = acting_impulse(real)
    records = record_structs(real)
    StoredImpulses, StepStatistics, DisplayedImpulses = (
        records.StoredImpulses,
        records.StepStatistics,
        records.DisplayedImpulses,
    )
    MinimaResults = minima_structs(real).MinimaResults
    slots = slot_count(room)

    @unique_kernel(unrolled=1)
    def show_minima(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        state: State,
        items: wp.array(dtype=wp.int32),  # [item] nonsmooth contacts of the group
        first_contact: wp.int32,
        first_stored: wp.int32,
        stored_impulses: StoredImpulses,
        statistics: StepStatistics,
        contacts: Contacts,
        results: MinimaResults,
        displayed: DisplayedImpulses,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = items[task_item(launch, task)]
            if status[env] != ENV_ACTIVE:
                continue
            per_second = real(1.0) / step[env, 0]
            impulse = vec3()
            across = vec3()
            couple = vec3()
            along = real(0.0)
            moment = vec3()
            approach_speed = real(0.0)
            slip_speed = real(0.0)
            # Slip if any minimum slips; stick if all that have an impulse stick.
            mode = wp.int32(MODE_OPEN)
            strongest = real(0.0)
            for slot in range(wp.static(slots)):
                member = (contact - first_contact) * wp.static(slots) + slot
                normal_force = real(0.0)
                stored = acting(stored_impulses, statistics, env, first_stored + member)
                if stored.mode != MODE_OPEN:
                    own = wp.dot(stored.impulse, stored.normal)
                    normal_force = per_second * own
                    impulse += stored.impulse
                    across += stored.impulse - own * stored.normal
                    couple += stored.couple
                    along += own
                    moment += own * results.arm[env, member]
                    if own > strongest:
                        strongest = own
                        approach_speed = stored.approach_speed
                        slip_speed = stored.slip_speed
                    if mode == MODE_OPEN or stored.mode == MODE_SLIP:
                        mode = stored.mode
                results.normal_force[env, member] = normal_force
            displayed.impulse[env, contact] = impulse
            displayed.mode[env, contact] = mode
            contacts.normal_force[env, contact] = per_second * along
            contacts.friction_force[env, contact] = per_second * across
            contacts.torque[env, contact] = per_second * couple
            contacts.approach_speed[env, contact] = approach_speed
            contacts.slip_speed[env, contact] = slip_speed
            results.force[env, contact - first_contact] = per_second * impulse
            center = wp.vec3d()
            if along > real(0.0):
                center = world_position(model, state, env, contact, moment / along)
            results.center[env, contact - first_contact] = center

    return show_minima
