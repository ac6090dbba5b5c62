"""Contact detection if all query meshes have face grids.

The cell of a point (``face_grid.py``) gives its clearance, or the few faces that may be nearest. Contacts that no
cell decides, deep inside or outside the boundary of an open surface, are searched with the BVH, on a GPU in a
second launch (``remaining``). No face lists or safe travels are cached; only inactive clusters are marked.
"""

import functools

import warp as wp
from warpcontact.kernels.broadphase import contact_detection
from warpcontact.kernels.lowlevel import warps
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase.closest_point import DEFERRED, DETECT_GRID_ANY, DETECT_GRID_FAR, DETECT_QUERY
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item

# Value of ``ActiveContacts.needs_history`` of a contact that the second launch evaluates.
NEEDS_SEARCH = 2
# Register limit per GPU thread in float32 (measured): with fewer registers more threads are resident, which hides
# memory latency.
REGISTERS = 80


@functools.cache
def _compact_function(real: type) -> wp.Function:
    """Returns the device function that lists the contacts of a cluster."""
    t = structs(real)
    Model, ActiveContacts = t.Model, t.ActiveContacts

    @wp.func
    def compact(model: Model, active_contacts: ActiveContacts, env: int, cluster: int):
        """Lists the contacts of a cluster that need later stages, in their order; returns their number."""
        start = assume_nonnegative(model.cluster_start[cluster])
        count = wp.int32(0)
        for index in range(start, model.cluster_start[cluster + 1]):
            contact = assume_nonnegative(model.cluster_contact[index])
            if active_contacts.needs_history[env, contact] != 0:
                active_contacts.contact[env, start + count] = contact
                count += 1
        active_contacts.count[env, cluster] = count
        return count

    return compact


@functools.cache
def kernel(real: type, tracks: bool, width: int, search_now: bool) -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` and ``active_contacts`` from ``state``; items: clusters.

    Args:
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        tracks: Whether any contact is latched or swept and so tracks the face that it touched.
        width: Threads per cluster on a GPU, a power of two, one per contact. 0: one thread per cluster.
        search_now: Whether to query the BVH in this kernel instead of deferring contacts to ``remaining``.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache = t.Contacts, t.ActiveContacts, t.Cache
    detection = contact_detection.functions(real, tracks, DETECT_GRID_ANY if search_now else DETECT_GRID_FAR)
    frames_of_set, cluster_clearance = detection.frames_of_set, detection.cluster_clearance
    compact = _compact_function(real)
    detect, write_contact, needs_history = detection.detect, detection.write_contact, detection.needs_history
    contact_clearance, can_cull = detection.contact_clearance, detection.can_cull
    SetFrames, DetectedContact, mark_far = detection.SetFrames, detection.DetectedContact, detection.mark_far
    registers = REGISTERS if width and not search_now and real is wp.float32 else None

    @wp.func
    def is_clear(model: Model, history: History, env: int, cluster: int, contact: int, center_clearance: real):
        """Returns whether the clearance at the cluster center shows that a contact is far on the outer side."""
        if not (center_clearance > real(0.0)) or not can_cull(model, history, env, contact):
            return False
        return contact_clearance(model, env, cluster, contact, center_clearance) > real(0.0)

    @wp.func
    def classify_contact(
        model: Model,
        set_frames: SetFrames,
        history: History,
        contacts: Contacts,
        cache: Cache,
        active_contacts: ActiveContacts,
        env: int,
        cluster: int,
        contact: int,
        center_clearance: real,
        was_inactive: bool,
    ):
        """Evaluates a contact; returns 1 if later stages must process it, 0 if not, or ``NEEDS_SEARCH``."""
        result = wp.static(NEEDS_SEARCH)
        # Read early: directly before the write the thread would wait for this cache line.
        previous_status = contacts.status[env, contact]
        clearance = is_clear(model, history, env, cluster, contact, center_clearance)
        detected = DetectedContact()
        if not clearance:
            detected = detect(model, set_frames, history, True, cache, env, contact)
        if clearance or detected.clearance != real(DEFERRED):
            # A contact that was inactive and still is needs no write.
            if (
                was_inactive
                and not detected.has_details
                and (clearance or detected.armed == history.armed[env, contact])
            ):
                return 0
            if clearance:
                mark_far(contacts, env, contact)
            else:
                write_contact(detected, contacts, env, contact)
            result = needs_history(contacts, history, env, contact, previous_status)
        active_contacts.needs_history[env, contact] = result
        return result

    @unique_kernel(registers)
    def detect_in_grid(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
    ):
        if wp.static(width == 0):
            for task in range(wp.tid(), task_count(launch), launch.threads):
                env = task_env(launch, task)
                cluster = task_item(launch, task)
                if status[env] != ENV_ACTIVE:
                    continue
                was_inactive = cache.cluster_inactive[env, cluster] != 0
                set_frames = frames_of_set(model, state, env, assume_nonnegative(model.cluster_set[cluster]))
                start = assume_nonnegative(model.cluster_start[cluster])
                stop = model.cluster_start[cluster + 1]
                center_clearance = real(-1.0)
                if stop - start > 1:
                    center_clearance = cluster_clearance(model, set_frames, cache, env, cluster)
                deferred = wp.bool(False)
                for index in range(start, stop):
                    contact = assume_nonnegative(model.cluster_contact[index])
                    outcome = classify_contact(
                        model,
                        set_frames,
                        history,
                        contacts,
                        cache,
                        active_contacts,
                        env,
                        cluster,
                        contact,
                        center_clearance,
                        was_inactive,
                    )
                    deferred = deferred or outcome == wp.static(NEEDS_SEARCH)
                if deferred:
                    cache.queue_clusters[wp.atomic_add(cache.queue_count, 0, 1)] = task
                else:
                    cache.cluster_inactive[env, cluster] = wp.where(
                        compact(model, active_contacts, env, cluster) == 0, 1, 0
                    )
        else:
            # A warp holds whole clusters. All its lanes must reach the ballots below, so there is no early exit.
            task = assume_nonnegative(wp.tid()) // wp.static(max(1, width))
            lane = assume_nonnegative(wp.tid()) % wp.static(max(1, width))
            has_task = task < task_count(launch)
            env = wp.int32(0)
            cluster = wp.int32(0)
            if has_task:
                env = task_env(launch, task)
                cluster = task_item(launch, task)
                has_task = status[env] == ENV_ACTIVE
            outcome = wp.int32(0)
            start = wp.int32(0)
            contact = wp.int32(0)
            if has_task:
                start = assume_nonnegative(model.cluster_start[cluster])
                if start + lane < model.cluster_start[cluster + 1]:
                    contact = assume_nonnegative(model.cluster_contact[start + lane])
                    set_frames = frames_of_set(model, state, env, assume_nonnegative(model.cluster_set[cluster]))
                    center_clearance = real(-1.0)
                    if wp.static(width > 1):
                        center_clearance = cluster_clearance(model, set_frames, cache, env, cluster)
                    was_inactive = cache.cluster_inactive[env, cluster] != 0
                    outcome = classify_contact(
                        model,
                        set_frames,
                        history,
                        contacts,
                        cache,
                        active_contacts,
                        env,
                        cluster,
                        contact,
                        center_clearance,
                        was_inactive,
                    )
            deferred = wp.bool(outcome == wp.static(NEEDS_SEARCH))
            active_bits = wp.where(outcome == 1, 1, 0)
            if wp.static(width > 1):
                first = warps.lane() - lane
                deferred = warps.bit_range(warps.ballot(deferred), first, wp.static(width)) != 0
                active_bits = warps.bit_range(warps.ballot(outcome == 1), first, wp.static(width))
            if has_task and not deferred:
                if outcome == 1:
                    active_contacts.contact[env, start + warps.popcount(warps.bit_range(active_bits, 0, lane))] = (
                        contact
                    )
                if lane == 0:
                    active_contacts.count[env, cluster] = warps.popcount(active_bits)
                    cache.cluster_inactive[env, cluster] = wp.where(active_bits == 0, 1, 0)
            if has_task and deferred and lane == 0:
                cache.queue_clusters[wp.atomic_add(cache.queue_count, 0, 1)] = task

    return detect_in_grid


@functools.cache
def remaining(real: type, tracks: bool) -> wp.Kernel:
    """Returns the kernel that evaluates the contacts deferred by ``kernel``; items: clusters."""
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache = t.Contacts, t.ActiveContacts, t.Cache
    detection = contact_detection.functions(real, tracks, DETECT_QUERY)
    frames_of_set, update_contact, needs_history = (
        detection.frames_of_set,
        detection.update_contact,
        detection.needs_history,
    )
    compact = _compact_function(real)

    @unique_kernel()
    def detect_remaining(
        launch: LaunchRange,
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
    ):
        for i in range(warps.interleave_warps(wp.tid(), launch.threads), cache.queue_count[0], launch.threads):
            task = cache.queue_clusters[i]
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            set_frames = frames_of_set(model, state, env, assume_nonnegative(model.cluster_set[cluster]))
            for index in range(model.cluster_start[cluster], model.cluster_start[cluster + 1]):
                contact = assume_nonnegative(model.cluster_contact[index])
                if active_contacts.needs_history[env, contact] == wp.static(NEEDS_SEARCH):
                    previous_status = contacts.status[env, contact]
                    update_contact(model, set_frames, history, contacts, True, cache, env, contact)
                    active_contacts.needs_history[env, contact] = needs_history(
                        contacts, history, env, contact, previous_status
                    )
            compact(model, active_contacts, env, cluster)
            cache.cluster_inactive[env, cluster] = 0

    return detect_remaining
