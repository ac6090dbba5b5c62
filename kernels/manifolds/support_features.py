"""Features of two convex solids that are towards each other: a point, a line or a flat end, and where they touch.

The features are seen along the common normal. Two lines touch at the ends of their common length, a line and a flat end where
the line is above the end, two flat ends at points of their circular edges inside each other and where these cross. All gaps are
along the normal, and the nearest points of both solids are always a point of contact.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CONE, ELLIPSOID
from warpcontact.kernels.body_contact.solids import RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, across, add_candidate
from warpcontact.kernels.manifolds.features import Feature, edge_feature, moved, plane_feature, vertex_feature

double = wp.float64
vec3d = wp.vec3d
zero, one = wp.constant(double(0.0)), wp.constant(double(1.0))

# Kinds of features.
POINT, LINE, FLAT_END = (wp.constant(i) for i in range(3))
#: Numbers of the points of a curved solid, which identify them: fixed on a circular edge (from 0; 4 of each flat end), at the ends of
#: a line, where an edge cuts it, where edges cross a circular edge, and the nearest point of two solids.
LINE_START, LINE_END, CUT_LINE, CIRCLE_ENTRY, CIRCLE_EXIT, COVERED, NEAREST_POINT = 8, 9, 10, 11, 12, 13, 14
#: Number of the point of a flat end that extends farthest over the other one.
FARTHEST_POINT = 15
# Cosine of the angle between axis and direction from which on a flat end is turned towards a plane.
FACING_END = wp.constant(double(0.5))
# Sine of the angle between a line and the plane across the normal up to which the line is a feature.
LYING = wp.constant(double(0.5))
# Distance beyond the end of a feature, relative to its size, up to which a point is on it.
ON_END = wp.constant(double(1.0e-9))
# Distance of the axes of two flat ends, relative to the sum of their radii, up to which they count as concentric.
CONCENTRIC = wp.constant(double(1.0e-3))
#: Largest number of iterations for the crossing of two circular edges.
CROSSING_ITERATIONS = 8
TINY = wp.constant(double(1.0e-300))


@wp.struct
class SupportFeature:
    """The feature of a solid that is towards another one, in the frame of the second solid of the pair."""

    kind: wp.int32  # POINT, LINE or FLAT_END
    # Ends of a line [m], and its radii of curvature across it there [m].
    start: vec3d
    end: vec3d
    start_radius: double
    end_radius: double
    # Numbers of both ends of a line as features, and of the line itself.
    start_number: wp.int32
    end_number: wp.int32
    number: wp.int32
    # Center [m], outward normal and radius of a flat end [m], two axes in it, and the number of its first fixed point.
    center: vec3d
    axis: vec3d
    radius: double
    u_axis: vec3d
    v_axis: vec3d
    first_point: wp.int32


@wp.func
def flat_end(flags: int, direction: vec3d):
    """Returns the side (−1 or 1) of the flat end of a curved solid that is turned towards a direction; 0: none is."""
    if (flags & (ELLIPSOID | CAPSULE)) != 0:
        return 0
    if (flags & CONE) != 0:
        return wp.where(direction[2] < -FACING_END, -1, 0)
    if wp.abs(direction[2]) > FACING_END:
        return wp.where(direction[2] > zero, 1, -1)
    return 0


@wp.func
def end_height(flags: int, scale: vec3d, side: int):
    """Returns the coordinate of a flat end along the axis [m]."""
    if (flags & CONE) != 0:
        return zero
    return double(side) * scale[2]


@wp.func
def lowest_line(flags: int, scale: vec3d, direction: vec3d):
    """Returns the ends of the line of a capsule, cylinder or cone that is farthest along a direction [m].

    ``direction``: unit vector in the frame of the solid. A solid that stands has the line in the plane of x and z.
    """
    r = scale[0]
    if (flags & CAPSULE) != 0:
        half = vec3d(zero, zero, scale[2] - r)
        return r * direction - half, r * direction + half
    to_side = vec3d(direction[0], direction[1], zero)
    size = wp.length(to_side)
    start = vec3d(r, zero, zero)
    if size > zero:
        start = (r / size) * to_side
    top = vec3d(zero, zero, scale[2])
    if (flags & CONE) != 0:
        return start, top
    return start - top, start + top


@wp.func
def support_feature(side: SolidGeometry, pose: RelativePose, direction: vec3d):
    """Returns the feature of a curved solid that is farthest along a direction.

    Args:
        side: The solid.
        pose: Its pose in the frame of the second solid.
        direction: Unit vector in that frame.
    """
    feature = SupportFeature()
    flags = side.flags
    scale = side.scale
    own = wp.transpose(pose.rotation) * direction
    end = flat_end(flags, own)
    if end != 0:
        feature.kind = FLAT_END
        feature.axis = double(end) * vec3d(pose.rotation[0, 2], pose.rotation[1, 2], pose.rotation[2, 2])
        feature.center = moved(pose, vec3d(zero, zero, end_height(flags, scale, end)))
        feature.radius = scale[0]
        feature.u_axis = vec3d(pose.rotation[0, 0], pose.rotation[1, 0], pose.rotation[2, 0])
        feature.v_axis = vec3d(pose.rotation[0, 1], pose.rotation[1, 1], pose.rotation[2, 1])
        feature.first_point = wp.where(end > 0, 0, 4)
        return feature
    if (flags & ELLIPSOID) != 0:
        return feature
    start, last = lowest_line(flags, scale, own)
    length = wp.length(last - start)
    if wp.abs(wp.dot(own, last - start)) > LYING * length:
        return feature
    feature.kind = LINE
    feature.start = moved(pose, start)
    feature.end = moved(pose, last)
    feature.start_radius = scale[0]
    feature.end_radius = scale[0]
    if (flags & CONE) != 0:
        feature.start_radius = scale[0] * (length / scale[2])
        feature.end_radius = zero
    feature.start_number = vertex_feature(LINE_START)
    feature.end_number = vertex_feature(LINE_END)
    feature.number = edge_feature(LINE_START)
    return feature


@wp.func
def height_of_end(feature: SupportFeature, normal: vec3d, position: vec3d):
    """Returns the height of the plane of a flat end above a position along ``normal`` [m]."""
    return wp.dot(feature.axis, feature.center - position) / wp.dot(feature.axis, normal)


@wp.func
def add_pair_of_points(
    on_first: vec3d,
    on_second: vec3d,
    gap: double,
    number_1: int,
    number_2: int,
    normal: vec3d,
    kappa: double,
    margin: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds a point of each solid as a candidate if their gap is at most ``margin``; ``normal``: out of the second one."""
    if gap > margin:
        return
    feature = Feature()
    feature.first = number_1
    feature.second = number_2
    # Both are on one line along the normal, except for lines that cross.
    middle = on_second + kappa * (on_first - on_second)
    middle += (wp.dot(normal, on_second) + kappa * gap - wp.dot(normal, middle)) * normal
    add_candidate(patches, candidates, patch, middle, gap, feature)


@wp.func
def line_point(line: SupportFeature, fraction: double):
    """Returns a point of a line and the radius of curvature there [m]."""
    position = line.start + fraction * (line.end - line.start)
    return position, line.start_radius + fraction * (line.end_radius - line.start_radius)


@wp.func
def add_end_on_line(
    own: SupportFeature,
    at_end: bool,
    other: SupportFeature,
    own_is_first: bool,
    normal: vec3d,
    kappa: double,
    margin: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds the contact of an end of a line with the other line as a candidate if it is next to the line.

    The gap is that of two circles with the radii of curvature of both lines.
    """
    position, radius = line_point(own, wp.where(at_end, one, zero))
    number = wp.where(at_end, own.end_number, own.start_number)
    along = across(other.end - other.start, normal)
    square = wp.length_sq(along)
    fraction = wp.dot(position - other.start, along) / square
    if fraction < -ON_END or fraction > one + ON_END:
        return
    fraction = wp.clamp(fraction, zero, one)
    other_position, other_radius = line_point(other, fraction)
    # A common end is a corner of both lines.
    other_number = other.number
    if fraction <= ON_END:
        other_number = other.start_number
    elif fraction >= one - ON_END:
        other_number = other.end_number
    side = wp.where(own_is_first, one, -one)
    height = side * wp.dot(normal, position - other_position) + radius + other_radius
    beside = across(position - other_position, normal)
    beside -= (wp.dot(beside, along) / square) * along
    gap = wp.sqrt(height * height + wp.length_sq(beside)) - radius - other_radius
    if own_is_first:
        add_pair_of_points(
            position, other_position, gap, number, other_number, normal, kappa, margin, patches, candidates, patch
        )
    else:
        add_pair_of_points(
            other_position, position, gap, other_number, number, normal, kappa, margin, patches, candidates, patch
        )


@wp.func
def add_line_on_end(
    line: SupportFeature,
    end: SupportFeature,
    line_is_first: bool,
    normal: vec3d,
    kappa: double,
    margin: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds the ends of the part of a line that is above a flat end as candidates."""
    start_height = height_of_end(end, normal, line.start)
    end_height_ = height_of_end(end, normal, line.end)
    from_center = line.start + start_height * normal - end.center
    along = line.end + end_height_ * normal - end.center - from_center
    square = wp.length_sq(along)
    if square <= TINY:
        return
    middle = -wp.dot(from_center, along) / square
    beyond = middle * middle - (wp.length_sq(from_center) - end.radius * end.radius) / square
    if beyond <= zero:
        return
    half = wp.sqrt(beyond)
    if middle - half > one + ON_END or middle + half < -ON_END:
        return
    for k in range(2):
        root = middle + wp.where(k == 0, -half, half)
        number = wp.where(k == 0, line.start_number, line.end_number)
        end_number = plane_feature(end.first_point)
        if root > -ON_END and root < one + ON_END:
            number = line.number
            end_number = edge_feature(wp.where(k == 0, CIRCLE_ENTRY, CIRCLE_EXIT))
        fraction = wp.clamp(root, zero, one)
        height = start_height + fraction * (end_height_ - start_height)
        position = line.start + fraction * (line.end - line.start)
        on_end = position + height * normal
        if line_is_first:
            add_pair_of_points(
                position, on_end, -height, number, end_number, normal, kappa, margin, patches, candidates, patch
            )
        else:
            add_pair_of_points(
                on_end, position, height, end_number, number, normal, kappa, margin, patches, candidates, patch
            )


@wp.func
def add_point_of_end(
    own: SupportFeature,
    offset: vec3d,
    number: int,
    other: SupportFeature,
    own_is_first: bool,
    normal: vec3d,
    kappa: double,
    margin: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds a point of the circular edge of a flat end, at an offset from its center, as a candidate if it is above the other end."""
    position = own.center + offset
    height = height_of_end(other, normal, position)
    on_other = position + height * normal
    if wp.length(on_other - other.center) > (one + ON_END) * other.radius:
        return
    own_number = vertex_feature(number)
    other_number = plane_feature(other.first_point)
    if own_is_first:
        add_pair_of_points(
            position,
            on_other,
            -height,
            own_number,
            other_number,
            normal,
            kappa,
            margin,
            patches,
            candidates,
            patch,
        )
    else:
        add_pair_of_points(
            on_other, position, height, other_number, own_number, normal, kappa, margin, patches, candidates, patch
        )


@wp.func
def add_crossing(
    first: SupportFeature,
    second: SupportFeature,
    near: vec3d,
    k: int,
    normal: vec3d,
    kappa: double,
    margin: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds crossing ``k`` of the circular edges of two flat ends, seen along the normal, as a candidate.

    ``near``: where it is if both ends are normal to ``normal`` [m].
    """
    offset = near - first.center
    angle = wp.atan2(wp.dot(offset, first.v_axis), wp.dot(offset, first.u_axis))
    slope = second.axis / wp.dot(second.axis, normal)
    # From the center of the second end to the projection of a point of the first edge on its plane, by Newton's method.
    middle = first.center + height_of_end(second, normal, first.center) * normal - second.center
    u_axis = first.radius * (first.u_axis - wp.dot(slope, first.u_axis) * normal)
    v_axis = first.radius * (first.v_axis - wp.dot(slope, first.v_axis) * normal)
    square = second.radius * second.radius
    error = double(wp.inf)
    iterations = wp.int32(CROSSING_ITERATIONS)
    for _ in range(iterations):
        cosine = wp.cos(angle)
        sine = wp.sin(angle)
        arm = middle + cosine * u_axis + sine * v_axis
        error = wp.length_sq(arm) - square
        rate = double(2.0) * wp.dot(arm, cosine * v_axis - sine * u_axis)
        if wp.abs(error) <= ON_END * square or rate == zero:
            break
        angle -= wp.clamp(error / rate, double(-0.5), double(0.5))
    if wp.abs(error) > ON_END * square:
        return
    on_first = first.center + first.radius * (wp.cos(angle) * first.u_axis + wp.sin(angle) * first.v_axis)
    height = height_of_end(second, normal, on_first)
    number = edge_feature(wp.where(k == 0, CIRCLE_ENTRY, CIRCLE_EXIT))
    add_pair_of_points(
        on_first,
        on_first + height * normal,
        -height,
        number,
        number,
        normal,
        kappa,
        margin,
        patches,
        candidates,
        patch,
    )


@wp.func
def add_two_ends(
    first: SupportFeature,
    second: SupportFeature,
    normal: vec3d,
    kappa: double,
    margin: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds points of two flat ends as candidates.

    Four points of each circular edge that are fixed in its solid, the one that extends farthest over the other end, and the crossings
    of both edges.
    """
    between = across(first.center - second.center, normal)
    distance = wp.length(between)
    total = first.radius + second.radius
    if distance >= total:
        return
    for k in range(2):
        own = first
        other = second
        towards = -between
        if k == 1:
            own = second
            other = first
            towards = between
        for i in range(4):
            reach = wp.where(i % 2 == 0, own.radius, -own.radius)
            offset = wp.where(i < 2, reach * own.u_axis, reach * own.v_axis)
            add_point_of_end(
                own, offset, own.first_point + i, other, k == 0, normal, kappa, margin, patches, candidates, patch
            )
        if distance > CONCENTRIC * total:
            offset = own.radius * wp.normalize(across(towards, own.axis))
            add_point_of_end(
                own, offset, FARTHEST_POINT, other, k == 0, normal, kappa, margin, patches, candidates, patch
            )
    if distance <= wp.abs(first.radius - second.radius) or distance <= zero:
        return
    towards = between / distance
    along = distance * distance + second.radius * second.radius - first.radius * first.radius
    along = along / (double(2.0) * distance)
    beside = wp.sqrt(wp.max(second.radius * second.radius - along * along, zero))
    for k in range(2):
        crossing = second.center + along * towards
        crossing += wp.where(k == 0, beside, -beside) * wp.cross(normal, towards)
        add_crossing(first, second, crossing, k, normal, kappa, margin, patches, candidates, patch)


@wp.func
def add_common_points(
    first: SupportFeature,
    second: SupportFeature,
    normal: vec3d,
    kappa: double,
    margin: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds the points at which two features touch, besides the nearest points of both solids, as candidates.

    Args:
        first: Feature of the first solid.
        second: Feature of the second solid.
        normal: Common normal, out of the second solid.
        kappa: Points are at kappa × the gap from the second solid.
        margin: Largest gap [m].
        patches: The patches.
        candidates: Their candidates.
        patch: The patch with this normal.
    """
    if first.kind == LINE and second.kind == LINE:
        for k in range(2):
            at_end = k == 1
            add_end_on_line(first, at_end, second, True, normal, kappa, margin, patches, candidates, patch)
            add_end_on_line(second, at_end, first, False, normal, kappa, margin, patches, candidates, patch)
    elif first.kind == LINE and second.kind == FLAT_END:
        add_line_on_end(first, second, True, normal, kappa, margin, patches, candidates, patch)
    elif first.kind == FLAT_END and second.kind == LINE:
        add_line_on_end(second, first, False, normal, kappa, margin, patches, candidates, patch)
    elif first.kind == FLAT_END and second.kind == FLAT_END:
        add_two_ends(first, second, normal, kappa, margin, patches, candidates, patch)
