"""Surfaces of curved solids: depth of points, normals, and the area of the surface inside another solid.

A *sheet* of a curved solid is its curved surface or a flat end. The column of a sheet through a point inside the solid runs along
the inward normal of the sheet. Areas on the sheet and on a surface that its columns cross have the ratio

    dS_sheet = dS |n · n_sheet| / ((1 − t κ₁)(1 − t κ₂))

with the depth t of the point below the sheet and the principal curvatures κ of the sheet.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CONE, CYLINDER, ELLIPSOID, Section

double = wp.float64
vec3d = wp.vec3d

ZERO = wp.constant(double(0.0))
ONE = wp.constant(double(1.0))
# Distance from an axis, relative to the radius, below which a plane contains the axis.
IN_PLANE = wp.constant(double(1.0e-12))
TWO_PI = wp.constant(double(6.283185307179586))
# Smallest ratio of a distance from an axis to a radius: points on the axis have no direction.
ON_AXIS = wp.constant(double(1.0e-9))
# Newton steps for the closest point of an ellipsoid; a few suffice at depths of half of the smallest radius of curvature.
FOOT_STEPS = 12


@wp.struct
class SheetPoint:
    """The column of a sheet through a point."""

    depth: double  # of the point below the sheet [m]
    normal: vec3d  # of the sheet, outward
    area_ratio: double  # (1 − t κ₁)(1 − t κ₂)
    reach: double  # depth at which neighboring columns meet [m]


@wp.func
def sheet_count(flags: int):
    """Returns the number of sheets of a curved solid."""
    if flags & CYLINDER:
        return wp.int32(3)
    if flags & CONE:
        return wp.int32(2)
    return wp.int32(1)


@wp.func
def radial_direction(position: vec3d):
    """Returns the unit vector from the z axis to a point; on the axis, x."""
    distance = wp.sqrt(position[0] * position[0] + position[1] * position[1])
    if distance == ZERO:
        return vec3d(ONE, ZERO, ZERO)
    return vec3d(position[0] / distance, position[1] / distance, ZERO)


@wp.func
def ellipsoid_sheet(scale: vec3d, position: vec3d):
    """Returns the ``SheetPoint`` of a point inside an ellipsoid; a sphere is one."""
    result = SheetPoint()
    if scale[0] == scale[1] and scale[1] == scale[2]:
        radius = scale[0]
        distance = wp.length(position)
        ratio = wp.max(distance / radius, ON_AXIS)
        result.depth = radius - distance
        result.normal = vec3d(ZERO, ZERO, ONE)
        if distance > ZERO:
            result.normal = position / distance
        result.area_ratio = ratio * ratio
        result.reach = radius
        return result
    # The closest point y has position = y + s S⁻² y with s = −t / |S⁻² y|: a scalar equation for s ≤ 0.
    squares = wp.cw_mul(scale, scale)
    smallest = wp.min(squares)
    # The equation is convex: after the first step, Newton steps converge monotonically.
    s = double(0.0)
    # Not a constant, so that the loop is not unrolled.
    steps = wp.int32(FOOT_STEPS)
    for _step in range(steps):
        shifted = squares + vec3d(s, s, s)
        weighted = wp.cw_div(wp.cw_mul(scale, position), shifted)
        value = wp.dot(weighted, weighted) - ONE
        slope = double(-2.0) * wp.dot(weighted, wp.cw_div(weighted, shifted))
        change = ZERO
        if slope < ZERO:
            change = -value / slope
        s = wp.max(s + change, double(-0.999999) * smallest)
    foot = wp.cw_div(wp.cw_mul(squares, position), squares + vec3d(s, s, s))
    # Onto the surface, where rounding or the limit of s left it.
    size = wp.length(wp.cw_div(foot, scale))
    if size > ZERO:
        foot = foot / size
    gradient = wp.cw_div(foot, squares)
    slope_length = wp.length(gradient)
    result.normal = vec3d(ZERO, ZERO, ONE)
    if slope_length > ZERO:
        result.normal = gradient / slope_length
    result.depth = wp.dot(foot - position, result.normal)
    volume = scale[0] * scale[1] * scale[2]
    gauss = ONE / (volume * volume * slope_length * slope_length * slope_length * slope_length)
    mean = (squares[0] + squares[1] + squares[2] - wp.length_sq(foot)) / (
        double(2.0) * volume * volume * slope_length * slope_length * slope_length
    )
    largest_curvature = mean + wp.sqrt(wp.max(mean * mean - gauss, ZERO))
    result.area_ratio = wp.max(
        ONE - double(2.0) * mean * result.depth + gauss * result.depth * result.depth, ON_AXIS * ON_AXIS
    )
    result.reach = ONE / largest_curvature
    return result


@wp.func
def sheet_point(flags: int, scale: vec3d, sheet: int, position: vec3d):
    """Returns the ``SheetPoint`` of a point inside a curved solid, in its frame; sheet 0 is the curved surface."""
    result = SheetPoint()
    if flags & ELLIPSOID:
        return ellipsoid_sheet(scale, position)
    radius = scale[0]
    if sheet > 0:
        # Flat ends.
        upward = wp.where(sheet == 1 and (flags & CONE) == 0, ONE, -ONE)
        offset = wp.where((flags & CONE) != 0, ZERO, scale[2])
        result.depth = offset - upward * position[2]
        result.normal = vec3d(ZERO, ZERO, upward)
        result.area_ratio = ONE
        result.reach = double(wp.inf)
        return result
    out = radial_direction(position)
    distance = wp.dot(out, position)
    if flags & CYLINDER:
        result.depth = radius - distance
        result.normal = out
        result.area_ratio = wp.max(distance / radius, ON_AXIS)
        result.reach = radius
    elif flags & CONE:
        slant = wp.sqrt(radius * radius + scale[2] * scale[2])
        cosine = scale[2] / slant
        sine = radius / slant
        result.depth = (radius * (ONE - position[2] / scale[2]) - distance) * cosine
        result.normal = cosine * out + vec3d(ZERO, ZERO, sine)
        result.reach = result.depth + distance / cosine
        result.area_ratio = wp.max(distance / (distance + result.depth * cosine), ON_AXIS)
    else:
        length = scale[2] - radius
        beyond = position[2] - wp.clamp(position[2], -length, length)
        from_axis = distance * out + vec3d(ZERO, ZERO, beyond)
        distance = wp.length(from_axis)
        ratio = wp.max(distance / radius, ON_AXIS)
        result.depth = radius - distance
        result.normal = out
        if distance > ZERO:
            result.normal = from_axis / distance
        result.area_ratio = ratio
        if beyond != ZERO:
            result.area_ratio = ratio * ratio
        result.reach = radius
    return result


@wp.func
def reach_weight(depth: double, reach: double):
    """Returns the factor on the weight of a column of a sheet: 1 up to half of the reach, 0 from 9/10 of the reach on."""
    if reach == double(wp.inf):
        return ONE
    x = wp.clamp((depth / reach - double(0.5)) / double(0.4), ZERO, ONE)
    return ONE - x * x * (double(3.0) - double(2.0) * x)


@wp.func
def least_reach(flags: int, scale: vec3d):
    """Returns the smallest radius of curvature of a curved solid; of a cone, at its base [m]."""
    if flags & ELLIPSOID:
        least = wp.min(scale)
        return least * least / wp.max(scale)
    return scale[0]


@wp.func
def depth_below_sheets(flags: int, scale: vec3d, position: vec3d):
    """Returns the depth of a point inside a curved solid below its surface; to first order for an ellipsoid [m]."""
    if flags & ELLIPSOID:
        scaled = wp.cw_div(position, scale)
        gauge = wp.length(scaled)
        slope = wp.length(wp.cw_div(scaled, scale))
        if slope == ZERO:
            return wp.min(scale)
        return (ONE - gauge) * gauge / slope
    depth = double(wp.inf)
    for sheet in range(sheet_count(flags)):
        depth = wp.min(depth, sheet_point(flags, scale, sheet, position).depth)
    return depth


@wp.func
def support_count(flags: int):
    """Returns the number of points of a curved solid of which one is farthest along a direction."""
    if flags & ELLIPSOID:
        return wp.int32(1)
    return wp.int32(2)


@wp.func
def support_point(flags: int, scale: vec3d, direction: vec3d, number: int):
    """Returns the farthest point along a unit vector of an ellipsoid, or of one of both ends of another solid [m]."""
    if flags & ELLIPSOID:
        stretched = wp.cw_mul(scale, direction)
        return wp.cw_mul(scale, stretched) / wp.length(stretched)
    radius = scale[0]
    upward = wp.where(number == 0, ONE, -ONE)
    if flags & CAPSULE:
        return radius * direction + vec3d(ZERO, ZERO, upward * (scale[2] - radius))
    if (flags & CONE) != 0 and number == 0:
        return vec3d(ZERO, ZERO, scale[2])
    across = wp.sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    edge = vec3d()
    if across > ON_AXIS * ON_AXIS:
        edge = (radius / across) * vec3d(direction[0], direction[1], ZERO)
    if flags & CYLINDER:
        edge[2] = upward * scale[2]
    return edge


@wp.func
def reach_along(flags: int, scale: vec3d, direction: vec3d):
    """Returns the largest coordinate of a curved solid along a unit vector, from the origin of its frame [m]."""
    largest = -double(wp.inf)
    for i in range(support_count(flags)):
        largest = wp.max(largest, wp.dot(direction, support_point(flags, scale, direction, i)))
    return largest


@wp.func
def inner_point(flags: int, scale: vec3d, position: vec3d, depth: double):
    """Returns a point of a cylinder, cone or capsule that is deeper than ``depth``, near a position in its frame [m].

    It is as deep as possible if no point is deeper. It is continuous in position and depth.
    """
    radius = scale[0]
    out = radial_direction(position)
    distance = wp.dot(out, position)
    if flags & CONE:
        slant = wp.sqrt(radius * radius + scale[2] * scale[2])
        depth = wp.min(depth, radius * scale[2] / (radius + slant))
        z = wp.clamp(position[2], depth, scale[2] - depth * slant / radius)
        distance = wp.min(distance, wp.max(radius * (ONE - z / scale[2]) - depth * slant / scale[2], ZERO))
        return distance * out + vec3d(ZERO, ZERO, z)
    if flags & CAPSULE:
        length = scale[2] - radius
        return vec3d(ZERO, ZERO, wp.clamp(position[2], -length, length))
    depth = wp.min(depth, wp.min(radius, scale[2]))
    distance = wp.min(distance, radius - depth)
    return distance * out + vec3d(ZERO, ZERO, wp.clamp(position[2], depth - scale[2], scale[2] - depth))


@wp.func
def axis_measure(flags: int, scale: vec3d, z: double):
    """Returns the area of the curved surface around the axis between z = 0 and z [m²]."""
    radius = scale[0]
    if flags & CONE:
        along = wp.clamp(z, ZERO, scale[2])
        slant = wp.sqrt(radius * radius + scale[2] * scale[2])
        return TWO_PI * radius * (along - along * along / (double(2.0) * scale[2])) * slant / scale[2]
    limit = scale[2]
    if flags & CAPSULE:
        limit = scale[2] - radius
    return TWO_PI * radius * wp.clamp(z, -limit, limit)


@wp.func
def seen_from_center(flags: int, scale: vec3d, position: vec3d, normal: vec3d):
    """Returns the area of an ellipsoid, or of the ends of a capsule, per area of a surface inside it, seen from the center.

    Args:
        flags: Kind of the solid.
        scale: Its sizes [m].
        position: A point of the surface inside the solid, in its frame [m].
        normal: Unit normal of that surface.

    Returns:
        The ratio; positive if the normal points away from the center.
    """
    if flags & ELLIPSOID:
        scaled = wp.cw_div(position, scale)
        squared = wp.max(wp.length_sq(scaled), ON_AXIS * ON_AXIS)
        return wp.length(wp.cw_div(scaled, scale)) * wp.dot(normal, position) / (squared * squared)
    radius = scale[0]
    length = scale[2] - radius
    from_end = position - vec3d(ZERO, ZERO, wp.clamp(position[2], -length, length))
    ratio = wp.max(wp.length(from_end) / radius, ON_AXIS)
    return wp.dot(normal, from_end) / (radius * ratio * ratio * ratio)


@wp.func
def seen_from_axis(flags: int, scale: vec3d, section: Section, u: double, lower: double, upper: double):
    """Returns the area of a cylinder or cone that the points of a plane from v = ``lower`` to ``upper`` hide, per width in u.

    It is seen from the axis, and positive if the normal of the plane points away from it [m].
    """
    radius = scale[0]
    if flags & CONE:
        slant = wp.sqrt(radius * radius + scale[2] * scale[2]) / scale[2]
        radius = slant * radius * (ONE - (section.z_0 + section.z_u * u) / scale[2])
    # Along v, the cosine of the normal is −x_t x / ρ at the distance ρ from the axis, ρ² = x² + v².
    x = section.x_0 + section.x_u * u
    area = wp.abs(section.x_t) * radius * (wp.atan2(upper, wp.abs(x)) - wp.atan2(lower, wp.abs(x)))
    # An axis in the plane counts as inside the other solid.
    if section.x_t * x > IN_PLANE * scale[0]:
        return -area
    return area
