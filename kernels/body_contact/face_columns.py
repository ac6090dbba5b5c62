"""Columns on one face: they are divided into polygons in which their depth is affine, and integrated over them."""

import functools

import warp as wp
from warpcontact.kernels.body_contact.column_sums import (
    Column,
    ColumnSums,
    Pair,
    PieceSums,
    RelativeMotion,
    column_functions,
    with_sample,
)
from warpcontact.kernels.body_contact.columns import (
    DOWN,
    ColumnFrame,
    FaceFrame,
    column_polygon,
    columns_box,
    face_frame,
    frame_of_face,
    is_apart,
    is_exit,
    pose_in_face,
    position_on_face,
    ramp_height,
)
from warpcontact.kernels.body_contact.convex_columns import (
    BaseFace,
    base_face,
    exit_polygon,
    store_exits,
    with_exit,
)
from warpcontact.kernels.body_contact.face_trees import first_crossing, next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.overlap import FULL_WEIGHT, NO_WEIGHT, Overlap, column_weight
from warpcontact.kernels.body_contact.patches import patch_of
from warpcontact.kernels.body_contact.polygons import (
    RULE_SIZE,
    Polygon,
    centroid,
    corner,
    cut,
    quadrature_point,
    stored,
    triangle_area,
)
from warpcontact.kernels.body_contact.records import body_contact_structs
from warpcontact.kernels.body_contact.solids import (
    CONVEX,
    FEW_PLANES,
    HALF_SPACE,
    Geometries,
    PairPose,
    RelativePose,
    inverse_pose,
)
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    OFFSET,
    BoundingBox,
    SolidGeometry,
    bounding_box,
)
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.types import structs

vec3d = wp.vec3d
double = wp.float64

#: Largest number of parts into which edges of polygons of entries are divided.
MAX_DIVISIONS = 8


@wp.struct
class ColumnSide:
    """The columns on one of two solids."""

    own: SolidGeometry  # the solid on whose faces the columns stand
    other: SolidGeometry  # the solid through which they pass
    other_in_own: RelativePose
    own_in_other: RelativePose
    # Poses in W axes, relative to the origin of the pair
    own_in_W: RelativePose
    other_in_W: RelativePose
    share: double  # weight of these columns
    kappa: double  # forces act at kappa × depth into the own solid
    sign: double  # of the outward normals of faces: 1 if ``own`` is the second solid, −1 if it is the first
    by_planes: wp.bool  # whether the other solid is convex with few planes
    half_space: wp.bool  # whether ``own`` is a half-space


@wp.func
def column_side(
    first: SolidGeometry, second: SolidGeometry, pose: PairPose, overlap: Overlap, kappa: double, number: int
):
    """Returns the ``ColumnSide`` of the second solid, number 0, or the first solid, number 1."""
    side = ColumnSide()
    side.own = second
    side.other = first
    side.other_in_own = pose.first_in_second
    side.own_in_W = pose.second_axes
    side.other_in_W = pose.first_axes
    side.share = overlap.share
    side.kappa = kappa
    side.sign = double(1.0)
    if number == 1:
        side.own = first
        side.other = second
        side.other_in_own = inverse_pose(pose.first_in_second)
        side.own_in_W = pose.first_axes
        side.other_in_W = pose.second_axes
        side.share = double(1.0) - overlap.share
        side.kappa = double(1.0) - kappa
        side.sign = double(-1.0)
    side.own_in_other = inverse_pose(side.other_in_own)
    side.half_space = (side.own.flags & HALF_SPACE) != 0
    side.by_planes = (side.other.flags & FEW_PLANES) != 0 and not side.half_space
    return side


@wp.func
def other_box(side: ColumnSide):
    """Returns a box around the other solid in the frame of the own one; all of space for a half-space."""
    if side.half_space:
        box = BoundingBox()
        box.upper = vec3d(INFINITE, INFINITE, INFINITE)
        box.lower = -box.upper
        return box
    return bounding_box(side.other, side.other_in_own, ramp_height(side.other))


@wp.func
def depth_beyond_entry(
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    side: ColumnSide,
    face_plane: FaceFrame,
    u: double,
    v: double,
    depth: double,
):
    """Returns the depth at which a column leaves the other solid after it enters at ``depth`` [m]."""
    to_other = side.own_in_other.rotation
    direction = -(to_other * face_plane.normal)
    base = to_other * position_on_face(face_plane, u, v) + side.own_in_other.origin
    start = base + (depth + OFFSET * wp.length(side.other.half_extents)) * direction
    return depth + first_crossing(pending, bottom, geometries, side.other, start, direction, True).distance


@wp.func
def divisions_of(corners: wp.array2d(dtype=double), polygon: Polygon, depth: double):
    """Returns the number of parts of the edges of triangles of a polygon, such that they are at most half as long as ``depth``."""
    longest = double(0.0)
    for i in range(polygon.count):
        edge = corner(corners, polygon, (i + 1) % polygon.count) - corner(corners, polygon, i)
        longest = wp.max(longest, wp.length_sq(edge))
    parts = wp.ceil(wp.min(wp.sqrt(longest) / (double(0.5) * depth), double(MAX_DIVISIONS)))
    return wp.max(wp.int32(parts), 1)


@wp.func
def part_corner(first: vec3d, second: vec3d, third: vec3d, number: int, divisions: int, i: int):
    """Returns corner ``i`` of part ``number`` of a triangle, whose edges are divided into ``divisions``."""
    # Row r has 2 r + 1 parts.
    row = wp.int32(0)
    while (row + 1) * (row + 1) <= number:
        row += 1
    place = number - row * row
    column = place // 2
    if place % 2 == 0:
        # Parts (r, c), (r + 1, c), (r + 1, c + 1)
        if i > 0:
            row += 1
        if i == 2:
            column += 1
    else:
        # Parts (r, c), (r + 1, c + 1), (r, c + 1)
        if i == 1:
            row += 1
        if i > 0:
            column += 1
    step = double(1.0) / double(divisions)
    return first + (double(row) * step) * (second - first) + (double(column) * step) * (third - second)


@wp.struct
class EntryPolygon:
    """The base of the columns on a face that enter the other solid at one of its faces, in coordinates (u, v, t)."""

    base: Polygon  # stored
    turn: double  # 1 if its corners are counter-clockwise in (u, v), otherwise −1
    normal: vec3d  # of the plane of entry, into the other solid
    offset: double  # normal · (u, v, t) + offset ≥ 0 beyond the entry [m]


@wp.func
def entry_polygon(
    corners: wp.array2d(dtype=double),
    geometries: Geometries,
    face_plane: FaceFrame,
    other: SolidGeometry,
    face: int,
    deepest: double,
):
    """Returns the ``EntryPolygon`` of a face of the other solid for columns of a length up to ``deepest`` [m]."""
    entry = EntryPolygon()
    polygon = column_polygon(corners, geometries, face_plane, other, face, -ramp_height(other), deepest)
    if polygon.count == 0:
        return entry
    entry.base = stored(corners, polygon)
    entry.normal = -(face_plane.projection * geometries.normal[face])
    entry.offset = -wp.dot(entry.normal, corner(corners, entry.base, 0))
    area = double(0.0)
    first = corner(corners, entry.base, 0)
    for i in range(1, entry.base.count - 1):
        area += triangle_area(first, corner(corners, entry.base, i), corner(corners, entry.base, i + 1), DOWN)
    entry.turn = wp.where(area < double(0.0), double(-1.0), double(1.0))
    return entry


@wp.func
def box_beyond(corners: wp.array2d(dtype=double), entry: EntryPolygon, deepest: double):
    """Returns the box of the columns beyond an entry up to a depth, in coordinates (u, v, t)."""
    box = BoundingBox()
    box.lower = corner(corners, entry.base, 0)
    box.upper = box.lower
    for i in range(1, entry.base.count):
        box.lower = wp.min(box.lower, corner(corners, entry.base, i))
        box.upper = wp.max(box.upper, corner(corners, entry.base, i))
    box.upper[2] = deepest
    return box


@wp.func
def polygon_beyond(
    corners: wp.array2d(dtype=double),
    geometries: Geometries,
    face_plane: FaceFrame,
    other: SolidGeometry,
    entry: EntryPolygon,
    face: int,
    shallowest: double,
    deepest: double,
):
    """Returns the part of an entry whose columns cross another face of the solid beyond it, at a depth within two limits.

    Its weight is negative: columns to that face are subtracted if they leave there, and added if they enter again.
    """
    polygon = column_polygon(corners, geometries, face_plane, other, face, shallowest, deepest)
    if polygon.count == 0:
        return polygon
    # One call of ``cut``, which compilers inline: at the plane of entry, and at its edges.
    for number in range(-1, entry.base.count):
        factors = entry.normal
        offset = entry.offset
        if number >= 0:
            start = corner(corners, entry.base, number)
            along = corner(corners, entry.base, (number + 1) % entry.base.count) - start
            factors = entry.turn * vec3d(-along[1], along[0], double(0.0))
            offset = -wp.dot(factors, start)
        polygon = cut(corners, polygon, factors, offset)
        if polygon.count == 0:
            return polygon
    polygon.weight = -polygon.weight * entry.base.weight
    return polygon


@functools.cache
def add_face(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Function:
    """Returns the device function that adds the columns on one face of a side.

    Its arguments are (model, state, env, dt, pair, motion, geometries, side, overlap, face, corners, planes, exits, pending,
    bottom,
    coefficients, history_in, history_out, body_contacts, sums, normals, patch_rows); it returns the ``ColumnSums``.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    has_patches = contact_model.acts_per_patch
    is_polynomial = contact_model.law.bilinear or bool(contact_model.law.memories)
    # Quadrature is exact for a product of affine functions, and for the depth that stands for the pressure of a law with history.
    # Otherwise triangles around the center of area make the result independent of the first corner.
    is_exact = is_polynomial and (has_patches or contact_model.friction is Frictionless)
    columns = column_functions(contact_model, real, per_area, has_joints)
    add_column, pressure, add_piece = columns.add_column, columns.pressure, columns.add_piece

    @wp.func
    def add_polygon(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        motion: RelativeMotion,
        geometries: Geometries,
        side: ColumnSide,
        overlap: Overlap,
        face_plane: FaceFrame,
        frame: ColumnFrame,
        polygon: Polygon,
        is_entry: bool,
        normal: vec3d,
        patch: int,
        corners: wp.array2d(dtype=double),
        pending: wp.array(dtype=wp.int32),
        bottom: int,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
        sums: ColumnSums,
        normals: wp.array2d(dtype=double),
        patch_rows: wp.array2d(dtype=double),
    ):
        """Adds the columns on a polygon, or subtracts them, down to the next exit, if they enter the other solid there."""
        triangles = polygon.count
        center = corner(corners, polygon, 0)
        if wp.static(is_exact):
            triangles -= 2
        else:
            center = centroid(corners, polygon, frame.direction)
        into_own = -side.sign * normal
        factor = wp.where(is_entry, -side.share, side.share) * polygon.weight
        # The approach speed is affine in the position, and does not change along columns.
        turning = wp.cross(normal, motion.angular_velocity)
        speed_at_origin = wp.dot(normal, motion.velocity) + wp.dot(turning, frame.origin)
        speed_gradient = wp.transpose(frame.to_W) * turning
        in_polygon = PieceSums()
        # Not a constant, so that its loop is not unrolled.
        rule_size = wp.int32(RULE_SIZE)
        # Columns may leave through several faces after an entry: the polygon is divided into parts of the size of depths.
        divisions = wp.int32(1)
        if is_entry and not side.half_space:
            divisions = divisions_of(corners, polygon, overlap.depth)
        for part in range(triangles * divisions * divisions):
            edge = part // (divisions * divisions)
            if wp.static(is_exact):
                edge += 1
            first = center
            corner_1 = corner(corners, polygon, edge)
            corner_2 = corner(corners, polygon, (edge + 1) % polygon.count)
            if divisions > 1:
                number = part % (divisions * divisions)
                first = part_corner(center, corner_1, corner_2, number, divisions, 0)
                next_1 = part_corner(center, corner_1, corner_2, number, divisions, 1)
                corner_2 = part_corner(center, corner_1, corner_2, number, divisions, 2)
                corner_1 = next_1
            area = factor * wp.abs(triangle_area(first, corner_1, corner_2, frame.direction))
            if area == double(0.0):
                continue
            for sample in range(rule_size):
                point = quadrature_point(first, corner_1, corner_2, sample)
                depth = wp.dot(frame.depth_factors, point.position) + frame.depth_offset
                if is_entry and not side.half_space:
                    # Columns of the next exit do not reach it.
                    depth = depth_beyond_entry(
                        pending, bottom, geometries, side, face_plane, point.position[0], point.position[1], depth
                    )
                fraction = column_weight(depth, overlap, side.half_space)
                weight = area * point.weight * fraction
                # Rounding can make the depth at the boundary of a polygon negative.
                if weight == double(0.0) or depth <= double(0.0):
                    continue
                if wp.static(is_exact):
                    speed = speed_at_origin + wp.dot(speed_gradient, point.position)
                    force_per_area = pressure(
                        env, dt, pair, depth, speed, coefficients, history_in, history_out, body_contacts
                    )
                    in_polygon = with_sample(
                        in_polygon, force_per_area, weight, fraction, depth, speed, point.position
                    )
                else:
                    column = Column()
                    column.depth = depth
                    column.weight = weight
                    column.fraction = fraction
                    column.position = frame.to_W * point.position + frame.origin + side.kappa * depth * into_own
                    column.normal = normal
                    column.patch = patch
                    sums = add_column(
                        model, state, env, dt, pair, column, coefficients, history_in, history_out, body_contacts,
                        sums, normals, patch_rows,
                    )  # fmt: skip
        if wp.static(is_exact):
            sums = add_piece(
                pair, in_polygon, frame.to_W, frame.origin, into_own, side.kappa, normal, patch, sums, normals,
                patch_rows,
            )  # fmt: skip
        return sums

    @wp.func(inline=False)
    def add_beyond_entry(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        motion: RelativeMotion,
        geometries: Geometries,
        side: ColumnSide,
        overlap: Overlap,
        face_plane: FaceFrame,
        frame: ColumnFrame,
        face: int,
        normal: vec3d,
        patch: int,
        corners: wp.array2d(dtype=double),
        pending: wp.array(dtype=wp.int32),
        bottom: int,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
        sums: ColumnSums,
        normals: wp.array2d(dtype=double),
        patch_rows: wp.array2d(dtype=double),
    ):
        """Subtracts the columns that enter the other solid at ``face``, down to the next exit.

        They are those to all exits beyond, less those beyond further entries. Depths are affine on each part, but beyond further
        entries, where they are sampled.
        """
        longest = NO_WEIGHT * overlap.depth
        entry = entry_polygon(corners, geometries, face_plane, side.other, face, longest)
        if entry.base.count == 0:
            return sums
        box = box_beyond(corners, entry, longest)
        top = start_traversal(pending, bottom, side.other)
        while top > bottom:
            leaf = next_leaf_in_box(pending, bottom, top, geometries, side.other, pose_in_face(face_plane), box)
            top = leaf.top
            # Each face twice: the weight is a polynomial below and above FULL_WEIGHT × D.
            for number in range(2 * leaf.first_face, 2 * leaf.end_face):
                beyond = number // 2
                re_enters = not is_exit(geometries, face_plane, beyond)
                if beyond == face or (re_enters and (side.other.flags & CONVEX) != 0):
                    continue
                shallowest = box.lower[2]
                deepest = FULL_WEIGHT * overlap.depth
                if number % 2 == 1:
                    shallowest = deepest
                    deepest = longest
                polygon = polygon_beyond(
                    corners, geometries, face_plane, side.other, entry, beyond, shallowest, deepest
                )
                if polygon.count > 0:
                    sums = add_polygon(
                        model, state, env, dt, pair, motion, geometries, side, overlap, face_plane, frame, polygon,
                        re_enters, normal, patch, corners, pending, top, coefficients,
                        history_in, history_out, body_contacts, sums, normals, patch_rows,
                    )  # fmt: skip
        return sums

    @wp.func
    def add_face(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        motion: RelativeMotion,
        geometries: Geometries,
        side: ColumnSide,
        overlap: Overlap,
        face: int,
        corners: wp.array2d(dtype=double),
        planes: wp.array2d(dtype=double),
        exits: wp.array2d(dtype=double),
        pending: wp.array(dtype=wp.int32),
        bottom: int,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
        sums: ColumnSums,
        normals: wp.array2d(dtype=double),
        patch_rows: wp.array2d(dtype=double),
    ):
        base = BaseFace()
        face_plane = FaceFrame()
        frame = ColumnFrame()
        box = BoundingBox()
        if side.by_planes:
            plane_count = side.other.end_plane - side.other.first_plane
            base = base_face(
                corners, planes, plane_count, geometries, side.own, side.own_in_other, side.other, face
            )
            if base.area == double(0.0):
                return sums
            store_exits(corners, planes, plane_count, base, exits)
            frame.to_W = side.other_in_W.rotation
            frame.origin = side.other_in_W.origin
            frame.direction = base.direction
        else:
            face_plane = face_frame(geometries, side.own, side.other, side.other_in_own, face)
            if is_apart(face_plane, side.other):
                return sums
            deepest_column = NO_WEIGHT * overlap.depth
            if side.half_space:
                deepest_column = INFINITE
            box = columns_box(face_plane, side.other, deepest_column)
            frame = frame_of_face(face_plane, side.own_in_W)
        # Out of the second solid.
        normal = side.sign * (side.own_in_W.rotation * geometries.normal[face])
        patch = wp.int32(0)
        if wp.static(has_patches):
            patch = patch_of(normals, pair.to_axes * normal)
        top = start_traversal(pending, bottom, side.other)
        while top > bottom:
            # All planes in one pass, or the leaves of the tree below the face.
            first_exit = wp.int32(0)
            end_exit = side.other.end_plane - side.other.first_plane
            if side.by_planes:
                top = bottom
            else:
                leaf = next_leaf_in_box(
                    pending, bottom, top, geometries, side.other, pose_in_face(face_plane), box
                )
                top = leaf.top
                first_exit = leaf.first_face
                end_exit = leaf.end_face
            for exit in range(first_exit, end_exit):
                is_entry = wp.bool(False)
                if not side.by_planes:
                    is_entry = not is_exit(geometries, face_plane, exit)
                    if is_entry and not side.half_space:
                        sums = add_beyond_entry(
                            model, state, env, dt, pair, motion, geometries, side, overlap, face_plane, frame, exit,
                            normal, patch, corners, pending, top, coefficients, history_in, history_out, body_contacts,
                            sums, normals, patch_rows,
                        )  # fmt: skip
                        continue
                elif exits[exit, 0] >= NO_WEIGHT * overlap.depth:
                    continue
                # The weight is a polynomial below and above FULL_WEIGHT × D.
                parts = wp.where(side.half_space, 1, 2)
                for part in range(parts):
                    shallowest = double(0.0)
                    deepest = FULL_WEIGHT * overlap.depth
                    if side.half_space:
                        deepest = INFINITE
                    elif part == 1:
                        shallowest = deepest
                        deepest = NO_WEIGHT * overlap.depth
                    polygon = Polygon()
                    if side.by_planes:
                        polygon = exit_polygon(
                            corners, planes, end_exit - first_exit, base, exits, exit, shallowest, deepest
                        )
                        if polygon.count > 0:
                            frame = with_exit(frame, planes, exit)
                    else:
                        polygon = column_polygon(
                            corners, geometries, face_plane, side.other, exit, shallowest, deepest
                        )
                    if polygon.count > 0:
                        sums = add_polygon(
                            model, state, env, dt, pair, motion, geometries, side, overlap, face_plane, frame, polygon,
                            is_entry, normal, patch, corners, pending, top, coefficients, history_in, history_out,
                            body_contacts, sums, normals, patch_rows,
                        )  # fmt: skip
        return sums

    return add_face
