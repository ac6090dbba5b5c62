"""Contact detection on triangle meshes, one thread per cluster of contacts.

Broad phase: a contact is skipped while the accumulated motion bound of its set (``motion_bound.py``) is below its
safe travel, that is, while its point cannot have moved farther than its last clearance. The test is applied to
sets, clusters and single contacts, in this order. Narrow phase: ``closest_point.py`` evaluates the remaining
contacts. The kernel writes ``Contacts``, ``ActiveContacts`` and ``Cache``. On a GPU,
``contact_detection_queues.py`` and ``contact_detection_grid.py`` do the same with one thread per contact.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase import bvh_search, face_grid, search
from warpcontact.kernels.narrowphase import closest_point as narrow_phase
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.narrowphase.closest_point import (
    DETECT_ALL,
    DETECT_GRID,
    DETECT_GRID_ANY,
    DETECT_GRID_FAR,
    MIN_CLEARANCE_FRACTION,
    TRACKED,
)
from warpcontact.kernels.narrowphase.face_grid import side_clearance_function
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    LATCHED,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)


class Functions(NamedTuple):
    """Structs and device functions of contact detection, for one part of the narrow phase."""

    SetFrames: Struct  # frames of a point set and its surface
    frames_of_set: wp.Function  # frames of a set in a state
    DetectedContact: Struct  # result of the narrow phase for one contact
    detect: wp.Function  # narrow-phase result of a contact
    write_contact: wp.Function  # writes a result to ``Contacts``
    update_contact: wp.Function  # detects a contact and writes it; displacement without contact [m], < 0: none
    mark_far: wp.Function  # writes a contact that is far away on the outer side
    contact_clearance: wp.Function  # clearance of a contact, from that of the center of its cluster [m]
    can_cull: wp.Function  # whether a contact may be culled if its surroundings are far away
    cluster_clearance: wp.Function  # lower bound on the distance of the center of a cluster [m]; < 0: unknown
    cull_by_cluster: wp.Function  # marks a contact as far if the clearance of its cluster is sufficient
    safe_travel_for: wp.Function  # safe travel of a contact with a clearance [m]
    extend_safe_travel: wp.Function  # extended safe travel of a culled contact [m]
    has_uncached: wp.Function  # whether a contact of a cluster cannot be culled and has no cached faces
    needs_history: wp.Function  # 1 if later stages must process a contact, otherwise 0
    probe_if_useful: wp.Function  # clearance of the center of a cluster if it can cull [m]; < 0: unknown
    store_result: wp.Function  # stores the result for one contact; its safe travel [m]
    store_cluster_result: wp.Function  # stores the safe travel of a cluster


@functools.cache
def functions(real: type, tracks: bool, part: str) -> Functions:
    """Returns the device functions for ``real``. ``tracks`` and ``part``: see ``closest_point.functions``."""
    t = structs(real)
    Model, History, Contacts, ActiveContacts, Cache = t.Model, t.History, t.Contacts, t.ActiveContacts, t.Cache
    narrow = narrow_phase.functions(real, tracks, part)
    SetFrames, frames_of_set = narrow.SetFrames, narrow.frames_of_set
    mark_far = narrow.mark_far
    search_functions, bvh_functions = search.functions(real), bvh_search.functions(real)
    max_coordinate, query_error = search_functions.max_coordinate, search_functions.query_error
    refine_closest = search_functions.refine_closest
    closest_in_bvh, rounding_error = bvh_functions.closest_in_bvh, bvh_functions.rounding_error
    side_clearance, cell_at = side_clearance_function(real), face_grid.functions(real).cell_at
    closest_on_face, is_inside = (
        closest_points.functions(real).closest_on_face,
        closest_points.functions(real).is_inside,
    )
    rounded_down = wp.constant(real(1.0 - 4.0 * t.epsilon))
    rounded_up = wp.constant(real(1.0 + 16.0 * t.epsilon))

    @wp.func
    def cluster_clearance(model: Model, set_frames: SetFrames, cache: Cache, env: int, cluster: int):
        """Returns a lower bound on the distance of a cluster's center to the surface or its inner side [m].

        Points nearer to the center than this are on the outer side as well. Negative: unknown.
        """
        query_mesh = set_frames.query_mesh
        c_W = set_frames.offset_W + set_frames.R_WB * model.cluster_center[env, cluster]
        c_S = set_frames.inverse_scale * (wp.transpose(set_frames.R_WS) * c_W)
        if wp.static(part in (DETECT_GRID, DETECT_GRID_FAR, DETECT_GRID_ANY)):
            # Near the surface this bound is small, and each contact reads its own cell.
            return set_frames.scale * cell_at(model, query_mesh, c_S).clearance
        extent = max_coordinate(c_S)
        if wp.static(part == DETECT_ALL):
            hint = cache.nearest[
                env, assume_nonnegative(model.cluster_contact[assume_nonnegative(model.cluster_start[cluster])])
            ]
            closest = closest_in_bvh(model, query_mesh, c_S, hint)
            if not (closest.distance < real(wp.inf)):
                return real(-1.0)
            error = rounding_error(extent, closest)
        else:
            query = wp.mesh_query_point_no_sign(
                model.query_mesh_id[query_mesh],
                wp.vec3f(wp.float32(c_S[0]), wp.float32(c_S[1]), wp.float32(c_S[2])),
                wp.float32(wp.inf),
            )
            if not query.result:
                return real(-1.0)
            closest = closest_on_face(model, set_frames.start + query.face, c_S)
            error = query_error(model, query_mesh, extent, closest.distance)
            if wp.static(real is wp.float64) or model.query_mesh_thin_length[query_mesh] > real(0.0):
                # Among faces within the error of the query another may be nearest, with the point on its inner
                # side.
                closest = refine_closest(model, query_mesh, c_S, closest, error)
        if is_inside(model, closest):
            return real(-1.0)
        return set_frames.scale * wp.min(closest.distance - error, side_clearance(model, query_mesh, c_S))

    @wp.func
    def contact_clearance(model: Model, env: int, cluster: int, contact: int, center_clearance: real):
        """Returns the clearance of one contact, from the clearance at the center of its cluster [m]."""
        arm_B = (
            model.point_position[env, assume_nonnegative(model.contact_point[contact])]
            - model.cluster_center[env, cluster]
        )
        geometry = model.contact_geometry[env, contact]
        return center_clearance - rounded_up * wp.length(arm_B) - (geometry.radius + geometry.contact_tolerance)

    @wp.func
    def probe_distance(model: Model, env: int, start: int, stop: int, cluster: int, center_clearance: real):
        """Returns the displacement of a cluster after which the clearance at its center can cull again [m]."""
        smallest = real(wp.inf)
        for index in range(start, stop):
            smallest = wp.min(
                smallest,
                center_clearance
                - contact_clearance(
                    model, env, cluster, assume_nonnegative(model.cluster_contact[index]), center_clearance
                ),
            )
        return wp.max(smallest / real(1.0 - MIN_CLEARANCE_FRACTION) - center_clearance, real(0.0))

    @wp.func
    def needs_arming(model: Model, history: History, env: int, contact: int):
        """Returns whether a latched contact is not armed. Only the narrow phase can arm it."""
        if wp.static(tracks):
            return (model.contact_options[contact] & LATCHED) != 0 and history.armed[env, contact] == 0
        return False

    @wp.func
    def can_cull(model: Model, history: History, env: int, contact: int):
        """Returns whether a contact may be culled if its surroundings are far away on the outer side.

        A tracked contact may not, because the face that it tracks determines its side. A latched contact that is
        not armed may not, because only the narrow phase can arm it.
        """
        if wp.static(tracks):
            if (model.contact_options[contact] & TRACKED) != 0 and history.face[env, contact] >= 0:
                return False
            if needs_arming(model, history, env, contact):
                return False
        return model.contact_geometry[env, contact].enabled != 0

    @wp.func
    def cull_by_cluster(
        model: Model,
        history: History,
        contacts: Contacts,
        cache: Cache,
        env: int,
        cluster: int,
        contact: int,
        center_clearance: real,
    ):
        """Marks a contact as far if the clearance at the center of its cluster is sufficient.

        Returns the distance that its point can move without contact [m]. Negative: unknown; nothing was written.
        """
        if not (center_clearance > real(0.0)) or cache.face_count[env, contact] != 0:
            return real(-1.0)
        if not can_cull(model, history, env, contact):
            return real(-1.0)
        clearance = contact_clearance(model, env, cluster, contact, center_clearance)
        if not (clearance > real(MIN_CLEARANCE_FRACTION) * center_clearance):
            return real(-1.0)
        mark_far(contacts, env, contact)
        return clearance

    @wp.func
    def safe_travel_for(travel: real, clearance: real):
        """Returns the safe travel of a contact with this clearance [m]."""
        if not (clearance > real(0.0)):
            return real(0.0)
        return rounded_down * (travel + clearance)

    @wp.func
    def extend_safe_travel(
        model: Model,
        history: History,
        cache: Cache,
        env: int,
        cluster: int,
        contact: int,
        travel: real,
        center_clearance: real,
    ):
        """Returns the safe travel of a culled contact, extended by the clearance at the cluster center [m]."""
        safe_travel = cache.safe_travel[env, contact]
        if needs_arming(model, history, env, contact):
            return safe_travel
        if center_clearance > real(0.0):
            extended = rounded_down * (travel + contact_clearance(model, env, cluster, contact, center_clearance))
            if extended > safe_travel:
                safe_travel = extended
                cache.safe_travel[env, contact] = safe_travel
        return safe_travel

    @wp.func
    def has_uncached(model: Model, cache: Cache, env: int, start: int, stop: int, max_travel: real):
        """Returns whether any contact of a cluster that cannot be culled has no cached faces."""
        for index in range(start, stop):
            contact = assume_nonnegative(model.cluster_contact[index])
            if cache.face_count[env, contact] == 0 and not (max_travel < cache.safe_travel[env, contact]):
                return True
        return False

    @wp.func
    def needs_history(contacts: Contacts, history: History, env: int, contact: int, previous_status: int):
        """Returns 1 if the later stages must process a contact, otherwise 0.

        They must if it is in contact, was in contact, or its latch changed. ``previous_status`` is the status of
        the last evaluation, which need not belong to an accepted step.
        """
        latch_changed = contacts.armed[env, contact] != history.armed[env, contact]
        was_touching = previous_status == CONTACT or history.entry_speed[env, contact] >= real(0.0)
        return wp.where(latch_changed or was_touching or contacts.status[env, contact] == CONTACT, 1, 0)

    @wp.func
    def probe_if_useful(
        model: Model,
        set_frames: SetFrames,
        cache: Cache,
        env: int,
        cluster: int,
        start: int,
        stop: int,
        travel: real,
        max_travel: real,
    ):
        """Returns the clearance at the center of a cluster if it can cull any contact; negative: unknown.

        One search at the center can cull all contacts that are far from the surface.
        """
        if stop - start > 1 and travel >= cache.cluster_probe_travel[env, cluster]:
            # Nested, because Warp evaluates both operands of ``and``.
            if has_uncached(model, cache, env, start, stop, max_travel):
                return cluster_clearance(model, set_frames, cache, env, cluster)
        return real(-1.0)

    @wp.func
    def store_result(
        history: History,
        contacts: Contacts,
        cache: Cache,
        active_contacts: ActiveContacts,
        env: int,
        contact: int,
        travel: real,
        clearance: real,
        previous_status: int,
    ):
        """Stores the result for one contact; returns its safe travel [m]."""
        safe_travel = safe_travel_for(travel, clearance)
        cache.safe_travel[env, contact] = safe_travel
        active_contacts.needs_history[env, contact] = needs_history(
            contacts, history, env, contact, previous_status
        )
        return safe_travel

    @wp.func
    def store_cluster_result(
        model: Model,
        cache: Cache,
        env: int,
        cluster: int,
        start: int,
        stop: int,
        travel: real,
        center_clearance: real,
        culled_any: bool,
        active_count: int,
        min_safe_travel: real,
    ):
        """Stores the safe travel of a cluster and the travel after which its center is probed again."""
        if center_clearance >= real(0.0) and not culled_any:
            cache.cluster_probe_travel[env, cluster] = travel + probe_distance(
                model, env, start, stop, cluster, center_clearance
            )
        # A cluster with active contacts is evaluated in every step, because a step may be repeated.
        cache.cluster_safe_travel[env, cluster] = wp.where(active_count > 0, real(0.0), min_safe_travel)

    return Functions(
        SetFrames=SetFrames,
        frames_of_set=frames_of_set,
        DetectedContact=narrow.DetectedContact,
        detect=narrow.detect,
        write_contact=narrow.write_contact,
        update_contact=narrow.update_contact,
        mark_far=mark_far,
        contact_clearance=contact_clearance,
        can_cull=can_cull,
        cluster_clearance=cluster_clearance,
        cull_by_cluster=cull_by_cluster,
        safe_travel_for=safe_travel_for,
        extend_safe_travel=extend_safe_travel,
        has_uncached=has_uncached,
        needs_history=needs_history,
        probe_if_useful=probe_if_useful,
        store_result=store_result,
        store_cluster_result=store_cluster_result,
    )


@functools.cache
def kernel(real: type, tracks: bool) -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` and ``active_contacts`` from ``state``; items: clusters.

    With ``cached``, only contacts that cannot be culled are evaluated, and their clearances are stored. Culled
    contacts are open and were open in the last step; ``active_contacts`` lists the others. Without ``cached``, all
    contacts are evaluated and listed, and gap, normal and contact point are written for distant ones too. Results
    for the other contacts are identical.

    Args:
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        tracks: Whether any contact is latched or swept and so tracks the face that it touched.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, ActiveContacts, Cache = t.Contacts, t.ActiveContacts, t.Cache
    detection = functions(real, tracks, DETECT_ALL)
    frames_of_set, update_contact, probe_if_useful = (
        detection.frames_of_set,
        detection.update_contact,
        detection.probe_if_useful,
    )
    cull_by_cluster, extend_safe_travel = detection.cull_by_cluster, detection.extend_safe_travel
    store_result, store_cluster_result = detection.store_result, detection.store_cluster_result

    @unique_kernel()
    def closest_point(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        cached: wp.bool,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            count = wp.int32(0)
            active_count = wp.int32(0)
            set_index = assume_nonnegative(model.cluster_set[cluster])
            travel = real(0.0)
            max_travel = real(0.0)
            if cached:
                travel = cache.set_travel[env, set_index]
                max_travel = travel + cache.set_margin[env, set_index]
                if cache.set_culled[env, set_index] != 0 or max_travel < cache.cluster_safe_travel[env, cluster]:
                    active_contacts.count[env, cluster] = 0
                    continue
            start = assume_nonnegative(model.cluster_start[cluster])
            stop = model.cluster_start[cluster + 1]
            set_frames = frames_of_set(model, state, env, set_index)
            center_clearance = real(-1.0)
            if cached:
                center_clearance = probe_if_useful(
                    model, set_frames, cache, env, cluster, start, stop, travel, max_travel
                )
            culled_any = wp.bool(False)
            min_safe_travel = real(wp.inf)
            for index in range(start, stop):
                contact = assume_nonnegative(model.cluster_contact[index])
                if cached and max_travel < cache.safe_travel[env, contact]:
                    safe_travel = extend_safe_travel(
                        model, history, cache, env, cluster, contact, travel, center_clearance
                    )
                    min_safe_travel = wp.min(min_safe_travel, safe_travel)
                else:
                    previous_status = contacts.status[env, contact]
                    clearance = real(-1.0)
                    if cached:
                        clearance = cull_by_cluster(
                            model, history, contacts, cache, env, cluster, contact, center_clearance
                        )
                    if clearance >= real(0.0):
                        culled_any = True
                    else:
                        clearance = update_contact(
                            model, set_frames, history, contacts, cached, cache, env, contact
                        )
                    if cached:
                        safe_travel = store_result(
                            history,
                            contacts,
                            cache,
                            active_contacts,
                            env,
                            contact,
                            travel,
                            clearance,
                            previous_status,
                        )
                        min_safe_travel = wp.min(min_safe_travel, safe_travel)
                    elif contacts.status[env, contact] == CONTACT:
                        # A later evaluation with ``cached`` must not cull this contact.
                        cache.safe_travel[env, contact] = real(0.0)
                        active_count += 1
                if cached:
                    active_count += active_contacts.needs_history[env, contact]
                if not cached or active_contacts.needs_history[env, contact] != 0:
                    active_contacts.contact[env, start + count] = contact
                    count += 1
            active_contacts.count[env, cluster] = count
            if cached:
                store_cluster_result(
                    model,
                    cache,
                    env,
                    cluster,
                    start,
                    stop,
                    travel,
                    center_clearance,
                    culled_any,
                    active_count,
                    min_safe_travel,
                )
            elif active_count > 0:
                cache.cluster_safe_travel[env, cluster] = real(0.0)
                cache.cluster_inactive[env, cluster] = 0
                cache.set_safe_travel[env, set_index] = real(0.0)

    return closest_point
