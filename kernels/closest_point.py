"""Closest point and orientation: the kinematics of a point or sphere against an oriented surface.

The algorithm of EULER's ``contactPS2`` element on a triangle mesh: the nearest
point S over the whole patch, then whether S is active, then the side. The BVH query runs in float32 in the
mesh's own frame and only names a face; the distance, the feature hit and its pseudonormal are computed here in
the precision of the simulation.
"""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels import frames, triangle
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    ENV_ACTIVE,
    FAR,
    FEATURE_ACTIVE,
    FEATURE_BORDER,
    HIDDEN,
    LATCH_ARM,
    LATCH_DISARM,
    LATCH_KEEP,
    LATCHED,
    OPEN,
    RIM_OUTER,
    WRONG_SIDE,
    structs,
)

# A point counts as beside an open border when it is farther sideways than this fraction of the border edge.
BORDER_TOLERANCE = 1.0e-4
# Rounding of a difference of coordinates, in units of the largest coordinate times epsilon: below ROUNDING a
# direction between two points means nothing, below TIE two distances are equal. A tie must not be wider: the
# distances to a face and to its neighbour's edge differ in second order only, and the pseudonormal of an edge
# tells the side of a point only if the edge is nearest.
ROUNDING = 16.0
TIE = 3.0


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` from ``state``. Launch with dim (env, contact)."""
    t = structs(real)
    vec3, Model, State, History, Contacts = t.vec3, t.Model, t.State, t.History, t.Contacts
    closest_on_triangle = triangle.functions(real).closest_on_triangle
    frame = frames.functions(real)
    point_to_world, orientation_to_world = frame.point_to_world, frame.orientation_to_world
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    tie_epsilon = wp.constant(real(t.epsilon * TIE))
    # The mesh that the query searches is stored in float32, whatever the precision of the simulation.
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * ROUNDING))
    border_tolerance = wp.constant(real(BORDER_TOLERANCE))

    @wp.struct
    class Foot:
        """The nearest point S of a patch."""

        point: vec3  # S, in the mesh's frame
        row: wp.int32  # of the face tables
        feature: wp.int32
        distance: real  # |P − S|
        inner: wp.bool  # P is on the inner side
        hidden: wp.bool  # S is not on the active part

    @wp.func
    def foot_on(model: Model, row: int, p: vec3):
        hit = closest_on_triangle(
            p,
            model.face_corner[row, 0],
            model.face_corner[row, 1],
            model.face_corner[row, 2],
            model.face_normal[row, 0],
        )
        foot = Foot()
        foot.point = hit.point
        foot.row = row
        foot.feature = hit.feature
        foot.distance = wp.length(p - hit.point)
        foot.inner = wp.dot(p - hit.point, model.face_normal[row, hit.feature]) < real(0.0)
        foot.hidden = (wp.int32(model.face_flags[row, hit.feature]) & FEATURE_ACTIVE) == 0
        return foot

    @wp.func
    def before(a: Foot, b: Foot, tie: real):
        """Whether ``a`` is taken of two feet at the same distance.

        One on the active part if they are one point; else a face before an edge before a corner, the outer side
        before the inner, and the lower face.
        """
        if a.hidden != b.hidden and wp.length(a.point - b.point) <= tie:
            return not a.hidden
        rank_a = wp.where(a.feature > 3, 2, wp.where(a.feature > 0, 1, 0))
        rank_b = wp.where(b.feature > 3, 2, wp.where(b.feature > 0, 1, 0))
        if rank_a != rank_b:
            return rank_a < rank_b
        if a.inner != b.inner:
            return not a.inner
        return a.row < b.row

    @wp.func
    def nearest_of_all(model: Model, mesh: wp.uint64, start: int, p: vec3, scale: real, first: Foot):
        """Looks again at all faces about as near as ``first``, in the precision of the simulation.

        Makes the choice on edges and medial axes independent of the traversal, and exact in float64.
        """
        best = first
        nearest = first.distance
        margin = query_epsilon * (scale + first.distance)
        tie = tie_epsilon * (scale + first.distance)
        reach = wp.float32(first.distance + margin)
        centre = wp.vec3f(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
        around = wp.vec3f(reach, reach, reach)
        query = wp.mesh_query_aabb(mesh, centre - around, centre + around)
        face = wp.int32(0)
        while wp.mesh_query_aabb_next(query, face):
            other = foot_on(model, start + face, p)
            level = other.distance <= nearest + tie
            if other.distance < nearest - tie or (level and before(other, best, tie)):
                best = other
            nearest = wp.min(nearest, other.distance)
        return best

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

    @wp.kernel(module="unique", enable_backward=False)
    def closest_point(
        status: wp.array(dtype=wp.int32), model: Model, state: State, history: History, contacts: Contacts
    ):
        env, contact = wp.tid()
        if status[env] != ENV_ACTIVE:
            return
        geometry = model.contact_geometry[env, contact]
        radius = geometry.radius
        contacts.penetration[env, contact] = real(0.0)
        contacts.normal[env, contact] = vec3()
        contacts.face[env, contact] = -1
        point = model.contact_point[contact]
        p_W = point_to_world(state, env, model.point_body[point], model.point_position[env, point])
        contacts.point[env, contact] = p_W
        if geometry.enabled == 0:
            contacts.gap[env, contact] = real(wp.nan)
            contacts.status[env, contact] = DISABLED
            contacts.armed[env, contact] = history.armed[env, contact]
            return

        # Into the mesh's own frame, where float32 is as good as the mesh.
        patch = model.contact_patch[contact]
        surface = model.patch_surface[patch]
        body = model.surface_body[surface]
        o_W = point_to_world(state, env, body, model.surface_position[env, surface])
        q_WS = orientation_to_world(state, env, body, model.surface_orientation[env, surface])
        p_S = wp.quat_rotate_inv(q_WS, p_W - o_W)

        mesh = model.patch_mesh[patch]
        query = wp.mesh_query_point_no_sign(
            mesh,
            wp.vec3f(wp.float32(p_S[0]), wp.float32(p_S[1]), wp.float32(p_S[2])),
            wp.float32(geometry.search_radius),
        )
        if not query.result:
            contacts.gap[env, contact] = wp.max(geometry.search_radius - radius, real(0.0))
            contacts.status[env, contact] = FAR
            contacts.armed[env, contact] = history.armed[env, contact]
            return

        start = model.patch_face_start[patch]
        scale = wp.max(wp.max(wp.abs(p_S[0]), wp.abs(p_S[1])), wp.abs(p_S[2]))
        foot = foot_on(model, start + query.face, p_S)
        if foot.inner or foot.distance < radius + model.patch_slack[patch]:
            foot = nearest_of_all(model, mesh, start, p_S, scale, foot)
        n_S = model.face_normal[foot.row, foot.feature]
        flags = wp.int32(model.face_flags[foot.row, foot.feature])
        contacts.face[env, contact] = foot.row - start

        # Signed distance s, direction n, and whether P lies beside an open border.
        to_point = p_S - foot.point
        side = wp.dot(to_point, n_S)
        distance = foot.distance
        s = side
        beside = False
        if foot.feature == 0:
            # Measured from a corner: the foot of a shallow point carries more rounding than its depth.
            s = wp.dot(p_S - model.face_corner[foot.row, 0], n_S)
            distance = wp.abs(s)
        else:
            sign = real(1.0)
            if side < real(0.0):
                sign = real(-1.0)
            if (flags & FEATURE_BORDER) != 0:
                sideways = wp.length(to_point - side * n_S)
                beside = sideways > border_tolerance * edge_length(model, foot.row, foot.feature)
            if beside or (flags & FEATURE_BORDER) == 0:
                s = sign * distance
                if distance > epsilon * (scale + distance):
                    n_S = (sign / distance) * to_point

        option = model.contact_options[contact]
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

        # K = S + κ (D − S) with D = P − RC n, the deepest point; on a face S is P − s n to the last digit.
        foot_S = foot.point
        if foot.feature == 0:
            foot_S = p_S - s * n_S
        deepest_S = p_S - radius * n_S
        k_S = foot_S + geometry.kappa * (deepest_S - foot_S)
        contacts.normal[env, contact] = wp.quat_rotate(q_WS, n_S)
        contacts.point[env, contact] = o_W + wp.quat_rotate(q_WS, k_S)

    return closest_point
