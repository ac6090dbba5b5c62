"""Force and torque of body contacts of a curved solid with a polyhedron or half-space.

Columns stand on the faces of the polyhedron, and on the sheets of the curved solid, with the shares and weights of
``overlap.py``. All of them cross a face of the polyhedron inside the curved solid, so they are integrated over sections of the
curved solid with the faces. A column of a sheet leaves the polyhedron at a face, or enters it there; then it is not inside
before, and the column down to the next exit is subtracted.

On a half-space, the columns are those of the shadow of the solid, and their parts above the solid are subtracted: the sum of
their lengths is the volume below the plane.
"""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.column_sums import Column, ColumnSums, column_functions, pair_of
from warpcontact.kernels.body_contact.columns import face_frame, is_apart
from warpcontact.kernels.body_contact.curved_columns import (
    ON_CURVED_SURFACE,
    ON_FACE,
    polygon_of_region,
    region_count,
    region_of,
    store_face,
)
from warpcontact.kernels.body_contact.curved_overlap import box_of_curved, curved_overlap_of
from warpcontact.kernels.body_contact.curved_sections import (
    MAX_BREAKS,
    MAX_LIMITS,
    POINTS,
    find_breaks,
    find_limits,
    interval_point,
    is_narrow,
    panel_point,
    panel_point_count,
    steepness,
)
from warpcontact.kernels.body_contact.curved_solids import (
    CONE,
    CURVED,
    column_interval,
    exit_depth_of,
    position_in_section,
    section_of,
    width_squared,
)
from warpcontact.kernels.body_contact.curved_surfaces import reach_weight, sheet_count, sheet_point
from warpcontact.kernels.body_contact.face_trees import (
    PENDING_NODES,
    first_crossing,
    next_leaf_in_box,
    start_traversal,
)
from warpcontact.kernels.body_contact.overlap import NO_WEIGHT, Overlap, column_weight
from warpcontact.kernels.body_contact.patches import PATCH_COUNT, PATCH_SUMS, patch_of, start_patches
from warpcontact.kernels.body_contact.polygons import CORNER_ROWS
from warpcontact.kernels.body_contact.records import (
    BodyContactSettings,
    Patches,
    SolidPairs,
    body_contact_structs,
)
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    Solids,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    OFFSET,
    PARALLEL,
    SolidBoxes,
    are_apart,
    are_boxes_apart,
    is_face_outside,
    solid_geometry,
)
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
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
def curved_contact_forces(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Kernel:
    """Returns the force kernel of body contacts of a curved solid and a polyhedron or half-space; items: pairs.

    The arguments are those of ``force.contact_forces``.
    """
    t = structs(real)
    Model, State, EndWrenches = t.Model, t.State, t.EndWrenches
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    has_patches = bool(contact_model.friction.memories)
    second_fraction = contact_model.law.second_fraction
    columns = column_functions(contact_model, real, per_area, has_joints)
    add_column, store_result = columns.add_column, columns.store_result
    pair_pose = solid_functions.functions(real).pair_pose

    @unique_kernel()
    def curved_body_contact_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        step: wp.array2d(dtype=real),  # [env, 0] duration over which the force acts [s]; 0: instantaneous force
        first_pair: wp.int32,  # pair of the first item
        first_end: wp.int32,
        geometries: Geometries,
        solids: Solids,
        boxes: SolidBoxes,
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
        breaks = wp.zeros(shape=(MAX_BREAKS, 3), dtype=double)
        limits = wp.zeros(shape=(MAX_LIMITS,), dtype=double)
        corners = wp.zeros(shape=(CORNER_ROWS, 3), dtype=double)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
        normals = wp.zeros(shape=(PATCH_COUNT, 3), dtype=double)
        patch_rows = wp.zeros(shape=(PATCH_COUNT, PATCH_SUMS), dtype=double)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = first_pair + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            setting = settings[env, number]
            solid_1 = pairs.first[number]
            solid_2 = pairs.second[number]
            first = solid_geometry(geometries, solids.pose[env, solid_1])
            second = solid_geometry(geometries, solids.pose[env, solid_2])
            if ((first.flags & CURVED) != 0) == ((second.flags & CURVED) != 0):
                continue
            contact_status = wp.int32(OPEN)
            if setting.enabled == 0:
                contact_status = DISABLED
            is_near = contact_status == OPEN and not are_boxes_apart(
                boxes.box[env, solid_1], boxes.box[env, solid_2]
            )
            if not is_near and body_contacts.status[env, number] == contact_status:
                # Readings and wrenches are zero already.
                continue
            pose = pair_pose(state, env, solids, solid_1, solid_2)
            pair = pair_of(pose, solids, solid_1, solid_2, number)
            is_first = (first.flags & CURVED) != 0  # whether the first solid is the curved one
            curved = first
            other = second
            curved_pose = pose.first_in_second
            rotation = pose.second_axes.rotation
            origin = vec3d()
            # Out of the second solid: normals of faces with this sign, normals of sheets with the opposite one.
            sign = double(1.0)
            kappa = setting.kappa
            if wp.static(second_fraction is not None):
                kappa = double(second_fraction(coefficients.law[env, number]))
            if not is_first:
                curved = second
                other = first
                curved_pose = inverse_pose(pose.first_in_second)
                rotation = pose.first_axes.rotation
                origin = pose.first_axes.origin
                sign = double(-1.0)
                kappa = double(1.0) - kappa
            flags = curved.flags
            scale = curved.scale
            to_curved = wp.transpose(curved_pose.rotation)
            half_space = (other.flags & HALF_SPACE) != 0

            overlap = Overlap()
            if is_near and not half_space:
                is_near = not are_apart(first, second, pose.first_in_second, double(0.0))
            if is_near:
                overlap = curved_overlap_of(
                    breaks, limits, corners, pending, geometries, curved, other, curved_pose
                )
                if setting.reference >= double(0.0) and (other.flags & (HALF_SPACE | HAS_BOUNDARY)) == 0:
                    overlap.share = setting.reference
                    if not is_first:
                        overlap.share = double(1.0) - setting.reference
                if overlap.depth > double(0.0):
                    contact_status = CONTACT
                    if overlap.depth > setting.max_depth:
                        contact_status = WRONG_SIDE

            sums = ColumnSums()
            if wp.static(has_patches):
                start_patches(normals, patch_rows, patches_in, env, number)
            kind_count = wp.int32(1)
            if not half_space and overlap.share < double(1.0):
                kind_count = 1 + sheet_count(flags)
            # Columns of a cone may leave it before they leave the polyhedron.
            reached = curved
            margin = double(0.0)
            if kind_count > 1 and (flags & CONE) != 0:
                margin = NO_WEIGHT * overlap.depth
                reached.half_extents += vec3d(margin, margin, margin)
            depth_of_weights = overlap.depth
            if half_space:
                depth_of_weights = double(wp.inf)
            box = box_of_curved(curved, other, curved_pose, margin)
            top = wp.int32(0)
            if contact_status == CONTACT:
                top = start_traversal(pending, 0, other)
            while top > 0:
                leaf = next_leaf_in_box(pending, 0, top, geometries, other, no_motion(), box)
                top = leaf.top
                for face in range(leaf.first_face, leaf.end_face):
                    if not half_space:
                        if is_face_outside(geometries, other, face, box):
                            continue
                    frame = face_frame(geometries, other, curved, curved_pose, face)
                    if is_apart(frame, reached):
                        continue
                    section = section_of(flags, scale, curved_pose, frame.origin, frame.u_axis, frame.normal)
                    face_polygon = store_face(corners, frame, section)
                    for kind in range(kind_count):
                        if kind == ON_FACE and overlap.share == double(0.0):
                            continue
                        is_deep = wp.bool(False)
                        for number_of_region in range(region_count(flags, kind)):
                            region = region_of(flags, scale, kind, number_of_region, section, depth_of_weights)
                            polygon = polygon_of_region(
                                corners, face_polygon, frame, flags, scale, curved_pose, kind, number_of_region,
                                overlap.depth,
                            )  # fmt: skip
                            if polygon.count == 0 and not half_space:
                                continue
                            break_count = find_breaks(breaks, section, region, corners, polygon)
                            width = width_squared(section, region.profile, double(0.0), double(0.0))
                            for panel in range(break_count - 1):
                                if is_narrow(breaks, panel):
                                    continue
                                middle = double(0.5) * (breaks[panel, 0] + breaks[panel + 1, 0])
                                if find_limits(limits, section, region, middle, corners, polygon) == 0:
                                    continue
                                for i in range(panel_point_count(breaks, panel)):
                                    u, u_weight = panel_point(breaks, panel, i, width)
                                    limit_count = find_limits(limits, section, region, u, corners, polygon)
                                    if limit_count == 0:
                                        continue
                                    steep = double(0.0)
                                    if kind == ON_FACE:
                                        steep = steepness(section, region.profile, u, limits, limit_count)
                                    # On a half-space, twice: down to the exit, and to the entry.
                                    samples = (limit_count - 1) * POINTS
                                    for sample in range(wp.where(half_space, 2 * samples, samples)):
                                        j = sample % samples
                                        if region.inner_count == 2 and j % POINTS == 0:
                                            # Intervals are divided at depths from which columns have no weight.
                                            between = double(0.5) * (limits[j // POINTS] + limits[j // POINTS + 1])
                                            position = position_in_section(section, u, between)
                                            is_deep = (
                                                sheet_point(
                                                    flags, scale, 0, to_curved * (position - curved_pose.origin)
                                                ).depth
                                                >= NO_WEIGHT * overlap.depth
                                            )
                                        if is_deep:
                                            continue
                                        v, v_weight = interval_point(limits, j // POINTS, j % POINTS, steep)
                                        area = section.area * u_weight * v_weight
                                        position = position_in_section(section, u, v)
                                        column = Column()
                                        normal = frame.normal
                                        base = position
                                        own_kappa = kappa
                                        own_sign = sign
                                        if half_space:
                                            interval = column_interval(section, region.profile, u, v)
                                            if interval[0] > interval[1]:
                                                continue
                                            column.depth = interval[1]
                                            column.weight = area
                                            if sample >= samples:
                                                column.depth = interval[0]
                                                column.weight = -area
                                        elif kind == ON_FACE:
                                            column.depth = exit_depth_of(section, flags, scale, u, v)
                                            column.weight = overlap.share * area
                                        else:
                                            position_c = to_curved * (position - curved_pose.origin)
                                            sheet = sheet_point(flags, scale, kind - ON_CURVED_SURFACE, position_c)
                                            normal = curved_pose.rotation * sheet.normal
                                            base = position + sheet.depth * normal
                                            own_kappa = double(1.0) - kappa
                                            own_sign = -sign
                                            cosine = wp.dot(normal, frame.normal)
                                            column.depth = sheet.depth
                                            column.weight = (
                                                (overlap.share - double(1.0)) * area * cosine / sheet.area_ratio
                                            )
                                            if wp.abs(cosine) < PARALLEL or sheet.depth >= sheet.reach:
                                                continue
                                            if cosine > double(0.0):
                                                # The column enters here: one down to the next exit is subtracted.
                                                start = position - OFFSET * wp.length(other.half_extents) * normal
                                                crossing = first_crossing(
                                                    pending, top, geometries, other, start, -normal, True
                                                )
                                                column.depth += crossing.distance
                                            column.weight = column.weight * reach_weight(column.depth, sheet.reach)
                                        column.fraction = column_weight(column.depth, overlap, half_space)
                                        column.weight = column.weight * column.fraction
                                        # Rounding can make the depth at the boundary of a section negative.
                                        if column.weight == double(0.0) or column.depth <= double(0.0):
                                            continue
                                        column.normal = own_sign * (rotation * normal)
                                        column.position = origin + rotation * (
                                            base - own_kappa * column.depth * normal
                                        )
                                        if wp.static(has_patches):
                                            column.patch = patch_of(normals, pair.to_axes * column.normal)
                                        sums = add_column(
                                            model, state, env, step[env, 0], pair, column, coefficients, history_in,
                                            history_out, body_contacts, sums, normals, patch_rows,
                                        )  # fmt: skip
            share = overlap.share
            if not is_first:
                share = double(1.0) - share
            if half_space:
                # Parts wholly below the plane have columns that cancel: the area is that of the exits.
                sums.area = double(0.5) * (sums.area + sums.gross_area)
            store_result(
                state, env, step[env, 0], pair, contact_status, overlap.depth, share, setting, coefficients,
                history_in, history_out, patches_out, body_contacts, ends, first_end + 2 * number, sums, patch_rows,
            )  # fmt: skip

    return curved_body_contact_forces
