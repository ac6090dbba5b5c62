"""Force and torque of body contacts: the pressure of columns, and its friction, integrated over the overlap."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.column_sums import (
    Column,
    ColumnSums,
    PieceSums,
    RelativeMotion,
    column_functions,
    pair_of,
    with_sample,
)
from warpcontact.kernels.body_contact.columns import (
    ColumnFrame,
    FaceFrame,
    column_polygon,
    columns_box,
    face_frame,
    frame_of_face,
    is_apart,
    is_exit,
    position_on_face,
    ramp_height,
)
from warpcontact.kernels.body_contact.convex_columns import (
    BaseFace,
    base_face,
    exit_polygon,
    store_planes,
    with_exit,
)
from warpcontact.kernels.body_contact.face_trees import (
    PENDING_NODES,
    first_crossing,
    next_leaf_in_box,
    start_traversal,
)
from warpcontact.kernels.body_contact.overlap import (
    FULL_WEIGHT,
    LEAST_DEPTHS,
    NO_WEIGHT,
    Overlap,
    column_weight,
    least_depth_of_face,
    overlap_of,
)
from warpcontact.kernels.body_contact.patches import PATCH_COUNT, PATCH_SUMS, patch_of, start_patches
from warpcontact.kernels.body_contact.polygons import (
    CORNER_ROWS,
    RULE_SIZE,
    Polygon,
    centroid,
    corner,
    quadrature_point,
    triangle_area,
)
from warpcontact.kernels.body_contact.records import (
    BodyContactSettings,
    Patches,
    SolidPairs,
    body_contact_structs,
)
from warpcontact.kernels.body_contact.solids import (
    FEW_PLANES,
    HALF_SPACE,
    HAS_BOUNDARY,
    MAX_PLANES,
    Geometries,
    RelativePose,
    Solids,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    OFFSET,
    BoundingBox,
    bounding_box,
    is_face_outside,
    solid_geometry,
)
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    ENV_ACTIVE,
    OPEN,
    WRONG_SIDE,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)

vec3d = wp.vec3d
double = wp.float64


@functools.cache
def contact_forces(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Kernel:
    """Returns the force kernel of body contacts with one contact model; items: pairs.

    Args:
        contact_model: Classes of law and friction models. The law has no history variables. A friction model with history
            variables acts once per patch, another one at each point of the area.
        real: Precision of state, law and friction. Geometry is in float64.
        per_area: Whether the law is a pressure; otherwise its mean over the area of the columns is the normal force.
        has_joints: Whether the effective mass includes the joints of bodies.
    """
    t = structs(real)
    Model, State, EndWrenches = t.Model, t.State, t.EndWrenches
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    has_patches = bool(contact_model.friction.memories)
    # The pressure is a product of affine functions, so that the quadrature is exact. Otherwise triangles around the center of area
    # make the result independent of the first corner.
    is_exact = contact_model.law.bilinear and (has_patches or contact_model.friction is Frictionless)
    of_columns = column_functions(contact_model, real, per_area, has_joints)
    add_column, store_result = of_columns.add_column, of_columns.store_result
    relative_motion, pressure, add_piece = of_columns.relative_motion, of_columns.pressure, of_columns.add_piece
    pair_pose = solid_functions.functions(real).pair_pose

    @unique_kernel()
    def body_contact_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        step: wp.array2d(dtype=real),  # [env, 0] duration over which the force acts [s]; 0: instantaneous force
        first_end: wp.int32,
        geometries: Geometries,
        solids: Solids,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        patches_in: Patches,
        patches_out: Patches,
        body_contacts: BodyContacts,
        ends: EndWrenches,
    ):
        # Not a constant, so that its loop is not unrolled.
        rule_size = wp.int32(RULE_SIZE)
        corners = wp.zeros(shape=(CORNER_ROWS, 3), dtype=double)
        planes = wp.zeros(shape=(MAX_PLANES, 4), dtype=double)
        least_depths = wp.zeros(shape=(LEAST_DEPTHS,), dtype=double)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
        normals = wp.zeros(shape=(PATCH_COUNT, 3), dtype=double)
        patch_rows = wp.zeros(shape=(PATCH_COUNT, PATCH_SUMS), dtype=double)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            setting = settings[env, number]
            solid_1 = pairs.first[number]
            solid_2 = pairs.second[number]
            first = solid_geometry(geometries, solids.pose[env, solid_1])
            second = solid_geometry(geometries, solids.pose[env, solid_2])
            pose = pair_pose(state, env, solids, solid_1, solid_2)
            pair = pair_of(pose, solids, solid_1, solid_2, number)
            half_space = (second.flags & HALF_SPACE) != 0
            second_is_reference = (second.flags & (HALF_SPACE | HAS_BOUNDARY)) != 0

            overlap = Overlap()
            contact_status = wp.int32(OPEN)
            if setting.enabled == 0:
                contact_status = DISABLED
            else:
                between = (
                    pose.first_in_second.origin + pose.first_in_second.rotation * first.center - second.center
                )
                reach = wp.length(first.half_extents) + wp.length(second.half_extents)
                if half_space or wp.dot(between, between) < reach * reach:
                    overlap = overlap_of(
                        corners, planes, least_depths, pending, geometries, first, second, pose.first_in_second
                    )
                    if setting.reference >= double(0.0) and not second_is_reference:
                        overlap.share = setting.reference
                if overlap.depth > double(0.0):
                    contact_status = CONTACT
                    if overlap.depth > setting.max_depth:
                        contact_status = WRONG_SIDE

            sums = ColumnSums()
            if wp.static(has_patches):
                start_patches(normals, patch_rows, patches_in, env, number)
            part_count = wp.int32(2)
            deepest_column = NO_WEIGHT * overlap.depth
            if half_space:
                part_count = 1
                deepest_column = INFINITE
            sides = wp.int32(0)
            motion = RelativeMotion()
            if contact_status == CONTACT:
                motion = relative_motion(state, env, pair)
                sides = wp.where(second_is_reference, 1, 2)
            for side in range(sides):
                share = overlap.share
                kappa = setting.kappa
                own = second
                other = first
                other_in_own = pose.first_in_second
                own_in_W = pose.second_axes
                other_in_W = pose.first_axes
                if side == 1:
                    share = double(1.0) - overlap.share
                    kappa = double(1.0) - setting.kappa
                    own = first
                    other = second
                    other_in_own = inverse_pose(pose.first_in_second)
                    own_in_W = pose.first_axes
                    other_in_W = pose.second_axes
                if share == double(0.0):
                    continue
                by_planes = (other.flags & FEW_PLANES) != 0 and not half_space
                plane_count = wp.int32(0)
                if by_planes:
                    plane_count = store_planes(planes, geometries, other)
                other_box = BoundingBox()
                if half_space:
                    other_box.lower = -vec3d(INFINITE, INFINITE, INFINITE)
                    other_box.upper = vec3d(INFINITE, INFINITE, INFINITE)
                else:
                    other_box = bounding_box(other, other_in_own, ramp_height(other))
                top = start_traversal(pending, 0, own)
                while top > 0:
                    leaf = next_leaf_in_box(pending, 0, top, geometries, own, no_motion(), other_box)
                    top = leaf.top
                    for face in range(leaf.first_face, leaf.end_face):
                        if not half_space:
                            shortest = least_depth_of_face(least_depths, side, face - own.first_face)
                            if shortest >= NO_WEIGHT * overlap.depth:
                                continue
                            if is_face_outside(geometries, own, face, other_box):
                                continue
                        base = BaseFace()
                        face_plane = FaceFrame()
                        frame = ColumnFrame()
                        to_face = RelativePose()
                        columns = BoundingBox()
                        column = Column()
                        # Out of the second solid.
                        if by_planes:
                            base = base_face(
                                corners,
                                planes,
                                plane_count,
                                geometries,
                                own,
                                inverse_pose(other_in_own),
                                other,
                                face,
                            )
                            if base.area == double(0.0):
                                continue
                            frame.to_W = other_in_W.rotation
                            frame.origin = other_in_W.origin
                            frame.direction = base.direction
                            column.normal = -(frame.to_W * base.direction)
                        else:
                            face_plane = face_frame(geometries, own, other, other_in_own, face)
                            if is_apart(face_plane, other):
                                continue
                            to_face.rotation = face_plane.projection
                            to_face.origin = face_plane.shift
                            columns = columns_box(face_plane, other, deepest_column)
                            frame = frame_of_face(face_plane, own_in_W)
                            column.normal = own_in_W.rotation * face_plane.normal
                        into_own = -column.normal
                        if side == 1:
                            column.normal = into_own
                        if wp.static(has_patches):
                            column.patch = patch_of(normals, pair.to_axes * column.normal)
                        approach = double(0.0)
                        approach_gradient = vec3d()
                        if wp.static(is_exact):
                            # The approach speed is affine in the position, and does not change along columns.
                            turning = wp.cross(column.normal, motion.angular_velocity)
                            approach = wp.dot(column.normal, motion.velocity) + wp.dot(turning, frame.origin)
                            approach_gradient = wp.transpose(frame.to_W) * turning
                        other_top = start_traversal(pending, top, other)
                        while other_top > top:
                            # All planes at once, or the leaves of the tree below the face.
                            first_exit = wp.int32(0)
                            end_exit = plane_count
                            if by_planes:
                                other_top = top
                            else:
                                below = next_leaf_in_box(
                                    pending, top, other_top, geometries, other, to_face, columns
                                )
                                other_top = below.top
                                first_exit = below.first_face
                                end_exit = below.end_face
                            for exit in range(first_exit, end_exit):
                                is_entry = wp.bool(False)
                                if by_planes:
                                    frame = with_exit(frame, planes, exit)
                                else:
                                    is_entry = not is_exit(geometries, face_plane, exit)
                                # The weight is a polynomial below and above FULL_WEIGHT × D.
                                for part in range(part_count):
                                    shallowest = double(0.0)
                                    if is_entry and not half_space:
                                        shallowest = -ramp_height(other)
                                    deepest = FULL_WEIGHT * overlap.depth
                                    if half_space:
                                        deepest = INFINITE
                                    elif part == 1:
                                        shallowest = deepest
                                        deepest = NO_WEIGHT * overlap.depth
                                    piece = Polygon()
                                    if by_planes:
                                        piece = exit_polygon(
                                            corners, planes, plane_count, base, exit, shallowest, deepest
                                        )
                                    else:
                                        piece = column_polygon(
                                            corners, geometries, face_plane, other, exit, shallowest, deepest
                                        )
                                    if piece.count == 0:
                                        continue
                                    triangles = piece.count
                                    center = corner(corners, piece, 0)
                                    if wp.static(is_exact):
                                        triangles -= 2
                                    else:
                                        center = centroid(corners, piece, frame.direction)
                                    sign = wp.where(is_entry, -share, share) * piece.weight
                                    in_piece = PieceSums()
                                    for triangle in range(triangles):
                                        edge = triangle
                                        if wp.static(is_exact):
                                            edge += 1
                                        corner_1 = corner(corners, piece, edge)
                                        corner_2 = corner(corners, piece, (edge + 1) % piece.count)
                                        signed_area = sign * wp.abs(
                                            triangle_area(center, corner_1, corner_2, frame.direction)
                                        )
                                        if signed_area == double(0.0):
                                            continue
                                        for sample in range(rule_size):
                                            point = quadrature_point(center, corner_1, corner_2, sample)
                                            depth = (
                                                wp.dot(frame.depth_factors, point.position) + frame.depth_offset
                                            )
                                            if is_entry and not half_space:
                                                # Columns of the next exit do not reach it.
                                                to_other = wp.transpose(other_in_own.rotation)
                                                start = position_on_face(
                                                    face_plane, point.position[0], point.position[1]
                                                )
                                                start = to_other * (
                                                    start - depth * face_plane.normal - other_in_own.origin
                                                )
                                                direction = -(to_other * face_plane.normal)
                                                start += OFFSET * wp.length(other.half_extents) * direction
                                                depth += first_crossing(
                                                    pending, other_top, geometries, other, start, direction, True
                                                ).distance
                                            weight = (
                                                signed_area
                                                * point.weight
                                                * column_weight(depth, overlap, half_space)
                                            )
                                            # Rounding can make the depth at the boundary of a piece negative.
                                            if weight == double(0.0) or depth <= double(0.0):
                                                continue
                                            if wp.static(is_exact):
                                                speed = approach + wp.dot(approach_gradient, point.position)
                                                force_per_area = pressure(
                                                    env, step[env, 0], pair, depth, speed, coefficients, history_in, history_out,
                                                    body_contacts,
                                                )  # fmt: skip
                                                in_piece = with_sample(
                                                    in_piece, force_per_area, weight, depth, speed, point.position
                                                )
                                            else:
                                                column.depth = depth
                                                column.weight = weight
                                                column.position = (
                                                    frame.to_W * point.position
                                                    + frame.origin
                                                    + kappa * depth * into_own
                                                )
                                                sums = add_column(
                                                    model, state, env, step[env, 0], pair, column, coefficients, history_in,
                                                    history_out, body_contacts, sums, normals, patch_rows,
                                                )  # fmt: skip
                                    if wp.static(is_exact):
                                        sums = add_piece(
                                            pair, in_piece, frame.to_W, frame.origin, into_own, kappa, column.normal,
                                            column.patch, sums, normals, patch_rows,
                                        )  # fmt: skip
            store_result(
                state, env, step[env, 0], pair, contact_status, overlap.depth, overlap.share, setting, coefficients,
                history_in, history_out, patches_out, body_contacts, ends, first_end + 2 * number, sums, patch_rows,
            )  # fmt: skip

    return body_contact_forces


@functools.cache
def accept_patches() -> wp.Kernel:
    """Returns the kernel that stores the patches of accepted steps; items: patches of all pairs."""

    @unique_kernel()
    def accept_body_contact_patches(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), patches_out: Patches, patches: Patches
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            patch = task_item(launch, task)
            if status[env] == ENV_ACTIVE:
                patches.normal[env, patch] = patches_out.normal[env, patch]

    return accept_body_contact_patches


@functools.cache
def reset_patches() -> wp.Kernel:
    """Returns the kernel that removes all patches. Launch with dim (env, patch of all pairs)."""

    @unique_kernel(runs_rarely=True)
    def reset_body_contact_patches(mask: wp.array(dtype=wp.bool), patches: Patches):
        env, patch = wp.tid()
        if mask[env]:
            patches.normal[env, patch] = vec3d()

    return reset_body_contact_patches


@functools.cache
def accept_contacts(real: type) -> wp.Kernel:
    """Returns the kernel that stores the entry speeds of accepted steps; items: pairs."""
    BodyContacts = body_contact_structs(real).BodyContacts

    @unique_kernel()
    def accept_body_contacts(launch: LaunchRange, status: wp.array(dtype=wp.int32), body_contacts: BodyContacts):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            pair = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            entry_speed = real(-1.0)
            if body_contacts.status[env, pair] == CONTACT:
                # At least 0: negative values mean "not in contact".
                speed = wp.max(body_contacts.approach_speed[env, pair], real(0.0))
                entry_speed = wp.max(body_contacts.entry_speed[env, pair], speed)
            body_contacts.entry_speed[env, pair] = entry_speed

    return accept_body_contacts


@functools.cache
def reset_contacts(real: type) -> wp.Kernel:
    """Returns the kernel that resets the history of contacts. Launch with dim (env, pair)."""
    BodyContacts = body_contact_structs(real).BodyContacts

    @unique_kernel(runs_rarely=True)
    def reset_body_contacts(mask: wp.array(dtype=wp.bool), body_contacts: BodyContacts):
        env, pair = wp.tid()
        if mask[env]:
            body_contacts.entry_speed[env, pair] = real(-1.0)

    return reset_body_contacts
