"""Convex polygons: clipping, area and quadrature points.

A corner is a point of the solid in which columns end, or (u, v, t): coordinates in the plane of a face, and the depth below
it. The corners of the polygons of a thread are rows of one array, in blocks of ``MAX_CORNERS`` rows. Each cut reads one block
and writes another.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import MAX_PLANES

double = wp.float64

#: Largest number of corners. A quadrilateral is cut by at most 4 edges of another one, or by two cuts for each of
#: ``MAX_PLANES`` planes, and at two depths. Each cut adds one corner at most.
MAX_CORNERS = 4 + 2 * MAX_PLANES + 2
#: Rows of the array of corners: two blocks for cutting, and one for a stored polygon.
CORNER_ROWS = 3 * MAX_CORNERS
#: First row of the block of stored polygons.
STORED = 2 * MAX_CORNERS
#: Points of the quadrature rule on a triangle.
RULE_SIZE = 7

# Radon's rule of degree 5 on a triangle: barycentric coordinates (a, b, b) and weights of its two orbits.
_A_1, _B_1, _W_1 = 0.059715871789769820, 0.470142064105115090, 0.132394152788506180
_A_2, _B_2, _W_2 = 0.797426985353087320, 0.101286507323456340, 0.125939180544827150
CENTER_WEIGHT = wp.constant(double(0.225))
WEIGHT_1 = wp.constant(double(_W_1))
WEIGHT_2 = wp.constant(double(_W_2))
FAR_1, NEAR_1 = wp.constant(double(_A_1)), wp.constant(double(_B_1))
FAR_2, NEAR_2 = wp.constant(double(_A_2)), wp.constant(double(_B_2))
THIRD = wp.constant(double(1.0 / 3.0))


@wp.struct
class Polygon:
    """A convex polygon."""

    start: wp.int32  # row of its first corner
    count: wp.int32  # number of corners; 0: empty
    weight: double  # of its area, 0 to 1 [-]


@wp.struct
class QuadraturePoint:
    """A point of the quadrature rule on a triangle."""

    position: wp.vec3d  # in the coordinates of the corners
    weight: double  # fraction of the area of the triangle [-]


@wp.func
def corner(corners: wp.array2d(dtype=double), polygon: Polygon, i: int):
    """Returns corner ``i``."""
    row = polygon.start + i
    return wp.vec3d(corners[row, 0], corners[row, 1], corners[row, 2])


@wp.func
def set_corner(corners: wp.array2d(dtype=double), row: int, position: wp.vec3d):
    """Stores a corner."""
    corners[row, 0] = position[0]
    corners[row, 1] = position[1]
    corners[row, 2] = position[2]


@wp.func
def stored(corners: wp.array2d(dtype=double), polygon: Polygon):
    """Returns a copy of a polygon in the block that cuts do not write."""
    result = Polygon()
    result.start = STORED
    result.count = polygon.count
    result.weight = polygon.weight
    for i in range(polygon.count):
        set_corner(corners, STORED + i, corner(corners, polygon, i))
    return result


@wp.func
def cut(corners: wp.array2d(dtype=double), polygon: Polygon, factors: wp.vec3d, offset: double):
    """Returns the part of a polygon with factors · corner + offset ≥ 0; empty if it has no area."""
    least = offset + wp.dot(factors, corner(corners, polygon, 0))
    greatest = least
    for i in range(1, polygon.count):
        value = offset + wp.dot(factors, corner(corners, polygon, i))
        least = wp.min(least, value)
        greatest = wp.max(greatest, value)
    if least >= double(0.0):
        return polygon
    result = Polygon()
    if greatest < double(0.0):
        return result
    result.weight = polygon.weight
    if polygon.start == 0:
        result.start = MAX_CORNERS
    previous = corner(corners, polygon, polygon.count - 1)
    previous_value = wp.dot(factors, previous) + offset
    count = wp.int32(0)
    for i in range(polygon.count):
        current = corner(corners, polygon, i)
        value = wp.dot(factors, current) + offset
        if (value >= double(0.0)) != (previous_value >= double(0.0)) and count < MAX_CORNERS:
            crossing = previous + (previous_value / (previous_value - value)) * (current - previous)
            set_corner(corners, result.start + count, crossing)
            count += 1
        if value >= double(0.0) and count < MAX_CORNERS:
            set_corner(corners, result.start + count, current)
            count += 1
        previous = current
        previous_value = value
    if count >= 3:
        result.count = count
    return result


@wp.func
def triangle_area(first: wp.vec3d, second: wp.vec3d, third: wp.vec3d, axis: wp.vec3d):
    """Returns the area of a triangle projected along a unit vector, with the sign of its direction around it [m²]."""
    return double(0.5) * wp.dot(wp.cross(second - first, third - first), axis)


@wp.func
def polygon_area(corners: wp.array2d(dtype=double), polygon: Polygon, axis: wp.vec3d):
    """Returns the magnitude of the area of the polygon projected along a unit vector [m²]."""
    area = double(0.0)
    first = corner(corners, polygon, 0)
    for i in range(1, polygon.count - 1):
        area += triangle_area(first, corner(corners, polygon, i), corner(corners, polygon, i + 1), axis)
    return wp.abs(area)


@wp.func
def centroid(corners: wp.array2d(dtype=double), polygon: Polygon, axis: wp.vec3d):
    """Returns the center of the area projected along a unit vector; of a polygon without area, its first corner."""
    area = double(0.0)
    moment = wp.vec3d()
    first = corner(corners, polygon, 0)
    for i in range(1, polygon.count - 1):
        second = corner(corners, polygon, i)
        third = corner(corners, polygon, i + 1)
        part = triangle_area(first, second, third, axis)
        area += part
        moment += part * (first + second + third)
    if area == double(0.0):
        return first
    return moment / (double(3.0) * area)


@wp.func
def sample_of_polygon(corners: wp.array2d(dtype=double), polygon: Polygon, middle: wp.vec3d, i: int):
    """Returns sample ``i`` of corners, midpoints of edges and, last, the center ``middle``."""
    if i == 2 * polygon.count:
        return middle
    point = corner(corners, polygon, i // 2)
    if i % 2 == 1:
        point = double(0.5) * (point + corner(corners, polygon, (i // 2 + 1) % polygon.count))
    return point


@wp.func
def quadrature_point(first: wp.vec3d, second: wp.vec3d, third: wp.vec3d, number: int):
    """Returns point ``number``, from 0 to ``RULE_SIZE`` − 1, of the rule of degree 5 on a triangle."""
    far = THIRD
    near = THIRD
    weight = CENTER_WEIGHT
    if number > 3:
        far = FAR_2
        near = NEAR_2
        weight = WEIGHT_2
    elif number > 0:
        far = FAR_1
        near = NEAR_1
        weight = WEIGHT_1
    opposite = (number + 2) % 3
    # near + near + far = 1
    position = near * (first + second + third)
    if opposite == 0:
        position += (far - near) * first
    elif opposite == 1:
        position += (far - near) * second
    else:
        position += (far - near) * third
    point = QuadraturePoint()
    point.position = position
    point.weight = weight
    return point
