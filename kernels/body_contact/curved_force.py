"""Columns of a curved solid and a polyhedron or half-space.

Columns stand on the faces of the polyhedron, and on the sheets of the curved solid, with the shares and weights of
``overlap.py``. All of them cross a face of the polyhedron inside the curved solid, so they are integrated over sections of the
curved solid with the faces. A column of a sheet leaves the polyhedron at a face, or enters it there; then it is not inside
before, and the column down to the next exit is subtracted.

On a half-space, the columns are those of the shadow of the solid, and their parts above the solid are subtracted: the sum of
their lengths is the volume below the plane.

From the outside in: ``columns_of_curved`` goes through the faces, ``add_face`` through the regions of a face, ``add_region`` through
the strips of a region, ``add_strip`` through the columns of a strip.
"""

import functools

import warp as wp
from warpcontact.kernels.body_contact.column_sums import (
    Column,
    ColumnSums,
    Pair,
    column_functions,
    status_at_depth,
)
from warpcontact.kernels.body_contact.columns import FaceFrame, face_frame, is_apart
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
    POINTS,
    Region,
    find_breaks,
    find_limits,
    has_points,
    interval_point,
    panel_point,
    panel_point_count,
    steepness,
)
from warpcontact.kernels.body_contact.curved_solids import (
    CONE,
    CURVED,
    Section,
    column_interval,
    exit_depth_of,
    position_in_section,
    section_of,
    width_squared,
)
from warpcontact.kernels.body_contact.curved_surfaces import reach_weight, sheet_count, sheet_point
from warpcontact.kernels.body_contact.face_trees import (
    first_crossing,
    next_leaf_in_box,
    start_traversal,
)
from warpcontact.kernels.body_contact.overlap import NO_WEIGHT, Overlap, column_weight
from warpcontact.kernels.body_contact.patches import patch_of, use_areas_of_exits
from warpcontact.kernels.body_contact.polygons import Polygon
from warpcontact.kernels.body_contact.records import BodyContactSettings, body_contact_structs
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    PairPose,
    RelativePose,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    OFFSET,
    PARALLEL,
    SolidGeometry,
    are_apart,
    is_face_outside,
)
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.types import CONTACT, structs

vec3d = wp.vec3d
double = wp.float64


@wp.struct
class CurvedSide:
    """A curved solid and the polyhedron or half-space that it touches, in the frame of the latter."""

    curved: SolidGeometry
    other: SolidGeometry
    pose: RelativePose  # of the curved solid
    other_in_W: RelativePose  # pose of the other solid in W axes, relative to the origin of the pair
    kappa: double  # forces act at kappa × length of a column into the other solid
    sign: double  # of the outward normals of faces: 1 if the other solid is the second one, −1 if it is the first
    half_space: wp.bool  # whether the other solid is a half-space


@wp.struct
class BaseColumn:
    """A column in the frame of the polyhedron; weight 0: there is none."""

    base: vec3d  # [m]
    normal: vec3d  # of the surface at the base, outward
    depth: double  # [m]
    weight: double  # of its area, without the weight of ``overlap.column_weight`` [m²]
    is_on_sheet: wp.bool  # whether it stands on the curved solid


@wp.func
def curved_side(first: SolidGeometry, second: SolidGeometry, pose: PairPose, kappa: double):
    """Returns the ``CurvedSide`` of a pair, one of which is curved."""
    side = CurvedSide()
    side.curved = first
    side.other = second
    side.pose = pose.first_in_second
    side.other_in_W.rotation = pose.second_axes.rotation
    side.kappa = kappa
    side.sign = double(1.0)
    if (first.flags & CURVED) == 0:
        side.curved = second
        side.other = first
        side.pose = inverse_pose(pose.first_in_second)
        side.other_in_W = pose.first_axes
        side.kappa = double(1.0) - kappa
        side.sign = double(-1.0)
    side.half_space = (side.other.flags & HALF_SPACE) != 0
    return side


@wp.func
def column_of_shadow(section: Section, region: Region, u: double, v: double, area: double, is_entry: bool):
    """Returns the column at a point of the plane of a half-space, down to the exit or entry of the curved solid."""
    column = BaseColumn()
    interval = column_interval(section, region.profile, u, v)
    if interval[0] > interval[1]:
        return column
    column.depth = interval[1]
    column.weight = area
    if is_entry:
        column.depth = interval[0]
        column.weight = -area
    return column


@wp.func
def column_on_sheet(
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    side: CurvedSide,
    overlap: Overlap,
    frame: FaceFrame,
    sheet_number: int,
    position: vec3d,
    area: double,
):
    """Returns the column of a sheet of the curved solid that crosses a face at ``position``."""
    column = BaseColumn()
    column.is_on_sheet = True
    from_solid = wp.transpose(side.pose.rotation) * (position - side.pose.origin)
    sheet = sheet_point(side.curved.flags, side.curved.scale, sheet_number, from_solid)
    column.normal = side.pose.rotation * sheet.normal
    column.base = position + sheet.depth * column.normal
    cosine = wp.dot(column.normal, frame.normal)
    if wp.abs(cosine) < PARALLEL or sheet.depth >= sheet.reach:
        return column
    column.depth = sheet.depth
    column.weight = (overlap.share - double(1.0)) * area * cosine / sheet.area_ratio
    if cosine > double(0.0):
        # The column enters here: one down to the next exit is subtracted.
        start = position - OFFSET * wp.length(side.other.half_extents) * column.normal
        crossing = first_crossing(pending, bottom, geometries, side.other, start, -column.normal, True)
        column.depth += crossing.distance
    column.weight = column.weight * reach_weight(column.depth, sheet.reach)
    return column


@wp.func
def is_interval_deep(
    side: CurvedSide, section: Section, u: double, limits: wp.array(dtype=double), interval: int, overlap: Overlap
):
    """Returns whether an interval is at depths below the curved surface from which columns have no weight."""
    middle = double(0.5) * (limits[interval] + limits[interval + 1])
    position = position_in_section(section, u, middle) - side.pose.origin
    sheet = sheet_point(side.curved.flags, side.curved.scale, 0, wp.transpose(side.pose.rotation) * position)
    return sheet.depth >= NO_WEIGHT * overlap.depth


@functools.cache
def pair_columns(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Function:
    """Returns the device function that finds the overlap of a pair, and integrates its columns.

    For its arguments and results, see ``polyhedron_force.pair_columns``.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    has_patches, has_law_history = contact_model.acts_per_patch, bool(contact_model.law.memories)
    add_column = column_functions(contact_model, real, per_area, has_joints).add_column

    @wp.func
    def add_strip(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        geometries: Geometries,
        side: CurvedSide,
        overlap: Overlap,
        frame: FaceFrame,
        section: Section,
        region: Region,
        kind: int,
        u: double,
        u_weight: double,
        limits: wp.array(dtype=double),
        limit_count: int,
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
        """Adds the columns of the strip of a region at ``u``."""
        flags = side.curved.flags
        steep = double(0.0)
        if kind == ON_FACE:
            steep = steepness(section, region.profile, u, limits, limit_count)
        is_deep = wp.bool(False)
        # On a half-space, twice: down to the exit, and to the entry.
        samples = (limit_count - 1) * POINTS
        for sample in range(wp.where(side.half_space, 2 * samples, samples)):
            j = sample % samples
            if region.inner_count == 2 and j % POINTS == 0:
                is_deep = is_interval_deep(side, section, u, limits, j // POINTS, overlap)
            if is_deep:
                continue
            v, v_weight = interval_point(limits, j // POINTS, j % POINTS, steep)
            area = section.area * u_weight * v_weight
            position = position_in_section(section, u, v)
            base = BaseColumn()
            if side.half_space:
                base = column_of_shadow(section, region, u, v, area, sample >= samples)
            elif kind == ON_FACE:
                base.depth = exit_depth_of(section, flags, side.curved.scale, u, v)
                base.weight = overlap.share * area
            else:
                base = column_on_sheet(
                    pending, bottom, geometries, side, overlap, frame, kind - ON_CURVED_SURFACE, position, area
                )
            kappa = double(1.0) - side.kappa
            sign = -side.sign
            if not base.is_on_sheet:
                base.base = position
                base.normal = frame.normal
                kappa = side.kappa
                sign = side.sign
            column = Column()
            column.depth = base.depth
            column.fraction = column_weight(column.depth, overlap, side.half_space)
            column.weight = base.weight * column.fraction
            # Rounding can make the depth at the boundary of a section negative.
            if column.weight == double(0.0) or column.depth <= double(0.0):
                continue
            column.normal = sign * (side.other_in_W.rotation * base.normal)
            column.position = side.other_in_W.origin + side.other_in_W.rotation * (
                base.base - kappa * column.depth * base.normal
            )
            if wp.static(has_patches):
                column.patch = patch_of(normals, pair.to_axes * column.normal)
            sums = add_column(
                model, state, env, dt, pair, column, coefficients, history_in, history_out, body_contacts, sums,
                normals, patch_rows,
            )  # fmt: skip
        return sums

    @wp.func
    def add_region(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        geometries: Geometries,
        side: CurvedSide,
        overlap: Overlap,
        frame: FaceFrame,
        section: Section,
        region: Region,
        kind: int,
        corners: wp.array2d(dtype=double),
        polygon: Polygon,
        breaks: wp.array2d(dtype=double),
        limits: wp.array(dtype=double),
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
        """Adds the columns of one region of a face."""
        break_count = find_breaks(breaks, section, region, corners, polygon)
        width = width_squared(section, region.profile, double(0.0), double(0.0))
        for panel in range(break_count - 1):
            if not has_points(breaks, panel, limits, section, region, corners, polygon):
                continue
            for i in range(panel_point_count(breaks, panel)):
                u, u_weight = panel_point(breaks, panel, i, width)
                limit_count = find_limits(limits, section, region, u, corners, polygon)
                if limit_count == 0:
                    continue
                sums = add_strip(
                    model, state, env, dt, pair, geometries, side, overlap, frame, section, region, kind, u, u_weight,
                    limits, limit_count, pending, bottom, coefficients, history_in, history_out, body_contacts, sums,
                    normals, patch_rows,
                )  # fmt: skip
        return sums

    @wp.func
    def add_face(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        geometries: Geometries,
        side: CurvedSide,
        overlap: Overlap,
        kind_count: int,
        margin: double,
        face: int,
        corners: wp.array2d(dtype=double),
        breaks: wp.array2d(dtype=double),
        limits: wp.array(dtype=double),
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
        """Adds the columns that cross one face: on the face, and on the sheets of the curved solid (``kind_count`` > 1)."""
        flags = side.curved.flags
        scale = side.curved.scale
        frame = face_frame(geometries, side.other, side.curved, side.pose, face)
        reached = side.curved
        reached.half_extents += vec3d(margin, margin, margin)
        if is_apart(frame, reached):
            return sums
        depth_of_weights = overlap.depth
        if side.half_space:
            depth_of_weights = double(wp.inf)
        section = section_of(flags, scale, side.pose, frame.origin, frame.u_axis, frame.normal)
        face_polygon = store_face(corners, frame, section)
        for kind in range(kind_count):
            if kind == ON_FACE and overlap.share == double(0.0):
                continue
            for number in range(region_count(flags, kind)):
                region = region_of(flags, scale, kind, number, section, depth_of_weights)
                polygon = polygon_of_region(
                    corners, face_polygon, frame, flags, scale, side.pose, kind, number, overlap.depth
                )
                if polygon.count == 0 and not side.half_space:
                    continue
                sums = add_region(
                    model, state, env, dt, pair, geometries, side, overlap, frame, section, region, kind, corners,
                    polygon, breaks, limits, pending, bottom, coefficients, history_in, history_out, body_contacts,
                    sums, normals, patch_rows,
                )  # fmt: skip
        return sums

    @wp.func
    def columns_of_curved(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        pose: PairPose,
        geometries: Geometries,
        first: SolidGeometry,
        second: SolidGeometry,
        setting: BodyContactSettings,
        kappa: double,
        contact_status: int,
        is_near: bool,
        corners: wp.array2d(dtype=double),
        planes: wp.array2d(dtype=double),
        exits: wp.array2d(dtype=double),
        least_depths: wp.array(dtype=double),
        breaks: wp.array2d(dtype=double),
        limits: wp.array(dtype=double),
        pending: wp.array(dtype=wp.int32),
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
        normals: wp.array2d(dtype=double),
        patch_rows: wp.array2d(dtype=double),
    ):
        sums = ColumnSums()
        sums.status = contact_status
        side = curved_side(first, second, pose, kappa)
        if not is_near:
            return sums
        if not side.half_space and are_apart(first, second, pose.first_in_second, double(0.0)):
            return sums
        # Its share is that of the polyhedron.
        overlap = curved_overlap_of(
            breaks, limits, corners, pending, geometries, side.curved, side.other, side.pose
        )
        is_first = side.sign > double(0.0)  # whether the first solid is the curved one
        if setting.reference >= double(0.0) and (side.other.flags & (HALF_SPACE | HAS_BOUNDARY)) == 0:
            overlap.share = wp.where(is_first, setting.reference, double(1.0) - setting.reference)
        sums.share = wp.where(is_first, overlap.share, double(1.0) - overlap.share)
        sums.depth = overlap.depth
        sums.status = status_at_depth(sums.depth, setting)
        if sums.status != CONTACT:
            return sums
        kind_count = wp.int32(1)
        if not side.half_space and overlap.share < double(1.0):
            kind_count = 1 + sheet_count(side.curved.flags)
        # Columns of a cone may leave it before they leave the polyhedron.
        margin = double(0.0)
        if kind_count > 1 and (side.curved.flags & CONE) != 0:
            margin = NO_WEIGHT * overlap.depth
        box = box_of_curved(side.curved, side.other, side.pose, margin)
        top = start_traversal(pending, 0, side.other)
        while top > 0:
            leaf = next_leaf_in_box(pending, 0, top, geometries, side.other, no_motion(), box)
            top = leaf.top
            for face in range(leaf.first_face, leaf.end_face):
                if not side.half_space and is_face_outside(geometries, side.other, face, box):
                    continue
                sums = add_face(
                    model, state, env, dt, pair, geometries, side, overlap, kind_count, margin, face, corners, breaks,
                    limits, pending, top, coefficients, history_in, history_out, body_contacts, sums, normals,
                    patch_rows,
                )  # fmt: skip
        if side.half_space:
            # Parts wholly below the plane have columns that cancel: the area is that of the exits.
            sums.area = double(0.5) * (sums.area + sums.gross_area)
            if wp.static(has_law_history):
                use_areas_of_exits(patch_rows)
        return sums

    return columns_of_curved
