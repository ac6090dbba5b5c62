"""Closest point and orientation: the kinematics of a point or sphere against an oriented surface.

The algorithm of EULER's ``contactPS2`` element on a triangle mesh: the nearest
point S over the whole patch, then whether S is active, then the side. Warp's query runs in float32 in the mesh's
own frame and only names a face; the distance, the feature hit and its pseudonormal are computed here in the
precision of the simulation. Where a CPU remembers faces it searches in that as well, by a tree of its own.
"""

import functools
import math
from types import SimpleNamespace

import numpy as np
import warp as wp
from warpcontact.kernels import cells, frames, rotations, search, tree
from warpcontact.kernels import foot as feet
from warpcontact.kernels import recall as lists
from warpcontact.kernels.sides import room_on_side as sides_of
from warpcontact.kernels.types import (
    AT_POINT,
    BOUNDARY_OUTER,
    CONTACT,
    DISABLED,
    FAR,
    FEATURE_ACTIVE,
    FEATURE_BOUNDARY,
    INACTIVE,
    LATCH_ARM,
    LATCH_DISARM,
    LATCH_KEEP,
    LATCHED,
    OPEN,
    REMEMBERED_IN_QUEUES,
    SWEPT,
    WRONG_SIDE,
    natural,
    structs,
)

# A point counts as beside an open boundary when it is farther sideways than this fraction of the boundary edge.
BOUNDARY_TOLERANCE = 1.0e-4
# Rounding, in units of epsilon times the size of the differences: below it a direction between two points means
# nothing.
ROUNDING = 16.0
# The same of a point alone, in units of epsilon times its coordinates: on fine meshes this is more.
POINT_ROUNDING = 4.0
# Parts of a look.
WHOLE, KNOWN, LISTED, RECALLED, SEARCH = "whole", "known", "listed", "recalled", "search"
CELL, AWAY, EITHER, QUERY = "cell", "away", "either", "query"
# Of what a point was free by: with less left it would soon be looked at again.
FEW = 0.25
# Result of one that is left to the next part: no distance.
LATER = -math.inf
# Contacts that stay with the part of the surface that they touched.
FOLLOWS = LATCHED | SWEPT


@functools.cache
def functions(real: type, follows: bool, part: str) -> SimpleNamespace:
    """Returns the struct ``View`` and the device functions for ``real``.

    With ``follows``, latched and swept contacts stay with the part of the surface that they touched: on the inner
    side their nearest point is the one reached by walking from the last, so that neither the middle of a plate
    nor its far side turns the force over.

    ``part`` is ``WHOLE``, or one of some that do it in turn, each putting off what it does not know: ``KNOWN``
    takes the face that is sure to be nearest, ``LISTED`` looks through the remembered ones, ``RECALLED`` does
    both, and ``SEARCH`` searches. Or, about meshes with cells, with no faces remembered: ``CELL`` looks through
    the faces of a cell, ``AWAY`` does unless it remembers that none is near, ``QUERY`` searches, and ``EITHER``
    does what is due.
    """
    t = structs(real)
    vec3, mat33, Model, State, History = t.vec3, t.mat33, t.Model, t.State, t.History
    Contacts, Cache = t.Contacts, t.Cache
    in_queues = part != WHOLE
    of_face, of_list, of_search = feet.functions(real), lists.functions(real), search.functions(real)
    Foot, foot_on, inner, walk = of_face.Foot, of_face.foot_on, of_face.inner, of_face.walk
    fallen = of_face.fallen
    recall = {
        WHOLE: of_list.recall_at_once,
        KNOWN: of_list.recall_sure,
        LISTED: of_list.recall_listed,
        RECALLED: of_list.recall,
    }.get(part, of_list.recall_nothing)
    nearest_of_all, extent_of, unsure_of = of_search.nearest_of_all, of_search.extent_of, of_search.unsure_of
    nearest_to_remember = search.nearest_to_remember(real, REMEMBERED_IN_QUEUES)
    of_tree = tree.functions(real)
    search_tree, rounding_of, remember_about = of_tree.nearest, of_tree.rounding_of, of_tree.remember_about
    cell_at, nearest_listed = cells.functions(real).cell_at, cells.functions(real).nearest_listed
    room_on_side = sides_of(real)
    frame = frames.functions(real)
    apart, turned, matrix = frame.apart, frame.turned, rotations.functions(real).matrix
    orientation_to_world, rotation_to_world = frame.orientation_to_world, frame.rotation_to_world
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    point_epsilon = wp.constant(real(t.epsilon * POINT_ROUNDING))
    # The mesh that the query searches is stored in float32, whatever the precision of the simulation.
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * search.QUERY_ROUNDING))
    boundary_tolerance = wp.constant(real(BOUNDARY_TOLERANCE))

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
        """Where the points of a set are, and what they see of their surface."""

        apart_W: vec3  # from the origin of the surface to where the points are given from
        R_WB: mat33
        R_WS: mat33
        scale: real
        per_scale: real
        number: wp.int32  # of their set
        patch: wp.int32
        start: wp.int32  # first row of its faces
        stop: wp.int32

    @wp.func
    def view_of(model: Model, state: State, env: int, number: int):
        view = View()
        contact = natural(model.set_contact[number])
        view.number = number
        point = natural(model.contact_point[contact])
        view.R_WB = rotation_to_world(state, env, model.point_body[point])
        base = natural(model.contact_patch[contact])
        surface = natural(model.patch_surface[base])
        carrier = model.surface_body[surface]
        o_W = turned(state, env, carrier, model.surface_position[env, surface])
        view.apart_W = apart(model, state, env, point, surface) - o_W
        q_BS = model.surface_orientation[env, surface]
        view.R_WS = matrix(orientation_to_world(state, env, carrier, q_BS))
        view.scale = model.surface_scale[env, surface]
        view.per_scale = real(1.0) / view.scale
        view.patch = natural(base + model.surface_mesh[env, surface])
        view.start = model.patch_face_start[view.patch]
        view.stop = model.patch_face_start[view.patch + 1]
        return view

    @wp.struct
    class Found:
        """What a look at a contact finds."""

        free: real  # how far its point can move and not touch [m]; < 0: not at all; LATER: nothing was found
        status: wp.int32  # OPEN, CONTACT, …
        armed: wp.int32  # the latch that this leads to
        penetration: real  # 0 unless status is CONTACT [m]
        told: wp.bool  # whether what follows is told: not of what is far away, as far as steps look at it
        gap: real  # < 0 in overlap [m]
        face: wp.int32  # row of the face; −1: none
        normal: vec3  # out of the surface, W
        arm: vec3  # to K, where the force acts, from where points are given, W [m]

    @wp.func
    def keep_away(cache: Cache, env: int, contact: int, p_S: vec3, room: real):
        """Remembers how far a point can move from where it is and not touch, in units of the mesh."""
        cache.room[env, contact] = room
        cache.room_place[env, contact] = p_S

    @wp.func
    def left_of_room(cache: Cache, env: int, contact: int, p_S: vec3):
        """How far a point can still move, of what it could where that was remembered, in units of the mesh."""
        return cache.room[env, contact] - wp.length(p_S - cache.room_place[env, contact])

    @wp.func
    def lost(free: real, gap: real, status: int, armed: int, arm_W: vec3):
        """What is found of one that has no nearest point."""
        found = Found()
        found.free = free
        found.status = status
        found.armed = armed
        found.told = True
        found.gap = gap
        found.face = -1
        found.arm = arm_W
        return found

    @wp.func
    def away(free: real):
        """What is found of one that is far away on the outer side."""
        found = Found()
        found.free = free
        found.status = OPEN
        found.armed = 1
        return found

    @wp.func
    def later():
        """What is found by a part that leaves it to the next."""
        found = Found()
        found.free = real(LATER)
        return found

    @wp.func
    def leave(contacts: Contacts, env: int, contact: int):
        """Fills ``contacts`` for one that is far away on the outer side, as far as steps look at it."""
        contacts.status[env, contact] = OPEN
        contacts.penetration[env, contact] = real(0.0)
        contacts.armed[env, contact] = 1

    @wp.func
    def find(model: Model, view: View, history: History, cached: bool, cache: Cache, env: int, contact: int):
        """Looks at a contact."""
        geometry = model.contact_geometry[env, contact]
        radius = geometry.radius
        armed = history.armed[env, contact]
        arm_W = view.R_WB * model.point_position[env, natural(model.contact_point[contact])]
        if geometry.enabled == 0:
            return lost(real(wp.inf), real(wp.nan), DISABLED, armed, arm_W)
        out_of_sight = wp.max(geometry.search_radius - radius, real(0.0))

        # Distance below which there is contact.
        touch_at = radius + geometry.closed
        # Into the mesh's own frame and unit, where float32 is as good as the mesh.
        patch, scale = view.patch, view.scale
        reach = touch_at * view.per_scale
        p_S = view.per_scale * (wp.transpose(view.R_WS) * (view.apart_W + arm_W))

        option = model.contact_options[contact]
        extent = extent_of(p_S)
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
            # A latch that is not armed waits until the surface is in sight.
            may_be_away = armed != 0 or (option & LATCHED) == 0
            if wp.static(part == AWAY):
                if may_be_away:
                    left = left_of_room(cache, env, contact, p_S)
                    if left > query_epsilon * extent:
                        return away(scale * left)
            elif wp.static(part == WHOLE):  # noqa: SIM102
                if cached and may_be_away and cache.faces[env, contact] == 0:
                    left = left_of_room(cache, env, contact, p_S)
                    if left > wp.max(query_epsilon * extent, real(FEW) * cache.room[env, contact]):
                        return away(scale * left)
            step = view.per_scale * cache.set_step[env, view.number]
            recalled = recall(model, patch, cache, env, contact, p_S, step)
            if wp.static(part == WHOLE):  # noqa: SIM102  Warp would evaluate both sides
                if recalled.known:
                    if cached:
                        cache.nearest[env, contact] = recalled.foot.row
                    else:
                        # Far away a search settles no ties, as what is remembered does.
                        farthest = recalled.foot.distance
                        farthest += unsure_of(model, patch, extent, farthest)
                        recalled.known = farthest < reach + model.patch_skin[patch]
            foot = recalled.foot
            known = recalled.known
            if wp.static(part in (CELL, AWAY, EITHER)):
                cell = cell_at(model, patch, p_S)
                if cell.free > reach and may_be_away:
                    if wp.static(part == AWAY):
                        keep_away(cache, env, contact, p_S, cell.free - reach)
                    return away(scale * (cell.free - reach))
                known = cell.faces >= 0
                if known:
                    margin = unsure_of(model, patch, extent, reach)
                    foot = nearest_listed(model, cell.faces, p_S, margin)
            if wp.static(part in (KNOWN, LISTED, RECALLED, CELL, AWAY)):  # noqa: SIM102
                if not known:
                    return later()
            if wp.static(part == WHOLE):  # noqa: SIM102
                if cached and not known:
                    foot = search_tree(model, patch, p_S, cache.nearest[env, contact])
                    cache.faces[env, contact] = 0
                    # A point that is no number has none.
                    if not (foot.distance < real(wp.inf)):
                        return lost(real(0.0), out_of_sight, FAR, armed, arm_W)
                    if foot.distance < reach + model.patch_skin[patch] or inner(model, foot):
                        remember_about(model, patch, p_S, foot, cache, env, contact)
                    cache.nearest[env, contact] = foot.row
                    unsure = rounding_of(extent, foot)
                    known = True
            if not known:
                # With a cache it looks farther, to know how long it need not look again. It never looks beyond the
                # face that was nearest last: whichever that was, what is found is the same.
                ahead = wp.where(cached, real(2.0) * seen, seen)
                limit = ahead
                hinted = wp.bool(False)
                hint = cache.nearest[env, contact]
                if hint >= view.start and hint < view.stop:
                    if wp.static(part in (SEARCH, EITHER, QUERY)) or not cached or cache.faces[env, contact] == 0:
                        foot = foot_on(model, hint, p_S)
                    hinted = foot.distance < ahead
                    limit = wp.min(limit, foot.distance)
                margin = unsure_of(model, patch, extent, limit)
                # Ties are settled from the nearest on; what is remembered keeps the choice of an earlier search.
                enough = cached and hinted and foot.distance + margin < reach + model.patch_skin[patch]
                if not enough:
                    mesh = model.patch_mesh[patch]
                    query = wp.mesh_query_point_no_sign(
                        mesh,
                        wp.vec3f(wp.float32(p_S[0]), wp.float32(p_S[1]), wp.float32(p_S[2])),
                        wp.float32(limit + margin),
                    )
                    if query.result:
                        foot = foot_on(model, view.start + query.face, p_S)
                    elif not hinted:
                        return lost(scale * (ahead - seen), out_of_sight, FAR, armed, arm_W)
                # Wherever rounding matters, the choice is looked at again.
                unsure = unsure_of(model, patch, extent, foot.distance)
                inside = inner(model, foot)
                close = inside or foot.distance < reach + model.patch_skin[patch]
                doubtful = close or foot.distance < reach + unsure or model.patch_thin[patch] > real(0.0)
                doubtful = doubtful or wp.abs(foot.distance - seen) < unsure or (option & LATCHED) != 0
                if wp.static(part in (EITHER, QUERY)):
                    if doubtful or wp.static(real is wp.float64):
                        foot = nearest_of_all(model, patch, p_S, foot, unsure)
                        unsure = real(0.0)
                    cache.nearest[env, contact] = foot.row
                else:
                    if cached:
                        cache.faces[env, contact] = 0
                    margin = unsure
                    if wp.static(in_queues) and cached and close:
                        foot = nearest_to_remember(model, patch, p_S, foot, unsure, cache, env, contact)
                        doubtful = fallen(foot)
                        foot.distance = wp.length(foot.to_point)
                        unsure = real(0.0)
                    else:
                        doubtful = doubtful or wp.static(real is wp.float64)
                    if doubtful:
                        foot = nearest_of_all(model, patch, p_S, foot, margin)
                        unsure = real(0.0)
                    if cached or cache.faces[env, contact] == 0:
                        cache.nearest[env, contact] = foot.row
            if foot.distance >= seen:
                return lost(scale * (foot.distance - unsure - seen), out_of_sight, FAR, armed, arm_W)
        row = natural(foot.row)
        feature = natural(foot.feature)
        n_S = model.face_normal[row, feature]
        flags = wp.int32(model.face_flags[row, feature])

        # Signed distance s [m], direction n, and whether P lies beside an open boundary.
        side = wp.dot(foot.to_point, n_S)
        s = side
        beside = wp.bool(False)
        if foot.feature != 0:
            sign = real(1.0)
            if side < real(0.0):
                sign = real(-1.0)
            if (flags & FEATURE_BOUNDARY) != 0:
                sideways = wp.length(foot.to_point - side * n_S)
                beside = sideways > boundary_tolerance * edge_length(model, foot.row, foot.feature)
            if beside or (flags & FEATURE_BOUNDARY) == 0:
                s = sign * foot.distance
                if foot.distance > wp.max(epsilon * foot.span, point_epsilon * extent):
                    n_S = (sign / foot.distance) * foot.to_point
        s = scale * s
        distance = scale * foot.distance

        hidden = (flags & FEATURE_ACTIVE) == 0
        # Beside a boundary only a sphere on the outer side can touch, and only the boundary.
        missed = beside and (s < real(0.0) or radius == real(0.0) or (option & BOUNDARY_OUTER) == 0)

        latch = LATCH_KEEP
        gap = s - radius
        if hidden or missed:
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

        touching = OPEN
        if hidden:
            touching = INACTIVE
        elif not missed and s < touch_at:
            touching = CONTACT
            if radius - s > geometry.max_depth or ((option & LATCHED) != 0 and armed == 0):
                touching = WRONG_SIDE
        penetration = real(0.0)
        if touching == CONTACT:
            penetration = wp.max(radius - s, real(0.0))

        # How far the point is from touching. On the side that it is on it stays, where that is known; one that is
        # deeper than counts as contact, or farther than that outside, does not touch whatever its side.
        free = real(-1.0)
        if not held and touching != CONTACT:
            nearest = distance - scale * unsure
            if s >= touch_at:
                free = wp.min(nearest - touch_at, scale * room_on_side(model, patch, p_S))
            if (option & LATCHED) == 0:
                free = wp.max(free, nearest - wp.max(touch_at, geometry.max_depth - radius))
            if wp.static(part in (AWAY, WHOLE)):  # noqa: SIM102  Warp would evaluate both sides
                if cached and touching == OPEN and armed != 0 and free > real(0.0):
                    keep_away(cache, env, contact, p_S, view.per_scale * free)

        # K = S + κ (D − S) with D = P − RC n, the deepest point; seen from P.
        to_surface = -scale * foot.to_point
        if foot.feature == 0:
            to_surface = -s * n_S
        to_deepest = -radius * n_S
        to_contact = to_surface + geometry.kappa * (to_deepest - to_surface)
        if (option & AT_POINT) != 0:
            to_contact = vec3()
        found = Found()
        found.free = free
        found.status = touching
        found.armed = armed
        found.penetration = penetration
        found.told = True
        found.gap = gap
        found.face = foot.row
        found.normal = view.R_WS * n_S
        found.arm = arm_W + view.R_WS * to_contact
        return found

    @wp.func
    def tell(found: Found, contacts: Contacts, env: int, contact: int):
        """Fills ``contacts`` for one."""
        if wp.static(follows):
            contacts.crossed_face[env, contact] = -1
        if not found.told:
            leave(contacts, env, contact)
            return
        contacts.gap[env, contact] = found.gap
        contacts.status[env, contact] = found.status
        contacts.armed[env, contact] = found.armed
        contacts.penetration[env, contact] = found.penetration
        contacts.face[env, contact] = found.face
        contacts.normal[env, contact] = found.normal
        contacts.arm[env, contact] = found.arm

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
        found = find(model, view, history, cached, cache, env, contact)
        if wp.static(part in (KNOWN, LISTED, RECALLED, CELL)):  # noqa: SIM102  Warp would evaluate both sides
            if found.free == real(LATER):
                return found.free
        tell(found, contacts, env, contact)
        return found.free

    return SimpleNamespace(
        View=View,
        Found=Found,
        view_of=view_of,
        find=find,
        leave=leave,
        tell=tell,
        look=look,
    )
