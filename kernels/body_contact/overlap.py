"""Depth of the overlap of two solids, which of them is the reference, and the weight of columns.

The depth D is the largest distance of a point of either surface inside the other solid from the surface of that solid, among
samples of the surface if the other solid has more than ``MAX_PLANES`` planes. The samples change continuously with the pose: those
inside the parts of a face count less on slender parts, because parts appear and disappear as lines. The weight w of a column is 1 up to t = 2 D and
0 from t = 4 D on: columns on side walls run along the overlap, not across it, and do not count.

Columns stand on the faces of both solids. Those on the second solid have a share that grows with the deviation from flatness
of the surface of the first solid in the overlap: the area inside the other solid, less the length of its area vector. So the
flatter surface is the reference.
"""

import warp as wp
from warpcontact.kernels.body_contact.columns import (
    DOWN,
    FaceFrame,
    column_polygon,
    columns_box,
    face_frame,
    is_apart,
    is_exit,
    pose_in_face,
    position_on_face,
    ramp_height,
    whole_face,
)
from warpcontact.kernels.body_contact.convex_columns import (
    base_face,
    deepest_inside,
    store_exits,
    store_planes,
)
from warpcontact.kernels.body_contact.face_trees import (
    distance_to_surface,
    is_inside_solid,
    next_leaf_in_box,
    start_traversal,
)
from warpcontact.kernels.body_contact.polygons import Polygon, centroid, corner, polygon_area, sample_of_polygon
from warpcontact.kernels.body_contact.solids import (
    FEW_PLANES,
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    RelativePose,
    corner_count,
    face_vertex,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    BoundingBox,
    SolidGeometry,
    bounding_box,
    is_face_outside,
)

double = wp.float64
vec3d = wp.vec3d

# Weight of columns: 1 up to FULL_WEIGHT × D, 0 from NO_WEIGHT × D on.
FULL_WEIGHT = wp.constant(double(2.0))
NO_WEIGHT = wp.constant(double(4.0))
# Area of a polygon relative to its squared perimeter, 1/16 for a square, from which on its midpoints and center are full samples.
SLENDER = wp.constant(double(0.01))
# Faces of each solid whose smallest depth is stored.
SLOTS_PER_SIDE = wp.constant(16)
#: Length of the array of smallest depths.
LEAST_DEPTHS = 2 * 16


@wp.struct
class Overlap:
    """Overlap of two solids."""

    depth: double  # D [m]
    share: double  # weight of the columns on the faces of the second solid; those on the first have 1 − share


@wp.func
def deepest_of(
    corners: wp.array2d(dtype=double),
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    frame: FaceFrame,
    other: SolidGeometry,
    pose: RelativePose,
    polygon: Polygon,
    is_inside: bool,
    deepest: double,
):
    """Returns the largest depth below the surface of the other solid on a polygon, at least ``deepest`` [m].

    It is evaluated at corners, and at midpoints of edges and the center, which count less on slender polygons. A column is at least
    as long as its base is deep.

    Args:
        corners: Corners of the polygons of the thread.
        pending: Pending nodes of the thread.
        bottom: Number of pending nodes of other traversals.
        geometries: The geometries.
        frame: The face of the polygon.
        other: The other solid.
        pose: Its pose in the solid of the face.
        polygon: Corners (u, v, t) with the depths t of columns.
        is_inside: Whether the polygon is known to be inside the other solid.
        deepest: Depth of other polygons [m].
    """
    middle = centroid(corners, polygon, DOWN)
    to_other = wp.transpose(pose.rotation)
    direction = -(to_other * frame.normal)
    perimeter = double(0.0)
    for i in range(polygon.count):
        edge = corner(corners, polygon, (i + 1) % polygon.count) - corner(corners, polygon, i)
        perimeter += wp.sqrt(edge[0] * edge[0] + edge[1] * edge[1])
    slenderness = SLENDER * perimeter * perimeter
    between = double(1.0)
    area = polygon_area(corners, polygon, DOWN)
    if area < slenderness:
        between = area / slenderness
    for i in range(2 * polygon.count + 1):
        point = sample_of_polygon(corners, polygon, middle, i)
        factor = double(1.0)
        if i % 2 == 1 or i == 2 * polygon.count:
            factor = between
        if factor * point[2] > deepest:
            position = to_other * (position_on_face(frame, point[0], point[1]) - pose.origin)
            depth = factor * distance_to_surface(
                pending, bottom, geometries, other, position, point[2], deepest / factor
            )
            if depth <= deepest:
                continue
            if not is_inside:
                if not is_inside_solid(pending, bottom, geometries, other, position, direction):
                    continue
            deepest = depth
    return deepest


@wp.func
def depth_below_plane(
    pending: wp.array(dtype=wp.int32), geometries: Geometries, solid: SolidGeometry, pose: RelativePose
):
    """Returns the depth of the lowest point of a solid below the plane z = 0 of a half-space [m]."""
    lowest = double(0.0)
    up = vec3d(pose.rotation[2, 0], pose.rotation[2, 1], pose.rotation[2, 2])
    box = BoundingBox()
    box.lower = -vec3d(INFINITE, INFINITE, INFINITE)
    box.upper = vec3d(INFINITE, INFINITE, double(0.0))
    top = start_traversal(pending, 0, solid)
    while top > 0:
        box.upper[2] = lowest
        leaf = next_leaf_in_box(pending, 0, top, geometries, solid, pose, box)
        top = leaf.top
        for face in range(leaf.first_face, leaf.end_face):
            # A lowest point is a vertex of a face that looks down.
            if wp.dot(up, geometries.normal[face]) < double(0.0):
                vertices = geometries.face[face]
                for i in range(corner_count(vertices)):
                    vertex = face_vertex(geometries, vertices, i, solid.scale)
                    lowest = wp.min(lowest, wp.dot(up, vertex) + pose.origin[2])
    return -lowest


@wp.struct
class FaceOverlap:
    """The part of a face that is inside another solid."""

    area: double  # [m²]
    depth: double  # D of all faces so far [m]
    least: double  # smallest depth of its columns [m]


@wp.func
def overlap_of_face(
    corners: wp.array2d(dtype=double),
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    own: SolidGeometry,
    other: SolidGeometry,
    pose: RelativePose,
    face: int,
    deepest: double,
):
    """Returns the ``FaceOverlap`` of a face of ``own`` and the other solid, whose pose in ``own`` is ``pose``."""
    result = FaceOverlap()
    result.depth = deepest
    result.least = INFINITE
    frame = face_frame(geometries, own, other, pose, face)
    if is_apart(frame, other):
        return result
    # A face that is farther from the surface than its size is wholly inside or outside.
    middle = double(0.5) * (frame.lower + frame.upper)
    radius = double(0.5) * wp.length(frame.upper - frame.lower)
    to_other = wp.transpose(pose.rotation)
    position = to_other * (position_on_face(frame, middle[0], middle[1]) - pose.origin)
    distance = distance_to_surface(pending, bottom, geometries, other, position, INFINITE, double(0.0))
    is_whole = distance >= radius
    if is_whole:
        if not is_inside_solid(pending, bottom, geometries, other, position, -(to_other * frame.normal)):
            return result
        if distance + radius <= deepest:
            result.area = polygon_area(corners, whole_face(corners, frame), DOWN)
            result.least = double(0.0)  # not known
            return result
    to_face = pose_in_face(frame)
    box = columns_box(frame, other, INFINITE)
    top = start_traversal(pending, bottom, other)
    while top > bottom:
        leaf = next_leaf_in_box(pending, bottom, top, geometries, other, to_face, box)
        top = leaf.top
        for other_face in range(leaf.first_face, leaf.end_face):
            leaves = is_exit(geometries, frame, other_face)
            shallowest = double(0.0)
            if not leaves:
                shallowest = -ramp_height(other)
            polygon = column_polygon(corners, geometries, frame, other, other_face, shallowest, INFINITE)
            if polygon.count == 0:
                continue
            area = polygon_area(corners, polygon, DOWN)
            if leaves:
                result.area += area
                if distance + radius > result.depth:
                    result.depth = deepest_of(
                        corners, pending, top, geometries, frame, other, pose, polygon, is_whole, result.depth
                    )
            else:
                result.area -= polygon.weight * area
            for i in range(polygon.count):
                result.least = wp.min(result.least, corner(corners, polygon, i)[2])
    return result


@wp.func
def overlap_of(
    corners: wp.array2d(dtype=double),
    planes: wp.array2d(dtype=double),
    exits: wp.array2d(dtype=double),
    least_depths: wp.array(dtype=double),
    pending: wp.array(dtype=wp.int32),
    geometries: Geometries,
    first: SolidGeometry,
    second: SolidGeometry,
    first_in_second: RelativePose,
):
    """Returns the ``Overlap`` of two solids; the first must not be a half-space or open.

    Args:
        corners: Corners of the polygons of the thread.
        planes: Room for the planes of a solid.
        exits: Room for the depths of its planes.
        least_depths: Receives the smallest depth of the columns on each face, see ``face_slot`` [m].
        pending: Pending nodes of the thread.
        geometries: The geometries.
        first: The first solid.
        second: The second solid.
        first_in_second: Pose of the first in the second.
    """
    result = Overlap()
    result.share = double(1.0)
    if (second.flags & HALF_SPACE) != 0:
        result.depth = depth_below_plane(pending, geometries, first, first_in_second)
        return result
    # Deviation from flatness of the part of each surface that is inside the other solid [m²].
    deviation = wp.vec2d()
    area = wp.vec2d()
    sides = wp.where((second.flags & HAS_BOUNDARY) != 0, 1, 2)
    for side in range(sides):
        own = second
        other = first
        pose = first_in_second
        if side == 1:
            own = first
            other = second
            pose = inverse_pose(first_in_second)
        by_planes = (other.flags & FEW_PLANES) != 0
        own_in_other = inverse_pose(pose)
        plane_count = wp.int32(0)
        if by_planes:
            plane_count = store_planes(planes, geometries, other)
        for slot in range(SLOTS_PER_SIDE):
            least_depths[face_slot(side, slot)] = INFINITE
        # The ramp of coplanar walls reaches beyond the solid.
        other_box = bounding_box(other, pose, ramp_height(other))
        total = double(0.0)
        total_vector = vec3d()
        top = start_traversal(pending, 0, own)
        while top > 0:
            leaf = next_leaf_in_box(pending, 0, top, geometries, own, no_motion(), other_box)
            top = leaf.top
            for face in range(leaf.first_face, leaf.end_face):
                if is_face_outside(geometries, own, face, other_box):
                    continue
                overlap = FaceOverlap()
                if by_planes:
                    base = base_face(corners, planes, plane_count, geometries, own, own_in_other, other, face)
                    if base.area == double(0.0):
                        continue
                    overlap.area = base.area
                    overlap.depth = deepest_inside(corners, planes, plane_count, base, exits, result.depth)
                    overlap.least = store_exits(corners, planes, plane_count, base, exits)
                else:
                    overlap = overlap_of_face(
                        corners, pending, top, geometries, own, other, pose, face, result.depth
                    )
                result.depth = overlap.depth
                least_depths[face_slot(side, face - own.first_face)] = overlap.least
                total += overlap.area
                total_vector += overlap.area * geometries.normal[face]
        area[side] = total
        deviation[side] = wp.max(total - wp.length(total_vector), double(0.0))
    if (second.flags & HAS_BOUNDARY) == 0:
        # Faces of the second solid carry more if the first solid is less flat.
        result.share = double(0.5)
        together = deviation[0] + deviation[1]
        if together > double(0.0):
            result.share = deviation[1] / together
        # Only the surface of a solid that is wholly inside the other one has columns.
        if area[0] == double(0.0) and area[1] > double(0.0):
            result.share = double(0.0)
        elif area[1] == double(0.0) and area[0] > double(0.0):
            result.share = double(1.0)
    return result


@wp.func
def face_slot(side: int, number: int):
    """Returns the index of a face in the array of smallest depths; the last one of a side is common to further faces."""
    return side * SLOTS_PER_SIDE + wp.min(number, SLOTS_PER_SIDE - 1)


@wp.func
def least_depth_of_face(least_depths: wp.array(dtype=double), side: int, number: int):
    """Returns the smallest depth of the columns on a face from ``overlap_of``; 0 if it is not known [m]."""
    if number >= SLOTS_PER_SIDE - 1:
        return double(0.0)
    return least_depths[face_slot(side, number)]


@wp.func
def column_weight(depth: double, overlap: Overlap, always: bool):
    """Returns the weight w of a column of depth ``depth``; ``always``: 1 for each column."""
    if always:
        return double(1.0)
    span = (NO_WEIGHT - FULL_WEIGHT) * overlap.depth
    if depth <= FULL_WEIGHT * overlap.depth:
        return double(1.0)
    if depth >= NO_WEIGHT * overlap.depth:
        return double(0.0)
    x = (depth - FULL_WEIGHT * overlap.depth) / span
    return double(1.0) - x * x * (double(3.0) - double(2.0) * x)
