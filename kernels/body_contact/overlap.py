"""Depth of the overlap of two solids, which of them is the reference, and the weight of columns.

The depth D is the largest distance of a point of either surface inside the other solid from the surface of that solid. The
weight w of a column is 1 up to t = 2 D and 0 from t = 4 D on: columns on side walls run along the overlap, not across it,
and do not count.

Columns stand on the faces of both solids. Those on the second solid have a share that grows with the deviation from flatness
of the surface of the first solid in the overlap: the area inside the other solid, less the length of its area vector. So the
flatter surface is the reference.
"""

import warp as wp
from warpcontact.kernels.body_contact.columns import (
    FaceFrame,
    column_polygon,
    convex_polygon,
    face_frame,
    is_apart,
    is_exit,
    planes_from_face,
    position_on_face,
    ramp_height,
)
from warpcontact.kernels.body_contact.polygons import Polygon, centroid, corner, polygon_area
from warpcontact.kernels.body_contact.solids import (
    CONVEX,
    FEW_PLANES,
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    RelativePose,
    inverse_pose,
)
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    SolidGeometry,
    depth_below_surface,
    plane_offset,
)

double = wp.float64
vec3d = wp.vec3d

# Weight of columns: 1 up to FULL_WEIGHT × D, 0 from NO_WEIGHT × D on.
FULL_WEIGHT = wp.constant(double(2.0))
NO_WEIGHT = wp.constant(double(4.0))


@wp.struct
class Overlap:
    """Overlap of two solids."""

    depth: double  # D [m]
    share: double  # weight of the columns on the faces of the second solid; those on the first have 1 − share


@wp.func
def depth_bound(
    geometries: Geometries, frame: FaceFrame, other: SolidGeometry, pose: RelativePose, polygon: Polygon
):
    """Returns an upper bound on the depth of the points of a polygon below the surface of a convex solid [m].

    The depth is the least distance from a plane, and each distance is largest at a corner.
    """
    bound = INFINITE
    to_other = wp.transpose(pose.rotation)
    origin = to_other * (frame.origin - pose.origin)
    u_axis = to_other * frame.u_axis
    v_axis = to_other * frame.v_axis
    for plane in range(other.first_plane, other.end_plane):
        face = geometries.plane_face[plane]
        normal = geometries.normal[face]
        height = plane_offset(geometries, other, face) - wp.dot(normal, origin)
        along_u = wp.dot(normal, u_axis)
        along_v = wp.dot(normal, v_axis)
        largest = -INFINITE
        for i in range(polygon.count):
            largest = wp.max(largest, height - along_u * polygon.corners[i, 0] - along_v * polygon.corners[i, 1])
        bound = wp.min(bound, largest)
    return bound


@wp.func
def deepest_of(
    geometries: Geometries,
    frame: FaceFrame,
    other: SolidGeometry,
    pose: RelativePose,
    polygon: Polygon,
    deepest: double,
):
    """Returns the largest depth below the surface of the other solid on a polygon, at least ``deepest`` [m].

    It is evaluated at corners, midpoints of edges and the center. A column is at least as long as its base is deep.
    """
    count = polygon.count
    is_convex = (other.flags & CONVEX) != 0 and frame.count > 0
    if is_convex:
        if depth_bound(geometries, frame, other, pose, polygon) <= deepest:
            return deepest
    middle = centroid(polygon)
    direction = -(wp.transpose(pose.rotation) * frame.normal)
    for i in range(2 * count + 1):
        point = corner(polygon, i // 2 % count)
        if i == 2 * count:
            point = middle
        elif i % 2 == 1:
            point = double(0.5) * (point + corner(polygon, (i // 2 + 1) % count))
        if is_convex or point[2] > deepest:
            position = position_on_face(frame, point[0], point[1]) - pose.origin
            depth = depth_below_surface(geometries, other, wp.transpose(pose.rotation) * position, direction)
            if not is_convex:
                depth = wp.min(depth, point[2])
            deepest = wp.max(deepest, depth)
    return deepest


@wp.func
def overlap_of(geometries: Geometries, first: SolidGeometry, second: SolidGeometry, first_in_second: RelativePose):
    """Returns the ``Overlap`` of two solids; the first must not be a half-space or open."""
    result = Overlap()
    result.share = double(1.0)
    second_is_reference = (second.flags & (HALF_SPACE | HAS_BOUNDARY)) != 0
    # Deviation from flatness of the part of each surface that is inside the other solid [m²].
    deviation = wp.vec2d()
    for side in range(2):
        if side == 1 and second_is_reference:
            break
        own = second
        other = first
        pose = first_in_second
        if side == 1:
            own = first
            other = second
            pose = inverse_pose(first_in_second)
        total = double(0.0)
        total_vector = vec3d()
        for face in range(own.first_face, own.end_face):
            frame = face_frame(geometries, own, other, pose, face)
            if is_apart(frame, other):
                continue
            area = double(0.0)
            if frame.count > 0 and (other.flags & FEW_PLANES) != 0:
                planes = planes_from_face(geometries, frame, other)
                polygon = convex_polygon(frame, other, planes, -1, double(0.0), INFINITE)
                if polygon.count > 0:
                    area = polygon.weight * polygon_area(polygon)
                    result.depth = deepest_of(geometries, frame, other, pose, polygon, result.depth)
            else:
                for other_face in range(other.first_face, other.end_face):
                    leaves = is_exit(geometries, frame, other_face)
                    shallowest = double(0.0)
                    if not leaves:
                        shallowest = -ramp_height(other)
                    polygon = column_polygon(geometries, frame, other, other_face, shallowest, INFINITE)
                    if polygon.count == 0:
                        continue
                    if frame.count == 0:
                        # On a half-space, the depth is that of the lowest point.
                        for i in range(polygon.count):
                            result.depth = wp.max(result.depth, polygon.corners[i, 2])
                    elif leaves:
                        area += polygon_area(polygon)
                        result.depth = deepest_of(geometries, frame, other, pose, polygon, result.depth)
                    else:
                        area -= polygon.weight * polygon_area(polygon)
            total += area
            total_vector += area * frame.normal
        deviation[side] = wp.max(total - wp.length(total_vector), double(0.0))
    if not second_is_reference:
        # Faces of the second solid carry more if the first solid is less flat.
        result.share = double(0.5)
        together = deviation[0] + deviation[1]
        if together > double(0.0):
            result.share = deviation[1] / together
    return result


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
