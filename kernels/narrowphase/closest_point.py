"""Narrow phase of a point or sphere against an oriented triangle mesh: gap, normal and contact point.

Algorithm of the element ``contactPS2`` of EULER: the closest point S on the whole query mesh, then whether S is on
an active face, then the side by the pseudonormal. Warp's query runs in float32 in the mesh frame and only selects
a face; distance, feature and pseudonormal are computed here in the precision of the simulation. With a cache, a
CPU searches in that precision, with the BVH of ``bvh_search.py``.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels import frames, rotations
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.narrowphase import bvh_search, face_cache, face_grid, search
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.narrowphase.face_grid import side_clearance_function
from warpcontact.kernels.types import (
    BOUNDARY_OUTER,
    CACHED_FACES_GPU,
    CONTACT,
    DISABLED,
    FAR,
    FEATURE_ACTIVE,
    FEATURE_BOUNDARY,
    FORCE_AT_POINT,
    INACTIVE,
    LATCH_ARM,
    LATCH_DISARM,
    LATCH_KEEP,
    LATCHED,
    OPEN,
    SWEPT,
    WRONG_SIDE,
    Struct,
    structs,
)

# A point is outside an open boundary if its lateral distance exceeds this fraction of the length of the boundary
# edge.
BOUNDARY_TOLERANCE = 1.0e-4
# Rounding error in units of epsilon times the size of the differences. A direction between points that are closer
# than this is undefined.
ROUNDING = 16.0
# Rounding error of the point itself, in units of epsilon times its coordinates. Larger than ROUNDING on fine
# meshes.
POINT_ROUNDING = 4.0
# Parts of the narrow phase that a kernel is compiled for.
DETECT_ALL, DETECT_CACHED, DETECT_CANDIDATES, DETECT_FACE_CACHE, DETECT_BVH = (
    "all",
    "cached",
    "candidates",
    "face_cache",
    "bvh",
)
DETECT_GRID, DETECT_GRID_FAR, DETECT_GRID_ANY, DETECT_QUERY = "grid", "grid_far", "grid_any", "query"
# Fraction of the cached clearance below which a contact is evaluated again instead of culled.
MIN_CLEARANCE_FRACTION = 0.25
# Clearance of a contact that is deferred to the next part.
DEFERRED = -math.inf
# Options of contacts that track the face that they touched.
TRACKED = LATCHED | SWEPT


class Functions(NamedTuple):
    """Structs and device functions of one part of the narrow phase."""

    SetFrames: Struct  # frames of a point set and its surface
    DetectedContact: Struct  # result for one contact
    frames_of_set: wp.Function  # frames of a set in a state
    detect: wp.Function  # result of a contact
    mark_far: wp.Function  # writes a contact that is far away on the outer side
    write_contact: wp.Function  # writes a result to ``Contacts``
    update_contact: wp.Function  # detects a contact and writes it; displacement without contact [m], < 0: none


@functools.cache
def functions(real: type, tracks: bool, part: str) -> Functions:
    """Returns the struct ``SetFrames`` and the device functions for ``real``.

    With ``tracks``, latched and swept contacts track the surface: on the inner side, their closest point is found
    by descent from the last face, so that the force does not flip in the middle or on the far side of a plate.

    ``part`` selects the code that is compiled. ``DETECT_ALL`` does everything. The others are successive parts,
    each of which defers what it cannot decide. With a face cache: ``DETECT_CACHED`` uses the nearest face,
    ``DETECT_CANDIDATES`` the cached candidates, ``DETECT_FACE_CACHE`` both, ``DETECT_BVH`` queries the BVH. With a
    face grid: ``DETECT_GRID`` uses the faces of a cell, ``DETECT_GRID_FAR`` first the stored clearance,
    ``DETECT_QUERY`` queries the BVH, ``DETECT_GRID_ANY`` uses the cell and, if necessary, the BVH.
    """
    t = structs(real)
    vec3, mat33, Model, State, History = t.vec3, t.mat33, t.Model, t.State, t.History
    Contacts, Cache = t.Contacts, t.Cache
    defers = part != DETECT_ALL
    face_functions, cache_functions, search_functions = (
        closest_points.functions(real),
        face_cache.functions(real),
        search.functions(real),
    )
    ClosestPoint, closest_on_face, is_inside, descend = (
        face_functions.ClosestPoint,
        face_functions.closest_on_face,
        face_functions.is_inside,
        face_functions.descend,
    )
    lost_tie = face_functions.lost_tie
    cached_closest = {
        DETECT_ALL: cache_functions.nearest_candidate_simd,
        DETECT_CACHED: cache_functions.cached_nearest,
        DETECT_CANDIDATES: cache_functions.nearest_candidate,
        DETECT_FACE_CACHE: cache_functions.cached_closest,
    }.get(part, cache_functions.no_cached_point)
    refine_closest, max_coordinate, query_error = (
        search_functions.refine_closest,
        search_functions.max_coordinate,
        search_functions.query_error,
    )
    closest_and_cache = search.closest_and_cache(real, CACHED_FACES_GPU)
    bvh_functions = bvh_search.functions(real)
    search_tree, rounding_error, cache_faces_near = (
        bvh_functions.closest_in_bvh,
        bvh_functions.rounding_error,
        bvh_functions.cache_faces_near,
    )
    cell_at, closest_in_cell = face_grid.functions(real).cell_at, face_grid.functions(real).closest_in_cell
    side_clearance = side_clearance_function(real)
    frame = frames.functions(real)
    offset_between, rotate_to_world, matrix = (
        frame.offset_between,
        frame.rotate_to_world,
        rotations.functions(real).matrix,
    )
    orientation_to_world, rotation_to_world = frame.orientation_to_world, frame.rotation_to_world
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    point_epsilon = wp.constant(real(t.epsilon * POINT_ROUNDING))
    # The mesh of the query is stored in float32 for any precision of the simulation.
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * search.QUERY_ROUNDING))
    boundary_tolerance = wp.constant(real(BOUNDARY_TOLERANCE))

    @wp.func
    def edge_length(model: Model, row: int, feature: int):
        """Returns the length of an edge, or for a vertex that of the shorter of its two edges of this face."""
        a = model.face_corner[row, 0]
        b = model.face_corner[row, 1]
        c = model.face_corner[row, 2]
        ab = wp.length(b - a)
        bc = wp.length(c - b)
        ca = wp.length(a - c)
        length = ab
        if feature == 2:
            length = bc
        elif feature == 3:
            length = ca
        elif feature == 4:
            length = wp.min(ab, ca)
        elif feature == 5:
            length = wp.min(ab, bc)
        elif feature == 6:
            length = wp.min(bc, ca)
        return length

    @wp.struct
    class SetFrames:
        """Frames of a point set and its surface."""

        offset_W: vec3  # from the origin of the surface to the origin of the points
        R_WB: mat33
        R_WS: mat33
        scale: real
        inverse_scale: real
        set_index: wp.int32
        query_mesh: wp.int32
        start: wp.int32  # first face row of the query mesh
        stop: wp.int32

    @wp.func
    def frames_of_set(model: Model, state: State, env: int, set_index: int):
        set_frames = SetFrames()
        contact = assume_nonnegative(model.set_contact[set_index])
        set_frames.set_index = set_index
        point = assume_nonnegative(model.contact_point[contact])
        set_frames.R_WB = rotation_to_world(state, env, model.point_body[point])
        base = assume_nonnegative(model.contact_query_mesh[contact])
        surface = assume_nonnegative(model.query_mesh_surface[base])
        carrier = model.surface_body[surface]
        o_W = rotate_to_world(state, env, carrier, model.surface_position[env, surface])
        set_frames.offset_W = offset_between(model, state, env, point, surface) - o_W
        q_BS = model.surface_orientation[env, surface]
        set_frames.R_WS = matrix(orientation_to_world(state, env, carrier, q_BS))
        set_frames.scale = model.surface_scale[env, surface]
        set_frames.inverse_scale = real(1.0) / set_frames.scale
        set_frames.query_mesh = assume_nonnegative(base + model.surface_mesh[env, surface])
        set_frames.start = model.query_mesh_face_start[set_frames.query_mesh]
        set_frames.stop = model.query_mesh_face_start[set_frames.query_mesh + 1]
        return set_frames

    @wp.struct
    class DetectedContact:
        """Result of the narrow phase for one contact."""

        clearance: real  # displacement without contact [m]; < 0: none; DEFERRED: undecided
        status: wp.int32  # OPEN, CONTACT, …
        armed: wp.int32  # resulting latch
        penetration: real  # 0 unless status is CONTACT [m]
        has_details: wp.bool  # whether the fields below are set; not for a contact that is far away
        gap: real  # < 0 in overlap [m]
        face: wp.int32  # row of the face; −1: none
        normal: vec3  # out of the surface, W
        arm: vec3  # from the origin of the points to K, where the force acts, W [m]

    @wp.func
    def store_clearance(cache: Cache, env: int, contact: int, p_S: vec3, clearance: real):
        """Stores a displacement from ``p_S`` without contact [mesh unit]."""
        cache.clearance[env, contact] = clearance
        cache.clearance_center[env, contact] = p_S

    @wp.func
    def remaining_clearance(cache: Cache, env: int, contact: int, p_S: vec3):
        """Returns what is left of the stored clearance at ``p_S`` [mesh unit]."""
        return cache.clearance[env, contact] - wp.length(p_S - cache.clearance_center[env, contact])

    @wp.func
    def no_closest_point(clearance: real, gap: real, status: int, armed: int, arm_W: vec3):
        """Returns the result for a contact without a closest point."""
        detected = DetectedContact()
        detected.clearance = clearance
        detected.status = status
        detected.armed = armed
        detected.has_details = True
        detected.gap = gap
        detected.face = -1
        detected.arm = arm_W
        return detected

    @wp.func
    def far_contact(clearance: real):
        """Returns the result for a contact far away on the outer side."""
        detected = DetectedContact()
        detected.clearance = clearance
        detected.status = OPEN
        detected.armed = 1
        return detected

    @wp.func
    def deferred_contact():
        """Returns the result of a part that defers the contact to the next."""
        detected = DetectedContact()
        detected.clearance = real(DEFERRED)
        return detected

    @wp.func
    def mark_far(contacts: Contacts, env: int, contact: int):
        """Writes the fields of ``contacts`` that a step reads for a contact far away on the outer side."""
        contacts.status[env, contact] = OPEN
        contacts.penetration[env, contact] = real(0.0)
        contacts.armed[env, contact] = 1

    @wp.func
    def detect(
        model: Model, set_frames: SetFrames, history: History, cached: bool, cache: Cache, env: int, contact: int
    ):
        """Returns the narrow-phase result of a contact.

        In the symbols of ``docs/contact.md``: P is ``p_S`` and P − S is ``closest.to_point``, in the frame and unit of
        the mesh; RC is ``radius``; ``s`` is in m.
        """
        geometry = model.contact_geometry[env, contact]
        radius = geometry.radius
        armed = history.armed[env, contact]
        arm_W = set_frames.R_WB * model.point_position[env, assume_nonnegative(model.contact_point[contact])]
        if geometry.enabled == 0:
            return no_closest_point(real(wp.inf), real(wp.nan), DISABLED, armed, arm_W)
        search_gap = wp.max(geometry.search_radius - radius, real(0.0))

        # Signed distance below which the contact is closed. The tolerance is 0 for compliant contact.
        contact_radius = radius + geometry.contact_tolerance
        # Mesh frame and unit, in which float32 is as accurate as the mesh.
        query_mesh, scale = set_frames.query_mesh, set_frames.scale
        contact_distance = contact_radius * set_frames.inverse_scale
        p_S = set_frames.inverse_scale * (wp.transpose(set_frames.R_WS) * (set_frames.offset_W + arm_W))

        option = model.contact_options[contact]
        extent = max_coordinate(p_S)
        closest = ClosestPoint()
        # Bound on how much nearer another face may be than ``closest``.
        error = real(0.0)
        tracked_inside = wp.bool(False)
        if wp.static(tracks):
            # Ignore a face of another mesh that the surface had before.
            last = history.face[env, contact]
            if last >= set_frames.start and last < set_frames.stop and (option & TRACKED) != 0:
                closest = descend(model, last, p_S)
                tracked_inside = is_inside(model, closest)
        if not tracked_inside:
            # The search covers at least the sphere.
            search_distance = wp.max(geometry.search_radius * set_frames.inverse_scale, contact_distance)
            # A latched contact that is not armed needs the closest point to become armed.
            can_be_far = armed != 0 or (option & LATCHED) == 0
            if wp.static(part == DETECT_GRID_FAR):
                if can_be_far:
                    remaining = remaining_clearance(cache, env, contact, p_S)
                    if remaining > query_epsilon * extent:
                        return far_contact(scale * remaining)
            elif wp.static(part == DETECT_ALL):
                if cached and can_be_far and cache.face_count[env, contact] == 0:
                    remaining = remaining_clearance(cache, env, contact, p_S)
                    if remaining > wp.max(
                        query_epsilon * extent, real(MIN_CLEARANCE_FRACTION) * cache.clearance[env, contact]
                    ):
                        return far_contact(scale * remaining)
            step = set_frames.inverse_scale * cache.set_step_travel[env, set_frames.set_index]
            cached_point = cached_closest(model, query_mesh, cache, env, contact, p_S, step)
            if wp.static(part == DETECT_ALL):
                if cached_point.valid:
                    if cached:
                        cache.nearest[env, contact] = cached_point.closest.row
                    else:
                        # An uncached search breaks no ties between distant faces, but the cache does. Use the
                        # cache only nearby.
                        farthest = cached_point.closest.distance
                        farthest += query_error(model, query_mesh, extent, farthest)
                        cached_point.valid = farthest < contact_distance + model.query_mesh_skin[query_mesh]
            closest = cached_point.closest
            valid = cached_point.valid
            if wp.static(part in (DETECT_GRID, DETECT_GRID_FAR, DETECT_GRID_ANY)):
                cell = cell_at(model, query_mesh, p_S)
                if cell.clearance > contact_distance and can_be_far:
                    if wp.static(part == DETECT_GRID_FAR):
                        store_clearance(cache, env, contact, p_S, cell.clearance - contact_distance)
                    return far_contact(scale * (cell.clearance - contact_distance))
                valid = cell.faces >= 0
                if valid:
                    margin = query_error(model, query_mesh, extent, contact_distance)
                    closest = closest_in_cell(model, cell.faces, p_S, margin)
            if wp.static(part not in (DETECT_ALL, DETECT_BVH, DETECT_GRID_ANY, DETECT_QUERY)):
                if not valid:
                    return deferred_contact()
            if wp.static(part == DETECT_ALL):
                if cached and not valid:
                    closest = search_tree(model, query_mesh, p_S, cache.nearest[env, contact])
                    cache.face_count[env, contact] = 0
                    # A NaN point has no closest point.
                    if not (closest.distance < real(wp.inf)):
                        return no_closest_point(real(0.0), search_gap, FAR, armed, arm_W)
                    if closest.distance < contact_distance + model.query_mesh_skin[query_mesh] or is_inside(
                        model, closest
                    ):
                        cache_faces_near(model, query_mesh, p_S, closest, cache, env, contact)
                    cache.nearest[env, contact] = closest.row
                    error = rounding_error(extent, closest)
                    valid = True
            if not valid:
                # With a cache, search farther, to obtain a clearance. The limit is the distance of the last
                # nearest face, which does not affect the result.
                lookahead = wp.where(cached, real(2.0) * search_distance, search_distance)
                limit = lookahead
                hinted = wp.bool(False)
                hint = cache.nearest[env, contact]
                if hint >= set_frames.start and hint < set_frames.stop:
                    if (
                        wp.static(part in (DETECT_BVH, DETECT_GRID_ANY, DETECT_QUERY))
                        or not cached
                        or cache.face_count[env, contact] == 0
                    ):
                        closest = closest_on_face(model, hint, p_S)
                    hinted = closest.distance < lookahead
                    limit = wp.min(limit, closest.distance)
                margin = query_error(model, query_mesh, extent, limit)
                # Within the skin, all faces as near as the hint are searched below. Farther away, skipping the query
                # would keep the choice of an earlier search.
                hint_suffices = (
                    cached
                    and hinted
                    and closest.distance + margin < contact_distance + model.query_mesh_skin[query_mesh]
                )
                if not hint_suffices:
                    mesh = model.query_mesh_id[query_mesh]
                    query = wp.mesh_query_point_no_sign(
                        mesh,
                        wp.vec3f(wp.float32(p_S[0]), wp.float32(p_S[1]), wp.float32(p_S[2])),
                        wp.float32(limit + margin),
                    )
                    if query.result:
                        closest = closest_on_face(model, set_frames.start + query.face, p_S)
                    elif not hinted:
                        return no_closest_point(
                            scale * (lookahead - search_distance), search_gap, FAR, armed, arm_W
                        )
                # Search again among nearly equal faces if rounding can affect the result.
                error = query_error(model, query_mesh, extent, closest.distance)
                inside = is_inside(model, closest)
                is_close = inside or closest.distance < contact_distance + model.query_mesh_skin[query_mesh]
                is_ambiguous = (
                    is_close
                    or closest.distance < contact_distance + error
                    or model.query_mesh_thin_length[query_mesh] > real(0.0)
                )
                is_ambiguous = (
                    is_ambiguous or wp.abs(closest.distance - search_distance) < error or (option & LATCHED) != 0
                )
                if wp.static(part in (DETECT_GRID_ANY, DETECT_QUERY)):
                    if is_ambiguous or wp.static(real is wp.float64):
                        closest = refine_closest(model, query_mesh, p_S, closest, error)
                        error = real(0.0)
                    cache.nearest[env, contact] = closest.row
                else:
                    if cached:
                        cache.face_count[env, contact] = 0
                    margin = error
                    if wp.static(defers) and cached and is_close:
                        closest = closest_and_cache(model, query_mesh, p_S, closest, error, cache, env, contact)
                        is_ambiguous = lost_tie(closest)
                        closest.distance = wp.length(closest.to_point)
                        error = real(0.0)
                    else:
                        is_ambiguous = is_ambiguous or wp.static(real is wp.float64)
                    if is_ambiguous:
                        closest = refine_closest(model, query_mesh, p_S, closest, margin)
                        error = real(0.0)
                    if cached or cache.face_count[env, contact] == 0:
                        cache.nearest[env, contact] = closest.row
            if closest.distance >= search_distance:
                return no_closest_point(
                    scale * (closest.distance - error - search_distance), search_gap, FAR, armed, arm_W
                )
        row = assume_nonnegative(closest.row)
        feature = assume_nonnegative(closest.feature)
        n_S = model.face_normal[row, feature]
        flags = wp.int32(model.face_flags[row, feature])

        # Signed distance s [m], normal n, and whether P is outside an open boundary.
        side = wp.dot(closest.to_point, n_S)
        s = side
        beside_boundary = wp.bool(False)
        if closest.feature != 0:
            sign = real(1.0)
            if side < real(0.0):
                sign = real(-1.0)
            if (flags & FEATURE_BOUNDARY) != 0:
                sideways = wp.length(closest.to_point - side * n_S)
                beside_boundary = sideways > boundary_tolerance * edge_length(model, closest.row, closest.feature)
            if beside_boundary or (flags & FEATURE_BOUNDARY) == 0:
                s = sign * closest.distance
                if closest.distance > wp.max(epsilon * closest.span, point_epsilon * extent):
                    n_S = (sign / closest.distance) * closest.to_point
        s = scale * s
        distance = scale * closest.distance

        is_inactive = (flags & FEATURE_ACTIVE) == 0
        # Outside a boundary only a sphere on the outer side can be in contact, and only with the boundary.
        outside_boundary = beside_boundary and (
            s < real(0.0) or radius == real(0.0) or (option & BOUNDARY_OUTER) == 0
        )

        latch = LATCH_KEEP
        gap = s - radius
        if is_inactive or outside_boundary:
            gap = wp.max(distance - radius, real(0.0))
            if s < real(0.0):
                latch = LATCH_DISARM
            elif s >= radius:
                latch = LATCH_ARM
        elif s >= radius:
            latch = LATCH_ARM
        elif radius - s > geometry.max_depth:
            latch = LATCH_DISARM
        if latch == LATCH_ARM:
            armed = 1
        elif latch == LATCH_DISARM:
            armed = 0

        contact_status = OPEN
        if is_inactive:
            contact_status = INACTIVE
        elif not outside_boundary and s < contact_radius:
            contact_status = CONTACT
            if radius - s > geometry.max_depth or ((option & LATCHED) != 0 and armed == 0):
                contact_status = WRONG_SIDE
        penetration = real(0.0)
        if contact_status == CONTACT:
            penetration = wp.max(radius - s, real(0.0))

        # Displacement without contact. Within the side region, the point stays on its side. Beyond max_depth, on
        # either side, there is no contact.
        clearance = real(-1.0)
        if not tracked_inside and contact_status != CONTACT:
            nearest = distance - scale * error
            if s >= contact_radius:
                clearance = wp.min(nearest - contact_radius, scale * side_clearance(model, query_mesh, p_S))
            if (option & LATCHED) == 0:
                clearance = wp.max(clearance, nearest - wp.max(contact_radius, geometry.max_depth - radius))
            if wp.static(part in (DETECT_GRID_FAR, DETECT_ALL)):
                if cached and contact_status == OPEN and armed != 0 and clearance > real(0.0):
                    store_clearance(cache, env, contact, p_S, set_frames.inverse_scale * clearance)

        # K = S + κ (D − S), where D = P − r n is the deepest point of the sphere; relative to P.
        to_surface = -scale * closest.to_point
        if closest.feature == 0:
            to_surface = -s * n_S
        to_deepest = -radius * n_S
        to_contact = to_surface + geometry.kappa * (to_deepest - to_surface)
        if (option & FORCE_AT_POINT) != 0:
            to_contact = vec3()
        detected = DetectedContact()
        detected.clearance = clearance
        detected.status = contact_status
        detected.armed = armed
        detected.penetration = penetration
        detected.has_details = True
        detected.gap = gap
        detected.face = closest.row
        detected.normal = set_frames.R_WS * n_S
        detected.arm = arm_W + set_frames.R_WS * to_contact
        return detected

    @wp.func
    def write_contact(detected: DetectedContact, contacts: Contacts, env: int, contact: int):
        """Writes a result to ``contacts``."""
        if wp.static(tracks):
            contacts.crossed_face[env, contact] = -1
        if not detected.has_details:
            mark_far(contacts, env, contact)
            return
        contacts.gap[env, contact] = detected.gap
        contacts.status[env, contact] = detected.status
        contacts.armed[env, contact] = detected.armed
        contacts.penetration[env, contact] = detected.penetration
        contacts.face[env, contact] = detected.face
        contacts.normal[env, contact] = detected.normal
        contacts.arm[env, contact] = detected.arm

    @wp.func
    def update_contact(
        model: Model,
        set_frames: SetFrames,
        history: History,
        contacts: Contacts,
        cached: bool,
        cache: Cache,
        env: int,
        contact: int,
    ):
        """Updates a contact; returns the displacement of its point without contact [m], < 0: none."""
        detected = detect(model, set_frames, history, cached, cache, env, contact)
        if wp.static(part in (DETECT_CACHED, DETECT_CANDIDATES, DETECT_FACE_CACHE, DETECT_GRID)):
            if detected.clearance == real(DEFERRED):
                return detected.clearance
        write_contact(detected, contacts, env, contact)
        return detected.clearance

    return Functions(
        SetFrames=SetFrames,
        DetectedContact=DetectedContact,
        frames_of_set=frames_of_set,
        detect=detect,
        mark_far=mark_far,
        write_contact=write_contact,
        update_contact=update_contact,
    )
