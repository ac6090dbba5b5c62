"""Columns between two solids.

A column stands on a point of a face of one solid that is inside the other solid. It runs along the inward normal of the
face, to the first place where it leaves the other solid; its length is its depth t. It pushes the other solid along the
outward normal of the face.

The bases of columns are polygons on the face. If the other solid is convex with few planes, they are the part of the face
inside all planes, divided by the plane at which the columns leave. Otherwise they are the projections of the faces of the other
solid below the face. Columns leave at some faces (exits) and enter at others (entries). An entry is above an exit that
columns do not reach, so the columns down to that exit are subtracted. On a half-space the columns down to the entry are
subtracted, so that the sum is the volume below the plane.
"""

import warp as wp
from warpcontact.kernels.body_contact.polygons import Polygon, centroid, cut, set_corner
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    Geometries,
    RelativePose,
    corner_count,
    face_vertex,
)
from warpcontact.kernels.body_contact.surface_queries import INFINITE, PARALLEL, BoundingBox, SolidGeometry

double = wp.float64
vec3d = wp.vec3d

# Height over which an entry counts partly, relative to the size of the solid. The side walls of two solids may be in one
# plane; then half of each counts, as on average to both sides of that pose.
RAMP = wp.constant(double(1.0e-9))
# Direction of columns in the coordinates (u, v, t) of a face.
DOWN = wp.constant(vec3d(double(0.0), double(0.0), double(1.0)))

corner_coordinates = wp.types.matrix(shape=(4, 2), dtype=double)


@wp.struct
class FaceFrame:
    """The plane of a face, in the frame of its solid, and the other solid as seen from it."""

    origin: vec3d  # [m]
    u_axis: vec3d
    v_axis: vec3d
    normal: vec3d  # outward
    count: wp.int32  # number of corners; 0: the whole plane
    corners: corner_coordinates  # rows (u, v) [m]
    lower: wp.vec2d  # smallest u and v [m]
    upper: wp.vec2d  # largest u and v [m]
    # A point of the other solid has (u, v, t) = projection · point + shift.
    projection: wp.mat33d
    shift: vec3d  # [m]


@wp.struct
class ColumnFrame:
    """Coordinates of the corners of polygons, in which the depth of columns is affine."""

    to_W: wp.mat33d  # coordinates → base of the column, W
    origin: vec3d  # likewise, relative to the origin of the pair, W [m]
    direction: vec3d  # of columns
    depth_factors: vec3d  # depth = depth_factors · coordinates + depth_offset
    depth_offset: double  # [m]


@wp.func
def face_frame(geometries: Geometries, side: SolidGeometry, other: SolidGeometry, pose: RelativePose, face: int):
    """Returns the plane of a face, and the other solid of relative pose ``pose`` as seen from it.

    The plane of a half-space is z = 0.
    """
    frame = FaceFrame()
    if side.flags & HALF_SPACE:
        frame.u_axis = vec3d(double(1.0), double(0.0), double(0.0))
        frame.v_axis = vec3d(double(0.0), double(1.0), double(0.0))
        frame.normal = vec3d(double(0.0), double(0.0), double(1.0))
    else:
        vertices = geometries.face[face]
        frame.origin = face_vertex(geometries, vertices, 0, side.scale)
        frame.normal = geometries.normal[face]
        frame.u_axis = geometries.u_axis[face]
        frame.v_axis = wp.cross(frame.normal, frame.u_axis)
        frame.count = corner_count(vertices)
        for i in range(1, frame.count):
            position = face_vertex(geometries, vertices, i, side.scale) - frame.origin
            coordinates = wp.vec2d(wp.dot(frame.u_axis, position), wp.dot(frame.v_axis, position))
            frame.corners[i, 0] = coordinates[0]
            frame.corners[i, 1] = coordinates[1]
            frame.lower = wp.min(frame.lower, coordinates)
            frame.upper = wp.max(frame.upper, coordinates)
    axes = wp.matrix_from_rows(frame.u_axis, frame.v_axis, -frame.normal)
    frame.projection = axes * pose.rotation
    frame.shift = axes * (pose.origin - frame.origin)
    return frame


@wp.func
def frame_of_face(frame: FaceFrame, pose: RelativePose):
    """Returns the ``ColumnFrame`` of coordinates (u, v, t) of a face; ``pose``: that of its solid, W."""
    result = ColumnFrame()
    result.to_W = pose.rotation * wp.matrix_from_cols(frame.u_axis, frame.v_axis, vec3d())
    result.origin = pose.rotation * frame.origin + pose.origin
    result.direction = DOWN
    result.depth_factors = DOWN
    return result


@wp.func
def position_on_face(frame: FaceFrame, u: double, v: double):
    """Returns the point of a face with coordinates ``u`` and ``v``, in the frame of its solid [m]."""
    return frame.origin + u * frame.u_axis + v * frame.v_axis


@wp.func
def ramp_height(other: SolidGeometry):
    """Returns the height above and below a face within which a face that columns enter counts partly [m]."""
    return RAMP * wp.length(other.half_extents)


@wp.func
def entry_weight(other: SolidGeometry, depth: double):
    """Returns the weight of a face that columns enter at ``depth``."""
    return wp.clamp(double(0.5) + depth / (double(2.0) * ramp_height(other)), double(0.0), double(1.0))


@wp.func
def is_apart(frame: FaceFrame, other: SolidGeometry):
    """Returns whether no point of a face is inside the bounding box of the other solid, whose plane it may not cut.

    Columns on a half-space also pass through solids that are wholly below its plane.
    """
    center = frame.projection * other.center + frame.shift
    reach = vec3d()
    for i in range(3):
        for k in range(3):
            reach[i] = reach[i] + wp.abs(frame.projection[i, k]) * other.half_extents[k]
    if center[2] + reach[2] <= double(0.0):
        return True
    if frame.count == 0:
        return False
    if center[2] - reach[2] >= ramp_height(other):
        return True
    apart_u = center[0] + reach[0] <= frame.lower[0] or center[0] - reach[0] >= frame.upper[0]
    apart_v = center[1] + reach[1] <= frame.lower[1] or center[1] - reach[1] >= frame.upper[1]
    return apart_u or apart_v


@wp.func
def is_exit(geometries: Geometries, frame: FaceFrame, face: int):
    """Returns whether columns leave the other solid at one of its faces; otherwise they enter it there."""
    inward = vec3d(frame.projection[2, 0], frame.projection[2, 1], frame.projection[2, 2])
    return wp.dot(inward, geometries.normal[face]) > double(0.0)


@wp.func
def pose_in_face(frame: FaceFrame):
    """Returns the pose of the other solid in the coordinates (u, v, t) of a face."""
    result = RelativePose()
    result.rotation = frame.projection
    result.origin = frame.shift
    return result


@wp.func
def whole_face(corners: wp.array2d(dtype=double), frame: FaceFrame):
    """Returns the polygon of a face, with depths t of 0."""
    polygon = Polygon()
    polygon.count = frame.count
    polygon.weight = double(1.0)
    for i in range(frame.count):
        set_corner(corners, i, vec3d(frame.corners[i, 0], frame.corners[i, 1], double(0.0)))
    return polygon


@wp.func
def columns_box(frame: FaceFrame, other: SolidGeometry, deepest: double):
    """Returns the box of columns on a face up to a depth, in coordinates (u, v, t)."""
    box = BoundingBox()
    ramp = ramp_height(other)
    box.lower = vec3d(frame.lower[0], frame.lower[1], -ramp)
    box.upper = vec3d(frame.upper[0], frame.upper[1], deepest)
    if frame.count == 0:
        box.lower = vec3d(-INFINITE, -INFINITE, -ramp)
        box.upper = vec3d(INFINITE, INFINITE, deepest)
    return box


@wp.func
def column_polygon(
    corners: wp.array2d(dtype=double),
    geometries: Geometries,
    frame: FaceFrame,
    other: SolidGeometry,
    face: int,
    shallowest: double,
    deepest: double,
):
    """Returns the base of the columns on a face that cross a face of the other solid at a depth within two limits.

    Args:
        corners: Corners of the polygons of the thread.
        geometries: The geometries.
        frame: The face on which the columns stand.
        other: The other solid.
        face: The face of the other solid.
        shallowest: Smallest depth [m].
        deepest: Largest depth [m].

    Returns:
        The ``Polygon``, not in the block of stored polygons.
    """
    polygon = Polygon()
    # The third row of the projection is the inward normal.
    inward = vec3d(frame.projection[2, 0], frame.projection[2, 1], frame.projection[2, 2])
    if wp.abs(wp.dot(inward, geometries.normal[face])) < PARALLEL:
        return polygon
    vertices = geometries.face[face]
    count = corner_count(vertices)
    lower = vec3d(INFINITE, INFINITE, INFINITE)
    upper = -lower
    for i in range(count):
        position = frame.projection * face_vertex(geometries, vertices, i, other.scale) + frame.shift
        lower = wp.min(lower, position)
        upper = wp.max(upper, position)
        set_corner(corners, i, position)
    if upper[2] <= shallowest or lower[2] >= deepest:
        return polygon
    if frame.count > 0:
        if (
            upper[0] <= frame.lower[0]
            or upper[1] <= frame.lower[1]
            or lower[0] >= frame.upper[0]
            or lower[1] >= frame.upper[1]
        ):
            return polygon
    polygon.count = count
    polygon.weight = double(1.0)
    # One call of ``cut``, which compilers inline: at the two depths, and at the edges of the face.
    for number in range(-2, frame.count):
        factors = vec3d(double(0.0), double(0.0), double(1.0))
        offset = -shallowest
        if number == -1:
            if deepest == INFINITE:
                continue
            factors = -factors
            offset = deepest
        elif number >= 0:
            end = number + 1
            if end == frame.count:
                end = 0
            along_u = frame.corners[end, 0] - frame.corners[number, 0]
            along_v = frame.corners[end, 1] - frame.corners[number, 1]
            factors = vec3d(-along_v, along_u, double(0.0))
            offset = along_v * frame.corners[number, 0] - along_u * frame.corners[number, 1]
        polygon = cut(corners, polygon, factors, offset)
        if polygon.count == 0:
            return polygon
    if frame.count > 0 and not is_exit(geometries, frame, face):
        polygon.weight = entry_weight(other, centroid(corners, polygon, DOWN)[2])
    return polygon


@wp.func
def cut_by_depth(corners: wp.array2d(dtype=double), polygon: Polygon, shallowest: double, deepest: double):
    """Returns the part of a polygon with depths t between two limits."""
    polygon = cut(corners, polygon, vec3d(double(0.0), double(0.0), double(1.0)), -shallowest)
    if polygon.count > 0 and deepest < INFINITE:
        polygon = cut(corners, polygon, vec3d(double(0.0), double(0.0), double(-1.0)), deepest)
    return polygon
