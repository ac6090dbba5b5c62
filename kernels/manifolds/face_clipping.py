"""Corners of the common area of two faces, as candidates for points.

A face of the other solid is projected along the normal of a reference face and cut at its edges. Each corner is a vertex of
the other face, a vertex of the reference face, or the crossing of an edge of one with an edge of the other.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, corner_count
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.features import (
    Feature,
    Features,
    edge_feature,
    moved,
    plane_feature,
    vertex_feature,
    vertex_position,
)

double = wp.float64
vec3d = wp.vec3d

#: Vertices of a face, and corners of a quadrilateral that is cut by the edges of another one.
FACE_CORNERS = 4
CLIPPED_CORNERS = 2 * FACE_CORNERS
# Cosine of two faces from which on they do not face each other: an angle of 1.15° from being normal to each other.
FACING = wp.constant(double(0.02))
# Distance from a cut, relative to the size, up to which a corner beyond it is inside.
ON_EDGE = wp.constant(double(1.0e-9))


@wp.struct
class ClippedCorner:
    """A corner of the common area of two faces."""

    position: vec3d  # on the other face, in the frame of the reference solid [m]
    # The edge that follows: 0 to 3 of the other face, FACE_CORNERS + (0 to 3) of the reference face.
    after: wp.int32
    height: double  # above the reference face, negative in overlap [m]


@wp.func
def heights_of_face(
    geometries: Geometries, other: SolidGeometry, pose: RelativePose, face: int, normal: vec3d, offset: double
):
    """Returns the smallest and largest height of the vertices of a face above a plane n·x = offset [m].

    ``pose``: pose of the solid of the face in the frame of the plane.
    """
    vertices = geometries.face[face]
    lowest = double(wp.inf)
    highest = -double(wp.inf)
    for i in range(corner_count(vertices)):
        height = wp.dot(normal, moved(pose, vertex_position(geometries, vertices[i], other))) - offset
        lowest = wp.min(lowest, height)
        highest = wp.max(highest, height)
    return lowest, highest


@wp.func
def clip_face(
    geometries: Geometries,
    own: SolidGeometry,
    reference_face: int,
    other: SolidGeometry,
    other_face: int,
    pose: RelativePose,
    size: double,
    corners: wp.array(dtype=ClippedCorner),
):
    """Writes the corners of the common area of two faces to ``corners``; returns their number and the first index.

    Args:
        geometries: The geometries.
        own: The solid of the reference face.
        reference_face: The reference face.
        other: The other solid.
        other_face: Its face.
        pose: Pose of the other solid in the frame of the reference solid.
        size: Length relative to which positions are rounded [m].
        corners: Working memory of two times ``CLIPPED_CORNERS``.
    """
    normal = geometries.normal[reference_face]
    vertices = geometries.face[other_face]
    count = corner_count(vertices)
    edges = geometries.face[reference_face]
    edge_count = corner_count(edges)
    origin = vertex_position(geometries, edges[0], own)
    for i in range(count):
        # In the order of the reference face, seen from its outside.
        k = count - 1 - i
        position = moved(pose, vertex_position(geometries, vertices[k], other))
        corners[i].position = position
        corners[i].height = wp.dot(normal, position - origin)
        # The edge from vertex k to vertex k − 1.
        corners[i].after = wp.where(k == 0, count - 1, k - 1)
    source = wp.int32(0)
    start = vertex_position(geometries, edges[edge_count - 1], own)
    for cut in range(edge_count):
        # Edge ``cut − 1``, from its vertex to the next one.
        edge = wp.where(cut == 0, edge_count - 1, cut - 1)
        end = vertex_position(geometries, edges[cut], own)
        inward = wp.normalize(wp.cross(normal, end - start))
        target = CLIPPED_CORNERS - source
        kept = wp.int32(0)
        for i in range(count):
            current = corners[source + i]
            following = corners[source + wp.where(i == count - 1, 0, i + 1)]
            value = wp.dot(inward, current.position - start) + ON_EDGE * size
            value_after = wp.dot(inward, following.position - start) + ON_EDGE * size
            inside = value >= double(0.0)
            inside_after = value_after >= double(0.0)
            if inside and kept < CLIPPED_CORNERS:
                corners[target + kept] = current
                kept += 1
            if inside != inside_after and kept < CLIPPED_CORNERS:
                fraction = value / (value - value_after)
                corners[target + kept].position = current.position + fraction * (
                    following.position - current.position
                )
                corners[target + kept].height = current.height + fraction * (following.height - current.height)
                corners[target + kept].after = wp.where(inside, FACE_CORNERS + edge, current.after)
                kept += 1
        start = end
        source = target
        count = kept
        if count == 0:
            return 0, source
    return count, source


@wp.func
def corner_feature(
    geometries: Geometries,
    features: Features,
    reference_face: int,
    other_face: int,
    before: int,
    after: int,
    reference_is_second: bool,
):
    """Returns the ``Feature`` of a corner between two edges, numbered as in ``ClippedCorner``."""
    own = wp.int32(0)
    other = wp.int32(0)
    if before < FACE_CORNERS and after < FACE_CORNERS:
        # Both edges run against the order of the face: the later one starts at the vertex where the corner is.
        vertices = geometries.face[other_face]
        own = plane_feature(features.face_plane[reference_face])
        other = vertex_feature(vertices[before])
    elif before >= FACE_CORNERS and after >= FACE_CORNERS:
        edges = geometries.face[reference_face]
        own = vertex_feature(edges[after - FACE_CORNERS])
        other = plane_feature(features.face_plane[other_face])
    else:
        own_edge = wp.where(before < FACE_CORNERS, after, before) - FACE_CORNERS
        other_edge = wp.where(before < FACE_CORNERS, before, after)
        own = edge_feature(features.face_edge[reference_face][own_edge])
        other = edge_feature(features.face_edge[other_face][other_edge])
    result = Feature()
    result.first = wp.where(reference_is_second, other, own)
    result.second = wp.where(reference_is_second, own, other)
    return result
