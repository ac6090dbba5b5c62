"""Candidates for points from pairs of faces and pairs of edges, in the frame of the second solid."""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.candidates import (
    COSINE_STEP,
    DIRECTIONS,
    SINE_STEP,
    Candidate,
    Patch,
    across,
    add_candidate,
    axes_across,
)
from warpcontact.kernels.manifolds.face_clipping import (
    FACING,
    ClippedCorner,
    clip_outline,
    corner_feature,
    corner_height,
    corner_position,
    edge_after,
    heights_of_outline,
)
from warpcontact.kernels.manifolds.features import Feature, Features, edge_feature, moved, vertex_position
from warpcontact.kernels.manifolds.separation import closest_on_edges

double = wp.float64
vec3d = wp.vec3d


@wp.struct
class Reach:
    """Lengths that decide which points belong to a manifold."""

    margin: double  # largest gap of a point [m]
    depth: double  # largest depth of a point [m]
    size: double  # of the smaller solid [m]


@wp.struct
class ReferenceSide:
    """The solid with the reference face, and the other one."""

    own: SolidGeometry
    other: SolidGeometry
    pose: RelativePose  # of the other solid in the frame of the reference solid
    kappa: double  # points are at kappa × depth below the reference face
    is_second: wp.bool  # whether the reference solid is the second one


@wp.func
def faces_oppose(geometries: Geometries, side: ReferenceSide, reference_face: int, other_face: int):
    """Returns whether the outsides of two faces are towards each other."""
    normal = side.pose.rotation * geometries.normal[other_face]
    return wp.dot(geometries.normal[reference_face], normal) < -FACING


@wp.func
def width_of(corners: wp.array(dtype=ClippedCorner), first: int, count: int, normal: vec3d):
    """Returns the smallest width of a convex polygon in the plane normal to ``normal`` [m]."""
    width = double(wp.inf)
    for i in range(count):
        start = corner_position(corners[first + i])
        edge = across(corner_position(corners[first + wp.where(i == count - 1, 0, i + 1)]) - start, normal)
        length = wp.length(edge)
        if length == double(0.0):
            continue
        inward = wp.cross(normal, edge) / length
        farthest = double(0.0)
        for k in range(count):
            farthest = wp.max(farthest, wp.abs(wp.dot(inward, corner_position(corners[first + k]) - start)))
        width = wp.min(width, farthest)
    return width


@wp.func
def clip_within_reach(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    reference_face: int,
    reference_outline: int,
    other_face: int,
    other_outline: int,
    offset: double,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
):
    """Clips two outlines unless they are apart; returns the number of corners and the index of the first.

    ``offset``: of the reference plane along its normal [m].
    """
    normal = geometries.normal[reference_face]
    lowest, highest = heights_of_outline(
        geometries, features, side.other, side.pose, other_outline, normal, offset
    )
    if lowest > reach.margin or highest < -reach.depth:
        return 0, 0
    count, first = clip_outline(
        geometries, features, side.own, reference_face, reference_outline, side.other, other_face, other_outline,
        side.pose, reach.size, corners,
    )  # fmt: skip
    return count, first


@wp.func
def add_corners(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    second_frame: RelativePose,
    reference_face: int,
    reference_outline: int,
    other_face: int,
    other_outline: int,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
    first: int,
    count: int,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds the corners of a common area within reach as candidates of a patch.

    ``second_frame``: pose of the reference solid in the frame of the second solid.
    """
    normal = geometries.normal[reference_face]
    u_axis, v_axis = axes_across(normal)
    direction = u_axis
    # With many corners, the deepest and the extremes of some directions, as ``keep_extremes``.
    few = count <= DIRECTIONS
    for number in range(wp.where(few, count, DIRECTIONS + 1)):
        i = wp.int32(number)
        if not few:
            largest = -double(wp.inf)
            for k in range(count):
                value = -corner_height(corners[first + k])
                if number > 0:
                    value = wp.dot(direction, corner_position(corners[first + k]))
                if value > largest:
                    largest = value
                    i = k
            if number > 0:
                u = COSINE_STEP * wp.dot(direction, u_axis) - SINE_STEP * wp.dot(direction, v_axis)
                v = SINE_STEP * wp.dot(direction, u_axis) + COSINE_STEP * wp.dot(direction, v_axis)
                direction = u * u_axis + v * v_axis
        corner = corners[first + i]
        height = corner_height(corner)
        if height > reach.margin or height < -reach.depth:
            continue
        before = edge_after(corners[first + wp.where(i == 0, count - 1, i - 1)])
        feature = corner_feature(
            features, features.face_plane[reference_face], reference_outline, features.face_plane[other_face],
            other_outline, before, edge_after(corner), side.is_second,
        )  # fmt: skip
        position = corner_position(corner) - ((double(1.0) - side.kappa) * height) * normal
        add_candidate(patches, candidates, patch, moved(second_frame, position), height, feature)


@wp.func
def add_edges(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    edge_1: int,
    edge_2: int,
    normal: vec3d,
    kappa: double,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
):
    """Adds the crossing of two edges as a candidate of a patch.

    Args:
        geometries: The geometries.
        features: Their features.
        first: The first solid.
        second: The second solid.
        pose: Pose of the first solid in the frame of the second one.
        edge_1: Edge of the first solid.
        edge_2: Edge of the second solid, not parallel to the other one.
        normal: Their common normal, out of the second solid.
        kappa: The point is at kappa × the distance from the second edge.
        patches: The patches.
        candidates: Their candidates.
        patch: The patch.
    """
    point_1, point_2 = closest_on_edges(geometries, features, first, second, pose, edge_1, edge_2)
    feature = Feature()
    feature.first = edge_feature(edge_1)
    feature.second = edge_feature(edge_2)
    start_1 = moved(pose, vertex_position(geometries, features.edge[edge_1][0], first))
    gap = wp.dot(normal, start_1 - vertex_position(geometries, features.edge[edge_2][0], second))
    add_candidate(patches, candidates, patch, point_2 + kappa * (point_1 - point_2), gap, feature)
