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
from warpcontact.kernels.body_contact.polygons import MAX_CORNERS, Polygon, centroid
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    MAX_PLANES,
    Geometries,
    RelativePose,
    corner_count,
    face_vertex,
)
from warpcontact.kernels.body_contact.surface_queries import INFINITE, PARALLEL, SolidGeometry, plane_offset

double = wp.float64
vec3d = wp.vec3d

# Height over which an entry counts partly, relative to the size of the solid. The side walls of two solids may be in one
# plane; then half of each counts, as on average to both sides of that pose.
RAMP = wp.constant(double(1.0e-9))

corner_coordinates = wp.types.matrix(shape=(4, 2), dtype=double)
corner_buffers = wp.types.matrix(shape=(2 * MAX_CORNERS, 3), dtype=double)
plane_rows = wp.types.matrix(shape=(MAX_PLANES, 4), dtype=double)


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
def column_polygon(
    geometries: Geometries, frame: FaceFrame, other: SolidGeometry, face: int, shallowest: double, deepest: double
):
    """Returns the base of the columns on a face that cross a face of the other solid at a depth within two limits.

    Args:
        geometries: The geometries.
        frame: The face on which the columns stand.
        other: The other solid.
        face: The face of the other solid.
        shallowest: Smallest depth [m].
        deepest: Largest depth [m].

    Returns:
        The ``Polygon``.
    """
    result = Polygon()
    # The third row of the projection is the inward normal.
    inward = vec3d(frame.projection[2, 0], frame.projection[2, 1], frame.projection[2, 2])
    if wp.abs(wp.dot(inward, geometries.normal[face])) < PARALLEL:
        return result
    vertices = geometries.face[face]
    count = corner_count(vertices)
    # Two buffers of corners: each cut reads one and writes the other.
    rows = corner_buffers()
    lower = vec3d(INFINITE, INFINITE, INFINITE)
    upper = -lower
    for i in range(count):
        position = frame.projection * face_vertex(geometries, vertices, i, other.scale) + frame.shift
        lower = wp.min(lower, position)
        upper = wp.max(upper, position)
        for k in range(3):
            rows[i, k] = position[k]
    if upper[2] <= shallowest or lower[2] >= deepest:
        return result
    if frame.count > 0:
        if (
            upper[0] <= frame.lower[0]
            or upper[1] <= frame.lower[1]
            or lower[0] >= frame.upper[0]
            or lower[1] >= frame.upper[1]
        ):
            return result
    source = wp.int32(0)
    for cut in range(2 + frame.count):
        # Corners with factors · (u, v, t) + offset ≥ 0 remain.
        factors = vec3d(double(0.0), double(0.0), double(1.0))
        offset = -shallowest
        if cut == 0:
            if lower[2] >= shallowest:
                continue
        elif cut == 1:
            if upper[2] <= deepest:
                continue
            factors = vec3d(double(0.0), double(0.0), double(-1.0))
            offset = deepest
        else:
            start = cut - 2
            end = start + 1
            if end == frame.count:
                end = 0
            along_u = frame.corners[end, 0] - frame.corners[start, 0]
            along_v = frame.corners[end, 1] - frame.corners[start, 1]
            factors = vec3d(-along_v, along_u, double(0.0))
            offset = along_v * frame.corners[start, 0] - along_u * frame.corners[start, 1]
        target = MAX_CORNERS - source
        kept = wp.int32(0)
        previous = vec3d(rows[source + count - 1, 0], rows[source + count - 1, 1], rows[source + count - 1, 2])
        previous_value = wp.dot(factors, previous) + offset
        for i in range(count):
            current = vec3d(rows[source + i, 0], rows[source + i, 1], rows[source + i, 2])
            value = wp.dot(factors, current) + offset
            if (value >= double(0.0)) != (previous_value >= double(0.0)) and kept < MAX_CORNERS:
                crossing = previous + (previous_value / (previous_value - value)) * (current - previous)
                for k in range(3):
                    rows[target + kept, k] = crossing[k]
                kept += 1
            if value >= double(0.0) and kept < MAX_CORNERS:
                for k in range(3):
                    rows[target + kept, k] = current[k]
                kept += 1
            previous = current
            previous_value = value
        source = target
        count = kept
        if count < 3:
            return result
    result.count = count
    result.weight = double(1.0)
    for i in range(count):
        for k in range(3):
            result.corners[i, k] = rows[source + i, k]
    if frame.count > 0 and not is_exit(geometries, frame, face):
        result.weight = entry_weight(other, centroid(result)[2])
    return result


@wp.func
def planes_from_face(geometries: Geometries, frame: FaceFrame, other: SolidGeometry):
    """Returns the planes of a convex solid with few planes as seen from a face: rows (a, b, c, h).

    A point (u, v, t) is at h − a u − b v − c t inside the plane [m]. c is the cosine of the inward normal of the face and the
    normal of the plane: columns leave at planes with c > 0.
    """
    planes = plane_rows()
    for i in range(other.end_plane - other.first_plane):
        face = geometries.plane_face[other.first_plane + i]
        normal = frame.projection * geometries.normal[face]
        for k in range(3):
            planes[i, k] = normal[k]
        planes[i, 3] = plane_offset(geometries, other, face) + wp.dot(normal, frame.shift)
    return planes


@wp.func
def convex_polygon(
    frame: FaceFrame, other: SolidGeometry, planes: plane_rows, exit: int, shallowest: double, deepest: double
):
    """Returns the base of the columns on a face that are inside a convex solid with few planes.

    Args:
        frame: The face on which the columns stand.
        other: The convex solid.
        planes: Its planes, from ``planes_from_face``.
        exit: Number of the plane at which the columns leave the solid. −1: any; then the depths at the corners are 0.
        shallowest: Smallest depth, with an exit plane [m].
        deepest: Largest depth, with an exit plane [m].
    """
    result = Polygon()
    count_of_planes = other.end_plane - other.first_plane
    # Depth of the columns: (exit_height − exit_u u − exit_v v) / exit_cosine.
    exit_u = double(0.0)
    exit_v = double(0.0)
    exit_cosine = double(0.0)
    exit_height = double(0.0)
    first_cut = wp.int32(0)
    cuts = count_of_planes
    if exit >= 0:
        exit_u = planes[exit, 0]
        exit_v = planes[exit, 1]
        exit_cosine = planes[exit, 2]
        exit_height = planes[exit, 3]
        if exit_cosine < PARALLEL:
            return result
        first_cut = -2
        cuts = 2 * count_of_planes
    # Two buffers of corners: each cut reads one and writes the other.
    rows = corner_buffers()
    count = frame.count
    for i in range(count):
        rows[i, 0] = frame.corners[i, 0]
        rows[i, 1] = frame.corners[i, 1]
    source = wp.int32(0)
    for cut in range(first_cut, cuts):
        # Points with factor_u u + factor_v v + offset ≥ 0 remain.
        factor_u = double(0.0)
        factor_v = double(0.0)
        offset = double(0.0)
        if cut == -2:
            # Depth at most ``deepest``.
            factor_u = exit_u
            factor_v = exit_v
            offset = deepest * exit_cosine - exit_height
        elif cut == -1:
            # Depth at least ``shallowest``.
            factor_u = -exit_u
            factor_v = -exit_v
            offset = exit_height - shallowest * exit_cosine
        elif cut >= 0 and cut < count_of_planes:
            # Inside the plane; at planes that columns would enter, at least within the ramp.
            factor_u = -planes[cut, 0]
            factor_v = -planes[cut, 1]
            offset = planes[cut, 3]
            if planes[cut, 2] < double(0.0):
                offset += ramp_height(other)
        elif cut >= 0:
            # The column leaves at the exit plane, not at this one.
            plane = cut - count_of_planes
            cosine = planes[plane, 2]
            if plane == exit or cosine < PARALLEL:
                continue
            factor_u = cosine * exit_u - exit_cosine * planes[plane, 0]
            factor_v = cosine * exit_v - exit_cosine * planes[plane, 1]
            offset = exit_cosine * planes[plane, 3] - cosine * exit_height
        least = INFINITE
        for i in range(count):
            value = factor_u * rows[source + i, 0] + factor_v * rows[source + i, 1] + offset
            least = wp.min(least, value)
        if least >= double(0.0):
            continue
        target = MAX_CORNERS - source
        kept = wp.int32(0)
        previous_u = rows[source + count - 1, 0]
        previous_v = rows[source + count - 1, 1]
        previous_value = factor_u * previous_u + factor_v * previous_v + offset
        for i in range(count):
            current_u = rows[source + i, 0]
            current_v = rows[source + i, 1]
            value = factor_u * current_u + factor_v * current_v + offset
            if (value >= double(0.0)) != (previous_value >= double(0.0)) and kept < MAX_CORNERS:
                fraction = previous_value / (previous_value - value)
                rows[target + kept, 0] = previous_u + fraction * (current_u - previous_u)
                rows[target + kept, 1] = previous_v + fraction * (current_v - previous_v)
                kept += 1
            if value >= double(0.0) and kept < MAX_CORNERS:
                rows[target + kept, 0] = current_u
                rows[target + kept, 1] = current_v
                kept += 1
            previous_u = current_u
            previous_v = current_v
            previous_value = value
        source = target
        count = kept
        if count < 3:
            return result
    result.count = count
    for i in range(count):
        u = rows[source + i, 0]
        v = rows[source + i, 1]
        result.corners[i, 0] = u
        result.corners[i, 1] = v
        if exit >= 0:
            result.corners[i, 2] = (exit_height - exit_u * u - exit_v * v) / exit_cosine
    result.weight = double(1.0)
    middle = centroid(result)
    for plane in range(count_of_planes):
        if planes[plane, 2] < double(0.0):
            height = planes[plane, 3] - planes[plane, 0] * middle[0] - planes[plane, 1] * middle[1]
            result.weight = result.weight * entry_weight(other, height)
    return result
