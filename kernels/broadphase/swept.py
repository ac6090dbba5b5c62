"""Swept test (continuous detection): finds points that cross a surface from its outer side within a step."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.broadphase import motion_bound
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    ENV_PAUSED,
    ENV_SUBSTEP,
    FAR,
    FEATURE_ACTIVE,
    LATCHED,
    SWEPT,
    LaunchRange,
    first_env,
    structs,
    task_count,
    task_env,
    task_item,
)

# Rounding error of the test, in units of epsilon times the size of the coordinates. Faces are enlarged by it, so
# that no point passes between two faces.
ROUNDING = 64.0
# Largest number of crossings of one point within a step.
MAX_CROSSINGS = 8


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that tracks swept contacts through their surface; items: clusters.

    Relative to the surface, a point moves on a straight line from ``state_in`` to ``state_out``. The first inward
    crossing is recorded; ``face`` and ``crossed_face`` are the face below the point at the end of the step.
    Contacts that crossed are appended to ``active_contacts``, unless they are listed already.
    """
    t = structs(real)
    vec3, Model, State, Contacts, ActiveContacts, Cache = (
        t.vec3,
        t.Model,
        t.State,
        t.Contacts,
        t.ActiveContacts,
        t.Cache,
    )
    set_pose, displacement_bound = (
        motion_bound.functions(real).set_pose,
        motion_bound.functions(real).displacement_bound,
    )
    track, is_inside = closest_points.functions(real).track, closest_points.functions(real).is_inside
    frame = frames.functions(real)
    offset_between, rotate_to_world, orientation_to_world = (
        frame.offset_between,
        frame.rotate_to_world,
        frame.orientation_to_world,
    )
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * ROUNDING))

    @wp.func
    def to_surface(model: Model, state: State, env: int, contact: int, surface: int):
        """Returns the point of a contact in the frame and unit of the mesh."""
        point = model.contact_point[contact]
        carrier = model.surface_body[surface]
        arm_W = rotate_to_world(state, env, model.point_body[point], model.point_position[env, point])
        o_W = rotate_to_world(state, env, carrier, model.surface_position[env, surface])
        q_WS = orientation_to_world(state, env, carrier, model.surface_orientation[env, surface])
        p_W = offset_between(model, state, env, point, surface) - o_W + arm_W
        return wp.quat_rotate_inv(q_WS, p_W) / model.surface_scale[env, surface]

    @wp.func
    def max_component(v: vec3):
        return wp.max(wp.max(wp.abs(v[0]), wp.abs(v[1])), wp.abs(v[2]))

    @wp.func
    def face_crossing(model: Model, row: int, p: vec3, q: vec3, sense: real, slack: real):
        """Returns the fraction of the path from ``p`` to ``q`` at which face ``row`` is crossed; 2: not crossed.

        ``sense``: 1: inwards, −1: outwards.
        """
        n = model.face_normal[row, 0]
        a = model.face_corner[row, 0]
        b = model.face_corner[row, 1]
        c = model.face_corner[row, 2]
        before = sense * wp.dot(p - a, n)
        after = sense * wp.dot(q - a, n)
        if before < -slack or after >= real(0.0) or after >= before:
            return real(2.0)
        fraction = wp.clamp(before / (before - after), real(0.0), real(1.0))
        x = p + fraction * (q - p)
        if (
            wp.dot(wp.cross(n, b - a), x - a) < -slack * wp.length(b - a)
            or wp.dot(wp.cross(n, c - b), x - b) < -slack * wp.length(c - b)
            or wp.dot(wp.cross(n, a - c), x - c) < -slack * wp.length(a - c)
        ):
            return real(2.0)
        return fraction

    @wp.func
    def first_crossing(model: Model, query_mesh: int, holding_face: int, p: vec3, q: vec3):
        """Returns the fraction of the path from ``p`` to ``q`` at the first crossing, and the row; 2 and −1: none.

        If ``holding_face`` < 0, inward crossings of active faces count; otherwise outward crossings of its sheet.
        """
        sense = wp.where(holding_face >= 0, real(-1.0), real(1.0))
        scale = max_component(p) + max_component(q)
        slack = epsilon * scale
        margin = model.query_mesh_error[query_mesh] + query_epsilon * scale
        margins = vec3(margin, margin, margin)
        low = wp.min(p, q) - margins
        high = wp.max(p, q) + margins
        start = model.query_mesh_face_start[query_mesh]
        boxes = wp.mesh_query_aabb(
            model.query_mesh_id[query_mesh],
            wp.vec3f(wp.float32(low[0]), wp.float32(low[1]), wp.float32(low[2])),
            wp.vec3f(wp.float32(high[0]), wp.float32(high[1]), wp.float32(high[2])),
        )
        face = wp.int32(0)
        first = real(2.0)
        crossed = wp.int32(-1)
        while wp.mesh_query_aabb_next(boxes, face):
            row = start + face
            fraction = face_crossing(model, row, p, q, sense, slack)
            if fraction < first or (fraction == first and fraction < real(2.0) and row < crossed):
                counts = (wp.int32(model.face_flags[row, 0]) & FEATURE_ACTIVE) != 0
                if holding_face >= 0:
                    counts = track(model, holding_face, p, p + fraction * (q - p)).distance <= real(2.0) * slack
                if counts:
                    first = fraction
                    crossed = row
        return first, crossed

    @wp.func
    def plane_crossing(model: Model, row: int, p: vec3, q: vec3):
        """Returns the fraction of the path from ``p`` to ``q`` at which the plane of face ``row`` is crossed."""
        n = model.face_normal[row, 0]
        before = wp.dot(p - model.face_corner[row, 0], n)
        after = wp.dot(q - model.face_corner[row, 0], n)
        if before >= real(0.0) or after <= real(0.0):
            return real(1.0)
        return before / (before - after)

    @wp.func
    def may_cross(model: Model, contacts: Contacts, env: int, contact: int):
        option = model.contact_options[contact]
        if (option & SWEPT) == 0 or model.contact_geometry[env, contact].enabled == 0:
            return False
        # Not armed: on the wrong side, or never near enough to determine the side.
        armed = contacts.armed[env, contact] != 0 or contacts.status[env, contact] == FAR
        return armed or (option & LATCHED) == 0

    @wp.func
    def track_through(model: Model, state_in: State, state_out: State, contacts: Contacts, env: int, contact: int):
        """Tracks a contact into and out of its surface; returns whether it crossed inwards."""
        base = model.contact_query_mesh[contact]
        surface = model.query_mesh_surface[base]
        query_mesh = base + model.surface_mesh[env, surface]
        p = to_surface(model, state_in, env, contact, surface)
        q = to_surface(model, state_out, env, contact, surface)
        # A point on the inner side belongs to a face until it leaves the sheet of that face.
        holding_face = wp.int32(-1)
        depth = contacts.penetration[env, contact] - model.contact_geometry[env, contact].radius
        if contacts.status[env, contact] == CONTACT and depth >= real(0.0):
            holding_face = contacts.face[env, contact]
        final_face = holding_face
        elapsed_fraction = real(0.0)
        entry_fraction = real(2.0)
        for _ in range(wp.static(MAX_CROSSINGS)):
            fraction, row = first_crossing(model, query_mesh, holding_face, p, q)
            if holding_face >= 0:
                closest = track(model, holding_face, p, q)
                final_face = closest.row
                if fraction > real(1.0):
                    if is_inside(model, closest):
                        break
                    # Past a boundary, the point is free again where it passes the plane of the face.
                    fraction = plane_crossing(model, final_face, p, q)
            elif row < 0:
                break
            else:
                entry_fraction = wp.min(
                    entry_fraction, elapsed_fraction + (real(1.0) - elapsed_fraction) * fraction
                )
            holding_face = wp.where(holding_face >= 0, -1, row)
            p = p + fraction * (q - p)
            elapsed_fraction = elapsed_fraction + (real(1.0) - elapsed_fraction) * fraction
        if final_face >= 0:
            # The next closest-point search starts from the face at the end of the path.
            contacts.face[env, contact] = final_face
        if entry_fraction > real(1.0):
            return False
        contacts.armed[env, contact] = 1
        contacts.crossed_face[env, contact] = final_face
        contacts.crossing_fraction[env, contact] = entry_fraction
        return True

    @unique_kernel()
    def sweep(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state_in: State,
        state_out: State,
        cached: wp.bool,
        cache: Cache,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        mark_crossings: wp.int32,  # whether environments with a crossing repeat the step in substeps
        any_crossed: wp.array(dtype=wp.int32),  # [0] 1 if any environment is marked
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            active_contacts.crossed_count[env, cluster] = 0
            start = model.cluster_start[cluster]
            if (model.contact_options[model.cluster_contact[start]] & SWEPT) == 0:
                continue
            # A repeated step may have crossed other faces before.
            count = active_contacts.count[env, cluster]
            for i in range(start, start + count):
                contacts.crossed_face[env, active_contacts.contact[env, i]] = -1
            # Travel at the end of the step: contacts that are still culled there did not cross.
            max_travel = real(wp.inf)
            if cached:
                set_index = model.cluster_set[cluster]
                pose = set_pose(model, state_out, env, set_index)
                margin = wp.max(pose.margin, cache.set_margin[env, set_index])
                max_travel = (
                    cache.set_travel[env, set_index]
                    + displacement_bound(model, cache, env, set_index, pose)
                    + margin
                )
                if max_travel < cache.cluster_safe_travel[env, cluster]:
                    continue
            crossed = wp.int32(0)
            for index in range(start, model.cluster_start[cluster + 1]):
                contact = model.cluster_contact[index]
                if max_travel < cache.safe_travel[env, contact] or not may_cross(model, contacts, env, contact):
                    continue
                if not track_through(model, state_in, state_out, contacts, env, contact):
                    continue
                listed = wp.bool(False)
                for i in range(start, start + count):
                    listed = listed or active_contacts.contact[env, i] == contact
                if not listed:
                    active_contacts.contact[env, start + count + crossed] = contact
                    crossed += 1
                if mark_crossings != 0:
                    # Several threads may write the same values.
                    status[env] = ENV_SUBSTEP
                    any_crossed[0] = 1
            active_contacts.crossed_count[env, cluster] = crossed

    return sweep


@functools.cache
def mask_substeps() -> wp.Kernel:
    """Returns the kernel that masks environments for substeps; items: environments.

    ``restore`` 0: environments with a crossing become active, active ones are paused. 1: both become active again.
    """

    @unique_kernel()
    def mask_environments(launch: LaunchRange, status: wp.array(dtype=wp.int32), restore: wp.int32):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if restore != 0:
                if status[env] == ENV_PAUSED or status[env] == ENV_SUBSTEP:
                    status[env] = ENV_ACTIVE
            elif status[env] == ENV_SUBSTEP:
                status[env] = ENV_ACTIVE
            elif status[env] == ENV_ACTIVE:
                status[env] = ENV_PAUSED

    return mask_environments
