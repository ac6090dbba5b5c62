"""Separation of two convex solids along the normals of their faces, and normal to pairs of their edges.

The separation along an axis is the gap of the projections, negative in overlap. The largest one over all axes is the
distance of the solids, or the least displacement that separates them.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, plane_offset
from warpcontact.kernels.manifolds.features import Features, moved, vertex_position

double = wp.float64
vec3d = wp.vec3d

# Sine of the angle between two edges, below which they have no common normal.
NO_COMMON_NORMAL = wp.constant(double(1.0e-6))


@wp.struct
class PlaneSeparation:
    """Separation along the normal of a plane of a solid."""

    distance: double  # [m]
    plane: wp.int32  # of the solid


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
    other_geometry: int,
    pose: RelativePose,
    limit: double,
):
    """Returns the separation of two solids along the normal of a plane of one [m]; below ``limit``, an upper bound.

    ``pose``: pose of the other solid in the frame of the one with the plane.
    """
    face = geometries.plane_face[plane]
    normal = geometries.normal[face]
    shift = wp.dot(normal, pose.origin) - plane_offset(geometries, own, face)
    # Normal in the frame of the other solid, for positions in its unit.
    along = wp.cw_mul(wp.transpose(pose.rotation) * normal, other.scale)
    distance = double(wp.inf)
    for i in range(features.corner_start[other_geometry], features.corner_start[other_geometry + 1]):
        distance = wp.min(distance, wp.dot(along, geometries.vertex[features.corner[i]]) + shift)
        if distance < limit:
            break
    return distance


@wp.func
def largest_plane_separation(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    other: SolidGeometry,
    other_geometry: int,
    pose: RelativePose,
    preferred_plane: int,
    hysteresis: double,
    margin: double,
):
    """Returns the ``PlaneSeparation`` of the plane of ``own`` with the largest separation.

    ``preferred_plane`` is returned if its separation is larger, less ``hysteresis``, and the first plane with a separation
    above ``margin`` if there is one.
    """
    result = PlaneSeparation()
    result.distance = -double(wp.inf)
    result.plane = preferred_plane
    preferred = -double(wp.inf)
    if preferred_plane >= 0:
        preferred = separation_along(
            geometries, features, own, preferred_plane, other, other_geometry, pose, -double(wp.inf)
        )
        result.distance = preferred
        if preferred > margin:
            return result
    limit = preferred + hysteresis
    for plane in range(own.first_plane, own.end_plane):
        distance = separation_along(geometries, features, own, plane, other, other_geometry, pose, limit)
        if distance > limit:
            limit = distance
            result.distance = distance
            result.plane = plane
            if distance > margin:
                break
    return result


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
def largest_edge_separation(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    geometry_1: int,
    second: SolidGeometry,
    geometry_2: int,
    pose: RelativePose,
    least: double,
    margin: double,
):
    """Returns the ``EdgeSeparation`` of the pair of edges with the largest separation above ``least``.

    The first pair with a separation above ``margin`` is returned if there is one. Without any, ``edge_1`` is −1.
    """
    result = EdgeSeparation()
    result.distance = least
    result.edge_1 = -1
    for i in range(features.edge_start[geometry_1], features.sharp_end[geometry_1]):
        edge_1 = features.edge[i]
        n_1 = pose.rotation * geometries.normal[edge_1[2]]
        n_2 = pose.rotation * geometries.normal[edge_1[3]]
        start_1 = moved(pose, vertex_position(geometries, edge_1[0], first))
        for k in range(features.edge_start[geometry_2], features.sharp_end[geometry_2]):
            edge_2 = features.edge[k]
            if not arcs_cross(n_1, n_2, geometries.normal[edge_2[2]], geometries.normal[edge_2[3]]):
                continue
            normal = common_normal(geometries, edge_1, edge_2, first, second, pose)
            if wp.length_sq(normal) == double(0.0):
                continue
            distance = wp.dot(normal, start_1 - vertex_position(geometries, edge_2[0], second))
            if distance > result.distance:
                result.distance = distance
                result.edge_1 = i
                result.edge_2 = k
                result.normal = normal
                if distance > margin:
                    return result
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
