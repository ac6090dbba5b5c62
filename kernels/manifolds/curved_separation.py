"""Points of a curved solid that are farthest along a direction, and the largest separation of a convex polyhedron from it."""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CONE, ELLIPSOID
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, is_on_face, plane_offset
from warpcontact.kernels.manifolds.candidates import across
from warpcontact.kernels.manifolds.features import Features, moved, vertex_position
from warpcontact.kernels.manifolds.separation import height_above_plane, highest_plane, lowest_vertex
from warpcontact.kernels.manifolds.support_features import LINE_END, LINE_START, end_height, flat_end, lowest_line

double = wp.float64
vec3d = wp.vec3d

#: Largest number of points of a curved solid on a plane.
SUPPORTS = 6


@wp.struct
class Support:
    """A point of a curved solid, in its frame."""

    position: vec3d  # [m]
    number: wp.int32  # which identifies it


@wp.func
def support_points(flags: int, scale: vec3d, direction: vec3d, supports: wp.array(dtype=Support)):
    """Writes the points of a curved solid that are farthest along a direction; returns their number.

    The first two are the ends of a line, except for ellipsoids.

    Args:
        flags: Properties of the solid.
        scale: Its scale [m].
        direction: Unit vector in its frame.
        supports: Receives the points.
    """
    r = scale[0]
    if (flags & ELLIPSOID) != 0:
        weighted = wp.cw_mul(scale, direction)
        supports[0].position = wp.cw_mul(scale, weighted) / wp.length(weighted)
        supports[0].number = LINE_START
        return 1
    supports[0].number = LINE_START
    supports[1].number = LINE_END
    start, end = lowest_line(flags, scale, direction)
    supports[0].position = start
    supports[1].position = end
    side = flat_end(flags, direction)
    if side == 0:
        return 2
    z = end_height(flags, scale, side)
    for k in range(4):
        extent = wp.where(k % 2 == 0, r, -r)
        supports[2 + k].position = wp.where(k < 2, vec3d(extent, double(0.0), z), vec3d(double(0.0), extent, z))
        supports[2 + k].number = wp.where(side > 0, k, 4 + k)
    return SUPPORTS


@wp.struct
class CurvedPair:
    """A polyhedron and a curved solid."""

    own: SolidGeometry  # the polyhedron
    other: SolidGeometry  # the curved solid
    pose: RelativePose  # of the curved solid in the frame of the polyhedron
    second_frame: RelativePose  # of the polyhedron in the frame of the second solid
    kappa: double  # points are at kappa × the gap from the polyhedron
    own_is_second: wp.bool  # whether the polyhedron is the second solid
    is_convex: wp.bool  # whether the polyhedron is convex, with few planes


@wp.func
def lowest_support(pair: CurvedPair, normal: vec3d, supports: wp.array(dtype=Support)):
    """Returns the support points of the curved solid against ``normal``: their number, and the least height above the origin [m].

    ``normal``: unit vector in the frame of the polyhedron.
    """
    direction = -(wp.transpose(pair.pose.rotation) * normal)
    count = support_points(pair.other.flags, pair.other.scale, direction, supports)
    lowest = double(wp.inf)
    for i in range(count):
        lowest = wp.min(lowest, wp.dot(normal, moved(pair.pose, supports[i].position)))
    return count, lowest


@wp.func
def near_point(pair: CurvedPair, normal: vec3d):
    """Returns a point of the feature of the curved solid against ``normal`` that is near the polyhedron, in its frame [m]."""
    flags = pair.other.flags
    scale = pair.other.scale
    to_curved = wp.transpose(pair.pose.rotation)
    direction = -(to_curved * normal)
    center = to_curved * (pair.own.center - pair.pose.origin)
    side = flat_end(flags, direction)
    point = vec3d()
    if side != 0:
        beside = wp.sqrt(center[0] * center[0] + center[1] * center[1])
        shrink = wp.min(scale[0] / wp.max(beside, double(1.0e-300)), double(1.0))
        point = vec3d(shrink * center[0], shrink * center[1], end_height(flags, scale, side))
    elif (flags & ELLIPSOID) != 0:
        weighted = wp.cw_mul(scale, direction)
        point = wp.cw_mul(scale, weighted) / wp.length(weighted)
    else:
        start, end = lowest_line(flags, scale, direction)
        along = end - start
        fraction = wp.clamp(wp.dot(center - start, along) / wp.length_sq(along), double(0.0), double(1.0))
        point = start + fraction * along
    return moved(pair.pose, point)


@wp.struct
class CurvedSeparation:
    """Largest separation of a convex polyhedron and a curved solid along normals of faces and flat ends."""

    distance: double  # [m]
    # A point of the curved solid near the polyhedron, in its frame [m]: no separation is larger than its height above a face or
    # edge.
    near: vec3d
    # Whether no edge of the polyhedron has a larger separation.
    is_largest: wp.bool


@wp.func
def nearest_point(
    geometries: Geometries, features: Features, pair: CurvedPair, plane: int, supports: wp.array(dtype=Support)
):
    """Returns a point of the curved solid above a plane that is near the polyhedron: the lowest one, or one near its center.

    Also returns the plane above which it is highest, and its height above that plane [m].
    """
    normal = geometries.normal[geometries.plane_face[plane]]
    count, _lowest = lowest_support(pair, normal, supports)
    lowest = double(wp.inf)
    point = vec3d()
    for i in range(count):
        position = moved(pair.pose, supports[i].position)
        height = wp.dot(normal, position)
        if height < lowest:
            lowest = height
            point = position
    highest, height = highest_plane(geometries, features, pair.own, plane, point)
    other = near_point(pair, normal)
    other_highest, other_height = highest_plane(geometries, features, pair.own, plane, other)
    if other_height < height:
        return other, other_highest, other_height
    return point, highest, height


@wp.func
def end_is_nearest(pair: CurvedPair, beside: double, depth: double):
    """Returns whether no other part of the surface of a cylinder or cone is nearer to a point than its flat end.

    ``beside``, ``depth``: distances of the point from the axis and below the flat end, 0 if it is above [m].
    """
    radius = pair.other.scale[0]
    height = pair.other.scale[2]
    if (pair.other.flags & CONE) != 0:
        slant = wp.sqrt(radius * radius + height * height)
        return beside <= radius - depth * (radius + slant) / height
    return beside <= radius - depth and depth <= height


@wp.func
def separation_of_faces(
    geometries: Geometries,
    features: Features,
    geometry: int,
    pair: CurvedPair,
    margin: double,
    tolerance: double,
    supports: wp.array(dtype=Support),
):
    """Returns the ``CurvedSeparation`` of a convex polyhedron and a curved solid; the first one above ``margin`` if there is one.

    ``geometry``: that of the polyhedron. ``tolerance``: rounding of separations [m].
    """
    result = CurvedSeparation()
    own = pair.own
    plane, _height = highest_plane(geometries, features, own, own.first_plane, moved(pair.pose, pair.other.center))
    result.distance = -double(wp.inf)
    best = plane
    near, highest, height = nearest_point(geometries, features, pair, plane, supports)
    result.near = near
    for number in range(own.first_plane - 1, own.end_plane):
        if number >= own.first_plane:
            plane = number
            # The separation is at most the height of any point of the curved solid.
            if height_above_plane(geometries, own, plane, result.near) <= result.distance:
                continue
        face = geometries.plane_face[plane]
        _count, lowest = lowest_support(pair, geometries.normal[face], supports)
        distance = lowest - plane_offset(geometries, own, face)
        if distance > result.distance:
            result.distance = distance
            best = plane
            if distance > margin:
                return result
        if number < own.first_plane and height <= distance + tolerance:
            break
    near, highest, height = nearest_point(geometries, features, pair, best, supports)
    result.near = near
    if height <= result.distance + tolerance:
        result.is_largest = height <= double(0.0)
        foot = result.near - height * geometries.normal[geometries.plane_face[highest]]
        for i in range(features.plane_start[highest], features.plane_start[highest + 1]):
            result.is_largest = result.is_largest or is_on_face(geometries, own, features.plane_face[i], foot)
    # Flat ends.
    axis = pair.pose.rotation * vec3d(double(0.0), double(0.0), double(1.0))
    likely = features.corner[features.corner_start[geometry]]
    for k in range(2):
        side = flat_end(pair.other.flags, vec3d(double(0.0), double(0.0), double(2 * k - 1)))
        if side == 0:
            continue
        end = vec3d(double(0.0), double(0.0), end_height(pair.other.flags, pair.other.scale, side))
        middle = moved(pair.pose, end)
        along = double(side) * axis
        nearest = lowest_vertex(geometries, features, own, along, likely)
        position = vertex_position(geometries, nearest, own)
        distance = wp.dot(along, position - middle)
        if distance > result.distance:
            result.distance = distance
            result.is_largest = end_is_nearest(
                pair, wp.length(across(position - middle, along)), wp.max(-distance, double(0.0))
            )
    return result
