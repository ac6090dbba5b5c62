"""The same on a GPU, contact by contact: threads side by side do the same kind of work.

Contacts that may touch are put into a queue; what is sure to be nearest is looked at there, and what needs more is
handed on: to the remembered faces, then to a search, each with a queue of its own. Blocks of which nothing is
known are probed before. About meshes with cells, where no faces are remembered, contacts look into their cell, and
what no cell tells of is searched for. In the end each block gathers which of its contacts the rest of the step has
to do with.
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

# Queues of contacts, by what they need; that of blocks to probe comes first.
QUEUE_INDEX = {
    DETECT_CACHED: 1,
    DETECT_FACE_CACHE: 1,
    DETECT_GRID: 1,
    DETECT_CANDIDATES: 2,
    DETECT_BVH: 3,
    DETECT_QUERY: 3,
}
# Registers of a search in float32, which would take 200: with so few an H200 holds all its threads at once
# (``schedule.SEARCHING``). They wait for memory most of the time.
SEARCH_REGISTERS = 128
# Of a look into a cell, likewise.
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
    """Returns the kernel that puts contacts that may touch into the first queue; items: blocks."""
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
    """Returns the kernel that looks in the middle of blocks of which nothing is known; items: blocks.

    ``uses_grid``: whether all meshes have cells, which tell; else it searches.
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
    """Returns the kernel that looks at the contacts in the queue of ``part`` or hands them on; items: contacts."""
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
                    # Of what is near a look in the middle of its block tells nothing.
                    size = set_frames.scale * model.query_mesh_cell_size[set_frames.query_mesh]
                    cache.face_count[env, contact] = wp.where(clearance < size, 1, 0)

    return process_contacts


@functools.cache
def compact(real: type) -> wp.Kernel:
    """Returns the kernel that lists in ``active_contacts`` what was found; items: blocks."""
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
            # What is new is told until history has it; a step may be taken again.
            cache.cluster_safe_travel[env, cluster] = wp.where(count > 0, real(0.0), safe_travel)

    return compact_contacts
