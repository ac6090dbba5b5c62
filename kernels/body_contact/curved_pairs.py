"""Overlap of two curved solids: a common plane, and lines along its normal through both solids.

The overlap of two convex solids is convex. A line along the normal n of the common plane is inside both solids between two
depths; the length between them is the depth of its column. Bases of columns fill a convex region of the plane around the
projection of any point of the overlap, and are integrated in polar coordinates around the center of the overlap.

The normal is that of both surfaces next to the center of the overlap: the difference of the normals of the sheets of the solids,
in which near sheets have a larger weight. So it is continuous in the poses, also where a contact moves from a flat end to a curved
surface.
"""

import math

import numpy as np
import warp as wp
from warpcontact.kernels.body_contact.curved_solids import (
    CONE,
    ELLIPSOID,
    TINY,
    Profile,
    interval_of_quadratic,
    part_count,
    profile_of,
)
from warpcontact.kernels.body_contact.curved_surfaces import (
    SheetPoint,
    depth_below_sheets,
    inner_point,
    sheet_count,
    sheet_point,
)
from warpcontact.kernels.body_contact.solids import RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry

double = wp.float64
vec3d = wp.vec3d

#: Directions around the center of the overlap.
DIRECTIONS = 24
#: Points along each direction.
RADIAL_POINTS = 4
# Gauss–Legendre rule on 0…1.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(RADIAL_POINTS)
_vector4 = wp.types.vector(length=RADIAL_POINTS, dtype=double)
RADII = wp.constant(_vector4(*(0.5 * (1.0 + _POINTS))))
RADIUS_WEIGHTS = wp.constant(_vector4(*(0.5 * _WEIGHTS)))
ANGLE_STEP = wp.constant(double(2.0 * math.pi / DIRECTIONS))
# Steps to the closest points of the inner solids, and of the ellipsoid method.
CORE_STEPS = 12
SEARCH_STEPS = 250
# Passes that fit the coordinates to the region, before that which integrates.
FITS = 2
BOUNDARY_STEPS = 80
# Length of the bracket of a boundary point, relative to its distance from the center, at which the search ends.
BOUNDARY_ERROR = wp.constant(double(1.0e-11))
# Least ratio of the width of a region to its length.
LEAST_ASPECT = wp.constant(double(1.0e-3))


@wp.struct
class CurvedPair:
    """Two curved solids, in the frame of the second."""

    first: SolidGeometry
    second: SolidGeometry
    pose: RelativePose  # of the first solid
    size: double  # sum of the radii of the bounding spheres [m]


@wp.struct
class CommonPlane:
    """Center of the overlap of two solids and axes of the common plane."""

    is_found: wp.bool  # whether there is an overlap
    depth: double  # length of the column at the center [m]
    largest_depth: double  # of the columns on the region [m]
    center: vec3d  # in the frame of the second solid [m]
    normal: vec3d  # unit, out of the second solid
    u_axis: vec3d  # along the region; its length is the unit of the polar coordinates [m]
    v_axis: vec3d  # likewise across it


@wp.func
def line_interval(flags: int, scale: vec3d, origin: vec3d, direction: vec3d):
    """Returns where a line enters and leaves a curved solid, in its frame; the first is larger if it does not [m]."""
    result = wp.vec2d(double(wp.inf), -double(wp.inf))
    if flags & ELLIPSOID:
        # In coordinates in which the solid is a unit sphere.
        origin = wp.cw_div(origin, scale)
        direction = wp.cw_div(direction, scale)
    for part in range(part_count(flags)):
        profile = profile_of(flags, scale, part)
        interval = part_interval(profile, origin, direction)
        if interval[0] <= interval[1]:
            result = wp.vec2d(wp.min(result[0], interval[0]), wp.max(result[1], interval[1]))
    return result


@wp.func
def part_interval(profile: Profile, origin: vec3d, direction: vec3d):
    """Returns where a line enters and leaves a part of a curved solid."""
    z = origin[2]
    coefficients = vec3d(
        profile.k_0 + profile.k_1 * z + profile.k_2 * z * z - origin[0] * origin[0] - origin[1] * origin[1],
        profile.k_1 * direction[2]
        + double(2.0) * (profile.k_2 * z * direction[2] - origin[0] * direction[0] - origin[1] * direction[1]),
        profile.k_2 * direction[2] * direction[2] - direction[0] * direction[0] - direction[1] * direction[1],
    )
    limits = wp.vec2d(-double(wp.inf), double(wp.inf))
    if direction[2] == double(0.0):
        if z < profile.lower or z > profile.upper:
            return wp.vec2d(double(1.0), double(0.0))
    else:
        first = (profile.lower - z) / direction[2]
        second = (profile.upper - z) / direction[2]
        limits = wp.vec2d(wp.min(first, second), wp.max(first, second))
    return interval_of_quadratic(coefficients, limits, direction[2])


@wp.func
def common_interval(pair: CurvedPair, origin: vec3d, direction: vec3d):
    """Returns where a line is inside both solids; the first value is larger if it is not [m]."""
    own = line_interval(pair.second.flags, pair.second.scale, origin, direction)
    to_first = wp.transpose(pair.pose.rotation)
    other = line_interval(
        pair.first.flags, pair.first.scale, to_first * (origin - pair.pose.origin), to_first * direction
    )
    return wp.vec2d(wp.max(own[0], other[0]), wp.min(own[1], other[1]))


@wp.func
def least_depth(pair: CurvedPair, position: vec3d):
    """Returns the smaller depth of a point below the surfaces of both solids; negative outside [m]."""
    to_first = wp.transpose(pair.pose.rotation)
    return wp.min(
        depth_below_sheets(pair.first.flags, pair.first.scale, to_first * (position - pair.pose.origin)),
        depth_below_sheets(pair.second.flags, pair.second.scale, position),
    )


@wp.func
def mean_normal(flags: int, scale: vec3d, position: vec3d):
    """Returns the mean of the normals of the sheets of a solid at a point inside; near sheets have a larger weight."""
    nearest = double(wp.inf)
    for sheet in range(sheet_count(flags)):
        nearest = wp.min(nearest, wp.abs(sheet_point(flags, scale, sheet, position).depth))
    total = vec3d()
    for sheet in range(sheet_count(flags)):
        point = sheet_point(flags, scale, sheet, position)
        ratio = double(1.0)
        if wp.abs(point.depth) > nearest:
            ratio = nearest / wp.abs(point.depth)
        normal = point.normal
        if (flags & CONE) != 0 and sheet == 0:
            # Next to the tip, the mean of all directions around the axis.
            squared = position[0] * position[0] + position[1] * position[1]
            around = wp.sqrt(squared / (squared + point.depth * point.depth + TINY))
            normal = vec3d(around * normal[0], around * normal[1], normal[2])
        total += (ratio * ratio * ratio * ratio) * normal
    return wp.normalize(total)


@wp.func
def normal_at(pair: CurvedPair, position: vec3d, fallback: vec3d):
    """Returns the unit normal of the common plane at a point of the overlap, out of the second solid."""
    to_first = wp.transpose(pair.pose.rotation)
    first = pair.pose.rotation * mean_normal(
        pair.first.flags, pair.first.scale, to_first * (position - pair.pose.origin)
    )
    normal = mean_normal(pair.second.flags, pair.second.scale, position) - first
    if wp.length_sq(normal) == double(0.0):
        return fallback
    return wp.normalize(normal)


@wp.func
def common_point(pair: CurvedPair):
    """Returns a point of the overlap of two curved solids, and the direction from the inside of the second to that of the first.

    The point is outside of the overlap if there is none.
    """
    to_first = wp.transpose(pair.pose.rotation)
    # Closest points of the centers of the largest spheres inside both.
    inside_1 = pair.pose.origin + pair.pose.rotation * pair.first.center
    inside_2 = pair.second.center
    # Not a constant, so that the loop is not unrolled.
    steps = wp.int32(CORE_STEPS)
    for _step in range(steps):
        inside_2 = center_near(pair.second, inside_1)
        inside_1 = pair.pose.origin + pair.pose.rotation * center_near(
            pair.first, to_first * (inside_2 - pair.pose.origin)
        )
    direction = inside_1 - inside_2
    if wp.length_sq(direction) == double(0.0):
        direction = vec3d(double(0.0), double(0.0), double(1.0))
    direction = wp.normalize(direction)
    interval = common_interval(pair, inside_2, direction)
    point = inside_2 + (double(0.5) * (interval[0] + interval[1])) * direction
    if interval[0] < interval[1]:
        return point, direction
    # Ellipsoid method: an ellipsoid around the overlap is cut through its center by a plane, and replaced by the smallest
    # ellipsoid around the rest, until its center is in the overlap or nothing is left.
    radius = wp.min(wp.length(pair.first.half_extents), wp.length(pair.second.half_extents))
    point = pair.second.center
    if wp.length(pair.first.half_extents) < wp.length(pair.second.half_extents):
        point = pair.pose.origin + pair.pose.rotation * pair.first.center
    shape = (radius * radius) * wp.identity(n=3, dtype=double)
    for _step in range(SEARCH_STEPS):
        plane_1 = nearest_plane(pair.first.flags, pair.first.scale, to_first * (point - pair.pose.origin))
        plane_2 = nearest_plane(pair.second.flags, pair.second.scale, point)
        normal = plane_2.normal
        depth = plane_2.depth
        if plane_1.depth < depth:
            normal = pair.pose.rotation * plane_1.normal
            depth = plane_1.depth
        if depth > double(0.0):
            break
        along = shape * normal
        extent = wp.sqrt(wp.max(wp.dot(normal, along), double(0.0)))
        cut = double(1.0)
        if extent > double(0.0):
            cut = -depth / extent
        if cut >= double(1.0):
            break
        along = along / extent
        point -= double(0.25) * (double(1.0) + double(3.0) * cut) * along
        shape = (double(1.125) * (double(1.0) - cut * cut)) * (
            shape
            - (double(0.5) * (double(1.0) + double(3.0) * cut) / (double(1.0) + cut)) * wp.outer(along, along)
        )
    return point, direction


@wp.func
def nearest_plane(flags: int, scale: vec3d, position: vec3d):
    """Returns depth and normal of a plane, which the solid does not cross, at the nearest sheet of a convex solid.

    The depth of the position below the plane is negative outside of the solid, and positive inside.
    """
    result = SheetPoint()
    if flags & ELLIPSOID:
        scaled = wp.cw_div(position, scale)
        gauge = wp.length(scaled)
        gradient = wp.cw_div(scaled, scale)
        slope = wp.length(gradient)
        result.normal = vec3d(double(0.0), double(0.0), double(1.0))
        result.depth = wp.min(scale)
        if slope > double(0.0):
            result.normal = gradient / slope
            result.depth = (double(1.0) - gauge) * gauge / slope
        return result
    result = sheet_point(flags, scale, 0, position)
    for sheet in range(1, sheet_count(flags)):
        other = sheet_point(flags, scale, sheet, position)
        if other.depth < result.depth:
            result = other
    return result


@wp.func
def center_near(solid: SolidGeometry, position: vec3d):
    """Returns the center, closest to a point, of one of the largest spheres inside a curved solid, in its frame [m]."""
    if solid.flags & ELLIPSOID:
        return vec3d()
    return inner_point(solid.flags, solid.scale, position, wp.max(solid.scale))


@wp.func
def boundary_distance(pair: CurvedPair, plane: CommonPlane, direction: vec3d, guess: double):
    """Returns the distance from the center to the boundary of the region along a direction, in units of its length.

    Args:
        pair: The solids.
        plane: Their common plane; its center is in the overlap.
        direction: The direction [m].
        guess: Estimate of the distance, positive.
    """
    inside = double(0.0)
    value_inside = plane.depth
    outside = double(wp.inf)
    value_outside = -double(wp.inf)
    distance = guess
    last_side = wp.int32(0)
    for _step in range(BOUNDARY_STEPS):
        interval = common_interval(pair, plane.center + distance * direction, plane.normal)
        value = interval[1] - interval[0]
        # The Illinois method: half of the value of an end that remains twice.
        if value > double(0.0):
            inside = distance
            value_inside = value
            if last_side == 1:
                value_outside = double(0.5) * value_outside
            last_side = 1
        else:
            outside = distance
            value_outside = value
            if last_side == -1:
                value_inside = double(0.5) * value_inside
            last_side = -1
        if outside == double(wp.inf):
            distance = double(2.0) * inside
            continue
        if outside - inside <= BOUNDARY_ERROR * outside:
            break
        distance = double(0.5) * (inside + outside)
        if value_outside > -double(wp.inf):
            distance = inside + (outside - inside) * value_inside / (value_inside - value_outside)
            if distance <= inside or distance >= outside:
                distance = double(0.5) * (inside + outside)
    return inside


@wp.func
def direction_of(plane: CommonPlane, number: int):
    """Returns a direction around the center of the region, whose length is the unit of its distances [m]."""
    angle = ANGLE_STEP * double(number)
    return wp.cos(angle) * plane.u_axis + wp.sin(angle) * plane.v_axis


@wp.func
def axis_of(solid: SolidGeometry, rotation: wp.mat33d):
    """Returns the axis of a solid, or zero if it has none."""
    if solid.flags & ELLIPSOID:
        return vec3d()
    return vec3d(rotation[0, 2], rotation[1, 2], rotation[2, 2])


@wp.func
def start_axes(pair: CurvedPair, plane: CommonPlane, first_axis: vec3d, second_axis: vec3d):
    """Returns the plane with axes along those of the solids, as far as they are parallel to it."""
    n = plane.normal
    # With signs such that they do not cancel.
    along_1 = first_axis - wp.dot(first_axis, n) * n
    along_2 = second_axis - wp.dot(second_axis, n) * n
    if wp.dot(along_1, along_2) < double(0.0):
        along_1 = -along_1
    along = along_1 + along_2
    if wp.length(along) < double(1.0e-6):
        # Around the normal, the region is nearly round.
        helper = vec3d(double(1.0), double(0.0), double(0.0))
        if wp.abs(n[0]) > double(0.7):
            helper = vec3d(double(0.0), double(1.0), double(0.0))
        along = wp.cross(n, helper)
    # The size of the solids as first estimate.
    plane.u_axis = (double(0.1) * pair.size) * wp.normalize(along)
    plane.v_axis = wp.cross(n, plane.u_axis)
    return plane


@wp.func
def with_extents(pair: CurvedPair, plane: CommonPlane):
    """Returns the plane with the center in the middle of the region along both axes, and their lengths those to its boundary."""
    # Not a constant, so that the loop is not unrolled.
    axes = wp.int32(2)
    for number in range(axes):
        axis = plane.v_axis
        if number == 1:
            axis = plane.u_axis
        forward = boundary_distance(pair, plane, axis, double(1.0))
        backward = boundary_distance(pair, plane, -axis, wp.max(forward, double(1.0e-9)))
        plane.center += (double(0.5) * (forward - backward)) * axis
        interval = common_interval(pair, plane.center, plane.normal)
        plane.depth = interval[1] - interval[0]
        axis = (double(0.5) * (forward + backward)) * axis
        if number == 0:
            plane.v_axis = axis
        else:
            plane.u_axis = axis
    return plane


@wp.func
def fitted_plane(pair: CurvedPair, plane: CommonPlane):
    """Returns the plane with center, normal and axes of the overlap; not found if the overlap has no volume."""
    volume = double(0.0)
    moment = vec3d()
    depth = double(0.0)
    # First and second moments of the area in the units of the axes.
    area = double(0.0)
    mean = wp.vec2d()
    second = vec3d()
    limit = double(1.0)
    # Not a constant, so that the loop is not unrolled.
    half_count = wp.int32(DIRECTIONS // 2)
    for half_number in range(half_count):
        number = 2 * half_number
        direction = direction_of(plane, number)
        limit = boundary_distance(pair, plane, direction, limit)
        angle = ANGLE_STEP * double(number)
        unit = wp.vec2d(wp.cos(angle), wp.sin(angle))
        area += limit * limit / double(2.0)
        mean += (limit * limit * limit / double(3.0)) * unit
        fourth = limit * limit * limit * limit / double(4.0)
        second += fourth * vec3d(unit[0] * unit[0], unit[1] * unit[1], unit[0] * unit[1])
        for i in range(RADIAL_POINTS):
            base = plane.center + (limit * RADII[i]) * direction
            interval = common_interval(pair, base, plane.normal)
            weight = RADIUS_WEIGHTS[i] * RADII[i] * limit * limit * wp.max(interval[1] - interval[0], double(0.0))
            volume += weight
            depth = wp.max(depth, interval[1] - interval[0])
            moment += weight * (base + (double(0.5) * (interval[0] + interval[1])) * plane.normal)
    result = plane
    result.is_found = volume > double(0.0)
    if not result.is_found:
        return result
    mean = mean / area
    uu = second[0] / area - mean[0] * mean[0]
    vv = second[1] / area - mean[1] * mean[1]
    uv = second[2] / area - mean[0] * mean[1]
    # Tensor of second moments in metres, and its principal axes in the plane of the new normal.
    tensor = uu * wp.outer(plane.u_axis, plane.u_axis) + vv * wp.outer(plane.v_axis, plane.v_axis)
    tensor += uv * (wp.outer(plane.u_axis, plane.v_axis) + wp.outer(plane.v_axis, plane.u_axis))
    result.center = moment / volume
    result.normal = normal_at(pair, result.center, plane.normal)
    interval = common_interval(pair, result.center, result.normal)
    result.depth = interval[1] - interval[0]
    result.largest_depth = wp.max(depth, result.depth)
    n = result.normal
    u = wp.normalize(plane.u_axis - wp.dot(plane.u_axis, n) * n)
    v = wp.cross(n, u)
    uu = wp.dot(u, tensor * u)
    vv = wp.dot(v, tensor * v)
    uv = wp.dot(u, tensor * v)
    half_sum = double(0.5) * (uu + vv)
    difference = wp.sqrt(double(0.25) * (uu - vv) * (uu - vv) + uv * uv)
    largest = half_sum + difference
    smallest = wp.max(half_sum - difference, LEAST_ASPECT * LEAST_ASPECT * largest)
    angle = double(0.0)
    if difference > double(1.0e-3) * half_sum:
        angle = double(0.5) * wp.atan2(double(2.0) * uv, uu - vv)
    u_new = wp.cos(angle) * u + wp.sin(angle) * v
    result.u_axis = double(2.0) * wp.sqrt(largest) * u_new
    result.v_axis = double(2.0) * wp.sqrt(smallest) * wp.cross(n, u_new)
    return result


@wp.func
def common_plane(pair: CurvedPair):
    """Returns the ``CommonPlane`` of two curved solids."""
    plane = CommonPlane()
    point, direction = common_point(pair)
    if least_depth(pair, point) <= double(0.0):
        return plane
    plane.center = point
    plane.normal = normal_at(pair, point, direction)
    interval = common_interval(pair, plane.center, plane.normal)
    plane.depth = interval[1] - interval[0]
    identity = wp.identity(n=3, dtype=double)
    plane = start_axes(pair, plane, axis_of(pair.first, pair.pose.rotation), axis_of(pair.second, identity))
    plane.is_found = plane.depth > double(0.0)
    if plane.is_found:
        plane = with_extents(pair, plane)
    # Not a constant, so that the loop is not unrolled.
    fits = wp.int32(FITS)
    for _fit in range(fits):
        if plane.is_found:
            plane = fitted_plane(pair, plane)
    return plane
