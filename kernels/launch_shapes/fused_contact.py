"""Contact detection and contact force in one kernel, one thread per set of contacts, on a CPU.

Uses the functions of ``contact_detection`` and ``contact_force``, without intermediate arrays. Contact sensors are
not written; their evaluation runs contact detection again.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.broadphase import contact_detection
from warpcontact.kernels.broadphase import motion_bound as travel
from warpcontact.kernels.contact import contact_force
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative, hide_from_optimizer
from warpcontact.kernels.lowlevel.static_strides import assume_strides
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase.closest_point import DETECT_ALL
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)


class Functions(NamedTuple):
    """Struct and device functions of a contact that is detected and evaluated in one kernel."""

    SetBodies: Struct  # frames and bodies of a set of contacts
    set_bodies_of: wp.Function  # frames and bodies of a set in a state
    detect_and_evaluate: wp.Function  # detection result of a contact and, if closed, its force
    clear_history: wp.Function  # clears the history variables of an open contact: ``contact_evaluation.Functions``


@functools.cache
def functions(contact_model: ContactModel, real: type, has_joints: bool, projected: bool, part: str) -> Functions:
    """Returns the structs and device functions of a contact; ``part``: see ``closest_point.functions``.

    The other arguments are those of ``contact_force.kernel``.
    """
    t = structs(real)
    vec3, quat, Model, State, History, Cache = t.vec3, t.quat, t.Model, t.State, t.History, t.Cache
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    detection = contact_detection.functions(real, False, part)
    SetFrames, frames_of_set, detect = detection.SetFrames, detection.frames_of_set, detection.detect
    contact_functions = contact_force.functions(contact_model, real, has_joints, projected)
    contact_wrench, clear_history = contact_functions.contact_wrench, contact_functions.clear_history
    frame = frames.functions(real)
    offset_between, orientation_to_world = frame.offset_between, frame.orientation_to_world
    needs_surface_axes = contact_model.needs_surface_axes

    @wp.struct
    class SetBodies:
        """Frames and bodies of a set of contacts."""

        set_frames: SetFrames
        body_1: wp.int32
        body_2: wp.int32
        offset_W: vec3  # from the center of mass of the surface's body to that of the points'
        q_WS: quat  # S → W, only if the models need it

    @wp.struct
    class ContactUpdate:
        """Result of detection and force of one contact in a step."""

        clearance: real  # displacement of its point without contact [m]
        status: wp.int32
        armed: wp.int32  # latch
        approach_speed: real  # [m/s]
        force: vec3  # on the point's body, W [N]; on the surface's the opposite
        torque_1: vec3  # on the point's body about its center of mass, W [N·m]
        torque_2: vec3  # on the surface's body, W [N·m]

    @wp.func
    def set_bodies_of(model: Model, state: State, env: int, set_index: int):
        set_bodies = SetBodies()
        set_bodies.set_frames = frames_of_set(model, state, env, set_index)
        contact = assume_nonnegative(model.set_contact[set_index])
        surface = assume_nonnegative(
            model.query_mesh_surface[assume_nonnegative(model.contact_query_mesh[contact])]
        )
        point = assume_nonnegative(model.contact_point[contact])
        set_bodies.body_1 = model.point_body[point]
        set_bodies.body_2 = model.surface_body[surface]
        set_bodies.offset_W = offset_between(model, state, env, point, surface)
        if wp.static(needs_surface_axes):
            set_bodies.q_WS = orientation_to_world(
                state, env, set_bodies.body_2, model.surface_orientation[env, surface]
            )
        return set_bodies

    @wp.func
    def detect_and_evaluate(
        model: Model,
        state: State,
        set_bodies: SetBodies,
        history: History,
        history_in: MaterialHistory,
        dt: real,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        env: int,
        contact: int,
        member: int,
    ):
        """Returns the detection result of a contact and, if closed, its force."""
        update = ContactUpdate()
        detected = detect(model, set_bodies.set_frames, history, True, cache, env, contact)
        update.clearance = detected.clearance
        update.status = detected.status
        update.armed = detected.armed
        # Early return: Warp evaluates both branches and copies every variable they assign.
        if detected.status != CONTACT:
            return update
        wrench = contact_wrench(
            model,
            state,
            history_in,
            dt,
            coefficients,
            history_out,
            env,
            contact,
            member,
            set_bodies.body_1,
            set_bodies.body_2,
            set_bodies.offset_W,
            set_bodies.q_WS,
            set_bodies.set_frames.R_WB,
            detected.arm,
            detected.normal,
            detected.penetration,
            history.entry_speed[env, contact],
        )
        update.approach_speed = wrench.approach_speed
        update.force = wrench.force
        update.torque_1 = wrench.torque_1
        update.torque_2 = wrench.torque_2
        return update

    return Functions(
        SetBodies=SetBodies,
        set_bodies_of=set_bodies_of,
        detect_and_evaluate=detect_and_evaluate,
        clear_history=clear_history,
    )


@functools.cache
def set_function(contact_model: ContactModel, real: type, has_joints: bool, projected: bool) -> wp.Function:
    """Returns the device function that evaluates a set of contacts on a CPU.

    It accumulates the motion bound of the set, evaluates contacts that cannot be culled, like
    ``contact_detection.kernel`` with ``cached``, and stores wrenches per cluster, like ``contact_force.kernel``
    with ``ordered``. It writes only what the rest of a step reads. Contacts that end get zero forces, because
    later evaluations skip them. For the arguments see ``contact_force.kernel``.
    """
    t = structs(real)
    vec3, Model, State, History = t.vec3, t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache = t.Contacts, t.ActiveContacts, t.Cache
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    contact_functions = functions(contact_model, real, has_joints, projected, DETECT_ALL)
    SetBodies, set_bodies_of, detect_and_evaluate = (
        contact_functions.SetBodies,
        contact_functions.set_bodies_of,
        contact_functions.detect_and_evaluate,
    )
    write_no_force = contact_force.functions(contact_model, real, has_joints, projected).write_no_force
    detection = contact_detection.functions(real, False, DETECT_ALL)
    probe_if_useful, cull_by_cluster, extend_safe_travel = (
        detection.probe_if_useful,
        detection.cull_by_cluster,
        detection.extend_safe_travel,
    )
    store_result, store_cluster_result = detection.store_result, detection.store_cluster_result
    accumulate_travel, is_culled = travel.functions(real).accumulate_travel, travel.functions(real).is_culled

    @wp.func
    def update_cluster(
        model: Model,
        state: State,
        set_bodies: SetBodies,
        history: History,
        history_in: MaterialHistory,
        dt: real,
        first_contact: int,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        env_index: int,
        cluster: int,
        travel: real,
        max_travel: real,
    ):
        env = hide_from_optimizer(env_index)
        start = assume_nonnegative(model.cluster_start[cluster])
        stop = model.cluster_start[cluster + 1]
        center_clearance = probe_if_useful(
            model, set_bodies.set_frames, cache, env, cluster, start, stop, travel, max_travel
        )
        culled_any = wp.bool(False)
        min_safe_travel = real(wp.inf)
        count = wp.int32(0)
        force = vec3()
        torque_1 = vec3()
        torque_2 = vec3()
        index = wp.int32(start)
        while index < stop:
            env = hide_from_optimizer(env_index)
            contact = assume_nonnegative(model.cluster_contact[index])
            index += 1
            if max_travel < cache.safe_travel[env, contact]:
                safe_travel = extend_safe_travel(
                    model, history, cache, env, cluster, contact, travel, center_clearance
                )
                min_safe_travel = wp.min(min_safe_travel, safe_travel)
            else:
                previous_status = contacts.status[env, contact]
                clearance = cull_by_cluster(
                    model, history, contacts, cache, env, cluster, contact, center_clearance
                )
                if clearance >= real(0.0):
                    culled_any = True
                else:
                    update = detect_and_evaluate(
                        model,
                        state,
                        set_bodies,
                        history,
                        history_in,
                        dt,
                        coefficients,
                        history_out,
                        cache,
                        env,
                        contact,
                        contact - first_contact,
                    )
                    clearance = update.clearance
                    contacts.status[env, contact] = update.status
                    contacts.armed[env, contact] = update.armed
                    if update.status == CONTACT:
                        contacts.approach_speed[env, contact] = update.approach_speed
                        force += update.force
                        torque_1 += update.torque_1
                        torque_2 += update.torque_2
                safe_travel = store_result(
                    history, contacts, cache, active_contacts, env, contact, travel, clearance, previous_status
                )
                min_safe_travel = wp.min(min_safe_travel, safe_travel)
            if active_contacts.needs_history[env, contact] != 0:
                active_contacts.contact[env, start + count] = contact
                count += 1
                if contacts.status[env, contact] != CONTACT:
                    contacts.penetration[env, contact] = real(0.0)
                    write_no_force(contacts, history_out, env, contact, contact - first_contact, dt)
        active_contacts.count[env, cluster] = count
        store_cluster_result(
            model, cache, env, cluster, start, stop, travel, center_clearance, culled_any, count, min_safe_travel
        )
        active_contacts.force[env, cluster] = force
        active_contacts.torque_1[env, cluster] = torque_1
        active_contacts.torque_2[env, cluster] = torque_2

    @wp.func
    def update_set(
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        dt: real,
        first_contact: int,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        env: int,
        set_index: int,
    ):
        max_travel = accumulate_travel(model, state, cache, env, set_index)
        cluster = assume_nonnegative(model.set_cluster_start[set_index])
        stop = model.set_cluster_start[set_index + 1]
        if is_culled(model, cache, env, set_index, max_travel):
            while cluster < stop:
                active_contacts.count[env, cluster] = 0
                cluster = assume_nonnegative(cluster + 1)
            return
        set_bodies = set_bodies_of(model, state, env, set_index)
        while cluster < stop:
            if max_travel < cache.cluster_safe_travel[env, cluster]:
                active_contacts.count[env, cluster] = 0
            else:
                update_cluster(
                    model,
                    state,
                    set_bodies,
                    history,
                    history_in,
                    dt,
                    first_contact,
                    coefficients,
                    history_out,
                    cache,
                    contacts,
                    active_contacts,
                    env,
                    cluster,
                    cache.set_travel[env, set_index],
                    max_travel,
                )
            cluster = assume_nonnegative(cluster + 1)

    return update_set


@functools.cache
def kernel(
    contact_model: ContactModel, real: type, has_joints: bool = False, projected: bool = False
) -> wp.Kernel:
    """Returns the kernel that evaluates sets of contacts on a CPU; items: sets of the group.

    For the arguments see ``contact_force.kernel``.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache = t.Contacts, t.ActiveContacts, t.Cache
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    update_set = set_function(contact_model, real, has_joints, projected)
    assume_model_strides, assume_state_strides, assume_history_strides = (
        assume_strides(Model),
        assume_strides(State),
        assume_strides(History),
    )
    assume_cache_strides, assume_contacts_strides, assume_active_strides = (
        assume_strides(Cache),
        assume_strides(Contacts),
        assume_strides(ActiveContacts),
    )
    assume_coefficient_strides = assume_strides(Coefficients)

    @unique_kernel()
    def update_sets(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        step: wp.array2d(dtype=real),  # [env, 0] step over which the force acts [s]
        first_set: wp.int32,
        first_contact: wp.int32,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
    ):
        assume_model_strides(model)
        assume_state_strides(state)
        assume_history_strides(history)
        assume_coefficient_strides(coefficients)
        assume_cache_strides(cache)
        assume_contacts_strides(contacts)
        assume_active_strides(active_contacts)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            set_index = assume_nonnegative(first_set + task_item(launch, task))
            if status[env] != ENV_ACTIVE:
                continue
            update_set(
                model,
                state,
                history,
                history_in,
                step[env, 0],
                first_contact,
                coefficients,
                history_out,
                cache,
                contacts,
                active_contacts,
                env,
                set_index,
            )

    return update_sets
