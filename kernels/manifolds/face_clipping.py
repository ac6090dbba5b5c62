"""Corners of the common area of two outlines, as candidates for points.

An outline of the other solid is projected along the normal of a reference face and cut at the edges of its outline. Each corner is
a vertex of one of both outlines, or the crossing of an edge of one with an edge of the other.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import INFINITE, BoundingBox, SolidGeometry
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

# Cosine of two faces from which on they do not face each other: an angle of 1.15° from being normal to each other.
FACING = wp.constant(double(0.02))
# Distance from a cut, relative to the size, up to which a corner beyond it is inside.
ON_EDGE = wp.constant(double(1.0e-9))


def clip_buffer_size(outline_corners: int) -> int:
    """Returns the size of the working memory of ``clip_outline`` for outlines of at most so many corners.

    A common area has at most as many corners as both outlines together. The memory holds it twice: before and after a cut.
    """
    return 2 * (2 * outline_corners)


#: A corner of the common area of two outlines: its position on the other outline, in the frame of the reference solid, and its height
#: above the reference face, negative in overlap [m]; and the edge that follows: i ≥ 0: edge i of the other outline; below: edge
#: −1 − i of the reference outline. A vector, because compilers unroll the initialization of arrays of structs.
ClippedCorner = wp.types.vector(length=5, dtype=wp.float64)


@wp.func
def clipped_corner(position: vec3d, height: double, after: int):
    """Returns a ``ClippedCorner``."""
    return ClippedCorner(position[0], position[1], position[2], height, double(after))


@wp.func
def corner_position(corner: ClippedCorner):
    """Returns the position of a corner [m]."""
    return vec3d(corner[0], corner[1], corner[2])


@wp.func
def corner_height(corner: ClippedCorner):
    """Returns the height of a corner above the reference face [m]."""
    return corner[3]


@wp.func
def edge_after(corner: ClippedCorner):
    """Returns the number of the edge that follows."""
    return wp.int32(corner[4])


@wp.func
def outline_box(geometries: Geometries, features: Features, side: SolidGeometry, outline: int, margin: double):
    """Returns a box around an outline, ``margin`` larger on each side, in the frame of its solid."""
    box = BoundingBox()
    first = features.outline_start[outline]
    box.lower = vertex_position(geometries, features.outline_vertex[first], side)
    box.upper = box.lower
    for i in range(first + 1, features.outline_start[outline + 1]):
        position = vertex_position(geometries, features.outline_vertex[i], side)
        box.lower = wp.min(box.lower, position)
        box.upper = wp.max(box.upper, position)
    box.lower -= vec3d(margin, margin, margin)
    box.upper += vec3d(margin, margin, margin)
    return box


@wp.func
def heights_of_outline(
    geometries: Geometries,
    features: Features,
    other: SolidGeometry,
    pose: RelativePose,
    outline: int,
    normal: vec3d,
    offset: double,
):
    """Returns the smallest and largest height of the vertices of an outline above a plane n·x = offset [m].

    ``pose``: pose of the solid of the outline in the frame of the plane.
    """
    along = wp.cw_mul(wp.transpose(pose.rotation) * normal, other.scale)
    shift = wp.dot(normal, pose.origin) - offset
    lowest = double(wp.inf)
    highest = -double(wp.inf)
    for i in range(features.outline_start[outline], features.outline_start[outline + 1]):
        height = wp.dot(along, geometries.vertex[features.outline_vertex[i]]) + shift
        lowest = wp.min(lowest, height)
        highest = wp.max(highest, height)
    return lowest, highest


@wp.func
def low_vertices(
    geometries: Geometries,
    features: Features,
    other: SolidGeometry,
    pose: RelativePose,
    outline: int,
    normal: vec3d,
    limit: double,
):
    """Returns how many vertices of an outline are at most at the offset ``limit`` along ``normal`` [m].

    ``pose``: pose of the solid of the outline in the frame of the normal.
    """
    along = wp.cw_mul(wp.transpose(pose.rotation) * normal, other.scale)
    shift = wp.dot(normal, pose.origin) - limit
    count = wp.int32(0)
    for i in range(features.outline_start[outline], features.outline_start[outline + 1]):
        if wp.dot(along, geometries.vertex[features.outline_vertex[i]]) + shift <= double(0.0):
            count += 1
    return count


@wp.func
def is_outline_outside(
    geometries: Geometries,
    features: Features,
    other: SolidGeometry,
    pose: RelativePose,
    outline: int,
    box: BoundingBox,
):
    """Returns whether the bounding box of an outline is outside a box; ``pose``: pose of its solid in the frame of the box."""
    lower = vec3d(INFINITE, INFINITE, INFINITE)
    upper = -lower
    for i in range(features.outline_start[outline], features.outline_start[outline + 1]):
        position = moved(pose, vertex_position(geometries, features.outline_vertex[i], other))
        lower = wp.min(lower, position)
        upper = wp.max(upper, position)
    return wp.max(wp.max(lower - box.upper, box.lower - upper)) > double(0.0)


@wp.func
def clip_outline(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    reference_face: int,
    reference_outline: int,
    other: SolidGeometry,
    other_face: int,
    other_outline: int,
    pose: RelativePose,
    size: double,
    corners: wp.array(dtype=ClippedCorner),
):
    """Writes the corners of the common area of two outlines to ``corners``; returns their number and the first index.

    The outline with more vertices is cut at the edges of the other one.

    Args:
        geometries: The geometries.
        features: Their features.
        own: The solid of the reference face.
        reference_face: The reference face.
        reference_outline: An outline in its plane.
        other: The other solid.
        other_face: Its face.
        other_outline: An outline in the plane of this face.
        pose: Pose of the other solid in the frame of the reference solid.
        size: Length relative to which positions are rounded [m].
        corners: Working memory of ``clip_buffer_size`` corners.
    """
    normal = geometries.normal[reference_face]
    first_other = features.outline_start[other_outline]
    other_count = features.outline_start[other_outline + 1] - first_other
    first_own = features.outline_start[reference_outline]
    own_count = features.outline_start[reference_outline + 1] - first_own
    origin = vertex_position(geometries, features.outline_vertex[first_own], own)
    cuts_own = own_count > other_count
    if cuts_own:
        # The height of the plane of the other face above a point of the reference plane.
        other_normal = pose.rotation * geometries.normal[other_face]
        other_origin = moved(pose, vertex_position(geometries, features.outline_vertex[first_other], other))
        slope = wp.dot(other_normal, normal)
        for i in range(own_count):
            position = vertex_position(geometries, features.outline_vertex[first_own + i], own)
            height = wp.dot(other_normal, other_origin - position) / slope
            corners[i] = clipped_corner(position + height * normal, height, -1 - i)
    else:
        for i in range(other_count):
            # In the order of the reference outline, seen from its outside.
            k = other_count - 1 - i
            vertex = features.outline_vertex[first_other + k]
            position = moved(pose, vertex_position(geometries, vertex, other))
            # The edge from vertex k to vertex k − 1.
            after = wp.where(k == 0, other_count - 1, k - 1)
            corners[i] = clipped_corner(position, wp.dot(normal, position - origin), after)
    count = wp.where(cuts_own, own_count, other_count)
    cuts = wp.where(cuts_own, other_count, own_count)
    room = corners.shape[0] // 2
    source = wp.int32(0)
    start = vec3d()
    for cut in range(-1, cuts):
        # Edge of the reference outline from vertex ``cut − 1`` to ``cut``, or of the other one in the same order.
        edge = wp.where(cut == 0, cuts - 1, cut - 1)
        code = -1 - edge
        end = vec3d()
        if cuts_own:
            code = cuts - 1 - wp.where(cut < 0, cuts - 1, cut)
            end = moved(pose, vertex_position(geometries, features.outline_vertex[first_other + code], other))
        else:
            k = wp.where(cut < 0, cuts - 1, cut)
            end = vertex_position(geometries, features.outline_vertex[first_own + k], own)
        inward = wp.cross(normal, end - start)
        shift = -wp.dot(inward, start)
        start = end
        if cut < 0:
            continue
        length = wp.length(inward)
        inward = inward / length
        shift = shift / length + ON_EDGE * size
        least = double(0.0)
        for i in range(count):
            least = wp.min(least, wp.dot(inward, corner_position(corners[source + i])) + shift)
        if least == double(0.0):
            continue
        target = room - source
        kept = wp.int32(0)
        value = wp.dot(inward, corner_position(corners[source])) + shift
        for i in range(count):
            following = source + wp.where(i == count - 1, 0, i + 1)
            value_after = wp.dot(inward, corner_position(corners[following])) + shift
            inside = value >= double(0.0)
            if inside and kept < room:
                corners[target + kept] = corners[source + i]
                kept += 1
            if inside != (value_after >= double(0.0)) and kept < room:
                fraction = value / (value - value_after)
                corner = corners[source + i]
                code_after = wp.where(inside, code, edge_after(corner))
                corner = corner + fraction * (corners[following] - corner)
                corners[target + kept] = clipped_corner(corner_position(corner), corner_height(corner), code_after)
                kept += 1
            value = value_after
        source = target
        count = kept
        if count == 0:
            return 0, source
    return count, source


@wp.func
def corner_feature(
    features: Features,
    reference_plane: int,
    reference_outline: int,
    other_plane: int,
    other_outline: int,
    before: int,
    after: int,
    reference_is_second: bool,
):
    """Returns the ``Feature`` of a corner between two edges, numbered as in ``ClippedCorner``."""
    own = wp.int32(0)
    other = wp.int32(0)
    first_edge = features.outline_start[reference_outline]
    first_vertex = features.outline_start[other_outline]
    if before >= 0 and after >= 0:
        # Both edges run against the order of the outline: the later one starts at the vertex where the corner is.
        own = plane_feature(reference_plane)
        other = vertex_feature(features.outline_vertex[first_vertex + before])
    elif before < 0 and after < 0:
        own = vertex_feature(features.outline_vertex[first_edge - 1 - after])
        other = plane_feature(other_plane)
    else:
        own_edge = -1 - wp.min(before, after)
        other_edge = wp.max(before, after)
        own = edge_feature(features.outline_edge[first_edge + own_edge])
        other = edge_feature(features.outline_edge[first_vertex + other_edge])
    result = Feature()
    result.first = wp.where(reference_is_second, other, own)
    result.second = wp.where(reference_is_second, own, other)
    return result
