"""Contact forces of a group of spheres at all local minima of the distance, summed per cluster.

Variant of ``contact_force.py``. The narrow phase finds the closest point of the surface, which is the deepest minimum and
decides whether there is contact. The other minima within reach are found here (``distance_minima.py``). Each one has its
own force and history. Minima with similar normals share the force of one contact.
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.contact import contact_force, minima_geometry
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.contact.minima_records import minima_structs, slot_count
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase import closest_point, distance_minima
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    OPEN,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)


@functools.cache
def kernel(contact_model: ContactModel, real: type, room: int, has_joints: bool = False) -> wp.Kernel:
    """Returns the force kernel for up to ``room`` minima of a sphere; items: clusters of the group.

    The other arguments, and those of the kernel, are those of ``contact_force.kernel``.
    """
    t = structs(real)
    vec3, quat, Model, State = t.vec3, t.quat, t.Model, t.State
    Contacts, ActiveContacts, Wrenches = t.Contacts, t.ActiveContacts, t.Wrenches
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    MinimaSettings, MinimaHistory, MinimaResults = minima_structs(real)
    slots = slot_count(room)
    contact_functions = contact_force.functions(contact_model, real, has_joints, False, slots)
    ContactWrench, contact_wrench = contact_functions.ContactWrench, contact_functions.contact_wrench
    clear_history, add_wrench = contact_functions.clear_history, contact_functions.add_wrench
    needs_surface_axes = contact_model.needs_surface_axes
    frame = frames.functions(real)
    orientation_to_world, offset_between = frame.orientation_to_world, frame.offset_between
    narrow = closest_point.functions(real, False, closest_point.DETECT_ALL)
    SetFrames, frames_of_set = narrow.SetFrames, narrow.frames_of_set
    geometry_functions = minima_geometry.functions(real, room)
    center_arm, center_in_mesh, find_minima = (
        geometry_functions.center_arm,
        geometry_functions.center_in_mesh,
        geometry_functions.find_minima,
    )
    contact_arm, match_slots = geometry_functions.contact_arm, geometry_functions.match_slots
    world_position = geometry_functions.world_position
    share = distance_minima.functions(real, room).share

    @wp.func
    def clear_slot(
        results: MinimaResults,
        history_out: MaterialHistory,
        env: int,
        member: int,
        armed: int,
        dt: real,
    ):
        """Writes an empty slot."""
        results.touching[env, member] = 0
        results.approach_speed[env, member] = real(0.0)
        results.penetration[env, member] = real(0.0)
        results.normal[env, member] = vec3()
        results.normal_force[env, member] = real(0.0)
        clear_history(history_out, env, member, armed, dt)

    @wp.func
    def write_sums(
        contacts: Contacts,
        results: MinimaResults,
        env: int,
        contact: int,
        item: int,
        found: int,
        total: ContactWrench,
        center: wp.vec3d,
    ):
        """Writes the number of minima and the sums of their forces."""
        contacts.approach_speed[env, contact] = total.approach_speed
        contacts.slip_speed[env, contact] = total.slip_speed
        contacts.normal_force[env, contact] = total.normal_force
        contacts.friction_force[env, contact] = total.friction_force
        contacts.torque[env, contact] = total.torque
        results.count[env, item] = found
        results.force[env, item] = total.force
        results.center[env, item] = center

    @wp.func
    def evaluate_minima(
        model: Model,
        state: State,
        history: MinimaHistory,
        history_in: MaterialHistory,
        dt: real,
        coefficients: Coefficients,
        settings: wp.array2d(dtype=MinimaSettings),
        contacts: Contacts,
        results: MinimaResults,
        history_out: MaterialHistory,
        env: int,
        contact: int,
        item: int,
        body_1: int,
        body_2: int,
        offset_W: vec3,
        q_WS: quat,
        set_frames: SetFrames,
    ):
        """Returns the sum of the wrenches of all minima of a contact, and writes its results."""
        total = ContactWrench()
        first = item * wp.static(slots)
        armed = contacts.armed[env, contact]
        if contacts.status[env, contact] != CONTACT:
            for slot in range(wp.static(slots)):
                clear_slot(results, history_out, env, first + slot, armed, dt)
            write_sums(contacts, results, env, contact, item, 0, total, wp.vec3d())
            return total
        geometry = model.contact_geometry[env, contact]
        radius = geometry.radius
        p = center_in_mesh(set_frames, center_arm(model, set_frames, env, contact))
        distance = wp.zeros(shape=(room,), dtype=real)
        penetration = wp.zeros(shape=(room,), dtype=real)
        normal = wp.zeros(shape=(room,), dtype=vec3)
        position = wp.zeros(shape=(room,), dtype=vec3)
        rows = wp.zeros(shape=(room,), dtype=wp.int32)
        slots_of = wp.zeros(shape=(room,), dtype=wp.int32)
        minima = find_minima(
            model, set_frames, contacts, env, contact, p, radius, distance, normal, position, rows
        )
        if minima.closest_counts:
            penetration[0] = contacts.penetration[env, contact]
        count = wp.int32(0)
        for i in range(minima.kept):
            if i > 0 or not minima.closest_counts:
                penetration[i] = radius - set_frames.scale * distance[i]
            # The last ones can be open by rounding.
            if penetration[i] > real(0.0):
                count = i + 1
        match_slots(history, env, first, normal, position, count, slots_of)
        cosines = settings[env, item]
        moment = vec3()
        # In the order of the slots, so that the sum does not depend on which of two minima is deeper by rounding.
        for slot in range(wp.static(slots)):
            member = first + slot
            i = wp.int32(-1)
            for j in range(count):
                if slots_of[j] == slot:
                    i = j
            if i < 0:
                clear_slot(results, history_out, env, member, armed, dt)
                continue
            is_closest = i == 0 and minima.closest_counts
            normal_W = contacts.normal[env, contact]
            if not is_closest:
                normal_W = set_frames.R_WS * normal[i]
            arm = contact_arm(model, set_frames, contacts, env, contact, p, normal[i], position[i], is_closest)
            wrench = contact_wrench(
                model, state, history_in, dt, coefficients, history_out, env, contact, member, body_1, body_2,
                offset_W, q_WS, set_frames.R_WB, arm, normal_W, penetration[i], history.entry_speed[env, member],
            )  # fmt: skip
            part = share(penetration, normal, count, i, cosines.cosine_one, cosines.cosine_none)
            results.touching[env, member] = 1
            results.approach_speed[env, member] = wrench.approach_speed
            results.normal_S[env, member] = normal[i]
            results.position[env, member] = position[i]
            results.penetration[env, member] = penetration[i]
            results.normal[env, member] = normal_W
            results.normal_force[env, member] = part * wrench.normal_force
            if i == 0:
                total.approach_speed = wrench.approach_speed
                total.slip_speed = wrench.slip_speed
            results.arm[env, member] = arm
            moment += (part * wrench.normal_force) * arm
            total.normal_force += part * wrench.normal_force
            total.friction_force += part * wrench.friction_force
            total.torque += part * wrench.torque
            total.force += part * wrench.force
            total.torque_1 += part * wrench.torque_1
            total.torque_2 += part * wrench.torque_2
        if count == 0:
            # Only a position outside a boundary is within reach.
            contacts.status[env, contact] = OPEN
            contacts.penetration[env, contact] = real(0.0)
            contacts.gap[env, contact] = real(0.0)
        center = wp.vec3d()
        if count > 0:
            # The point of the closest minimum if the forces have no center.
            mean_arm = results.arm[env, first + slots_of[0]]
            if total.normal_force > real(0.0):
                mean_arm = moment / total.normal_force
            center = world_position(model, state, env, contact, mean_arm)
        write_sums(contacts, results, env, contact, item, minima.found, total, center)
        return total

    # Without unrolling: the loop over slots contains the whole evaluation of a contact.
    @unique_kernel(unrolled=1)
    def minima_force(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history_in: MaterialHistory,
        step: wp.array2d(dtype=real),  # [env, 0] step over which the force acts [s]; 0: force at this instant
        first_cluster: wp.int32,
        first_contact: wp.int32,
        coefficients: Coefficients,
        contacts: Contacts,
        history_out: MaterialHistory,
        active_contacts: ActiveContacts,
        ordered: wp.bool,
        wrenches: Wrenches,
        settings: wp.array2d(dtype=MinimaSettings),
        minima: MinimaHistory,
        results: MinimaResults,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = first_cluster + task_item(launch, task)
            if status[env] != ENV_ACTIVE or active_contacts.count[env, cluster] == 0:
                continue
            start = assume_nonnegative(model.cluster_start[cluster])
            contact = assume_nonnegative(model.cluster_contact[start])
            surface = assume_nonnegative(
                model.query_mesh_surface[assume_nonnegative(model.contact_query_mesh[contact])]
            )
            point = assume_nonnegative(model.contact_point[contact])
            body_1 = model.point_body[point]
            body_2 = model.surface_body[surface]
            offset_W = offset_between(model, state, env, point, surface)
            set_frames = frames_of_set(model, state, env, assume_nonnegative(model.cluster_set[cluster]))
            q_WS = quat()
            if wp.static(needs_surface_axes):
                q_WS = orientation_to_world(state, env, body_2, model.surface_orientation[env, surface])
            dt = step[env, 0]
            force = vec3()
            torque_1 = vec3()
            torque_2 = vec3()
            for index in range(start, start + active_contacts.count[env, cluster]):
                contact = assume_nonnegative(active_contacts.contact[env, index])
                wrench = evaluate_minima(
                    model, state, minima, history_in, dt, coefficients, settings, contacts, results, history_out,
                    env, contact, contact - first_contact, body_1, body_2, offset_W, q_WS, set_frames,
                )  # fmt: skip
                force += wrench.force
                torque_1 += wrench.torque_1
                torque_2 += wrench.torque_2
            if ordered:
                active_contacts.force[env, cluster] = force
                active_contacts.torque_1[env, cluster] = torque_1
                active_contacts.torque_2[env, cluster] = torque_2
            else:
                add_wrench(wrenches, env, body_1, force, torque_1)
                add_wrench(wrenches, env, body_2, -force, torque_2)

    return minima_force
