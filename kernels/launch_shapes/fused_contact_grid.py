"""Contact detection with a face grid and contact force in one kernel, for sets of one contact, on a GPU.

Uses the functions of ``contact_detection_grid`` and ``contact_force``, without intermediate arrays. Contact
sensors are not written. Inactive contacts write only their count.
"""

import functools

import warp as wp
from warpcontact.kernels.broadphase import contact_detection
from warpcontact.kernels.contact import contact_force
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.launch_shapes import fused_contact
from warpcontact.kernels.lowlevel import warps
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase.closest_point import DEFERRED, DETECT_GRID_ANY, DETECT_GRID_FAR, DETECT_QUERY
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item

# Register limit per GPU thread in float32 (measured).
REGISTERS = 96


@functools.cache
def _evaluate_cluster(
    contact_model: ContactModel, real: type, has_joints: bool, projected: bool, part: str
) -> wp.Function:
    """Returns the device function that evaluates the contact of a cluster and adds its wrench."""
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache, Wrenches = t.Contacts, t.ActiveContacts, t.Cache, t.Wrenches
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    contact_functions = fused_contact.functions(contact_model, real, has_joints, projected, part)
    set_bodies_of, detect_and_evaluate, clear_history = (
        contact_functions.set_bodies_of,
        contact_functions.detect_and_evaluate,
        contact_functions.clear_history,
    )
    add_wrench = contact_force.functions(contact_model, real, has_joints, projected).add_wrench
    needs_history = contact_detection.functions(real, False, part).needs_history

    @wp.func
    def evaluate_cluster(
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        dt: real,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        ordered: bool,
        wrenches: Wrenches,
        env: int,
        cluster: int,
    ):
        """Returns whether the contact was evaluated; if not, it needs a BVH search."""
        index = assume_nonnegative(model.cluster_start[cluster])
        contact = assume_nonnegative(model.cluster_contact[index])
        set_bodies = set_bodies_of(model, state, env, assume_nonnegative(model.cluster_set[cluster]))
        # Read early: directly before the write the thread would wait for this cache line.
        previous_status = contacts.status[env, contact]
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
            contact,
        )
        if wp.static(part == DETECT_GRID_FAR):
            if update.clearance == real(DEFERRED):
                return False
        # A contact that was inactive and still is needs no other write. An evaluation for sensors may have listed
        # it.
        if update.status != CONTACT and cache.cluster_inactive[env, cluster] != 0:
            if update.armed == history.armed[env, contact]:
                active_contacts.count[env, cluster] = 0
                return True
        contacts.status[env, contact] = update.status
        contacts.armed[env, contact] = update.armed
        needed = needs_history(contacts, history, env, contact, previous_status)
        active_contacts.needs_history[env, contact] = needed
        active_contacts.contact[env, index] = contact
        active_contacts.count[env, cluster] = needed
        cache.cluster_inactive[env, cluster] = 1 - needed
        if update.status == CONTACT:
            contacts.approach_speed[env, contact] = update.approach_speed
        elif needed != 0:
            clear_history(history_out, env, contact, update.armed, dt)
        if ordered:
            active_contacts.force[env, cluster] = update.force
            active_contacts.torque_1[env, cluster] = update.torque_1
            active_contacts.torque_2[env, cluster] = update.torque_2
        elif update.status == CONTACT:
            add_wrench(wrenches, env, set_bodies.body_1, update.force, update.torque_1)
            add_wrench(wrenches, env, set_bodies.body_2, -update.force, update.torque_2)
        return True

    return evaluate_cluster


@functools.cache
def kernel(
    contact_model: ContactModel, real: type, has_joints: bool, projected: bool, search_now: bool
) -> wp.Kernel:
    """Returns the kernel that evaluates clusters of one contact; items: clusters.

    With ``search_now``, contacts that the face grid does not decide are queried here, not in ``remaining``. The
    other arguments are those of ``contact_force.kernel``.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache, Wrenches = t.Contacts, t.ActiveContacts, t.Cache, t.Wrenches
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    evaluate_cluster = _evaluate_cluster(
        contact_model, real, has_joints, projected, DETECT_GRID_ANY if search_now else DETECT_GRID_FAR
    )
    registers = REGISTERS if real is wp.float32 else None

    @unique_kernel(registers)
    def fused_in_grid(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        step: wp.array2d(dtype=real),  # [env, 0] step over which the force acts [s]
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        ordered: wp.bool,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            detected_now = evaluate_cluster(
                model,
                state,
                history,
                history_in,
                step[env, 0],
                coefficients,
                history_out,
                cache,
                contacts,
                active_contacts,
                ordered,
                wrenches,
                env,
                cluster,
            )
            if not detected_now:
                cache.queue_clusters[wp.atomic_add(cache.queue_count, 0, 1)] = task

    return fused_in_grid


@functools.cache
def remaining(contact_model: ContactModel, real: type, has_joints: bool, projected: bool) -> wp.Kernel:
    """Returns the kernel that evaluates the contacts deferred by ``kernel``; items: clusters."""
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache, Wrenches = t.Contacts, t.ActiveContacts, t.Cache, t.Wrenches
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    evaluate_cluster = _evaluate_cluster(contact_model, real, has_joints, projected, DETECT_QUERY)

    @unique_kernel()
    def fused_remaining(
        launch: LaunchRange,
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        step: wp.array2d(dtype=real),  # [env, 0] step over which the force acts [s]
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        ordered: wp.bool,
        wrenches: Wrenches,
    ):
        for i in range(warps.interleave_warps(wp.tid(), launch.threads), cache.queue_count[0], launch.threads):
            task = cache.queue_clusters[i]
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            evaluate_cluster(
                model,
                state,
                history,
                history_in,
                step[env, 0],
                coefficients,
                history_out,
                cache,
                contacts,
                active_contacts,
                ordered,
                wrenches,
                env,
                cluster,
            )

    return fused_remaining
