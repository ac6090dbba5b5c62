"""Closest point and orientation: the kinematics of a point or sphere against an oriented surface.

The algorithm of EULER's ``contactPS2`` element on a triangle mesh: the nearest
point S over the whole patch, then whether S is active, then the side. The BVH query runs in float32 in the
mesh's own frame and only names a face; the distance, the feature hit and its pseudonormal are computed here in
the precision of the simulation.
"""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels import frames, search
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    ENV_ACTIVE,
    FAR,
    FEATURE_ACTIVE,
    FEATURE_BORDER,
    HIDDEN,
    INLINED,
    LATCH_ARM,
    LATCH_DISARM,
    LATCH_KEEP,
    LATCHED,
    OPEN,
    RIM_OUTER,
    SIDES_ABOVE,
    SIDES_NOWHERE,
    SWEPT,
    WRONG_SIDE,
    Work,
    structs,
)

# A point counts as beside an open border when it is farther sideways than this fraction of the border edge.
BORDER_TOLERANCE = 1.0e-4
# Rounding, in units of epsilon times the size of the differences: below it a direction between two points means
# nothing.
ROUNDING = 16.0
# The same of a point alone, in units of epsilon times its coordinates: on fine meshes this is more.
POINT_ROUNDING = 4.0
# Result of a look that needs a search, and is put off.
LATER = -2.0
# Of what a block is free by: a contact with less left would soon be looked at again.
FEW = 0.25
# Contacts that stay with the part of the surface that they touched.
FOLLOWS = LATCHED | SWEPT


@functools.cache
def kernel(real: type, follows: bool, part: str = "whole") -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` and ``near`` from ``state``; items: blocks.

    With ``follows``, latched and swept contacts stay with the part of the surface that they touched: on the inner
    side their nearest point is the one reached by walking from the last, so that neither the middle of a plate
    nor its far side turns the force over.

    With ``cached`` it looks only at points that may touch, and remembers what it finds: contacts that it leaves
    out do not touch and did not in the last step, and ``near`` lists the others. The outcome is the same.

    Args:
        real: Type of a real number.
        follows: See above.
        part: ``"whole"``; or ``"known"``, which puts off the blocks that need a search, and then ``"rest"``.
    """
    t = structs(real)
    vec3, mat33, Model, State, History = t.vec3, t.mat33, t.Model, t.State, t.History
    Contacts, Near, Cache = t.Contacts, t.Near, t.Cache
    near = feet.functions(real)
    Foot, foot_on, inner, walk = near.Foot, near.foot_on, near.inner, near.walk
    looking = search.functions(real)
    recall, nearest_of_all = looking.recall, looking.nearest_of_all
    nearest_to_remember = looking.nearest_to_remember
    frame = frames.functions(real)
    point_to_world, orientation_to_world = frame.point_to_world, frame.orientation_to_world
    origin, rotation_to_world = frame.origin, frame.rotation_to_world
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    point_epsilon = wp.constant(real(t.epsilon * POINT_ROUNDING))
    # The mesh that the query searches is stored in float32, whatever the precision of the simulation.
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * ROUNDING))
    border_tolerance = wp.constant(real(BORDER_TOLERANCE))
    rounded_down = wp.constant(real(1.0 - 4.0 * t.epsilon))
    rounded_up = wp.constant(real(1.0 + 16.0 * t.epsilon))

    @wp.func
    def edge_length(model: Model, row: int, feature: int):
        """Length of the edge hit, or of the shorter of the two edges of this face at the corner hit."""
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
    class View:
        """Where the points of a block are, and what they see of their surface."""

        b_W: vec3  # origin of the points' body
        R_WB: mat33
        o_W: vec3  # origin of the surface
        R_WS: mat33
        scale: real
        per_scale: real
        patch: wp.int32
        start: wp.int32  # first row of its faces
        stop: wp.int32

    @wp.func
    def view_of(model: Model, state: State, env: int, block: int):
        view = View()
        contact = model.block_contact[model.block_start[block]]
        body = model.point_body[model.contact_point[contact]]
        view.b_W = origin(state, env, body)
        view.R_WB = rotation_to_world(state, env, body)
        base = model.contact_patch[contact]
        surface = model.patch_surface[base]
        carrier = model.surface_body[surface]
        view.o_W = point_to_world(state, env, carrier, model.surface_position[env, surface])
        q_BS = model.surface_orientation[env, surface]
        view.R_WS = wp.quat_to_matrix(orientation_to_world(state, env, carrier, q_BS))
        view.scale = model.surface_scale[env, surface]
        view.per_scale = real(1.0) / view.scale
        view.patch = base + model.surface_mesh[env, surface]
        view.start = model.patch_face_start[view.patch]
        view.stop = model.patch_face_start[view.patch + 1]
        return view

    @wp.func
    def room_on_side(model: Model, patch: int, p_S: vec3):
        """How far a point of the outer side can go before it may be on the inner side without coming through.

        Of surfaces that are not known to keep their sides apart nothing is said: the result is negative.
        """
        sides = model.patch_sides[patch]
        room = real(wp.inf)
        if sides == SIDES_NOWHERE:
            room = real(-1.0)
        elif sides == SIDES_ABOVE:
            for wall in range(model.patch_wall_start[patch], model.patch_wall_start[patch + 1]):
                room = wp.min(room, wp.dot(model.wall_normal[wall], p_S) - model.wall_offset[wall])
        return room

    @wp.func
    def look(
        model: Model,
        view: View,
        history: History,
        contacts: Contacts,
        cached: bool,
        cache: Cache,
        env: int,
        contact: int,
    ):
        """Fills ``contacts`` for one; returns how far its point can move and not touch [m], < 0: not at all."""
        geometry = model.contact_geometry[env, contact]
        radius = geometry.radius
        contacts.penetration[env, contact] = real(0.0)
        contacts.normal[env, contact] = vec3()
        contacts.face[env, contact] = -1
        contacts.crossed_face[env, contact] = -1
        p_W = view.b_W + view.R_WB * model.point_position[env, model.contact_point[contact]]
        contacts.point[env, contact] = p_W
        if geometry.enabled == 0:
            contacts.gap[env, contact] = real(wp.nan)
            contacts.status[env, contact] = DISABLED
            contacts.armed[env, contact] = history.armed[env, contact]
            return real(wp.inf)

        # Into the mesh's own frame and unit, where float32 is as good as the mesh.
        patch, scale = view.patch, view.scale
        reach = radius * view.per_scale
        p_S = view.per_scale * (wp.transpose(view.R_WS) * (p_W - view.o_W))

        option = model.contact_options[contact]
        extent = wp.max(wp.max(wp.abs(p_S[0]), wp.abs(p_S[1])), wp.abs(p_S[2]))
        foot = Foot()
        # How far the nearest face may be nearer than the foot.
        unsure = real(0.0)
        held = wp.bool(False)
        if wp.static(follows):
            # A face of another mesh, which the surface had before, says nothing.
            last = history.face[env, contact]
            if last >= view.start and last < view.stop and (option & FOLLOWS) != 0:
                foot = walk(model, last, p_S)
                held = inner(model, foot)
        if not held:
            # A sphere sees at least what it overlaps.
            seen = wp.max(geometry.search_radius * view.per_scale, reach)
            known = wp.bool(False)
            if cached:
                recalled = recall(model, cache, env, contact, p_S)
                known = recalled.known
                foot = recalled.foot
            if wp.static(part == "known"):
                if not known:
                    return real(LATER)
            elif not known:
                # With a cache it looks farther, to know how long it need not look again, yet not beyond the face
                # that was nearest last.
                ahead = wp.where(cached, real(2.0) * seen, seen)
                limit = ahead
                hinted = wp.bool(False)
                if cached:
                    hint = cache.nearest[env, contact]
                    if hint >= view.start and hint < view.stop:
                        if cache.faces[env, contact] == 0:
                            foot = foot_on(model, hint, p_S)
                        hinted = foot.distance < ahead
                        limit = wp.min(limit, foot.distance)
                if not (hinted and foot.distance < reach + model.patch_skin[patch]):
                    margin = model.patch_slack[patch] + query_epsilon * (extent + limit)
                    mesh = model.patch_mesh[patch]
                    query = wp.mesh_query_point_no_sign(
                        mesh,
                        wp.vec3f(wp.float32(p_S[0]), wp.float32(p_S[1]), wp.float32(p_S[2])),
                        wp.float32(limit + margin),
                    )
                    if query.result:
                        foot = foot_on(model, view.start + query.face, p_S)
                    elif not hinted:
                        contacts.gap[env, contact] = wp.max(geometry.search_radius - radius, real(0.0))
                        contacts.status[env, contact] = FAR
                        contacts.armed[env, contact] = history.armed[env, contact]
                        return scale * (ahead - seen)
                # Wherever rounding matters, the choice is looked at again.
                unsure = model.patch_slack[patch] + query_epsilon * (extent + foot.distance)
                inside = inner(model, foot)
                doubtful = inside or foot.distance < reach + unsure or model.patch_doubtful[patch]
                doubtful = doubtful or wp.abs(foot.distance - seen) < unsure or (option & LATCHED) != 0
                keep = cached and (inside or foot.distance < reach + model.patch_skin[patch])
                if cached:
                    cache.faces[env, contact] = 0
                if keep:
                    foot = nearest_to_remember(model, patch, p_S, foot, unsure, cache, env, contact)
                    unsure = real(0.0)
                elif doubtful or wp.static(real is wp.float64):
                    foot = nearest_of_all(model, patch, p_S, foot, unsure)
                    unsure = real(0.0)
                if cached:
                    cache.nearest[env, contact] = foot.row
            if foot.distance >= seen:
                contacts.gap[env, contact] = wp.max(geometry.search_radius - radius, real(0.0))
                contacts.status[env, contact] = FAR
                contacts.armed[env, contact] = history.armed[env, contact]
                return scale * (foot.distance - unsure - seen)
        n_S = model.face_normal[foot.row, foot.feature]
        flags = wp.int32(model.face_flags[foot.row, foot.feature])
        contacts.face[env, contact] = foot.row

        # Signed distance s [m], direction n, and whether P lies beside an open border.
        side = wp.dot(foot.to_point, n_S)
        s = side
        beside = wp.bool(False)
        if foot.feature != 0:
            sign = real(1.0)
            if side < real(0.0):
                sign = real(-1.0)
            if (flags & FEATURE_BORDER) != 0:
                sideways = wp.length(foot.to_point - side * n_S)
                beside = sideways > border_tolerance * edge_length(model, foot.row, foot.feature)
            if beside or (flags & FEATURE_BORDER) == 0:
                s = sign * foot.distance
                if foot.distance > wp.max(epsilon * foot.span, point_epsilon * extent):
                    n_S = (sign / foot.distance) * foot.to_point
        s = scale * s
        distance = scale * foot.distance

        hidden = (flags & FEATURE_ACTIVE) == 0
        # Beside a border only a sphere on the outer side can touch, and only the rim.
        missed = beside and (s < real(0.0) or radius == real(0.0) or (option & RIM_OUTER) == 0)

        latch = LATCH_KEEP
        if hidden or missed:
            contacts.gap[env, contact] = wp.max(distance - radius, real(0.0))
            if s < real(0.0):
                latch = LATCH_DISARM
            elif s >= radius:
                latch = LATCH_ARM
        else:
            contacts.gap[env, contact] = s - radius
            if s >= radius:
                latch = LATCH_ARM
            elif radius - s > geometry.max_depth:
                latch = LATCH_DISARM
        armed = history.armed[env, contact]
        if latch == LATCH_ARM:
            armed = 1
        elif latch == LATCH_DISARM:
            armed = 0
        contacts.armed[env, contact] = armed

        touching = OPEN
        if hidden:
            touching = HIDDEN
        elif not missed and s < radius:
            touching = CONTACT
            if radius - s > geometry.max_depth or ((option & LATCHED) != 0 and armed == 0):
                touching = WRONG_SIDE
        contacts.status[env, contact] = touching
        if touching == CONTACT:
            contacts.penetration[env, contact] = radius - s

        # How far the point is from touching. On the side that it is on it stays, where that is known; one that is
        # deeper than counts as contact, or farther than that outside, does not touch whatever its side.
        free = real(-1.0)
        if not held and touching != CONTACT:
            nearest = distance - scale * unsure
            if s >= radius:
                free = wp.min(nearest - radius, scale * room_on_side(model, patch, p_S))
            if (option & LATCHED) == 0:
                free = wp.max(free, nearest - wp.max(radius, geometry.max_depth - radius))

        # K = S + κ (D − S) with D = P − RC n, the deepest point; seen from P.
        to_surface = -scale * foot.to_point
        if foot.feature == 0:
            to_surface = -s * n_S
        to_deepest = -radius * n_S
        to_contact = to_surface + geometry.kappa * (to_deepest - to_surface)
        contacts.normal[env, contact] = view.R_WS * n_S
        contacts.point[env, contact] = p_W + view.R_WS * to_contact
        return free

    @wp.func
    def probe(model: Model, view: View, env: int, block: int):
        """How far a point in the middle of a block is from coming to touch, or to be on the inner side [m].

        All that lies nearer to it than this is as free. Negative: nothing is known.
        """
        patch = view.patch
        c_W = view.b_W + view.R_WB * model.block_center[env, block]
        c_S = view.per_scale * (wp.transpose(view.R_WS) * (c_W - view.o_W))
        query = wp.mesh_query_point_no_sign(
            model.patch_mesh[patch],
            wp.vec3f(wp.float32(c_S[0]), wp.float32(c_S[1]), wp.float32(c_S[2])),
            wp.float32(wp.inf),
        )
        if not query.result:
            return real(-1.0)
        foot = foot_on(model, view.start + query.face, c_S)
        extent = wp.max(wp.max(wp.abs(c_S[0]), wp.abs(c_S[1])), wp.abs(c_S[2]))
        unsure = model.patch_slack[patch] + query_epsilon * (extent + foot.distance)
        if inner(model, foot):
            return real(-1.0)
        return view.scale * wp.min(foot.distance - unsure, room_on_side(model, patch, c_S))

    @wp.func
    def left_of(model: Model, env: int, block: int, contact: int, around: real):
        """What is left of ``around``, which is for the middle of a block, for one of its contacts [m]."""
        arm_B = model.point_position[env, model.contact_point[contact]] - model.block_center[env, block]
        return around - rounded_up * wp.length(arm_B) - model.contact_geometry[env, contact].radius

    @wp.func
    def leave(contacts: Contacts, env: int, contact: int):
        """Fills ``contacts`` for one that is far away on the outer side."""
        contacts.status[env, contact] = OPEN
        contacts.penetration[env, contact] = real(0.0)
        contacts.armed[env, contact] = 1

    @wp.func
    def changed(contacts: Contacts, history: History, env: int, contact: int):
        """Whether a contact that does not touch has something to tell: it did, or its latch moved."""
        latch = contacts.armed[env, contact] != history.armed[env, contact]
        return latch or history.entry_speed[env, contact] >= real(0.0)

    @wp.func
    def put_off(cache: Cache, task: int):
        cache.waiting_task[wp.atomic_add(cache.waiting, 0, 1)] = task

    @wp.kernel(module="unique", enable_backward=False, module_options=INLINED)
    def closest_point(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        cached: wp.bool,
        cache: Cache,
        contacts: Contacts,
        near: Near,
    ):
        tasks = work.tasks
        if wp.static(part == "rest"):
            tasks = cache.waiting[0]
        thread = wp.tid()
        if wp.static(part == "rest"):
            # Searches go different ways: as few as may be side by side in a warp.
            warps = (work.threads + 31) // 32
            thread = (thread % 32) * warps + thread // 32
        for i in range(thread, tasks, work.threads):
            task = i
            if wp.static(part == "rest"):
                task = cache.waiting_task[i]
            env = work.first + task // work.items
            block = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            count = wp.int32(0)
            number = model.block_set[block]
            travel = real(0.0)
            travelled = real(0.0)
            if cached:
                travel = cache.set_travel[env, number]
                travelled = travel + cache.set_margin[env, number]
                if cache.set_asleep[env, number] != 0 or travelled < cache.block_wake[env, block]:
                    near.count[env, block] = 0
                    continue
            start = model.block_start[block]
            stop = model.block_start[block + 1]
            view = view_of(model, state, env, block)
            around = real(-1.0)
            if cached and stop - start > 1:
                # One search in the middle may do for all that are far from where they last touched.
                unknown = wp.bool(False)
                for place in range(start, stop):
                    contact = model.block_contact[place]
                    if cache.faces[env, contact] == 0 and not (travelled < cache.wake[env, contact]):
                        unknown = True
                if unknown:
                    if wp.static(part == "known"):
                        put_off(cache, task)
                        continue
                    around = probe(model, view, env, block)
            later = wp.bool(False)
            first_wake = real(wp.inf)
            for place in range(start, stop):
                contact = model.block_contact[place]
                wake = real(0.0)
                if cached:
                    wake = cache.wake[env, contact]
                news = wp.bool(False)
                if not cached or not (travelled < wake):
                    news = True
                    always = (model.contact_options[contact] & SWEPT) != 0
                    free = real(-1.0)
                    if around > real(0.0) and not always and cache.faces[env, contact] == 0:
                        free = left_of(model, env, block, contact, around)
                    if free > real(FEW) * around and model.contact_geometry[env, contact].enabled != 0:
                        leave(contacts, env, contact)
                    else:
                        free = look(model, view, history, contacts, cached, cache, env, contact)
                    if wp.static(part == "known") and free == real(LATER):
                        later = True
                        break
                    if cached:
                        wake = real(0.0)
                        if free > real(0.0) and not always:
                            wake = rounded_down * (travel + free)
                        cache.wake[env, contact] = wake
                        # What neither touches nor touched has nothing to be told.
                        touches = contacts.status[env, contact] == CONTACT
                        news = always or touches or changed(contacts, history, env, contact)
                else:
                    if wp.static(part == "rest"):
                        # It may have been looked at before its block was put off.
                        news = changed(contacts, history, env, contact)
                    if around > real(0.0):
                        # Those asleep may learn that they can sleep longer.
                        longer = rounded_down * (travel + left_of(model, env, block, contact, around))
                        if longer > wake:
                            wake = longer
                            cache.wake[env, contact] = wake
                if news:
                    near.contact[env, start + count] = contact
                    count += 1
                first_wake = wp.min(first_wake, wake)
            if wp.static(part == "known") and later:
                put_off(cache, task)
                continue
            near.count[env, block] = count
            if cached:
                cache.block_wake[env, block] = first_wake

    return closest_point
