"""Quadrature over sections of curved solids with faces, and over their shadows on a half-space.

A region of a plane is integrated in strips: values of u are divided into panels at *breaks*, and for each u of a panel the
values of v into intervals at *limits*. Between breaks and limits, boundary and depth of the columns are smooth.

- A section is the part of a face inside a solid. Its columns leave the solid at depth t.
- A shadow is the part of the plane of a half-space above or inside the solid. Its columns may enter the solid below the plane.

The rules are exact for areas and first moments of ellipses. Weights next to a closed end of a section, where its width is a
square root, take that into account. Results are continuous in the pose of the solid up to the error of the rules.
"""

import math

import numpy as np
import warp as wp
from warpcontact.kernels.body_contact.curved_solids import (
    Profile,
    Section,
    column_quadratic,
    largest_width_squared,
    limit_depth,
    polynomial,
    real_roots,
    width_squared,
)
from warpcontact.kernels.body_contact.polygons import Polygon, corner

double = wp.float64
vec3d = wp.vec3d

#: Points of a panel, unless it is a whole ellipse, and of an interval.
POINTS = 5
#: Points of a panel on a whole ellipse.
WHOLE_POINTS = 4
#: Length of the array of breaks.
MAX_BREAKS = 64
#: Length of the array of limits.
MAX_LIMITS = 10

# Gauss–Legendre rule on −1…1.
_vector = wp.types.vector(length=POINTS, dtype=double)
GAUSS, GAUSS_WEIGHT = (wp.constant(_vector(*one)) for one in np.polynomial.legendre.leggauss(POINTS))
# Gauss–Chebyshev rule of the second kind on −1…1, for functions with the factor √(1 − x²), which the weights do not include.
_whole_vector = wp.types.vector(length=WHOLE_POINTS, dtype=double)
_ANGLES = [math.pi * (i + 1) / (WHOLE_POINTS + 1) for i in range(WHOLE_POINTS)]
WHOLE = wp.constant(_whole_vector(*(-math.cos(one) for one in _ANGLES)))
WHOLE_WEIGHT = wp.constant(_whole_vector(*(math.pi / (WHOLE_POINTS + 1) * math.sin(one) for one in _ANGLES)))
# Kinds of breaks: others, where the width of the region may be 0, and where another width or depth has a square root.
REGULAR = wp.constant(double(0.0))
CLOSED = wp.constant(double(1.0))
INNER = wp.constant(double(2.0))
# Width of a panel relative to the largest coordinate below which it has no points.
NARROW = wp.constant(double(1.0e-14))
# Distance of a limit from the boundary, relative to the width, below which it does not divide an interval.
NARROW_INTERVAL = wp.constant(double(1.0e-9))
# Square of the width at the end of a panel, relative to that in its middle, below which it is 0.
NO_WIDTH = wp.constant(double(1.0e-9))
# Largest part of an ellipse in a panel, as an angle: 108°.
LARGEST_ANGLE = wp.constant(double(0.6 * math.pi))
# Size of an ellipse, relative to a panel, from which its ends do not affect the panel.
LARGE = wp.constant(double(1.0e8))


@wp.struct
class Region:
    """A region of a plane, over which columns are integrated."""

    profile: Profile  # of the set whose section or shadow is integrated
    end_count: wp.int32  # ends of the profile at which columns leave (1), or leave and enter (2)
    has_tip: wp.bool  # whether columns may leave at the tip of a cone
    has_axis: wp.bool  # whether to divide it where the plane crosses the axis
    inner_count: wp.int32  # profiles that divide intervals
    inner_1: Profile
    inner_2: Profile


@wp.func
def inner_profile(region: Region, number: int):
    """Returns one of the profiles that divide intervals."""
    if number == 0:
        return region.inner_1
    return region.inner_2


@wp.func
def add_break(breaks: wp.array2d(dtype=double), count: int, u: double, kind: double):
    """Adds a break in ascending order, and returns the number of breaks."""
    if not wp.isfinite(u) or count >= MAX_BREAKS:
        return count
    i = count
    while i > 0 and breaks[wp.max(i - 1, 0), 0] > u:
        for k in range(3):
            breaks[i, k] = breaks[i - 1, k]
        i -= 1
    breaks[i, 0] = u
    breaks[i, 1] = kind
    breaks[i, 2] = double(0.0)
    return count + 1


@wp.func
def add_roots(breaks: wp.array2d(dtype=double), count: int, coefficients: vec3d, kind: double):
    """Adds the roots of c₀ + c₁ u + c₂ u² to the breaks, and returns the number of breaks."""
    first, second, are_real = real_roots(coefficients)
    if are_real:
        count = add_break(breaks, count, first, kind)
        count = add_break(breaks, count, second, kind)
    return count


@wp.func
def add_crossings(
    breaks: wp.array2d(dtype=double), count: int, width: vec3d, corners: wp.array2d(dtype=double), polygon: Polygon
):
    """Adds the crossings of v² = c₀ + c₁ u + c₂ u² with the edges of a polygon, and returns the number of breaks."""
    for i in range(polygon.count):
        start = corner(corners, polygon, i)
        along = corner(corners, polygon, (i + 1) % polygon.count) - start
        u = start[0]
        v = start[1]
        along_u = along[0]
        along_v = along[1]
        on_edge = vec3d(
            polynomial(width, u) - v * v,
            (width[1] + double(2.0) * width[2] * u) * along_u - double(2.0) * v * along_v,
            width[2] * along_u * along_u - along_v * along_v,
        )
        first, second, are_real = real_roots(on_edge)
        if are_real:
            if first > double(0.0) and first < double(1.0):
                count = add_break(breaks, count, u + first * along_u, REGULAR)
            if second > double(0.0) and second < double(1.0):
                count = add_break(breaks, count, u + second * along_u, REGULAR)
    return count


@wp.func
def end_depth(section: Section, profile: Profile, is_exit: bool):
    """Returns the depth t = start + slope × u of the flat end at which columns leave or enter, and whether there is one."""
    limit = end_of_columns(section, profile, is_exit)
    depth, has_end = limit_depth(section, limit)
    # The limit at the tip of a cone is no end.
    return depth, has_end and not (profile.k_2 > double(0.0) and limit == profile.upper)


@wp.func
def end_of_columns(section: Section, profile: Profile, is_exit: bool):
    """Returns the limit of z at which columns leave (``is_exit``) or enter a part."""
    if (section.z_t > double(0.0)) == is_exit:
        return profile.upper
    return profile.lower


@wp.func
def find_breaks(
    breaks: wp.array2d(dtype=double),
    section: Section,
    region: Region,
    corners: wp.array2d(dtype=double),
    polygon: Polygon,
):
    """Finds the values of u that divide a region into panels, and returns their number.

    Args:
        breaks: Receives rows (u, kind of the break, 1 if a whole ellipse follows, else 0), in ascending order.
        section: The plane.
        region: The region.
        corners: Corners of the polygons of the thread.
        polygon: Boundary of the region on a face; empty for a shadow.
    """
    count = wp.int32(0)
    profile = region.profile
    width = width_squared(section, profile, double(0.0), double(0.0))
    for i in range(polygon.count):
        count = add_break(breaks, count, corner(corners, polygon, i)[0], REGULAR)
    if wp.abs(section.z_u) > double(0.0):
        count = add_break(breaks, count, (profile.lower - section.z_0) / section.z_u, REGULAR)
        count = add_break(breaks, count, (profile.upper - section.z_0) / section.z_u, REGULAR)
    count = add_roots(breaks, count, width, CLOSED)
    count = add_crossings(breaks, count, width, corners, polygon)
    if region.has_tip:
        count = add_break(breaks, count, section.u_tip, INNER)
    if region.has_axis:
        count = add_break(breaks, count, -section.x_0 / section.x_u, REGULAR)
    for side in range(region.end_count):
        depth, has_end = end_depth(section, profile, side == 0)
        if has_end:
            at_end = width_squared(section, profile, depth[0], depth[1])
            count = add_roots(breaks, count, at_end, wp.where(polygon.count == 0, CLOSED, INNER))
            count = add_crossings(breaks, count, at_end, corners, polygon)
    for side in range(region.inner_count):
        inner = width_squared(section, inner_profile(region, side), double(0.0), double(0.0))
        count = add_roots(breaks, count, inner, INNER)
        count = add_crossings(breaks, count, inner, corners, polygon)
    if polygon.count == 0:
        # The depth of the largest width is start + slope × u.
        here = column_quadratic(section, profile, double(0.0), double(0.0))
        there = column_quadratic(section, profile, double(1.0), double(0.0))
        if here[2] < double(0.0):
            start = double(-0.5) * here[1] / here[2]
            slope = double(-0.5) * (there[1] - here[1]) / here[2]
            count = add_roots(breaks, count, width_squared(section, profile, start, slope), CLOSED)
            count = add_break(breaks, count, -start / slope, REGULAR)
            # Not a constant, so that the loop is not unrolled.
            sides = wp.int32(2)
            for side in range(sides):
                depth, has_end = end_depth(section, profile, side == 0)
                if has_end:
                    count = add_break(breaks, count, (depth[0] - start) / (slope - depth[1]), REGULAR)
    return divide_panels(breaks, count, section, profile, polygon.count > 0)


@wp.func
def divide_panels(
    breaks: wp.array2d(dtype=double), count: int, section: Section, profile: Profile, is_section: bool
):
    """Divides panels which no rule integrates well, and returns the number of breaks."""
    width = width_squared(section, profile, double(0.0), double(0.0))
    panel = wp.int32(0)
    while panel < count - 1:
        if not is_narrow(breaks, panel):
            start = breaks[panel, 0]
            end = breaks[panel + 1, 0]
            middle = double(0.5) * (start + end)
            divide = wp.bool(False)
            # Both ends may have square roots.
            if breaks[panel, 1] > REGULAR and breaks[panel + 1, 1] > REGULAR:
                at_ends = wp.max(
                    region_width_squared(section, profile, start, is_section),
                    region_width_squared(section, profile, end, is_section),
                )
                if at_ends <= NO_WIDTH * region_width_squared(section, profile, middle, is_section):
                    breaks[panel, 2] = double(1.0)
                else:
                    divide = True
            if breaks[panel, 2] == double(0.0):
                first, last, is_ellipse = ellipse_angles(width, start, end)
                if is_ellipse and last - first > LARGEST_ANGLE:
                    divide = True
                    middle = (
                        double(-0.5)
                        * (width[1] - half_axis(width) * wp.cos(double(0.5) * (first + last)))
                        / width[2]
                    )
            if divide:
                count = add_break(breaks, count, middle, REGULAR)
                panel += 1
        panel += 1
    return count


@wp.func
def half_axis(width: vec3d):
    """Returns the distance of the ends of an ellipse v² = c₀ + c₁ u + c₂ u² from its center, times 2 |c₂|."""
    return wp.sqrt(wp.max(width[1] * width[1] - double(4.0) * width[2] * width[0], double(0.0)))


@wp.func
def ellipse_angles(width: vec3d, start: double, end: double):
    """Returns ψ at both ends of a panel on an ellipse, with u = center − half axis × cos ψ, and whether it is on one."""
    if width[2] >= double(0.0):
        return double(0.0), double(0.0), False
    axis = double(-0.5) * half_axis(width) / width[2]
    length = end - start
    first_end = double(-0.5) * width[1] / width[2] - axis
    from_first = start - first_end
    to_second = first_end + double(2.0) * axis - end
    if axis > LARGE * length or wp.min(from_first, to_second) < -NARROW * wp.max(wp.abs(start), wp.abs(end)):
        return double(0.0), double(0.0), False
    return angle_at(from_first, axis), angle_at(from_first + length, axis), True


@wp.func
def angle_at(distance: double, axis: double):
    """Returns the angle of a point at a distance from the first end of an ellipse."""
    ratio = wp.clamp(distance / (double(2.0) * axis), double(0.0), double(1.0))
    return double(2.0) * wp.asin(wp.sqrt(ratio))


@wp.func
def region_width_squared(section: Section, profile: Profile, u: double, is_section: bool):
    """Returns the largest v² of the region at ``u``, negative if it has no point there."""
    if is_section:
        return polynomial(column_quadratic(section, profile, u, double(0.0)), double(0.0))
    return largest_width_squared(section, profile, u)


@wp.func
def add_limit(limits: wp.array(dtype=double), count: int, v: double):
    """Adds ±v to the sorted limits if they are inside the interval of the first and last, and returns their number."""
    margin = NARROW_INTERVAL * (limits[count - 1] - limits[0])
    for side in range(2):
        value = v
        if side == 1:
            value = -v
            if v == double(0.0):
                break
        if value > limits[0] + margin and value < limits[count - 1] - margin and count < MAX_LIMITS:
            i = count
            while limits[i - 1] > value:
                limits[i] = limits[i - 1]
                i -= 1
            limits[i] = value
            count += 1
    return count


@wp.func
def find_limits(
    limits: wp.array(dtype=double),
    section: Section,
    region: Region,
    u: double,
    corners: wp.array2d(dtype=double),
    polygon: Polygon,
):
    """Finds the values of v that divide a region at ``u`` into intervals, in ascending order.

    Returns:
        Their number; 0: the region has no point at ``u``. For the other arguments, see ``find_breaks``.
    """
    profile = region.profile
    column = column_quadratic(section, profile, u, double(0.0))
    z = section.z_0 + section.z_u * u
    is_inside = z >= profile.lower and z <= profile.upper
    widest = column[0]
    if polygon.count == 0:
        widest = largest_width_squared(section, profile, u)
    elif not is_inside:
        return wp.int32(0)
    if widest <= double(0.0):
        return wp.int32(0)
    lower = -wp.sqrt(widest)
    upper = -lower
    if polygon.count > 0:
        least = double(wp.inf)
        largest = -least
        end = corner(corners, polygon, polygon.count - 1)
        for i in range(polygon.count):
            start = end
            end = corner(corners, polygon, i)
            if (start[0] <= u) != (end[0] <= u):
                v = start[1] + (u - start[0]) / (end[0] - start[0]) * (end[1] - start[1])
                least = wp.min(least, v)
                largest = wp.max(largest, v)
        lower = wp.max(lower, least)
        upper = wp.min(upper, largest)
    if lower >= upper:
        return wp.int32(0)
    limits[0] = lower
    limits[1] = upper
    count = wp.int32(2)
    for side in range(region.end_count):
        # Columns leave at, or enter through, a flat end.
        depth, has_end = end_depth(section, profile, side == 0)
        if has_end:
            at = depth[0] + depth[1] * u
            if at > double(0.0):
                at_end = polynomial(column, at)
                if at_end > double(0.0):
                    count = add_limit(limits, count, wp.sqrt(at_end))
    if region.has_tip:
        count = add_limit(limits, count, double(0.0))
    for side in range(region.inner_count):
        inner = column_quadratic(section, inner_profile(region, side), u, double(0.0))
        if inner[0] > double(0.0):
            count = add_limit(limits, count, wp.sqrt(inner[0]))
    if polygon.count == 0 and is_inside and column[0] > double(0.0):
        count = add_limit(limits, count, wp.sqrt(column[0]))
    return count


@wp.func
def panel_point_count(breaks: wp.array2d(dtype=double), panel: int):
    """Returns the number of points of the panel between two breaks."""
    if breaks[panel, 2] > double(0.0):
        return wp.int32(WHOLE_POINTS)
    return wp.int32(POINTS)


@wp.func
def panel_point(breaks: wp.array2d(dtype=double), panel: int, number: int, width: vec3d):
    """Returns u of a point of the panel between two breaks, and its weight in the integral over u.

    Args:
        breaks: The breaks.
        panel: Number of the first one.
        number: Number of the point.
        width: Coefficients of v² at the boundary of the section in the plane. The coordinates of the rule are such that this
            boundary is smooth in them.
    """
    start = breaks[panel, 0]
    end = breaks[panel + 1, 0]
    half = double(0.5) * (end - start)
    if breaks[panel, 2] > double(0.0):
        return start + half * (double(1.0) + WHOLE[number]), half * WHOLE_WEIGHT[number]
    first, last, is_ellipse = ellipse_angles(width, start, end)
    s = double(0.5) * (double(1.0) + GAUSS[number])
    weight = double(0.5) * GAUSS_WEIGHT[number]
    if breaks[panel, 1] == INNER or (breaks[panel, 1] == CLOSED and not is_ellipse):
        weight = weight * double(2.0) * s
        s = s * s
    elif breaks[panel + 1, 1] == INNER or (breaks[panel + 1, 1] == CLOSED and not is_ellipse):
        weight = weight * double(2.0) * (double(1.0) - s)
        s = double(1.0) - (double(1.0) - s) * (double(1.0) - s)
    if is_ellipse:
        angle = first + (last - first) * s
        axis = double(-0.5) * half_axis(width) / width[2]
        center = double(-0.5) * width[1] / width[2]
        return center - axis * wp.cos(angle), weight * (last - first) * axis * wp.sin(angle)
    return start + (end - start) * s, weight * (end - start)


@wp.func
def steepness(section: Section, profile: Profile, u: double, limits: wp.array(dtype=double), limit_count: int):
    """Returns how steep the solid is at the boundary of the region at ``u``: from 0, flat, to 1, along the columns."""
    column = column_quadratic(section, profile, u, double(0.0))
    if column[1] >= double(0.0):
        return double(1.0)
    half_width = double(0.5) * (limits[limit_count - 1] - limits[0])
    curved = wp.abs(column[2]) * half_width * half_width
    return curved / (curved + double(0.25) * column[1] * column[1])


@wp.func
def interval_point(limits: wp.array(dtype=double), interval: int, number: int, steep: double):
    """Returns v of a point of the interval between two limits, and its weight in the integral over v.

    Next to a steep boundary, the depth of columns contains √(1 − x²), which is smooth in s with x = (3 s − s³)/2. Quadratic
    polynomials are integrated exactly for any steepness.
    """
    half = double(0.5) * (limits[interval + 1] - limits[interval])
    middle = double(0.5) * (limits[interval + 1] + limits[interval])
    s = GAUSS[number]
    x = s + double(0.5) * steep * (s - s * s * s)
    slope = double(1.0) + double(0.5) * steep * (double(1.0) - double(3.0) * s * s)
    return middle + half * x, half * slope * GAUSS_WEIGHT[number]


@wp.func
def is_narrow(breaks: wp.array2d(dtype=double), panel: int):
    """Returns whether a panel is so narrow that it has no points."""
    start = breaks[panel, 0]
    end = breaks[panel + 1, 0]
    return end - start <= NARROW * wp.max(wp.abs(start), wp.abs(end))


@wp.func
def has_points(
    breaks: wp.array2d(dtype=double),
    panel: int,
    limits: wp.array(dtype=double),
    section: Section,
    region: Region,
    corners: wp.array2d(dtype=double),
    polygon: Polygon,
):
    """Returns whether a panel has points of the region; overwrites ``limits``. For the arguments, see ``find_limits``."""
    if is_narrow(breaks, panel):
        return False
    middle = double(0.5) * (breaks[panel, 0] + breaks[panel + 1, 0])
    return find_limits(limits, section, region, middle, corners, polygon) > 0
