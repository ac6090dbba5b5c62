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
#: Numbers of the points of a curved solid, which identify them: fixed on a circular edge (from 0; 4 of each flat end), the nearest
#: point of two solids, at the ends of a line, where an edge cuts it, and where edges cross a circular edge. Of points at the same
#: place, that with the smallest number remains.
NEAREST_POINT, LINE_START, LINE_END, CUT_LINE, CIRCLE_ENTRY, CIRCLE_EXIT, COVERED = 8, 9, 10, 11, 12, 13, 14
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


@wp.struct
class CommonNormal:
    """Common normal of two solids, ``own`` and ``other``, along which their features touch."""

    normal: vec3d  # out of ``other``, in the frame of the second solid
    kappa: double  # points are at kappa × the gap from ``other``
    margin: double  # largest gap [m]
    patch: wp.int32  # with this normal
    is_swapped: wp.bool  # whether ``own`` is the second solid


@wp.func
def seen_from_other(common: CommonNormal):
    """Returns the common normal with ``own`` and ``other`` exchanged."""
    result = CommonNormal()
    result.normal = -common.normal
    result.kappa = one - common.kappa
    result.margin = common.margin
    result.patch = common.patch
    result.is_swapped = not common.is_swapped
    return result


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


@wp.func(inline=False)
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


@wp.func(inline=False)
def add_pair_of_points(
    common: CommonNormal,
    on_own: vec3d,
    on_other: vec3d,
    gap: double,
    own_number: int,
    other_number: int,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds a point of each solid as a candidate if their gap is within the margin; the numbers are those of their features."""
    if gap > common.margin:
        return
    feature = Feature()
    feature.first = wp.where(common.is_swapped, other_number, own_number)
    feature.second = wp.where(common.is_swapped, own_number, other_number)
    # Both are on one line along the normal, except for lines that cross.
    middle = on_other + common.kappa * (on_own - on_other)
    height = wp.dot(common.normal, on_other) + common.kappa * gap
    middle += (height - wp.dot(common.normal, middle)) * common.normal
    add_candidate(patches, candidates, common.patch, middle, gap, feature)


@wp.func
def line_point(line: SupportFeature, fraction: double):
    """Returns a point of a line and the radius of curvature there [m]."""
    position = line.start + fraction * (line.end - line.start)
    return position, line.start_radius + fraction * (line.end_radius - line.start_radius)


@wp.func
def add_end_on_line(
    common: CommonNormal,
    own: SupportFeature,
    at_end: bool,
    other: SupportFeature,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the contact of an end of a line with the other line as a candidate if it is next to the line.

    The gap is that of two circles with the radii of curvature of both lines.
    """
    normal = common.normal
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
    height = wp.dot(normal, position - other_position) + radius + other_radius
    beside = across(position - other_position, normal)
    beside -= (wp.dot(beside, along) / square) * along
    gap = wp.sqrt(height * height + wp.length_sq(beside)) - radius - other_radius
    add_pair_of_points(common, position, other_position, gap, number, other_number, patches, candidates)


@wp.func
def add_line_on_end(
    common: CommonNormal,
    line: SupportFeature,
    end: SupportFeature,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the ends of the part of a line, of ``own``, that is above a flat end as candidates."""
    normal = common.normal
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
        add_pair_of_points(
            common, position, position + height * normal, -height, number, end_number, patches, candidates
        )


@wp.func
def add_point_of_end(
    common: CommonNormal,
    own: SupportFeature,
    offset: vec3d,
    number: int,
    other: SupportFeature,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds a point of the circular edge of a flat end, at an offset from its center, as a candidate if it is above the other end."""
    position = own.center + offset
    height = height_of_end(other, common.normal, position)
    on_other = position + height * common.normal
    if wp.length(on_other - other.center) > (one + ON_END) * other.radius:
        return
    add_pair_of_points(
        common, position, on_other, -height, vertex_feature(number), plane_feature(other.first_point), patches,
        candidates,
    )  # fmt: skip


@wp.func
def add_crossing(
    common: CommonNormal,
    own: SupportFeature,
    other: SupportFeature,
    near: vec3d,
    k: int,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds crossing ``k`` of the circular edges of two flat ends, seen along the normal, as a candidate.

    ``near``: where it is if both ends are normal to the common normal [m].
    """
    normal = common.normal
    offset = near - own.center
    angle = wp.atan2(wp.dot(offset, own.v_axis), wp.dot(offset, own.u_axis))
    slope = other.axis / wp.dot(other.axis, normal)
    # From the center of the other end to the projection of a point of the own edge on its plane, by Newton's method.
    middle = own.center + height_of_end(other, normal, own.center) * normal - other.center
    u_axis = own.radius * (own.u_axis - wp.dot(slope, own.u_axis) * normal)
    v_axis = own.radius * (own.v_axis - wp.dot(slope, own.v_axis) * normal)
    square = other.radius * other.radius
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
    on_own = own.center + own.radius * (wp.cos(angle) * own.u_axis + wp.sin(angle) * own.v_axis)
    height = height_of_end(other, normal, on_own)
    number = edge_feature(wp.where(k == 0, CIRCLE_ENTRY, CIRCLE_EXIT))
    add_pair_of_points(common, on_own, on_own + height * normal, -height, number, number, patches, candidates)


@wp.func
def add_points_of_end(
    common: CommonNormal,
    own: SupportFeature,
    other: SupportFeature,
    distance: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds four points that are fixed on the circular edge of a flat end, and the one that extends farthest over the other end.

    ``distance``: of the axes of both ends, across the normal [m].
    """
    for i in range(4):
        reach = wp.where(i % 2 == 0, own.radius, -own.radius)
        offset = wp.where(i < 2, reach * own.u_axis, reach * own.v_axis)
        add_point_of_end(common, own, offset, own.first_point + i, other, patches, candidates)
    if distance > CONCENTRIC * (own.radius + other.radius):
        towards = across(other.center - own.center, common.normal)
        offset = own.radius * wp.normalize(across(towards, own.axis))
        add_point_of_end(common, own, offset, FARTHEST_POINT, other, patches, candidates)


@wp.func
def add_two_ends(
    common: CommonNormal,
    own: SupportFeature,
    other: SupportFeature,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds points of the circular edges of two flat ends above the other end, and the crossings of both edges, as candidates."""
    between = across(own.center - other.center, common.normal)
    distance = wp.length(between)
    if distance >= own.radius + other.radius:
        return
    add_points_of_end(common, own, other, distance, patches, candidates)
    add_points_of_end(seen_from_other(common), other, own, distance, patches, candidates)
    if distance <= wp.abs(own.radius - other.radius) or distance <= zero:
        return
    towards = between / distance
    along = distance * distance + other.radius * other.radius - own.radius * own.radius
    along = along / (double(2.0) * distance)
    beside = wp.sqrt(wp.max(other.radius * other.radius - along * along, zero))
    for k in range(2):
        crossing = other.center + along * towards
        crossing += wp.where(k == 0, beside, -beside) * wp.cross(common.normal, towards)
        add_crossing(common, own, other, crossing, k, patches, candidates)


@wp.func(inline=False)
def add_common_points(
    common: CommonNormal,
    own: SupportFeature,
    other: SupportFeature,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the points at which the features of two solids touch, besides the nearest points of both, as candidates."""
    if own.kind == LINE and other.kind == LINE:
        for k in range(2):
            add_end_on_line(common, own, k == 1, other, patches, candidates)
            add_end_on_line(seen_from_other(common), other, k == 1, own, patches, candidates)
    elif own.kind == LINE and other.kind == FLAT_END:
        add_line_on_end(common, own, other, patches, candidates)
    elif own.kind == FLAT_END and other.kind == LINE:
        add_line_on_end(seen_from_other(common), other, own, patches, candidates)
    elif own.kind == FLAT_END and other.kind == FLAT_END:
        add_two_ends(common, own, other, patches, candidates)
