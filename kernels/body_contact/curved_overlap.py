"""Depth of the overlap of a curved solid with a polyhedron or half-space, and which of them is the reference.

Depth and reference have the meaning of ``overlap.py``. All sums are over the parts of the faces of the polyhedron that are inside
the curved solid. The area of the curved surface inside the polyhedron follows from them: seen from the axis or center of the
curved solid, a face hides the part of the curved surface behind it.
"""

import warp as wp
from warpcontact.kernels.body_contact.columns import FaceFrame, face_frame, is_apart, position_on_face
from warpcontact.kernels.body_contact.curved_columns import ON_FACE, region_of, store_face
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
    CAPSULE,
    CONE,
    CYLINDER,
    ELLIPSOID,
    Section,
    exit_depth_of,
    part_count,
    position_in_section,
    section_of,
    width_squared,
)
from warpcontact.kernels.body_contact.curved_surfaces import (
    TWO_PI,
    axis_measure,
    depth_below_sheets,
    inner_point,
    least_reach,
    reach_along,
    reach_weight,
    seen_from_axis,
    seen_from_center,
    support_count,
    support_point,
)
from warpcontact.kernels.body_contact.face_trees import (
    distance_to_surface,
    is_inside_solid,
    next_leaf_in_box,
    start_traversal,
)
from warpcontact.kernels.body_contact.overlap import Overlap
from warpcontact.kernels.body_contact.polygons import Polygon, corner
from warpcontact.kernels.body_contact.solids import (
    FEW_PLANES,
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    RelativePose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    BoundingBox,
    SolidGeometry,
    bounding_box,
    is_face_outside,
    is_on_face,
    plane_offset,
)

double = wp.float64
vec3d = wp.vec3d

# Deviation from flatness, relative to the area, below which a surface is flat.
FLAT = wp.constant(double(1.0e-12))
# Largest depth of the end of a column, relative to that of its base: where a section ends, bases have no depth.
LARGEST_RATIO = wp.constant(double(3.0))
# Steps towards the deepest point of a face.
PROJECTIONS = 5
# Cosine of an axis and a normal below which the axis is parallel to the face.
PARALLEL_AXIS = wp.constant(double(1.0e-12))


@wp.func
def box_of_curved(curved: SolidGeometry, other: SolidGeometry, pose: RelativePose, margin: double):
    """Returns a box around a curved solid in the frame of the other solid; all of space for a half-space."""
    if other.flags & HALF_SPACE:
        box = BoundingBox()
        box.upper = vec3d(INFINITE, INFINITE, INFINITE)
        box.lower = -box.upper
        return box
    return bounding_box(curved, pose, margin)


@wp.func
def depth_inside(
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    other: SolidGeometry,
    position: vec3d,
    direction: vec3d,
    limit: double,
):
    """Returns the depth of a point below the surface of a closed polyhedron, at most ``limit``; 0 outside [m].

    Args:
        pending: Pending nodes of the thread.
        bottom: Number of pending nodes of other traversals.
        geometries: The geometries.
        other: The polyhedron.
        position: The point, in its frame [m].
        direction: Direction of a ray that crosses the surface.
        limit: Largest depth that matters [m].
    """
    depth = limit
    if other.flags & FEW_PLANES:
        for plane in range(other.first_plane, other.end_plane):
            face = geometries.plane_face[plane]
            depth = wp.min(
                depth, plane_offset(geometries, other, face) - wp.dot(geometries.normal[face], position)
            )
        return wp.max(depth, double(0.0))
    depth = distance_to_surface(pending, bottom, geometries, other, position, limit, double(0.0))
    if is_inside_solid(pending, bottom, geometries, other, position, direction):
        return depth
    return double(0.0)


@wp.func
def closest_on_face(frame: FaceFrame, position: vec3d):
    """Returns the point of a face that is closest to the projection of a position onto its plane [m]."""
    u = wp.dot(frame.u_axis, position - frame.origin)
    v = wp.dot(frame.v_axis, position - frame.origin)
    point = wp.vec2d(u, v)
    is_inside = wp.bool(True)
    least = double(wp.inf)
    result = point
    for i in range(frame.count):
        k = i + 1
        if k == frame.count:
            k = 0
        start = wp.vec2d(frame.corners[i, 0], frame.corners[i, 1])
        along = wp.vec2d(frame.corners[k, 0], frame.corners[k, 1]) - start
        beyond = point - start
        if along[0] * beyond[1] - along[1] * beyond[0] < double(0.0):
            is_inside = False
        fraction = wp.clamp(wp.dot(beyond, along) / wp.dot(along, along), double(0.0), double(1.0))
        nearest = start + fraction * along
        distance = wp.length(point - nearest)
        if distance < least:
            least = distance
            result = nearest
    if is_inside:
        result = point
    return position_on_face(frame, result[0], result[1])


@wp.func
def closest_to_origin(corners: wp.array2d(dtype=double), polygon: Polygon):
    """Returns the point (u, v) of a polygon that is closest to u = v = 0."""
    result = wp.vec2d()
    least = double(wp.inf)
    left = wp.int32(0)
    for i in range(polygon.count):
        start_3 = corner(corners, polygon, i)
        end_3 = corner(corners, polygon, (i + 1) % polygon.count)
        start = wp.vec2d(start_3[0], start_3[1])
        along = wp.vec2d(end_3[0], end_3[1]) - start
        if along[0] * start[1] - along[1] * start[0] < double(0.0):
            left += 1
        nearest = start + wp.clamp(-wp.dot(start, along) / wp.dot(along, along), double(0.0), double(1.0)) * along
        if wp.length(nearest) < least:
            least = wp.length(nearest)
            result = nearest
    # Inside if it is on the same side of all edges, in either orientation.
    if left == 0 or left == polygon.count:
        return wp.vec2d()
    return result


@wp.func
def is_inside_curved(flags: int, scale: vec3d, position: vec3d):
    """Returns whether a point is inside a curved solid; position in its frame [m]."""
    if flags & ELLIPSOID:
        return wp.length_sq(wp.cw_div(position, scale)) <= double(1.0)
    squared = position[0] * position[0] + position[1] * position[1]
    radius = scale[0]
    if flags & CYLINDER:
        return squared <= radius * radius and wp.abs(position[2]) <= scale[2]
    if flags & CONE:
        local = radius * (double(1.0) - position[2] / scale[2])
        return position[2] >= double(0.0) and local >= double(0.0) and squared <= local * local
    length = scale[2] - radius
    beyond = position[2] - wp.clamp(position[2], -length, length)
    return squared + beyond * beyond <= radius * radius


@wp.func
def depth_of_support(
    pending: wp.array(dtype=wp.int32),
    geometries: Geometries,
    curved: SolidGeometry,
    other: SolidGeometry,
    pose: RelativePose,
    normal: vec3d,
    number: int,
):
    """Returns the depth of a support point of a curved solid along −normal below the surface of a closed polyhedron [m]."""
    direction = -(wp.transpose(pose.rotation) * normal)
    support = pose.rotation * support_point(curved.flags, curved.scale, direction, number) + pose.origin
    return depth_inside(pending, 0, geometries, other, support, normal, wp.length(other.half_extents))


@wp.func
def depth_on_face(
    corners: wp.array2d(dtype=double),
    polygon: Polygon,
    section: Section,
    frame: FaceFrame,
    curved: SolidGeometry,
    pose: RelativePose,
    center: vec3d,
):
    """Returns the largest depth found on a face below the surface of a curved solid, from the center of their section [m].

    Points move towards the part of the solid that is deeper than they are, and back to the face.
    """
    to_curved = wp.transpose(pose.rotation)
    deepest = double(0.0)
    if curved.flags & ELLIPSOID:
        # Its surfaces of equal depth are nearly circles around u = v = 0.
        nearest = closest_to_origin(corners, polygon)
        position = to_curved * (position_in_section(section, nearest[0], nearest[1]) - pose.origin)
        if is_inside_curved(curved.flags, curved.scale, position):
            deepest = depth_below_sheets(curved.flags, curved.scale, position)
        return deepest
    point = center
    # Not a constant, so that the loop is not unrolled.
    steps = wp.int32(PROJECTIONS)
    for _step in range(steps):
        position = to_curved * (point - pose.origin)
        depth = double(0.0)
        if is_inside_curved(curved.flags, curved.scale, position):
            depth = depth_below_sheets(curved.flags, curved.scale, position)
        deepest = wp.max(deepest, depth)
        inner = inner_point(curved.flags, curved.scale, position, double(2.0) * deepest)
        point = closest_on_face(frame, pose.rotation * inner + pose.origin)
    return deepest


@wp.func
def depth_at_face(
    corners: wp.array2d(dtype=double),
    polygon: Polygon,
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    curved: SolidGeometry,
    other: SolidGeometry,
    pose: RelativePose,
    frame: FaceFrame,
    section: Section,
    center: vec3d,
):
    """Returns the largest depth found at a face: of its points in the curved solid, and of the solid below the face [m].

    All points at which depths are evaluated move continuously with the pose, or their depth is 0 where they do not.
    """
    flags = curved.flags
    scale = curved.scale
    to_curved = wp.transpose(pose.rotation)
    deepest = depth_on_face(corners, polygon, section, frame, curved, pose, center)
    for i in range(frame.count):
        corner_c = to_curved * (position_on_face(frame, frame.corners[i, 0], frame.corners[i, 1]) - pose.origin)
        if is_inside_curved(flags, scale, corner_c):
            deepest = wp.max(deepest, depth_below_sheets(flags, scale, corner_c))
    is_closed = (other.flags & HAS_BOUNDARY) == 0
    for i in range(support_count(flags) + 1):
        # Support points of the solid, and the end of the column at the center.
        point = vec3d()
        largest = double(wp.inf)
        if i < support_count(flags):
            point = pose.rotation * support_point(flags, scale, -(to_curved * frame.normal), i) + pose.origin
            if not is_closed:
                # Not if it is beyond the boundary of the surface.
                foot_c = to_curved * (closest_on_face(frame, point) - pose.origin)
                largest = double(0.0)
                if is_inside_curved(flags, scale, foot_c):
                    largest = LARGEST_RATIO * depth_below_sheets(flags, scale, foot_c)
        else:
            u = wp.dot(section.u_dual, center - section.center)
            v = wp.dot(section.v_dual, center - section.center)
            point = center - exit_depth_of(section, flags, scale, u, v) * frame.normal
            largest = LARGEST_RATIO * depth_below_sheets(flags, scale, to_curved * (center - pose.origin))
        below = wp.min(wp.dot(frame.normal, frame.origin - point), largest)
        if below > deepest:
            if is_closed:
                below = depth_inside(pending, bottom, geometries, other, point, frame.normal, below)
            deepest = wp.max(deepest, below)
    return deepest


@wp.func
def depth_below_half_space(curved: SolidGeometry, pose: RelativePose):
    """Returns the depth of the lowest point of a curved solid below the plane z = 0 [m]."""
    down = -vec3d(pose.rotation[2, 0], pose.rotation[2, 1], pose.rotation[2, 2])
    return reach_along(curved.flags, curved.scale, down) - pose.origin[2]


@wp.struct
class FaceSection:
    """The section of a face with a curved solid."""

    area: double  # [m²]
    moment: vec3d  # of its area [m³]
    curved_area: double  # sum over all faces so far of the area of the curved surface behind them [m²]


@wp.struct
class OverlapSums:
    """Sums over the faces of a polyhedron that cross a curved solid."""

    depth: double  # D of all faces so far [m]
    area: double  # of faces inside the curved solid [m²]
    area_vector: vec3d  # likewise, times their normals [m²]
    curved_area: double  # of the curved surface behind faces [m²]
    on_ends: double  # of faces, times the component of their normals along the axis [m²]
    crossings: double  # of the axis: number at which it leaves the polyhedron, less those at which it enters
    axis_area: double  # sum of ``axis_measure`` over these crossings [m²]


@wp.func
def add_strip(
    sums: FaceSection,
    curved: SolidGeometry,
    pose: RelativePose,
    section: Section,
    region: Region,
    normal_c: vec3d,
    u: double,
    u_weight: double,
    limits: wp.array(dtype=double),
    limit_count: int,
):
    """Returns the ``FaceSection`` with the strip of a region at ``u`` added; ``normal_c``: of the face, in the curved solid."""
    lower = limits[0]
    upper = limits[limit_count - 1]
    if region.has_axis:
        sums.area += u_weight * (upper - lower)
        middle_of_strip = position_in_section(section, u, double(0.5) * (lower + upper))
        sums.moment += u_weight * (upper - lower) * middle_of_strip
        sums.curved_area -= u_weight * seen_from_axis(curved.flags, curved.scale, section, u, lower, upper)
        return sums
    to_curved = wp.transpose(pose.rotation)
    steep = steepness(section, region.profile, u, limits, limit_count)
    for j in range((limit_count - 1) * POINTS):
        v, v_weight = interval_point(limits, j // POINTS, j % POINTS, steep)
        weight = section.area * u_weight * v_weight
        position = position_in_section(section, u, v)
        position_c = to_curved * (position - pose.origin)
        sums.area += weight
        sums.moment += weight * position
        sums.curved_area -= weight * seen_from_center(curved.flags, curved.scale, position_c, normal_c)
    return sums


@wp.func
def add_region(
    sums: FaceSection,
    breaks: wp.array2d(dtype=double),
    limits: wp.array(dtype=double),
    corners: wp.array2d(dtype=double),
    polygon: Polygon,
    curved: SolidGeometry,
    pose: RelativePose,
    section: Section,
    region: Region,
    normal_c: vec3d,
):
    """Returns the ``FaceSection`` with one region of a face added."""
    break_count = find_breaks(breaks, section, region, corners, polygon)
    width = width_squared(section, region.profile, double(0.0), double(0.0))
    for panel in range(break_count - 1):
        if not has_points(breaks, panel, limits, section, region, corners, polygon):
            continue
        for i in range(panel_point_count(breaks, panel)):
            u, u_weight = panel_point(breaks, panel, i, width)
            limit_count = find_limits(limits, section, region, u, corners, polygon)
            if limit_count > 0:
                sums = add_strip(sums, curved, pose, section, region, normal_c, u, u_weight, limits, limit_count)
    return sums


@wp.func
def add_axis_crossing(
    sums: OverlapSums,
    geometries: Geometries,
    curved: SolidGeometry,
    other: SolidGeometry,
    pose: RelativePose,
    face: int,
    frame: FaceFrame,
):
    """Returns the sums with the crossing of the axis of a curved solid, not an ellipsoid, with a face."""
    axis = vec3d(pose.rotation[0, 2], pose.rotation[1, 2], pose.rotation[2, 2])
    along = wp.dot(frame.normal, axis)
    if wp.abs(along) <= PARALLEL_AXIS:
        return sums
    z = wp.dot(frame.normal, frame.origin - pose.origin) / along
    ends = axis_ends(curved.flags, curved.scale)
    if z < ends[0] or z > ends[1]:
        return sums
    if is_on_face(geometries, other, face, pose.origin + z * axis):
        leaves = wp.sign(along)
        sums.crossings += leaves
        sums.axis_area += leaves * axis_measure(curved.flags, curved.scale, z)
    return sums


@wp.func
def axis_ends(flags: int, scale: vec3d):
    """Returns z of both ends of the axis of a curved solid, without the half balls of a capsule [m]."""
    if flags & CONE:
        return wp.vec2d(double(0.0), scale[2])
    if flags & CAPSULE:
        return wp.vec2d(scale[0] - scale[2], scale[2] - scale[0])
    return wp.vec2d(-scale[2], scale[2])


@wp.func
def add_face(
    sums: OverlapSums,
    breaks: wp.array2d(dtype=double),
    limits: wp.array(dtype=double),
    corners: wp.array2d(dtype=double),
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    curved: SolidGeometry,
    other: SolidGeometry,
    pose: RelativePose,
    face: int,
):
    """Returns the sums with one face of the polyhedron ``other`` added; for the arguments, see ``curved_overlap_of``."""
    flags = curved.flags
    scale = curved.scale
    frame = face_frame(geometries, other, curved, pose, face)
    if is_apart(frame, curved):
        return sums
    to_curved = wp.transpose(pose.rotation)
    normal_c = to_curved * frame.normal
    section = section_of(flags, scale, pose, frame.origin, frame.u_axis, frame.normal)
    polygon = store_face(corners, frame, section)
    on_face = FaceSection()
    on_face.curved_area = sums.curved_area
    for part in range(part_count(flags)):
        region = region_of(flags, scale, ON_FACE, part, section, double(0.0))
        region.has_axis = (flags & ELLIPSOID) == 0 and part == 0
        on_face = add_region(on_face, breaks, limits, corners, polygon, curved, pose, section, region, normal_c)
    sums.curved_area = on_face.curved_area
    if on_face.area == double(0.0):
        return sums
    # No point of the face is deeper than the solid reaches below the face.
    offset = to_curved * (frame.origin - pose.origin)
    if wp.dot(normal_c, offset) + reach_along(flags, scale, -normal_c) > sums.depth:
        center = on_face.moment / on_face.area
        depth = depth_at_face(
            corners, polygon, pending, bottom, geometries, curved, other, pose, frame, section, center
        )
        sums.depth = wp.max(sums.depth, depth)
    sums.area += on_face.area
    sums.area_vector += on_face.area * frame.normal
    sums.on_ends += on_face.area * normal_c[2]
    if (flags & ELLIPSOID) == 0:
        sums = add_axis_crossing(sums, geometries, curved, other, pose, face, frame)
    return sums


@wp.func
def area_of_curved(flags: int, scale: vec3d, sums: OverlapSums):
    """Returns the area of the surface of a curved solid inside the polyhedron [m²]."""
    axis_area = sums.axis_area
    ends = axis_ends(flags, scale)
    # The axis is inside at its lower end if it leaves more often than it enters, and at its upper end likewise.
    if sums.crossings > double(0.0):
        axis_area -= sums.crossings * axis_measure(flags, scale, ends[0])
    elif sums.crossings < double(0.0):
        axis_area -= sums.crossings * axis_measure(flags, scale, ends[1])
    if flags & CAPSULE:
        # Likewise the center of a half ball.
        axis_area += wp.abs(sums.crossings) * TWO_PI * scale[0] * scale[0]
    area = wp.abs(axis_area + sums.curved_area)
    if flags & CYLINDER:
        area += wp.abs(sums.on_ends)
    elif flags & CONE:
        # Lines along the axis leave through the base as often as they enter it or the curved surface.
        sine = scale[0] / wp.sqrt(scale[0] * scale[0] + scale[2] * scale[2])
        area += wp.max(sums.on_ends + sine * area, double(0.0))
    return area


@wp.func
def curved_overlap_of(
    breaks: wp.array2d(dtype=double),
    limits: wp.array(dtype=double),
    corners: wp.array2d(dtype=double),
    pending: wp.array(dtype=wp.int32),
    geometries: Geometries,
    curved: SolidGeometry,
    other: SolidGeometry,
    pose: RelativePose,
):
    """Returns the ``Overlap`` of a curved solid with a polyhedron or half-space; ``share`` is that of the polyhedron.

    Args:
        breaks: Room for the breaks of a section.
        limits: Room for the limits of a section.
        corners: Corners of the polygons of the thread.
        pending: Pending nodes of the thread.
        geometries: The geometries.
        curved: The curved solid.
        other: The other solid.
        pose: Pose of the curved solid in the other one.
    """
    result = Overlap()
    result.share = double(1.0)
    if other.flags & HALF_SPACE:
        result.depth = depth_below_half_space(curved, pose)
        return result
    sums = OverlapSums()
    box = box_of_curved(curved, other, pose, double(0.0))
    top = start_traversal(pending, 0, other)
    while top > 0:
        leaf = next_leaf_in_box(pending, 0, top, geometries, other, no_motion(), box)
        top = leaf.top
        for face in range(leaf.first_face, leaf.end_face):
            if not is_face_outside(geometries, other, face, box):
                sums = add_face(sums, breaks, limits, corners, pending, top, geometries, curved, other, pose, face)
    result.depth = sums.depth
    if (other.flags & HAS_BOUNDARY) != 0:
        return result
    flat = wp.length(sums.area_vector)
    if flat > double(0.0):
        # Also of the support points along the mean normal.
        for i in range(support_count(curved.flags)):
            below = depth_of_support(pending, geometries, curved, other, pose, sums.area_vector / flat, i)
            result.depth = wp.max(result.depth, below)
    deviation = wp.max(area_of_curved(curved.flags, curved.scale, sums) - flat, double(0.0))
    other_deviation = wp.max(sums.area - flat, double(0.0))
    if other_deviation > FLAT * sums.area:
        # Columns on the curved surface are not defined at depths near its radius of curvature.
        own_share = other_deviation / (deviation + other_deviation)
        result.share = double(1.0) - own_share * reach_weight(
            double(2.0) * result.depth, least_reach(curved.flags, curved.scale)
        )
    return result
