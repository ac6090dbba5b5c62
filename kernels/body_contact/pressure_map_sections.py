"""Pressure maps of a curved solid and a polyhedron or half-space: sections of the solid with faces, as grids of triangles.

The regions are those of ``curved_force.py``. Columns on the curved solid are found on the faces that they cross.
"""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
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
    Region,
    find_breaks,
    find_limits,
    is_narrow,
)
from warpcontact.kernels.body_contact.curved_solids import (
    CONE,
    CURVED,
    Section,
    column_interval,
    exit_depth_of,
    part_count,
    position_in_section,
    profile_of,
    section_of,
)
from warpcontact.kernels.body_contact.curved_surfaces import reach_weight, sheet_count, sheet_point
from warpcontact.kernels.body_contact.face_trees import (
    PENDING_NODES,
    is_inside_solid,
    next_leaf_in_box,
    start_traversal,
)
from warpcontact.kernels.body_contact.overlap import NO_WEIGHT
from warpcontact.kernels.body_contact.polygons import CORNER_ROWS, Polygon
from warpcontact.kernels.body_contact.pressure_maps import (
    MapCounts,
    MapPairs,
    MapTriangles,
    MapVertices,
    add_triangle,
    add_vertex,
)
from warpcontact.kernels.body_contact.records import BodyContactSettings, SolidPairs
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    RelativePose,
    Solids,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    OFFSET,
    PARALLEL,
    SolidGeometry,
    are_apart,
    is_face_outside,
    solid_geometry,
)
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import structs

vec3d = wp.vec3d
double = wp.float64

#: Smallest number of strips and cells; largest number of strips of a panel, and of cells of a strip.
FEWEST = 6
STRIPS = 16
CELLS = 12
# Parts of the area of contact along each direction; faces that are small against it have fewer cells.
PARTS = wp.constant(double(24.0))
# Distance from the ends of a panel, relative to its length, of the first and last line: at the end, there may be no points.
INSIDE = wp.constant(double(1.0e-9))
PI = wp.constant(double(3.14159265358979323846))


@wp.struct
class MappedRegion:
    """A region of a face, and where its columns stand."""

    curved: SolidGeometry
    other: SolidGeometry
    pose: RelativePose  # of the curved solid in the other one
    to_W: RelativePose  # pose of the other solid in W axes, relative to the origin of the pair
    section: Section
    region: Region
    normal: vec3d  # of the face
    kind: wp.int32  # ON_FACE, ON_CURVED_SURFACE or that of a flat end
    half_space: wp.bool
    extent: double  # estimate of the size of the area of contact [m]
    sign: double  # of the normals of faces, so that they point out of the second solid


@wp.struct
class MappedColumn:
    """A column through a point of a region."""

    base: vec3d  # in the frame of the other solid [m]
    normal: vec3d  # of the surface on which it stands, in the frame of the other solid
    depth: double  # [m]
    entry: double  # depth of the column that is subtracted [m]
    factor: double  # of its pressure, 0 to 1 [-]


@wp.func
def spaced(part: double):
    """Returns evenly spaced numbers from 0 to 1 closer to both ends, where the depth of columns may be steep."""
    return double(0.5) - double(0.5) * wp.cos(PI * part)


@wp.func
def part_count_of(length: double, extent: double, most: int):
    """Returns the number of parts of a length in an area of contact of this extent [m].

    It is even, because depths may have a peak in the middle.
    """
    return 2 * wp.clamp(wp.int32(wp.ceil(double(0.5) * PARTS * length / extent)), FEWEST // 2, most // 2)


@wp.func
def column_through(mapped: MappedRegion, u: double, v: double):
    """Returns the ``MappedColumn`` through the point (u, v) of a region."""
    column = MappedColumn()
    flags = mapped.curved.flags
    position = position_in_section(mapped.section, u, v)
    column.base = position
    column.normal = mapped.normal
    column.factor = double(1.0)
    if mapped.half_space:
        # Through all parts of the solid.
        column.entry = double(wp.inf)
        for part in range(part_count(flags)):
            interval = column_interval(mapped.section, profile_of(flags, mapped.curved.scale, part), u, v)
            if interval[0] <= interval[1]:
                column.depth = wp.max(column.depth, interval[1])
                column.entry = wp.min(column.entry, interval[0])
        if column.entry >= column.depth:
            column.entry = column.depth
    elif mapped.kind == ON_FACE:
        column.depth = exit_depth_of(mapped.section, flags, mapped.curved.scale, u, v)
    else:
        in_curved = wp.transpose(mapped.pose.rotation) * (position - mapped.pose.origin)
        sheet = sheet_point(flags, mapped.curved.scale, mapped.kind - ON_CURVED_SURFACE, in_curved)
        column.normal = mapped.pose.rotation * sheet.normal
        column.base = position + sheet.depth * column.normal
        column.depth = sheet.depth
        column.factor = reach_weight(sheet.depth, sheet.reach)
    return column


@wp.func
def add_cells(
    vertices: MapVertices,
    triangles: MapTriangles,
    first_vertex: int,
    first_triangle: int,
    counts: MapCounts,
    geometries: Geometries,
    mapped: MappedRegion,
    side: int,
    face: int,
    weight: double,
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    grid: wp.array2d(dtype=double),
):
    """Adds the cells between two lines, and returns the counts.

    ``grid`` has the lines as rows (u, smallest v, largest v).
    """
    width = wp.max(grid[0, 2] - grid[0, 1], grid[1, 2] - grid[1, 1]) * wp.length(mapped.section.v_axis)
    cells = part_count_of(width, mapped.extent, CELLS)
    # Not a constant, so that the loop is not unrolled.
    corner_count = wp.int32(4)
    for cell in range(cells):
        at_middle = spaced((double(cell) + double(0.5)) / double(cells))
        u = double(0.5) * (grid[0, 0] + grid[1, 0])
        v = double(0.5) * (grid[0, 1] + at_middle * (grid[0, 2] - grid[0, 1]))
        v += double(0.5) * (grid[1, 1] + at_middle * (grid[1, 2] - grid[1, 1]))
        center = column_through(mapped, u, v)
        if center.depth <= double(0.0) or center.factor == double(0.0):
            continue
        if mapped.half_space:
            # The cells of each part are those whose columns leave the solid there.
            own = column_interval(mapped.section, mapped.region.profile, u, v)
            if own[0] > own[1] or own[1] < center.depth:
                continue
        if mapped.kind != ON_FACE:
            # Columns that leave the polyhedron here, and stand on the part of the surface inside it.
            if wp.dot(center.normal, mapped.normal) > -PARALLEL:
                continue
            start = center.base - OFFSET * wp.length(mapped.other.half_extents) * center.normal
            if not is_inside_solid(pending, bottom, geometries, mapped.other, start, -center.normal):
                continue
        start_of_cell = first_vertex + counts.vertex
        for number in range(corner_count):
            line = number // 2
            at = spaced(double(cell + number % 2) / double(cells))
            column = column_through(mapped, grid[line, 0], grid[line, 1] + at * (grid[line, 2] - grid[line, 1]))
            normal = mapped.sign * (mapped.to_W.rotation * column.normal)
            counts = add_vertex(
                vertices,
                first_vertex,
                counts,
                mapped.to_W.origin + mapped.to_W.rotation * column.base,
                normal,
                wp.max(column.depth, double(0.0)),
                wp.max(column.entry, double(0.0)),
                column.factor,
            )
        lower = wp.vec3i(start_of_cell, start_of_cell + 1, start_of_cell + 2)
        upper = wp.vec3i(start_of_cell + 1, start_of_cell + 3, start_of_cell + 2)
        counts = add_triangle(triangles, first_triangle, counts, lower, weight, side, face)
        counts = add_triangle(triangles, first_triangle, counts, upper, weight, side, face)
    return counts


@functools.cache
def section_maps(real: type) -> wp.Kernel:
    """Returns the kernel of the pressure maps of pairs with one curved solid, in one precision of the state."""
    State = structs(real).State
    pair_pose = solid_functions.functions(real).pair_pose

    @unique_kernel()
    def map_sections(
        state: State,
        geometries: Geometries,
        solids: Solids,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        map_pairs: MapPairs,
        vertices: MapVertices,
        triangles: MapTriangles,
    ):
        breaks = wp.zeros(shape=(MAX_BREAKS, 3), dtype=double)
        limits = wp.zeros(shape=(MAX_LIMITS,), dtype=double)
        corners = wp.zeros(shape=(CORNER_ROWS, 3), dtype=double)
        grid = wp.zeros(shape=(2, 3), dtype=double)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
        env, number = wp.tid()
        setting = settings[env, number]
        solid_1 = pairs.first[number]
        solid_2 = pairs.second[number]
        first = solid_geometry(geometries, solids.pose[env, solid_1])
        second = solid_geometry(geometries, solids.pose[env, solid_2])
        is_first = (first.flags & CURVED) != 0  # whether the first solid is the curved one
        if setting.enabled == 0 or is_first == ((second.flags & CURVED) != 0):
            return
        pose = pair_pose(state, env, solids, solid_1, solid_2)
        mapped = MappedRegion()
        mapped.curved = first
        mapped.other = second
        mapped.pose = pose.first_in_second
        mapped.to_W = pose.second_axes
        sign = double(1.0)
        if not is_first:
            mapped.curved = second
            mapped.other = first
            mapped.pose = inverse_pose(pose.first_in_second)
            mapped.to_W = pose.first_axes
            sign = double(-1.0)
        flags = mapped.curved.flags
        scale = mapped.curved.scale
        half_space = (mapped.other.flags & HALF_SPACE) != 0
        mapped.half_space = half_space
        if not half_space and are_apart(first, second, pose.first_in_second, double(0.0)):
            return
        overlap = curved_overlap_of(
            breaks, limits, corners, pending, geometries, mapped.curved, mapped.other, mapped.pose
        )
        if setting.reference >= double(0.0) and (mapped.other.flags & (HALF_SPACE | HAS_BOUNDARY)) == 0:
            overlap.share = wp.where(is_first, setting.reference, double(1.0) - setting.reference)
        if overlap.depth <= double(0.0) or overlap.depth > setting.max_depth:
            return
        map_pairs.depth[env, number] = overlap.depth
        map_pairs.share[env, number] = wp.where(is_first, overlap.share, double(1.0) - overlap.share)
        # A sphere of radius R has an area of the radius √(2 R D).
        size = wp.length(mapped.curved.half_extents)
        mapped.extent = double(2.0) * wp.min(wp.sqrt(double(2.0) * size * overlap.depth), size)
        first_vertex = map_pairs.vertex_start[env, number]
        first_triangle = map_pairs.triangle_start[env, number]
        counts = MapCounts()
        kind_count = wp.int32(1)
        if not half_space and overlap.share < double(1.0):
            kind_count = 1 + sheet_count(flags)
        # Columns of a cone may leave it before they leave the polyhedron.
        reached = mapped.curved
        margin = double(0.0)
        if kind_count > 1 and (flags & CONE) != 0:
            margin = NO_WEIGHT * overlap.depth
            reached.half_extents += vec3d(margin, margin, margin)
        depth_of_weights = overlap.depth
        if half_space:
            depth_of_weights = double(wp.inf)
        box = box_of_curved(mapped.curved, mapped.other, mapped.pose, margin)
        top = start_traversal(pending, 0, mapped.other)
        while top > 0:
            leaf = next_leaf_in_box(pending, 0, top, geometries, mapped.other, no_motion(), box)
            top = leaf.top
            for face in range(leaf.first_face, leaf.end_face):
                if not half_space:
                    if is_face_outside(geometries, mapped.other, face, box):
                        continue
                frame = face_frame(geometries, mapped.other, mapped.curved, mapped.pose, face)
                if is_apart(frame, reached):
                    continue
                mapped.section = section_of(flags, scale, mapped.pose, frame.origin, frame.u_axis, frame.normal)
                mapped.normal = frame.normal
                face_polygon = store_face(corners, frame, mapped.section)
                for kind in range(kind_count):
                    weight = overlap.share
                    side = wp.where(is_first, 0, 1)
                    face_of_columns = face
                    mapped.sign = sign
                    if kind != ON_FACE:
                        weight = double(1.0) - overlap.share
                        side = 1 - side
                        face_of_columns = -1
                        mapped.sign = -sign
                    if weight == double(0.0):
                        continue
                    mapped.kind = kind
                    for number_of_region in range(region_count(flags, kind)):
                        mapped.region = region_of(
                            flags, scale, kind, number_of_region, mapped.section, depth_of_weights
                        )
                        polygon = Polygon()
                        polygon = polygon_of_region(
                            corners, face_polygon, frame, flags, scale, mapped.pose, kind, number_of_region,
                            overlap.depth,
                        )  # fmt: skip
                        if polygon.count == 0 and not half_space:
                            continue
                        break_count = find_breaks(breaks, mapped.section, mapped.region, corners, polygon)
                        for panel in range(break_count - 1):
                            if is_narrow(breaks, panel):
                                continue
                            is_open = wp.bool(False)
                            length = breaks[panel + 1, 0] - breaks[panel, 0]
                            strips = part_count_of(
                                length * wp.length(mapped.section.u_axis), mapped.extent, STRIPS
                            )
                            for line in range(strips + 1):
                                part = spaced(double(line) / double(strips))
                                part = wp.clamp(part, INSIDE, double(1.0) - INSIDE)
                                u = breaks[panel, 0] + part * length
                                limit_count = find_limits(
                                    limits, mapped.section, mapped.region, u, corners, polygon
                                )
                                if limit_count == 0:
                                    is_open = False
                                    continue
                                for k in range(3):
                                    grid[0, k] = grid[1, k]
                                grid[1, 0] = u
                                grid[1, 1] = limits[0]
                                grid[1, 2] = limits[limit_count - 1]
                                if is_open:
                                    counts = add_cells(
                                        vertices, triangles, first_vertex, first_triangle, counts, geometries, mapped,
                                        side, face_of_columns, weight, pending, top, grid,
                                    )  # fmt: skip
                                is_open = True
        map_pairs.vertex_count[env, number] = counts.vertex
        map_pairs.triangle_count[env, number] = counts.triangle

    return map_sections
