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
from warpcontact.kernels import frames
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
    SWEPT,
    WRONG_SIDE,
    structs,
)

# A point counts as beside an open border when it is farther sideways than this fraction of the border edge.
BORDER_TOLERANCE = 1.0e-4
# Rounding, in units of epsilon times the size of the differences: below it a direction between two points means
# nothing.
ROUNDING = 16.0
# The same of a point alone, in units of epsilon times its coordinates: on fine meshes this is more.
POINT_ROUNDING = 4.0
# Contacts that stay with the part of the surface that they touched.
FOLLOWS = LATCHED | SWEPT


@functools.cache
def kernel(real: type, follows: bool) -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` from ``state``. Launch with dim (env, contact).

    With ``follows``, latched and swept contacts stay with the part of the surface that they touched: on the inner
    side their nearest point is the one reached by walking from the last, so that neither the middle of a plate
    nor its far side turns the force over.
    """
    t = structs(real)
    vec3, Model, State, History, Contacts = t.vec3, t.Model, t.State, t.History, t.Contacts
    near = feet.functions(real)
    Foot, foot_on, nearest_of_all, walk = near.Foot, near.foot_on, near.nearest_of_all, near.walk
    frame = frames.functions(real)
    point_to_world, orientation_to_world = frame.point_to_world, frame.orientation_to_world
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    point_epsilon = wp.constant(real(t.epsilon * POINT_ROUNDING))
    # The mesh that the query searches is stored in float32, whatever the precision of the simulation.
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * ROUNDING))
    border_tolerance = wp.constant(real(BORDER_TOLERANCE))

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
        contacts.crossed_face[env, contact] = -1
        point = model.contact_point[contact]
        p_W = point_to_world(state, env, model.point_body[point], model.point_position[env, point])
        contacts.point[env, contact] = p_W
        if geometry.enabled == 0:
            contacts.gap[env, contact] = real(wp.nan)
            contacts.status[env, contact] = DISABLED
            contacts.armed[env, contact] = history.armed[env, contact]
            return

        # Into the mesh's own frame and unit, where float32 is as good as the mesh.
        base = model.contact_patch[contact]
        surface = model.patch_surface[base]
        patch = base + model.surface_mesh[env, surface]
        scale = model.surface_scale[env, surface]
        reach = radius / scale
        body = model.surface_body[surface]
        o_W = point_to_world(state, env, body, model.surface_position[env, surface])
        q_WS = orientation_to_world(state, env, body, model.surface_orientation[env, surface])
        p_S = wp.quat_rotate_inv(q_WS, p_W - o_W) / scale

        option = model.contact_options[contact]
        extent = wp.max(wp.max(wp.abs(p_S[0]), wp.abs(p_S[1])), wp.abs(p_S[2]))
        start = model.patch_face_start[patch]
        foot = Foot()
        held = wp.bool(False)
        if wp.static(follows):
            # A face of another mesh, which the surface had before, says nothing.
            last = history.face[env, contact]
            if last >= start and last < model.patch_face_start[patch + 1] and (option & FOLLOWS) != 0:
                foot = walk(model, last, p_S)
                held = foot.inner
        if not held:
            mesh = model.patch_mesh[patch]
            query = wp.mesh_query_point_no_sign(
                mesh,
                wp.vec3f(wp.float32(p_S[0]), wp.float32(p_S[1]), wp.float32(p_S[2])),
                wp.float32(wp.max(geometry.search_radius / scale, reach)),
            )
            if not query.result:
                # A sphere sees at least what it overlaps.
                contacts.gap[env, contact] = wp.max(geometry.search_radius - radius, real(0.0))
                contacts.status[env, contact] = FAR
                contacts.armed[env, contact] = history.armed[env, contact]
                return
            # Wherever its rounding matters, the choice of the query is looked at again.
            foot = foot_on(model, start + query.face, p_S)
            margin = model.patch_slack[patch] + query_epsilon * (extent + foot.distance)
            doubtful = foot.inner or foot.distance < reach + margin or model.patch_doubtful[patch]
            if doubtful or wp.static(real is wp.float64):
                foot = nearest_of_all(model, patch, p_S, foot, margin)
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

        # K = S + κ (D − S) with D = P − RC n, the deepest point; seen from P.
        to_surface = -scale * foot.to_point
        if foot.feature == 0:
            to_surface = -s * n_S
        to_deepest = -radius * n_S
        to_contact = to_surface + geometry.kappa * (to_deepest - to_surface)
        contacts.normal[env, contact] = wp.quat_rotate(q_WS, n_S)
        contacts.point[env, contact] = p_W + wp.quat_rotate(q_WS, to_contact)

    return closest_point
