"""Columns between two solids, the depth of their overlap, and which solid is the reference.

A column stands on a point of a face of one solid that is inside the other solid. It runs along the inward normal of
the face, to the first place where it leaves the other solid; its length is its depth t. The column pushes the other
solid along the outward normal of the face. The projection of each face of the other solid onto the plane of the first
face, where it is below that plane, is a polygon on which t is linear. Columns end at faces that they leave (exits). A face that they enter below
the plane (an entry) is between the face and an exit that the column does not reach, so the columns of that exit are
subtracted.

With D, the depth of the overlap, the weight w of a column is 1 up to t = 2 D and 0 from t = 4 D on: columns on side walls
run along the overlap, not across it, and do not count. Columns stand on the faces of both solids. They are weighted with the
share of each solid as the reference, which is larger for the solid whose surface is flatter in the overlap.
"""

import warp as wp
from warpcontact.kernels.body_contact.polygons import MAX_CORNERS, Polygon, centroid, corner, polygon_area
from warpcontact.kernels.body_contact.solids import (
    CONVEX,
    HALF_SPACE,
    OPEN,
    Geometries,
    RelativePose,
    SolidPose,
    corner_count,
    face_vertex,
    inverse_pose,
    scaled,
)

real = wp.float64
vec3d = wp.vec3d

# Weight of columns: 1 up to FULL_WEIGHT × D, 0 from NO_WEIGHT × D on.
FULL_WEIGHT = wp.constant(real(2.0))
NO_WEIGHT = wp.constant(real(4.0))
# Cosine of two normals below which a face is parallel to the columns.
PARALLEL = wp.constant(real(1.0e-12))
# Height over which a face that columns enter counts partly, relative to the size of the solid. The side walls of two solids
# may be in one plane; then half of each counts, as on average to both sides of that pose.
RAMP = wp.constant(real(1.0e-9))
# Offset of a search from the point where it starts, relative to the size of the solid.
OFFSET = wp.constant(real(1.0e-12))
INFINITE = wp.constant(real(wp.inf))

corner_coordinates = wp.types.matrix(shape=(4, 2), dtype=real)
corner_buffers = wp.types.matrix(shape=(2 * MAX_CORNERS, 3), dtype=real)


@wp.struct
class Side:
    """One solid of a pair."""

    first_face: wp.int32
    end_face: wp.int32
    first_plane: wp.int32
    end_plane: wp.int32
    flags: wp.int32  # of its geometry
    scale: vec3d  # [m per unit]
    center: vec3d  # of its bounding box [m]
    half_extents: vec3d  # of its bounding box [m]


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
class Overlap:
    """Overlap of two solids."""

    depth: real  # D [m]
    share: real  # weight of the columns on the faces of the second solid; those on the first have 1 − share


@wp.struct
class Crossing:
    """Where a ray crosses a surface."""

    distance: real  # along the ray; infinite: nowhere [m]
    leaves: wp.int32  # 1: the ray leaves the solid; 0: it enters the solid


@wp.func
def side_of(geometries: Geometries, pose: SolidPose):
    """Returns the ``Side`` of a solid."""
    side = Side()
    side.first_face = geometries.face_start[pose.geometry]
    side.end_face = geometries.face_start[pose.geometry + 1]
    side.first_plane = geometries.plane_start[pose.geometry]
    side.end_plane = geometries.plane_start[pose.geometry + 1]
    side.flags = geometries.flags[pose.geometry]
    side.scale = pose.scale
    side.center = scaled(geometries.center[pose.geometry], pose.scale)
    side.half_extents = scaled(geometries.half_extents[pose.geometry], pose.scale)
    return side


@wp.func
def plane_offset(geometries: Geometries, side: Side, face: int):
    """Returns the offset of the plane of a face along its normal [m]."""
    normal = geometries.normal[face]
    return geometries.offset[face] * wp.dot(wp.cw_mul(normal, normal), side.scale)


@wp.func
def face_frame(geometries: Geometries, side: Side, other: Side, pose: RelativePose, face: int):
    """Returns the plane of a face, and the other solid of relative pose ``pose`` as seen from it.

    The plane of a half-space is z = 0.
    """
    frame = FaceFrame()
    if side.flags & HALF_SPACE:
        frame.u_axis = vec3d(real(1.0), real(0.0), real(0.0))
        frame.v_axis = vec3d(real(0.0), real(1.0), real(0.0))
        frame.normal = vec3d(real(0.0), real(0.0), real(1.0))
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
def position_on_face(frame: FaceFrame, u: real, v: real):
    """Returns the point of a face with coordinates ``u`` and ``v``, in the frame of its solid [m]."""
    return frame.origin + u * frame.u_axis + v * frame.v_axis


@wp.func
def ramp_height(other: Side):
    """Returns the height above and below a face within which a face that columns enter counts partly [m]."""
    return RAMP * wp.length(other.half_extents)


@wp.func
def entry_weight(other: Side, depth: real):
    """Returns the weight of a face that columns enter at ``depth``."""
    return wp.clamp(real(0.5) + depth / (real(2.0) * ramp_height(other)), real(0.0), real(1.0))


@wp.func
def is_apart(frame: FaceFrame, other: Side):
    """Returns whether no point of a face is inside the bounding box of the other solid, whose plane it may not cut.

    Columns on a half-space also pass through solids that are wholly below its plane.
    """
    center = frame.projection * other.center + frame.shift
    reach = vec3d()
    for i in range(3):
        for k in range(3):
            reach[i] = reach[i] + wp.abs(frame.projection[i, k]) * other.half_extents[k]
    if center[2] + reach[2] <= real(0.0):
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
    return wp.dot(inward, geometries.normal[face]) > real(0.0)


@wp.func
def column_polygon(
    geometries: Geometries, frame: FaceFrame, other: Side, face: int, shallowest: real, deepest: real
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
        factors = vec3d(real(0.0), real(0.0), real(1.0))
        offset = -shallowest
        if cut == 0:
            if lower[2] >= shallowest:
                continue
        elif cut == 1:
            if upper[2] <= deepest:
                continue
            factors = vec3d(real(0.0), real(0.0), real(-1.0))
            offset = deepest
        else:
            start = cut - 2
            end = start + 1
            if end == frame.count:
                end = 0
            along_u = frame.corners[end, 0] - frame.corners[start, 0]
            along_v = frame.corners[end, 1] - frame.corners[start, 1]
            factors = vec3d(-along_v, along_u, real(0.0))
            offset = along_v * frame.corners[start, 0] - along_u * frame.corners[start, 1]
        target = MAX_CORNERS - source
        kept = wp.int32(0)
        previous = vec3d(rows[source + count - 1, 0], rows[source + count - 1, 1], rows[source + count - 1, 2])
        previous_value = wp.dot(factors, previous) + offset
        for i in range(count):
            current = vec3d(rows[source + i, 0], rows[source + i, 1], rows[source + i, 2])
            value = wp.dot(factors, current) + offset
            if (value >= real(0.0)) != (previous_value >= real(0.0)) and kept < MAX_CORNERS:
                crossing = previous + (previous_value / (previous_value - value)) * (current - previous)
                for k in range(3):
                    rows[target + kept, k] = crossing[k]
                kept += 1
            if value >= real(0.0) and kept < MAX_CORNERS:
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
    result.weight = real(1.0)
    for i in range(count):
        for k in range(3):
            result.corners[i, k] = rows[source + i, k]
    if frame.count > 0 and not is_exit(geometries, frame, face):
        result.weight = entry_weight(other, centroid(result)[2])
    return result


@wp.func
def convex_polygon(
    geometries: Geometries, frame: FaceFrame, other: Side, exit_plane: int, shallowest: real, deepest: real
):
    """Returns the base of the columns on a face that are inside a convex solid.

    Args:
        geometries: The geometries.
        frame: The face on which the columns stand.
        other: The convex solid.
        exit_plane: The plane at which the columns leave the solid. −1: any; then the depths at the corners are 0.
        shallowest: Smallest depth, with an exit plane [m].
        deepest: Largest depth, with an exit plane [m].
    """
    result = Polygon()
    planes = other.end_plane - other.first_plane
    # Depth of the columns: exit_height / exit_cosine, where the height is linear in u and v.
    exit_normal = vec3d()
    exit_height = real(0.0)
    cuts = planes
    if exit_plane >= 0:
        exit_face = geometries.plane_face[exit_plane]
        exit_normal = frame.projection * geometries.normal[exit_face]
        if exit_normal[2] < PARALLEL:
            return result
        exit_height = plane_offset(geometries, other, exit_face) + wp.dot(exit_normal, frame.shift)
        cuts = 2 + 2 * planes
    # Two buffers of corners: each cut reads one and writes the other.
    rows = corner_buffers()
    count = frame.count
    for i in range(count):
        rows[i, 0] = frame.corners[i, 0]
        rows[i, 1] = frame.corners[i, 1]
    source = wp.int32(0)
    for number in range(cuts):
        # Points with factor_u u + factor_v v + offset ≥ 0 remain.
        cut = number
        if exit_plane >= 0:
            cut = number - 2
        factor_u = real(0.0)
        factor_v = real(0.0)
        offset = real(0.0)
        if cut == -2:
            # Depth at most ``deepest``.
            if deepest == INFINITE:
                continue
            factor_u = exit_normal[0]
            factor_v = exit_normal[1]
            offset = deepest * exit_normal[2] - exit_height
        elif cut == -1:
            # Depth at least ``shallowest``.
            factor_u = -exit_normal[0]
            factor_v = -exit_normal[1]
            offset = exit_height - shallowest * exit_normal[2]
        else:
            plane = cut
            if cut >= planes:
                plane = cut - planes
            plane += other.first_plane
            face = geometries.plane_face[plane]
            normal = frame.projection * geometries.normal[face]
            height = plane_offset(geometries, other, face) + wp.dot(normal, frame.shift)
            if cut < planes:
                # Inside the plane; columns start inside planes that they would enter, at least within the ramp.
                factor_u = -normal[0]
                factor_v = -normal[1]
                offset = height
                if normal[2] < real(0.0):
                    offset += ramp_height(other)
            else:
                # The column leaves at the exit plane, not at this one.
                if plane == exit_plane or normal[2] < PARALLEL:
                    continue
                factor_u = normal[2] * exit_normal[0] - exit_normal[2] * normal[0]
                factor_v = normal[2] * exit_normal[1] - exit_normal[2] * normal[1]
                offset = exit_normal[2] * height - normal[2] * exit_height
        least = INFINITE
        for i in range(count):
            value = factor_u * rows[source + i, 0] + factor_v * rows[source + i, 1] + offset
            least = wp.min(least, value)
        if least >= real(0.0):
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
            if (value >= real(0.0)) != (previous_value >= real(0.0)) and kept < MAX_CORNERS:
                fraction = previous_value / (previous_value - value)
                rows[target + kept, 0] = previous_u + fraction * (current_u - previous_u)
                rows[target + kept, 1] = previous_v + fraction * (current_v - previous_v)
                kept += 1
            if value >= real(0.0) and kept < MAX_CORNERS:
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
        if exit_plane >= 0:
            result.corners[i, 2] = (exit_height - exit_normal[0] * u - exit_normal[1] * v) / exit_normal[2]
    result.weight = real(1.0)
    middle = centroid(result)
    for plane in range(other.first_plane, other.end_plane):
        face = geometries.plane_face[plane]
        normal = frame.projection * geometries.normal[face]
        if normal[2] < real(0.0):
            height = plane_offset(geometries, other, face) + wp.dot(normal, frame.shift)
            height -= normal[0] * middle[0] + normal[1] * middle[1]
            result.weight = result.weight * entry_weight(other, height)
    return result


@wp.func
def is_on_face(geometries: Geometries, side: Side, face: int, position: vec3d):
    """Returns whether a point of the plane of a face is on the face."""
    normal = geometries.normal[face]
    vertices = geometries.face[face]
    count = corner_count(vertices)
    previous = face_vertex(geometries, vertices, count - 1, side.scale)
    for i in range(count):
        current = face_vertex(geometries, vertices, i, side.scale)
        if wp.dot(wp.cross(current - previous, position - previous), normal) < real(0.0):
            return False
        previous = current
    return True


@wp.func
def first_crossing(geometries: Geometries, side: Side, origin: vec3d, direction: vec3d, only_exits: bool):
    """Returns where a ray in the frame of a solid first crosses its surface.

    Args:
        geometries: The geometries.
        side: The solid; not a half-space.
        origin: Start of the ray [m].
        direction: Unit vector.
        only_exits: Whether to ignore places where the ray enters the solid.
    """
    result = Crossing()
    result.distance = INFINITE
    convex = (side.flags & CONVEX) != 0
    for face in range(side.first_face, side.end_face):
        normal = geometries.normal[face]
        cosine = wp.dot(normal, direction)
        if wp.abs(cosine) < PARALLEL or ((only_exits or convex) and cosine < real(0.0)):
            continue
        distance = (plane_offset(geometries, side, face) - wp.dot(normal, origin)) / cosine
        if distance < OFFSET * wp.length(side.half_extents) or distance >= result.distance:
            continue
        if not convex:
            if not is_on_face(geometries, side, face, origin + distance * direction):
                continue
        result.distance = distance
        result.leaves = wp.where(cosine > real(0.0), 1, 0)
    return result


@wp.func
def distance_to_segment(position: vec3d, start: vec3d, end: vec3d):
    """Returns the distance of a point from a segment [m]."""
    along = end - start
    fraction = wp.clamp(wp.dot(position - start, along) / wp.dot(along, along), real(0.0), real(1.0))
    return wp.length(position - start - fraction * along)


@wp.func
def distance_to_face(geometries: Geometries, side: Side, face: int, position: vec3d):
    """Returns the distance of a point from a face [m]."""
    normal = geometries.normal[face]
    height = wp.dot(normal, position) - plane_offset(geometries, side, face)
    if is_on_face(geometries, side, face, position - height * normal):
        return wp.abs(height)
    vertices = geometries.face[face]
    count = corner_count(vertices)
    previous = face_vertex(geometries, vertices, count - 1, side.scale)
    least = INFINITE
    for i in range(count):
        current = face_vertex(geometries, vertices, i, side.scale)
        least = wp.min(least, distance_to_segment(position, previous, current))
        previous = current
    return least


@wp.func
def depth_below_surface(geometries: Geometries, side: Side, position: vec3d, direction: vec3d):
    """Returns the distance of a point inside a solid from its surface; 0 or less if the point is outside [m].

    Args:
        geometries: The geometries.
        side: The solid.
        position: The point, in the frame of the solid [m].
        direction: Direction of a ray that crosses the surface.
    """
    if side.flags & HALF_SPACE:
        return -position[2]
    convex = (side.flags & CONVEX) != 0
    if not convex:
        crossing = first_crossing(geometries, side, position, direction, False)
        if crossing.leaves == 0:
            return real(0.0)
    depth = INFINITE
    for face in range(side.first_face, side.end_face):
        if convex:
            depth = wp.min(depth, plane_offset(geometries, side, face) - wp.dot(geometries.normal[face], position))
        else:
            depth = wp.min(depth, distance_to_face(geometries, side, face, position))
    return depth


@wp.func
def depth_bound(geometries: Geometries, frame: FaceFrame, other: Side, pose: RelativePose, polygon: Polygon):
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
    geometries: Geometries, frame: FaceFrame, other: Side, pose: RelativePose, polygon: Polygon, deepest: real
):
    """Returns the largest depth below the surface of the other solid on a polygon, at least ``deepest`` [m].

    It is evaluated at corners, midpoints of edges and the center. A column is at least as long as its base is deep.
    """
    count = polygon.count
    is_convex = (other.flags & CONVEX) != 0 and frame.count > 0
    if is_convex:
        if depth_bound(geometries, frame, other, pose, polygon) <= deepest:
            return deepest
    center = vec3d()
    direction = -(wp.transpose(pose.rotation) * frame.normal)
    for i in range(2 * count + 1):
        point = corner(polygon, i // 2 % count)
        if i == 2 * count:
            point = center / real(count)
        elif i % 2 == 1:
            point = real(0.5) * (point + corner(polygon, (i // 2 + 1) % count))
        else:
            center += point
        if is_convex or point[2] > deepest:
            position = position_on_face(frame, point[0], point[1]) - pose.origin
            depth = depth_below_surface(geometries, other, wp.transpose(pose.rotation) * position, direction)
            if not is_convex:
                depth = wp.min(depth, point[2])
            deepest = wp.max(deepest, depth)
    return deepest


@wp.func
def overlap_of(geometries: Geometries, first: Side, second: Side, first_in_second: RelativePose):
    """Returns the ``Overlap`` of two solids; the first must not be a half-space or open."""
    result = Overlap()
    result.share = real(1.0)
    second_is_reference = (second.flags & (HALF_SPACE | OPEN)) != 0
    # Deviation from flatness of the part of each surface that is inside the other solid [m²].
    deviation = wp.vec2d()
    for family in range(2):
        if family == 1 and second_is_reference:
            break
        own = second
        other = first
        pose = first_in_second
        if family == 1:
            own = first
            other = second
            pose = inverse_pose(first_in_second)
        total = real(0.0)
        total_vector = vec3d()
        for face in range(own.first_face, own.end_face):
            frame = face_frame(geometries, own, other, pose, face)
            if is_apart(frame, other):
                continue
            area = real(0.0)
            if frame.count > 0 and (other.flags & CONVEX) != 0:
                polygon = convex_polygon(geometries, frame, other, -1, real(0.0), INFINITE)
                if polygon.count > 0:
                    area = polygon.weight * polygon_area(polygon)
                    result.depth = deepest_of(geometries, frame, other, pose, polygon, result.depth)
            else:
                for other_face in range(other.first_face, other.end_face):
                    leaves = is_exit(geometries, frame, other_face)
                    shallowest = real(0.0)
                    if not leaves:
                        shallowest = -ramp_height(other)
                    polygon = column_polygon(geometries, frame, other, other_face, shallowest, INFINITE)
                    if polygon.count == 0:
                        continue
                    if leaves:
                        area += polygon_area(polygon)
                        result.depth = deepest_of(geometries, frame, other, pose, polygon, result.depth)
                    else:
                        area -= polygon.weight * polygon_area(polygon)
            total += area
            total_vector += area * frame.normal
        deviation[family] = total - wp.length(total_vector)
    if not second_is_reference:
        # Faces of the second solid carry more if the first solid is less flat.
        result.share = real(0.5)
        together = deviation[0] + deviation[1]
        if together > real(0.0):
            result.share = deviation[1] / together
    return result


@wp.func
def column_weight(depth: real, overlap: Overlap, always: bool):
    """Returns the weight w of a column of depth ``depth``; ``always``: 1 for each column."""
    if always:
        return real(1.0)
    span = (NO_WEIGHT - FULL_WEIGHT) * overlap.depth
    if depth <= FULL_WEIGHT * overlap.depth:
        return real(1.0)
    if depth >= NO_WEIGHT * overlap.depth:
        return real(0.0)
    x = (depth - FULL_WEIGHT * overlap.depth) / span
    return real(1.0) - x * x * (real(3.0) - real(2.0) * x)
