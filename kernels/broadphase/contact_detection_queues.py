"""Contact detection on a GPU with work queues, so that neighboring threads do the same kind of work.

``enqueue`` puts contacts that cannot be culled into the first queue and clusters without cached faces into a queue
of their own. ``probe_clusters`` culls contacts of these clusters by the clearance at the center. ``process``
evaluates one queue and passes contacts that it cannot decide to the next: cached nearest face, cached candidates,
BVH search; or, with a face grid, the cell of the point, then a BVH search. ``compact`` lists the active contacts
of each cluster. Results equal those of ``contact_detection.py``.
"""

import functools

import warp as wp
from warpcontact.kernels.broadphase import contact_detection
from warpcontact.kernels.lowlevel import warps
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase.closest_point import (
    DEFERRED,
    DETECT_BVH,
    DETECT_CACHED,
    DETECT_CANDIDATES,
    DETECT_FACE_CACHE,
    DETECT_GRID,
    DETECT_QUERY,
)
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, first_env, structs, task_count, task_env, task_item

# Queue index of each part of the narrow phase. Queue 0 holds the clusters to probe.
QUEUE_INDEX = {
    DETECT_CACHED: 1,
    DETECT_FACE_CACHE: 1,
    DETECT_GRID: 1,
    DETECT_CANDIDATES: 2,
    DETECT_BVH: 3,
    DETECT_QUERY: 3,
}
# Register limit of the search in float32, which would use 200. With 128, an H200 holds all its threads
# (``execution_plan.SEARCH_THREADS``) at the same time. They wait for memory most of the time.
SEARCH_REGISTERS = 128
# Register limit of the evaluation of a grid cell, for the same reason.
CELL_REGISTERS = 112


@functools.cache
def _push(real: type) -> wp.Function:
    Cache = structs(real).Cache

    @wp.func
    def push(cache: Cache, queue: int, task: int):
        cache.queue_contacts[queue, wp.atomic_add(cache.queue_count, queue, 1)] = task

    return push


@functools.cache
def enqueue(real: type, tracks: bool) -> wp.Kernel:
    """Returns the kernel that puts contacts that cannot be culled into the first queue; items: clusters."""
    t = structs(real)
    Model, Cache = t.Model, t.Cache
    has_uncached = contact_detection.functions(real, tracks, DETECT_CACHED).has_uncached
    push = _push(real)

    @unique_kernel()
    def enqueue_contacts(
        launch: LaunchRange, contacts: wp.int32, status: wp.array(dtype=wp.int32), model: Model, cache: Cache
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            local_env = task // launch.items
            env = first_env(launch) + local_env
            cluster = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            set_index = model.cluster_set[cluster]
            max_travel = cache.set_travel[env, set_index] + cache.set_margin[env, set_index]
            if cache.set_culled[env, set_index] != 0 or max_travel < cache.cluster_safe_travel[env, cluster]:
                continue
            start = model.cluster_start[cluster]
            stop = model.cluster_start[cluster + 1]
            if stop - start > 1:
                if has_uncached(model, cache, env, start, stop, max_travel):
                    cache.queue_clusters[wp.atomic_add(cache.queue_count, 0, 1)] = task
                    continue
            for index in range(start, stop):
                contact = model.cluster_contact[index]
                if not (max_travel < cache.safe_travel[env, contact]):
                    push(cache, wp.static(QUEUE_INDEX[DETECT_CACHED]), local_env * contacts + contact)

    return enqueue_contacts


@functools.cache
def probe_clusters(real: type, tracks: bool, uses_grid: bool) -> wp.Kernel:
    """Returns the kernel that evaluates the centers of clusters without cached faces; items: clusters.

    ``uses_grid``: Whether all query meshes have a face grid; otherwise the kernel searches the BVH.
    """
    t = structs(real)
    Model, State, History, Contacts, ActiveContacts, Cache = (
        t.Model,
        t.State,
        t.History,
        t.Contacts,
        t.ActiveContacts,
        t.Cache,
    )
    detection = contact_detection.functions(real, tracks, DETECT_GRID if uses_grid else DETECT_CACHED)
    frames_of_set, cluster_clearance, safe_travel_for, needs_history = (
        detection.frames_of_set,
        detection.cluster_clearance,
        detection.safe_travel_for,
        detection.needs_history,
    )
    cull_by_cluster, extend_safe_travel = detection.cull_by_cluster, detection.extend_safe_travel
    push = _push(real)

    @unique_kernel()
    def probe_cluster_centers(
        launch: LaunchRange,
        items: wp.int32,
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
    ):
        for i in range(warps.interleave_warps(wp.tid(), launch.threads), cache.queue_count[0], launch.threads):
            task = cache.queue_clusters[i]
            local_env = task // launch.items
            env = first_env(launch) + local_env
            cluster = task_item(launch, task)
            set_index = model.cluster_set[cluster]
            travel = cache.set_travel[env, set_index]
            max_travel = travel + cache.set_margin[env, set_index]
            center_clearance = cluster_clearance(
                model, frames_of_set(model, state, env, set_index), cache, env, cluster
            )
            for index in range(model.cluster_start[cluster], model.cluster_start[cluster + 1]):
                contact = model.cluster_contact[index]
                if max_travel < cache.safe_travel[env, contact]:
                    extend_safe_travel(model, history, cache, env, cluster, contact, travel, center_clearance)
                else:
                    previous_status = contacts.status[env, contact]
                    clearance = cull_by_cluster(
                        model, history, contacts, cache, env, cluster, contact, center_clearance
                    )
                    if clearance < real(0.0):
                        push(cache, wp.static(QUEUE_INDEX[DETECT_CACHED]), local_env * items + contact)
                    else:
                        cache.safe_travel[env, contact] = safe_travel_for(travel, clearance)
                        active_contacts.needs_history[env, contact] = needs_history(
                            contacts, history, env, contact, previous_status
                        )

    return probe_cluster_centers


@functools.cache
def process(real: type, tracks: bool, part: str, next_part: str) -> wp.Kernel:
    """Returns the kernel that evaluates the queue of ``part``; undecided contacts go to ``next_part``."""
    t = structs(real)
    Model, State, History, Contacts, ActiveContacts, Cache = (
        t.Model,
        t.State,
        t.History,
        t.Contacts,
        t.ActiveContacts,
        t.Cache,
    )
    detection = contact_detection.functions(real, tracks, part)
    frames_of_set, update_contact, safe_travel_for, needs_history = (
        detection.frames_of_set,
        detection.update_contact,
        detection.safe_travel_for,
        detection.needs_history,
    )
    push = _push(real)
    queue, next_queue = QUEUE_INDEX[part], QUEUE_INDEX[next_part]
    registers = {DETECT_BVH: SEARCH_REGISTERS, DETECT_QUERY: SEARCH_REGISTERS, DETECT_GRID: CELL_REGISTERS}.get(
        part
    )
    registers = registers if real is wp.float32 else None

    @unique_kernel(registers)
    def process_contacts(
        launch: LaunchRange,
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
    ):
        thread = wp.tid()
        if wp.static(part in (DETECT_BVH, DETECT_QUERY)):
            thread = warps.interleave_warps(thread, launch.threads)
        for i in range(thread, cache.queue_count[queue], launch.threads):
            task = cache.queue_contacts[queue, i]
            env = task_env(launch, task)
            contact = task_item(launch, task)
            set_index = model.contact_set[contact]
            set_frames = frames_of_set(model, state, env, set_index)
            previous_status = contacts.status[env, contact]
            clearance = update_contact(model, set_frames, history, contacts, True, cache, env, contact)
            if wp.static(part not in (DETECT_BVH, DETECT_QUERY)) and clearance == real(DEFERRED):
                push(cache, next_queue, task)
            else:
                cache.safe_travel[env, contact] = safe_travel_for(cache.set_travel[env, set_index], clearance)
                active_contacts.needs_history[env, contact] = needs_history(
                    contacts, history, env, contact, previous_status
                )
                if wp.static(part in (DETECT_GRID, DETECT_QUERY)):
                    # If any contact is near the surface, the clearance at the cluster center cannot cull it.
                    size = set_frames.scale * model.query_mesh_cell_size[set_frames.query_mesh]
                    cache.face_count[env, contact] = wp.where(clearance < size, 1, 0)

    return process_contacts


@functools.cache
def compact(real: type) -> wp.Kernel:
    """Returns the kernel that lists active contacts in ``active_contacts``; items: clusters."""
    t = structs(real)
    Model, ActiveContacts, Cache = t.Model, t.ActiveContacts, t.Cache

    @unique_kernel()
    def compact_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        cache: Cache,
        active_contacts: ActiveContacts,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            set_index = model.cluster_set[cluster]
            max_travel = cache.set_travel[env, set_index] + cache.set_margin[env, set_index]
            if cache.set_culled[env, set_index] != 0 or max_travel < cache.cluster_safe_travel[env, cluster]:
                active_contacts.count[env, cluster] = 0
                continue
            start = model.cluster_start[cluster]
            count = wp.int32(0)
            safe_travel = real(wp.inf)
            for index in range(start, model.cluster_start[cluster + 1]):
                contact = model.cluster_contact[index]
                safe_travel = wp.min(safe_travel, cache.safe_travel[env, contact])
                if active_contacts.needs_history[env, contact] != 0:
                    active_contacts.contact[env, start + count] = contact
                    count += 1
            active_contacts.count[env, cluster] = count
            # A cluster with active contacts is evaluated in every step, because a step may be repeated.
            cache.cluster_safe_travel[env, cluster] = wp.where(count > 0, real(0.0), safe_travel)

    return compact_contacts
