"""Points of a curved solid that are farthest along a direction, and the largest separation of a convex polyhedron from it."""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import ELLIPSOID
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, is_on_face, plane_offset
from warpcontact.kernels.manifolds.curved_hull import CurvedHull, lowest_of_hull, nearest_surface_point
from warpcontact.kernels.manifolds.features import Features, moved, vertex_position
from warpcontact.kernels.manifolds.normal_trees import height_above_plane, highest_plane_above
from warpcontact.kernels.manifolds.separation import lowest_vertex
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
    plane: wp.int32  # with the largest separation along normals of faces
    vertex: wp.int32  # nearest to the flat end with this separation; 0: it is along the normal of a face
    end_normal: vec3d  # of this flat end, towards the curved solid


@wp.func
def plane_separation(geometries: Geometries, own: SolidGeometry, hull: CurvedHull, plane: int):
    """Returns the separation of a curved solid from a plane of a polyhedron [m], and its lowest point above it [m]."""
    face = geometries.plane_face[plane]
    normal = geometries.normal[face]
    lowest = lowest_of_hull(hull, normal)
    return wp.dot(normal, lowest) - plane_offset(geometries, own, face), lowest


@wp.func
def highest_plane(
    geometries: Geometries,
    features: Features,
    geometry: int,
    own: SolidGeometry,
    likely: int,
    position: vec3d,
    pending: wp.array(dtype=wp.int32),
):
    """Returns the plane of a convex polyhedron above which a point is highest, ``likely`` among equal ones, and the height [m]."""
    height = height_above_plane(geometries, own, likely, position)
    plane, height = highest_plane_above(geometries, features, own, geometry, position, height, pending)
    return wp.where(plane < 0, likely, plane), height


@wp.func
def nearest_point(
    geometries: Geometries,
    features: Features,
    geometry: int,
    pair: CurvedPair,
    plane: int,
    lowest: vec3d,
    pending: wp.array(dtype=wp.int32),
):
    """Returns a point of the curved solid above a plane that is near the polyhedron: the lowest one, or one near its center.

    Also returns the plane above which it is highest, and its height above that plane [m]. ``lowest``: the lowest point [m].
    """
    highest, height = highest_plane(geometries, features, geometry, pair.own, plane, lowest, pending)
    if highest == plane:
        return lowest, highest, height
    other = near_point(pair, geometries.normal[geometries.plane_face[plane]])
    other_highest, other_height = highest_plane(geometries, features, geometry, pair.own, plane, other, pending)
    if other_height < height:
        return other, other_highest, other_height
    return lowest, highest, height


@wp.func
def separation_of_faces(
    geometries: Geometries,
    features: Features,
    geometry: int,
    pair: CurvedPair,
    hull: CurvedHull,
    likely: wp.vec4i,
    margin: double,
    tolerance: double,
    pending: wp.array(dtype=wp.int32),
):
    """Returns the ``CurvedSeparation`` of a convex polyhedron and a curved solid; the first one above ``margin`` if there is one.

    Args:
        geometries: The geometries.
        features: Their features.
        geometry: That of the polyhedron.
        pair: The pair.
        hull: The curved solid in the frame of the polyhedron.
        likely: The plane and the vertex of the last step, numbers of which may be invalid.
        margin: Separation that ends the search [m].
        tolerance: Rounding of separations [m].
        pending: Working memory of traversals.
    """
    result = CurvedSeparation()
    own = pair.own
    start = likely[0]
    if start < own.first_plane or start >= own.end_plane:
        center = moved(pair.pose, pair.other.center)
        start, _height = highest_plane(geometries, features, geometry, own, own.first_plane, center, pending)
    # From plane to plane, to the one above which a point near the last plane is highest, while the separation grows.
    result.distance = -double(wp.inf)
    plane = wp.int32(start)
    highest = wp.int32(start)
    height = double(wp.inf)
    near = vec3d()
    searching = wp.bool(True)
    while searching:
        distance, lowest = plane_separation(geometries, own, hull, plane)
        searching = distance > result.distance
        if searching:
            result.distance = distance
            result.plane = plane
            if distance > margin:
                return result
            near, highest, height = nearest_point(geometries, features, geometry, pair, plane, lowest, pending)
            result.near = near
            plane = highest
            searching = highest != result.plane and height > distance + tolerance
    if height > result.distance + tolerance:
        # The separation is at most the height of any point of the curved solid.
        start = result.plane
        for number in range(own.first_plane, own.end_plane):
            if height_above_plane(geometries, own, number, near) > result.distance:
                distance, lowest = plane_separation(geometries, own, hull, number)
                if distance > result.distance:
                    result.distance = distance
                    result.plane = number
                    result.near = lowest
                    if distance > margin:
                        return result
        if result.plane != start:
            near, highest, height = nearest_point(
                geometries, features, geometry, pair, result.plane, result.near, pending
            )
            result.near = near
    if height <= result.distance + tolerance:
        result.is_largest = height <= double(0.0)
        foot = result.near - height * geometries.normal[geometries.plane_face[highest]]
        for i in range(features.plane_start[highest], features.plane_start[highest + 1]):
            result.is_largest = result.is_largest or is_on_face(geometries, own, features.plane_face[i], foot)
    # Flat ends.
    first_corner = features.corner_start[geometry]
    vertex = features.corner[first_corner]
    if likely[1] >= vertex and likely[1] <= features.corner[features.corner_start[geometry + 1] - 1]:
        vertex = likely[1]
    ends = wp.int32(2)
    for k in range(ends):
        side = double(2 * k - 1)
        if flat_end(pair.other.flags, vec3d(double(0.0), double(0.0), side)) == 0:
            continue
        along = side * hull.axis
        middle = wp.where(k == 0, hull.first, hull.second)
        nearest = lowest_vertex(geometries, features, own, along, vertex)
        position = vertex_position(geometries, nearest, own)
        distance = wp.dot(along, position - middle)
        if distance > result.distance:
            result.distance = distance
            result.vertex = nearest
            result.end_normal = -along
            if distance > margin:
                return result
            # No separation is larger than the distance of a point of the polyhedron from the curved solid.
            found = nearest_surface_point(hull, position, True)
            result.is_largest = found.gap > -double(wp.inf) and found.gap <= distance + tolerance
    return result
