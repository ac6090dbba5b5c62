"""Separation of two convex solids along the normals of their faces, and normal to pairs of their edges.

The separation along an axis is the gap of the projections, negative in overlap. The largest one over all axes is the
distance of the solids, or the least displacement that separates them. Along the outward normal n of a face or edge of one
solid it is at most n·(x − p), with any point x of the other solid and a point p of the face or edge. A point near the face of
the largest separation, the *witness*, excludes most faces and edges by trees of their normals.
"""

import warp as wp
from warpcontact.kernels.body_contact.face_trees import PENDING_NODES
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, is_on_face, plane_offset
from warpcontact.kernels.manifolds.features import Features, moved, vertex_position
from warpcontact.kernels.manifolds.normal_trees import (
    NormalLeaf,
    height_above_plane,
    highest_plane_above,
    in_unit,
    next_normals,
)

double = wp.float64
vec3d = wp.vec3d

# Sine of the angle between two edges, below which they have no common normal.
NO_COMMON_NORMAL = wp.constant(double(1.0e-6))
# Number of times that a witness is moved, and the fraction of the way to the nearest vertex that it is moved too far, so that
# rounding does not return the same plane.
MOVES = wp.constant(4)
OVERSHOOT = wp.constant(double(1.0e-3))
# Number of edges of the second solid that are compared at a time, and of pending nodes of each traversal.
EDGES_AT_A_TIME = wp.constant(PENDING_NODES // 3)


@wp.struct
class PlaneSeparation:
    """Separation along the normal of a plane of a solid."""

    distance: double  # [m]
    plane: wp.int32  # of the solid
    vertex: wp.int32  # of the other solid, nearest to the plane
    witness: vec3d  # a point of the other solid, in the frame of the solid [m]
    # Whether the witness is above no plane by more than the separation; in overlap, by more than any that does not replace the plane.
    is_certain: wp.bool


@wp.struct
class EdgeSeparation:
    """Separation normal to two edges."""

    distance: double  # [m]
    edge_1: wp.int32  # of the first solid
    edge_2: wp.int32  # of the second solid
    normal: vec3d  # out of the second solid, in its frame


@wp.func
def separation_along(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    plane: int,
    other: SolidGeometry,
    pose: RelativePose,
    limit: double,
    likely: int,
):
    """Returns the separation of two solids along the normal of a plane of one [m], and the vertex of the other that is nearest.

    Below ``limit``, an upper bound and any vertex with it. ``pose``: pose of the other solid in the frame of the one with
    the plane. ``likely``: a vertex of the other solid, where the search starts.
    """
    face = geometries.plane_face[plane]
    normal = geometries.normal[face]
    shift = wp.dot(normal, pose.origin) - plane_offset(geometries, own, face)
    # Normal in the frame of the other solid, for positions in its unit.
    along = wp.cw_mul(wp.transpose(pose.rotation) * normal, other.scale)
    nearest = likely
    distance = wp.dot(along, geometries.vertex[likely]) + shift
    # From neighbor to neighbor: a vertex of a convex solid that is not the nearest has a nearer neighbor.
    current = wp.int32(-1)
    while nearest != current and distance >= limit:
        current = nearest
        for i in range(features.neighbor_start[current], features.neighbor_start[current + 1]):
            height = wp.dot(along, geometries.vertex[features.neighbor[i]]) + shift
            if height < distance:
                distance = height
                nearest = features.neighbor[i]
    return distance, nearest


@wp.func
def lowest_vertex(geometries: Geometries, features: Features, side: SolidGeometry, direction: vec3d, start: int):
    """Returns the vertex of a convex solid that is lowest along a direction of its frame, searched from ``start``."""
    along = wp.cw_mul(direction, side.scale)
    lowest = start
    least = wp.dot(along, geometries.vertex[start])
    current = wp.int32(-1)
    while lowest != current:
        current = lowest
        for i in range(features.neighbor_start[current], features.neighbor_start[current + 1]):
            height = wp.dot(along, geometries.vertex[features.neighbor[i]])
            if height < least:
                least = height
                lowest = features.neighbor[i]
    return lowest


@wp.func
def largest_plane_separation(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    own_geometry: int,
    other: SolidGeometry,
    other_geometry: int,
    pose: RelativePose,
    preferred_plane: int,
    likely_plane: int,
    likely_vertex: int,
    hysteresis: double,
    least: double,
    margin: double,
    pending: wp.array(dtype=wp.int32),
):
    """Returns the ``PlaneSeparation`` of the plane of a solid with the largest separation.

    Args:
        geometries: The geometries.
        features: Their features.
        own: The solid.
        own_geometry: Its geometry.
        other: The other solid.
        other_geometry: Its geometry.
        pose: Pose of the other solid in the frame of the solid.
        preferred_plane: This plane is returned if its separation is larger, less ``hysteresis``; −1: none.
        likely_plane: A plane of the solid, where the search starts; the number may be invalid.
        likely_vertex: A vertex of the other solid, likewise.
        hysteresis: Advantage of the preferred plane [m].
        least: Separation up to which planes do not matter: any of them may be returned [m].
        margin: The first plane with a larger separation is returned if there is one [m].
        pending: Working memory of ``PENDING_NODES`` numbers.
    """
    result = PlaneSeparation()
    first_corner = features.corner_start[other_geometry]
    likely = features.corner[first_corner]
    last = features.corner[features.corner_start[other_geometry + 1] - 1]
    if likely_vertex >= likely and likely_vertex <= last:
        likely = likely_vertex
    plane = own.first_plane
    if likely_plane >= own.first_plane and likely_plane < own.end_plane:
        plane = likely_plane
    if preferred_plane >= 0:
        plane = preferred_plane
    # Planes that the witness is above are compared. One whose separation is not larger excludes itself by a witness that is moved
    # towards its nearest vertex, on the line to which all points are in the other solid. After a few of them, all are compared.
    vertex = wp.int32(likely)
    limit = -double(wp.inf)
    height = double(0.0)
    leaf = NormalLeaf()
    moves = wp.int32(0)
    while True:
        distance, vertex = separation_along(geometries, features, own, plane, other, pose, limit, vertex)
        if moves == 0 or distance > limit:
            result.distance = distance
            result.plane = plane
            result.vertex = vertex
            if distance > margin:
                return result
            limit = distance
            if moves == 0:
                limit = wp.max(distance + wp.where(preferred_plane >= 0, hysteresis, double(0.0)), least)
        threshold = wp.min(limit, wp.max(result.distance, double(0.0)))
        if moves <= MOVES:
            nearest = moved(pose, vertex_position(geometries, vertex, other))
            if moves == 0:
                result.witness = nearest
            else:
                fraction = (height - threshold) / (height - distance) + OVERSHOOT
                result.witness += wp.min(fraction, double(1.0)) * (nearest - result.witness)
        moves += 1
        plane = wp.int32(-1)
        if moves <= MOVES:
            plane, height = highest_plane_above(
                geometries, features, own, own_geometry, result.witness, threshold, pending
            )
            result.is_certain = plane < 0
        else:
            if moves == MOVES + 1:
                pending[0] = features.plane_root[own_geometry]
                leaf.top = 1
            is_complete = wp.bool(False)
            while plane < 0 and not is_complete:
                if leaf.first == leaf.end:
                    leaf = next_normals(pending, 0, leaf.top, features, in_unit(own, result.witness, limit))
                    is_complete = leaf.first == leaf.end
                else:
                    plane = features.normal_item[leaf.first]
                    leaf.first += 1
                    if height_above_plane(geometries, own, plane, result.witness) <= limit:
                        plane = -1
        if plane < 0:
            break
    return result


@wp.func
def is_near_surface(geometries: Geometries, features: Features, own: SolidGeometry, plane: int, position: vec3d):
    """Returns whether a point is below a plane of a convex solid, or above one of the faces of the plane."""
    face = geometries.plane_face[plane]
    height = height_above_plane(geometries, own, plane, position)
    if height <= double(0.0):
        return True
    position -= height * geometries.normal[face]
    for i in range(features.plane_start[plane], features.plane_start[plane + 1]):
        if is_on_face(geometries, own, features.plane_face[i], position):
            return True
    return False


@wp.func
def arcs_cross(first_normal: vec3d, first_normal_2: vec3d, second_normal: vec3d, second_normal_2: vec3d):
    """Returns whether two edges with these normals of adjacent faces may touch each other.

    They do if the arcs of their normals, the second ones reversed, cross on the sphere of directions.
    """
    first_axis = wp.cross(first_normal, first_normal_2)
    second_axis = wp.cross(second_normal, second_normal_2)
    c = -wp.dot(second_normal, first_axis)
    d = -wp.dot(second_normal_2, first_axis)
    a = wp.dot(first_normal, second_axis)
    b = wp.dot(first_normal_2, second_axis)
    return c * d < double(0.0) and a * b < double(0.0) and c * b > double(0.0)


@wp.func
def common_normal(
    geometries: Geometries,
    edge_1: wp.vec4i,
    edge_2: wp.vec4i,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
):
    """Returns the unit normal of an edge of each solid, out of the second one, in its frame; zero if there is none."""
    start_1 = moved(pose, vertex_position(geometries, edge_1[0], first))
    along_1 = moved(pose, vertex_position(geometries, edge_1[1], first)) - start_1
    start_2 = vertex_position(geometries, edge_2[0], second)
    along_2 = vertex_position(geometries, edge_2[1], second) - start_2
    normal = wp.cross(along_1, along_2)
    length = wp.length(normal)
    if length <= NO_COMMON_NORMAL * wp.length(along_1) * wp.length(along_2):
        return vec3d()
    normal = normal / length
    outward = geometries.normal[edge_2[2]] + geometries.normal[edge_2[3]]
    if wp.dot(normal, outward) < double(0.0):
        normal = -normal
    return normal


@wp.func
def edge_bound(geometries: Geometries, edge: wp.vec4i, side: SolidGeometry, position: vec3d):
    """Returns an upper bound of the separation from another solid along the normals of a convex edge [m].

    It is the largest height of a point of the other solid above the edge along any normal between those of both faces.

    Args:
        geometries: The geometries.
        edge: Vertices and faces of the edge.
        side: Its solid.
        position: The point of the other solid, in the frame of the one with the edge [m].
    """
    n_1 = geometries.normal[edge[2]]
    n_2 = geometries.normal[edge[3]]
    between = position - vertex_position(geometries, edge[0], side)
    height_1 = wp.dot(n_1, between)
    height_2 = wp.dot(n_2, between)
    cosine = wp.dot(n_1, n_2)
    if height_1 > cosine * height_2 and height_2 > cosine * height_1:
        sine_squared = double(1.0) - cosine * cosine
        square = height_1 * height_1 + height_2 * height_2 - double(2.0) * cosine * height_1 * height_2
        return wp.sqrt(square / sine_squared)
    return wp.max(height_1, height_2)


@wp.func
def edge_of_geometry(features: Features, geometry: int, edge: int):
    """Returns an edge if it is a convex edge of a geometry; otherwise −1."""
    if edge < features.edge_start[geometry] or edge >= features.sharp_end[geometry]:
        return -1
    return edge


@wp.func
def separation_of_edges(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    edge_1: int,
    edge_2: int,
):
    """Returns the ``EdgeSeparation`` of an edge of each solid; −∞ and ``edge_1`` −1 if they cannot touch each other.

    ``pose``: pose of the first solid in the frame of the second one.
    """
    result = EdgeSeparation()
    result.distance = -double(wp.inf)
    result.edge_1 = -1
    own_1 = features.edge[edge_1]
    own_2 = features.edge[edge_2]
    n_1 = pose.rotation * geometries.normal[own_1[2]]
    n_2 = pose.rotation * geometries.normal[own_1[3]]
    if arcs_cross(n_1, n_2, geometries.normal[own_2[2]], geometries.normal[own_2[3]]):
        normal = common_normal(geometries, own_1, own_2, first, second, pose)
        if wp.length_sq(normal) > double(0.0):
            start_1 = moved(pose, vertex_position(geometries, own_1[0], first))
            result.distance = wp.dot(normal, start_1 - vertex_position(geometries, own_2[0], second))
            result.edge_1 = edge_1
            result.edge_2 = edge_2
            result.normal = normal
    return result


@wp.func
def largest_edge_separation(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    geometry_1: int,
    second: SolidGeometry,
    geometry_2: int,
    pose: RelativePose,
    position_1: vec3d,
    position_2: vec3d,
    start: EdgeSeparation,
    margin: double,
    near: wp.array(dtype=wp.int32),
):
    """Returns the ``EdgeSeparation`` of the pair of edges with the largest separation if it is above that of ``start``.

    Otherwise ``start``. The first pair with a separation above ``margin`` is returned if there is one.

    Args:
        geometries: The geometries.
        features: Their features.
        first: The first solid.
        geometry_1: Its geometry.
        second: The second solid.
        geometry_2: Its geometry.
        pose: Pose of the first solid in the frame of the second one.
        position_1: A point of the first solid, near the second one, in the frame of the second one [m].
        position_2: A point of the second solid, near the first one, in the frame of the first one [m].
        start: Pair of edges with a separation, or only a separation above which others matter.
        margin: Separation that ends the search [m].
        near: Working memory of ``PENDING_NODES`` numbers.
    """
    result = EdgeSeparation()
    result.distance = start.distance
    result.edge_1 = start.edge_1
    result.edge_2 = start.edge_2
    result.normal = start.normal
    room = wp.int32(EDGES_AT_A_TIME)
    point_1 = in_unit(second, position_1, start.distance)
    near[room] = features.edge_root[geometry_2]
    top_2 = room + 1
    item_2 = wp.int32(0)
    end_2 = wp.int32(0)
    is_complete = wp.bool(False)
    while not is_complete:
        # Some of the edges of the second solid that may touch, with all of the first one.
        count = wp.int32(0)
        while count < room and not is_complete:
            if item_2 == end_2:
                leaf = next_normals(near, room, top_2, features, point_1)
                item_2 = leaf.first
                end_2 = leaf.end
                top_2 = leaf.top
                is_complete = item_2 == end_2
            else:
                edge = features.normal_item[item_2]
                item_2 += 1
                if edge_bound(geometries, features.edge[edge], second, position_1) > result.distance:
                    near[count] = edge
                    count += 1
        if count == 0:
            break
        point_2 = in_unit(first, position_2, result.distance)
        near[2 * room] = features.edge_root[geometry_1]
        other = next_normals(near, 2 * room, 2 * room + 1, features, point_2)
        while other.end > other.first:
            for item_1 in range(other.first, other.end):
                i = features.normal_item[item_1]
                edge_1 = features.edge[i]
                if edge_bound(geometries, edge_1, first, position_2) <= result.distance:
                    continue
                n_1 = pose.rotation * geometries.normal[edge_1[2]]
                n_2 = pose.rotation * geometries.normal[edge_1[3]]
                start_1 = moved(pose, vertex_position(geometries, edge_1[0], first))
                for k in range(count):
                    edge_2 = features.edge[near[k]]
                    if not arcs_cross(n_1, n_2, geometries.normal[edge_2[2]], geometries.normal[edge_2[3]]):
                        continue
                    normal = common_normal(geometries, edge_1, edge_2, first, second, pose)
                    if wp.length_sq(normal) == double(0.0):
                        continue
                    distance = wp.dot(normal, start_1 - vertex_position(geometries, edge_2[0], second))
                    if distance > result.distance:
                        result.distance = distance
                        result.edge_1 = i
                        result.edge_2 = near[k]
                        result.normal = normal
                        if distance > margin:
                            return result
            point_2 = in_unit(first, position_2, result.distance)
            other = next_normals(near, 2 * room, other.top, features, point_2)
    return result


@wp.func
def closest_on_lines(start_1: vec3d, end_1: vec3d, start_2: vec3d, end_2: vec3d):
    """Returns the fractions of the closest points of two lines that are not parallel."""
    along_1 = end_1 - start_1
    along_2 = end_2 - start_2
    between = start_1 - start_2
    a = wp.dot(along_1, along_1)
    b = wp.dot(along_1, along_2)
    c = wp.dot(along_2, along_2)
    d = wp.dot(along_1, between)
    e = wp.dot(along_2, between)
    scale = a * c - b * b
    return (b * e - c * d) / scale, (a * e - b * d) / scale


@wp.func
def closest_on_edges(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    edge_1: int,
    edge_2: int,
):
    """Returns the points of two edges, that are not parallel, nearest to the closest points of their lines, in the second frame [m].

    ``pose``: pose of the first solid in the frame of the second one.
    """
    ends_1 = features.edge[edge_1]
    ends_2 = features.edge[edge_2]
    start_1 = moved(pose, vertex_position(geometries, ends_1[0], first))
    end_1 = moved(pose, vertex_position(geometries, ends_1[1], first))
    start_2 = vertex_position(geometries, ends_2[0], second)
    end_2 = vertex_position(geometries, ends_2[1], second)
    fraction_1, fraction_2 = closest_on_lines(start_1, end_1, start_2, end_2)
    point_1 = start_1 + wp.clamp(fraction_1, double(0.0), double(1.0)) * (end_1 - start_1)
    point_2 = start_2 + wp.clamp(fraction_2, double(0.0), double(1.0)) * (end_2 - start_2)
    return point_1, point_2
