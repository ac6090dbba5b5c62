"""Columns on a face that end in a convex solid with few planes.

Their bases are the part of the face inside all planes, divided by the plane at which the columns leave. All positions are in
the frame of the convex solid.
"""

import warp as wp
from warpcontact.kernels.body_contact.columns import ColumnFrame, entry_weight, ramp_height
from warpcontact.kernels.body_contact.polygons import (
    Polygon,
    centroid,
    corner,
    cut,
    polygon_area,
    set_corner,
    stored,
)
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, corner_count, face_vertex
from warpcontact.kernels.body_contact.surface_queries import INFINITE, PARALLEL, SolidGeometry, plane_offset

double = wp.float64
vec3d = wp.vec3d


@wp.struct
class BaseFace:
    """A face on which columns stand, in the frame of the solid in which they end."""

    area: double  # of the part inside the solid [m²]
    direction: vec3d  # of the columns: unit, into the solid of the face
    base: Polygon  # the part inside the solid, stored


@wp.func
def store_planes(planes: wp.array2d(dtype=double), geometries: Geometries, solid: SolidGeometry):
    """Stores the planes of a convex solid as rows (normal, offset), and returns their number."""
    count = solid.end_plane - solid.first_plane
    for i in range(count):
        face = geometries.plane_face[solid.first_plane + i]
        normal = geometries.normal[face]
        for k in range(3):
            planes[i, k] = normal[k]
        planes[i, 3] = plane_offset(geometries, solid, face)
    return count


@wp.func
def plane_normal(planes: wp.array2d(dtype=double), plane: int):
    """Returns the outward normal of a plane."""
    return vec3d(planes[plane, 0], planes[plane, 1], planes[plane, 2])


@wp.func
def height_inside(planes: wp.array2d(dtype=double), plane: int, position: vec3d):
    """Returns the distance of a point from a plane, positive inside [m]."""
    return planes[plane, 3] - wp.dot(plane_normal(planes, plane), position)


@wp.func
def base_face(
    corners: wp.array2d(dtype=double),
    planes: wp.array2d(dtype=double),
    plane_count: int,
    geometries: Geometries,
    own: SolidGeometry,
    own_in_other: RelativePose,
    other: SolidGeometry,
    face: int,
):
    """Returns the part of a face that is inside a convex solid.

    Args:
        corners: Corners of the polygons of the thread.
        planes: Planes of the convex solid, from ``store_planes``.
        plane_count: Their number.
        geometries: The geometries.
        own: The solid of the face.
        own_in_other: Its pose in the convex solid.
        other: The convex solid.
        face: The face.
    """
    result = BaseFace()
    result.direction = -(own_in_other.rotation * geometries.normal[face])
    vertices = geometries.face[face]
    polygon = Polygon()
    polygon.count = corner_count(vertices)
    polygon.weight = double(1.0)
    for i in range(polygon.count):
        position = face_vertex(geometries, vertices, i, own.scale)
        set_corner(corners, i, own_in_other.rotation * position + own_in_other.origin)
    for plane in range(plane_count):
        # Inside the plane; at planes that columns would enter, at least within the ramp.
        normal = plane_normal(planes, plane)
        offset = planes[plane, 3]
        if wp.dot(normal, result.direction) < double(0.0):
            offset += ramp_height(other)
        polygon = cut(corners, polygon, -normal, offset)
        if polygon.count == 0:
            return result
    polygon = stored(corners, polygon)
    middle = centroid(corners, polygon, result.direction)
    for plane in range(plane_count):
        if wp.dot(plane_normal(planes, plane), result.direction) < double(0.0):
            polygon.weight = polygon.weight * entry_weight(other, height_inside(planes, plane, middle))
    result.base = polygon
    result.area = polygon.weight * polygon_area(corners, polygon, result.direction)
    return result


@wp.func
def store_exits(
    corners: wp.array2d(dtype=double),
    planes: wp.array2d(dtype=double),
    plane_count: int,
    face: BaseFace,
    exits: wp.array2d(dtype=double),
):
    """Stores the smallest and largest depths at which columns on a face cross each plane, and returns the smallest [m].

    Both are infinite for planes at which columns do not leave the solid: those they would enter, and those that are deeper
    than another plane everywhere on the face.
    """
    least = INFINITE
    # No column is longer than this.
    longest = INFINITE
    for plane in range(plane_count):
        cosine = wp.dot(plane_normal(planes, plane), face.direction)
        lower = INFINITE
        upper = INFINITE
        if cosine >= PARALLEL:
            upper = -INFINITE
            for i in range(face.base.count):
                depth = height_inside(planes, plane, corner(corners, face.base, i)) / cosine
                lower = wp.min(lower, depth)
                upper = wp.max(upper, depth)
        exits[plane, 0] = lower
        exits[plane, 1] = upper
        least = wp.min(least, lower)
        longest = wp.min(longest, upper)
    for plane in range(plane_count):
        if exits[plane, 0] > longest:
            exits[plane, 0] = INFINITE
            exits[plane, 1] = INFINITE
    return least


@wp.func
def exit_polygon(
    corners: wp.array2d(dtype=double),
    planes: wp.array2d(dtype=double),
    plane_count: int,
    face: BaseFace,
    exits: wp.array2d(dtype=double),
    exit: int,
    shallowest: double,
    deepest: double,
):
    """Returns the base of the columns on a face that leave the convex solid at one of its planes.

    Args:
        corners: Corners of the polygons of the thread.
        planes: Planes of the solid, from ``store_planes``.
        plane_count: Their number.
        face: The face.
        exits: Depths of the planes, from ``store_exits``.
        exit: The plane at which the columns leave.
        shallowest: Smallest depth [m].
        deepest: Largest depth [m].
    """
    polygon = Polygon()
    least = exits[exit, 0]
    largest = exits[exit, 1]
    if least >= deepest or largest <= shallowest:
        return polygon
    polygon = face.base
    normal = plane_normal(planes, exit)
    cosine = wp.dot(normal, face.direction)
    # Depths times the cosine: offset − normal · position.
    offset = planes[exit, 3]
    # One call of ``cut``, which compilers inline: at the two depths, and at the other planes.
    for number in range(-2, plane_count):
        factors = -normal
        distance = offset - shallowest * cosine
        if number == -2:
            if least >= shallowest:
                continue
        elif number == -1:
            if largest <= deepest:
                continue
            factors = normal
            distance = deepest * cosine - offset
        else:
            if number == exit or exits[number, 0] >= largest:
                continue
            # The column does not cross the other plane before the exit: its end is inside.
            other_normal = plane_normal(planes, number)
            ratio = wp.dot(other_normal, face.direction) / cosine
            factors = ratio * normal - other_normal
            distance = planes[number, 3] - ratio * offset
        polygon = cut(corners, polygon, factors, distance)
        if polygon.count == 0:
            return polygon
    return polygon


@wp.func
def deepest_inside(
    corners: wp.array2d(dtype=double),
    planes: wp.array2d(dtype=double),
    plane_count: int,
    face: BaseFace,
    heights: wp.array2d(dtype=double),
    deepest: double,
):
    """Returns the largest distance of a point of a face from the nearest plane around it, at least ``deepest`` [m].

    ``heights``: room for the smallest distance of each plane from the face.
    """
    # The distance from the nearest plane is at most that from any plane, which is largest at a corner.
    bound = INFINITE
    for plane in range(plane_count):
        least = INFINITE
        largest = -INFINITE
        for i in range(face.base.count):
            height = height_inside(planes, plane, corner(corners, face.base, i))
            least = wp.min(least, height)
            largest = wp.max(largest, height)
        if largest <= deepest:
            return deepest
        heights[plane, 0] = least
        bound = wp.min(bound, largest)
    # On the part of a face with one nearest plane, the distance is affine, and largest at a corner.
    for nearest in range(plane_count):
        if heights[nearest, 0] > bound:
            continue
        polygon = face.base
        normal = plane_normal(planes, nearest)
        offset = planes[nearest, 3]
        # One call of ``cut``, which compilers inline: at the depth so far, and at the other planes.
        for number in range(-1, plane_count):
            factors = -normal
            distance = offset - deepest
            if number >= 0:
                if number == nearest or heights[number, 0] > bound:
                    continue
                factors = normal - plane_normal(planes, number)
                distance = planes[number, 3] - offset
            polygon = cut(corners, polygon, factors, distance)
            if polygon.count == 0:
                break
        for i in range(polygon.count):
            deepest = wp.max(deepest, height_inside(planes, nearest, corner(corners, polygon, i)))
    return deepest


@wp.func
def with_exit(frame: ColumnFrame, planes: wp.array2d(dtype=double), exit: int):
    """Returns the frame with the depth of columns that leave the convex solid at a plane."""
    normal = plane_normal(planes, exit)
    cosine = wp.dot(normal, frame.direction)
    frame.depth_factors = -normal / cosine
    frame.depth_offset = planes[exit, 3] / cosine
    return frame
