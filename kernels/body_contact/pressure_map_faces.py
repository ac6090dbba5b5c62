"""Pressure maps of polyhedra and half-spaces: polygons of columns on faces, divided into triangles."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.columns import (
    ColumnFrame,
    FaceFrame,
    column_polygon,
    columns_box,
    face_frame,
    frame_of_face,
    is_apart,
    is_exit,
    pose_in_face,
    ramp_height,
)
from warpcontact.kernels.body_contact.convex_columns import (
    BaseFace,
    base_face,
    exit_polygon,
    store_exits,
    store_planes,
    with_exit,
)
from warpcontact.kernels.body_contact.curved_solids import CURVED
from warpcontact.kernels.body_contact.face_columns import ColumnSide, column_side, other_box
from warpcontact.kernels.body_contact.face_trees import PENDING_NODES, next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.overlap import FULL_WEIGHT, LEAST_DEPTHS, NO_WEIGHT, Overlap, overlap_of
from warpcontact.kernels.body_contact.polygons import CORNER_ROWS, Polygon, corner
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
    MAX_PLANES,
    Geometries,
    Solids,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    BoundingBox,
    are_apart,
    is_face_outside,
    solid_geometry,
)
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import structs

vec3d = wp.vec3d
double = wp.float64


@wp.func
def add_polygon(
    vertices: MapVertices,
    triangles: MapTriangles,
    first_vertex: int,
    first_triangle: int,
    counts: MapCounts,
    corners: wp.array2d(dtype=double),
    polygon: Polygon,
    frame: ColumnFrame,
    normal: vec3d,
    weight: double,
    side: int,
    face: int,
):
    """Adds the columns on a polygon, and returns the counts."""
    start = counts.vertex
    for i in range(polygon.count):
        position = corner(corners, polygon, i)
        depth = wp.dot(frame.depth_factors, position) + frame.depth_offset
        counts = add_vertex(
            vertices,
            first_vertex,
            counts,
            frame.to_W * position + frame.origin,
            normal,
            depth,
            double(0.0),
            double(1.0),
        )
    for i in range(1, polygon.count - 1):
        numbers = wp.vec3i(first_vertex + start, first_vertex + start + i, first_vertex + start + i + 1)
        counts = add_triangle(triangles, first_triangle, counts, numbers, weight, side, face)
    return counts


@wp.func
def add_face(
    vertices: MapVertices,
    triangles: MapTriangles,
    first_vertex: int,
    first_triangle: int,
    counts: MapCounts,
    geometries: Geometries,
    side: ColumnSide,
    side_number: int,
    overlap: Overlap,
    face: int,
    corners: wp.array2d(dtype=double),
    planes: wp.array2d(dtype=double),
    exits: wp.array2d(dtype=double),
    pending: wp.array(dtype=wp.int32),
    bottom: int,
):
    """Adds the columns on a face, divided as in ``face_columns.add_face``, and returns the counts.

    Columns that enter the other solid have a negative weight, and end where they enter.
    """
    base = BaseFace()
    face_plane = FaceFrame()
    frame = ColumnFrame()
    box = BoundingBox()
    plane_count = side.other.end_plane - side.other.first_plane
    if side.by_planes:
        base = base_face(corners, planes, plane_count, geometries, side.own, side.own_in_other, side.other, face)
        if base.area == double(0.0):
            return counts
        store_exits(corners, planes, plane_count, base, exits)
        frame.to_W = side.other_in_W.rotation
        frame.origin = side.other_in_W.origin
        frame.direction = base.direction
    else:
        face_plane = face_frame(geometries, side.own, side.other, side.other_in_own, face)
        if is_apart(face_plane, side.other):
            return counts
        deepest_column = NO_WEIGHT * overlap.depth
        if side.half_space:
            deepest_column = INFINITE
        box = columns_box(face_plane, side.other, deepest_column)
        frame = frame_of_face(face_plane, side.own_in_W)
    normal = side.sign * (side.own_in_W.rotation * geometries.normal[face])
    top = start_traversal(pending, bottom, side.other)
    while top > bottom:
        # All planes in one pass, or the leaves of the tree below the face.
        first_exit = wp.int32(0)
        end_exit = plane_count
        if side.by_planes:
            top = bottom
        else:
            leaf = next_leaf_in_box(pending, bottom, top, geometries, side.other, pose_in_face(face_plane), box)
            top = leaf.top
            first_exit = leaf.first_face
            end_exit = leaf.end_face
        for exit in range(first_exit, end_exit):
            is_entry = wp.bool(False)
            if not side.by_planes:
                is_entry = not is_exit(geometries, face_plane, exit)
            elif exits[exit, 0] >= NO_WEIGHT * overlap.depth:
                continue
            # The weight decreases beyond FULL_WEIGHT × D.
            parts = wp.where(side.half_space, 1, 2)
            for part in range(parts):
                shallowest = double(0.0)
                deepest = FULL_WEIGHT * overlap.depth
                if side.half_space:
                    deepest = INFINITE
                elif part == 1:
                    shallowest = deepest
                    deepest = NO_WEIGHT * overlap.depth
                elif is_entry:
                    shallowest = -ramp_height(side.other)
                polygon = Polygon()
                if side.by_planes:
                    polygon = exit_polygon(corners, planes, plane_count, base, exits, exit, shallowest, deepest)
                    if polygon.count > 0:
                        frame = with_exit(frame, planes, exit)
                else:
                    polygon = column_polygon(
                        corners, geometries, face_plane, side.other, exit, shallowest, deepest
                    )
                if polygon.count > 0:
                    weight = wp.where(is_entry, -side.share, side.share) * polygon.weight
                    counts = add_polygon(
                        vertices, triangles, first_vertex, first_triangle, counts, corners, polygon, frame, normal,
                        weight, side_number, face,
                    )  # fmt: skip
    return counts


@functools.cache
def face_maps(real: type) -> wp.Kernel:
    """Returns the kernel of the pressure maps of pairs without curved solids, in one precision of the state."""
    State = structs(real).State
    pair_pose = solid_functions.functions(real).pair_pose

    @unique_kernel()
    def map_faces(
        state: State,
        geometries: Geometries,
        solids: Solids,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        map_pairs: MapPairs,
        vertices: MapVertices,
        triangles: MapTriangles,
    ):
        corners = wp.zeros(shape=(CORNER_ROWS, 3), dtype=double)
        planes = wp.zeros(shape=(MAX_PLANES, 4), dtype=double)
        exits = wp.zeros(shape=(MAX_PLANES, 2), dtype=double)
        least_depths = wp.zeros(shape=(LEAST_DEPTHS,), dtype=double)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
        env, number = wp.tid()
        setting = settings[env, number]
        solid_1 = pairs.first[number]
        solid_2 = pairs.second[number]
        first = solid_geometry(geometries, solids.pose[env, solid_1])
        second = solid_geometry(geometries, solids.pose[env, solid_2])
        if setting.enabled == 0 or ((first.flags | second.flags) & CURVED) != 0:
            return
        pose = pair_pose(state, env, solids, solid_1, solid_2)
        half_space = (second.flags & HALF_SPACE) != 0
        second_is_reference = (second.flags & (HALF_SPACE | HAS_BOUNDARY)) != 0
        if not half_space and are_apart(
            first, second, pose.first_in_second, ramp_height(first) + ramp_height(second)
        ):
            return
        overlap = overlap_of(
            corners, planes, exits, least_depths, pending, geometries, first, second, pose.first_in_second
        )
        if setting.reference >= double(0.0) and not second_is_reference:
            overlap.share = setting.reference
        if overlap.depth <= double(0.0) or overlap.depth > setting.max_depth:
            return
        map_pairs.depth[env, number] = overlap.depth
        map_pairs.share[env, number] = overlap.share
        first_vertex = map_pairs.vertex_start[env, number]
        first_triangle = map_pairs.triangle_start[env, number]
        counts = MapCounts()
        sides = wp.where(second_is_reference, 1, 2)
        for side_number in range(sides):
            side = column_side(first, second, pose, overlap, double(0.0), side_number)
            if side.share == double(0.0):
                continue
            if side.by_planes:
                store_planes(planes, geometries, side.other)
            box = other_box(side)
            top = start_traversal(pending, 0, side.own)
            while top > 0:
                leaf = next_leaf_in_box(pending, 0, top, geometries, side.own, no_motion(), box)
                top = leaf.top
                for face in range(leaf.first_face, leaf.end_face):
                    if not half_space:
                        if is_face_outside(geometries, side.own, face, box):
                            continue
                    counts = add_face(
                        vertices, triangles, first_vertex, first_triangle, counts, geometries, side, side_number, overlap,
                        face, corners, planes, exits, pending, top,
                    )  # fmt: skip
        map_pairs.vertex_count[env, number] = counts.vertex
        map_pairs.triangle_count[env, number] = counts.triangle

    return map_faces
