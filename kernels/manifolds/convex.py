"""Manifold of two convex solids, or of any solid and a half-space.

The reference face is the one along whose normal the solids are separated most, or overlap least. The previous one, and the
second solid, are preferred by a small distance. If two edges are separated more than any face, the manifold is the point
where they cross; this advantage vanishes as the edges become parallel.
"""

import warp as wp
from warpcontact.kernels.body_contact.face_trees import next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.solids import (
    Geometries,
    RelativePose,
    corner_count,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    BoundingBox,
    SolidGeometry,
    plane_offset,
)
from warpcontact.kernels.manifolds.boxes import (
    is_box,
    largest_box_edge_separation,
    largest_box_plane_separation,
)
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, add_candidate
from warpcontact.kernels.manifolds.collect import (
    Reach,
    ReferenceSide,
    add_corners,
    add_edges,
    clip_within_reach,
    faces_oppose,
)
from warpcontact.kernels.manifolds.face_clipping import ClippedCorner
from warpcontact.kernels.manifolds.features import (
    Feature,
    Features,
    moved,
    plane_feature,
    vertex_feature,
    vertex_position,
)
from warpcontact.kernels.manifolds.separation import (
    EdgeSeparation,
    PlaneSeparation,
    largest_edge_separation,
    largest_plane_separation,
)

double = wp.float64
vec3d = wp.vec3d

# Values of a reference that are no face: none, and two edges.
NO_REFERENCE, EDGES = wp.constant(0), wp.constant(-1)
# Number of vertices up to which all are compared with a plane, without the tree of faces.
FEW_VERTICES = wp.constant(64)
# Distances relative to the size by which the previous reference face, and faces rather than edges, are preferred.
FACE_HYSTERESIS = wp.constant(double(2.0e-4))
EDGE_BIAS = wp.constant(double(1.0e-3))


@wp.func
def reference_code(plane: int, is_second: bool):
    """Returns the code of a reference face, stored from step to step."""
    return 1 + 2 * plane + wp.where(is_second, 0, 1)


@wp.func
def previous_plane(reference: int, side: SolidGeometry, is_second: bool):
    """Returns the plane of a reference if it belongs to a solid; otherwise −1."""
    if reference <= 0:
        return -1
    plane = (reference - 1) // 2
    on_second = (reference - 1) % 2 == 0
    if on_second != is_second or plane < side.first_plane or plane >= side.end_plane:
        return -1
    return plane


@wp.func
def add_vertex_below(
    geometries: Geometries,
    vertex: int,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    kappa: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds a vertex of a solid as a candidate of the first patch if it is near a half-space z ≤ 0."""
    position = moved(pose, vertex_position(geometries, vertex, first))
    if position[2] <= reach.margin:
        feature = Feature()
        feature.first = vertex_feature(vertex)
        feature.second = plane_feature(second.first_plane)
        gap = position[2]
        position[2] = kappa * gap
        add_candidate(patches, candidates, 0, position, gap, feature)


@wp.func
def add_vertices_below(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    geometry_1: int,
    second: SolidGeometry,
    pose: RelativePose,
    kappa: double,
    reach: Reach,
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the vertices of a solid near a half-space z ≤ 0 as candidates of the first patch."""
    patches[0].normal = vec3d(double(0.0), double(0.0), double(1.0))
    patches[0].gap = double(wp.inf)
    start = features.corner_start[geometry_1]
    end = features.corner_start[geometry_1 + 1]
    if end - start <= FEW_VERTICES:
        for i in range(start, end):
            add_vertex_below(
                geometries, features.corner[i], first, second, pose, kappa, reach, patches, candidates
            )
        return
    box = BoundingBox()
    box.lower = vec3d(-INFINITE, -INFINITE, -INFINITE)
    box.upper = vec3d(INFINITE, INFINITE, reach.margin)
    leaf = next_leaf_in_box(pending, 0, start_traversal(pending, 0, first), geometries, first, pose, box)
    while leaf.end_face > leaf.first_face:
        for face in range(leaf.first_face, leaf.end_face):
            vertices = geometries.face[face]
            for i in range(corner_count(vertices)):
                add_vertex_below(geometries, vertices[i], first, second, pose, kappa, reach, patches, candidates)
        leaf = next_leaf_in_box(pending, 0, leaf.top, geometries, first, pose, box)


@wp.func
def convex_manifold(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    geometry_1: int,
    second: SolidGeometry,
    geometry_2: int,
    pose: RelativePose,
    kappa: double,
    previous: int,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Collects the candidates of two bounded convex solids in the first patch; returns the code of the reference.

    Args:
        geometries: The geometries.
        features: Their features.
        first: The first solid.
        geometry_1: Its geometry.
        second: The second solid.
        geometry_2: Its geometry.
        pose: Pose of the first solid in the frame of the second one.
        kappa: Points are at kappa × the gap from the second solid.
        previous: Reference of the last step.
        reach: Lengths that decide which points belong to the manifold.
        corners: Working memory of ``clip_face``.
        patches: The patches.
        candidates: Their candidates.
    """
    hysteresis = FACE_HYSTERESIS * reach.size
    to_first = inverse_pose(pose)
    plane_1 = previous_plane(previous, first, False)
    plane_2 = previous_plane(previous, second, True)
    are_boxes = is_box(features, geometry_1) and is_box(features, geometry_2)
    second_separation = PlaneSeparation()
    first_separation = PlaneSeparation()
    if are_boxes:
        second_separation = largest_box_plane_separation(
            features, second, geometry_2, first, pose, plane_2, hysteresis
        )
    else:
        second_separation = largest_plane_separation(
            geometries, features, second, first, geometry_1, pose, plane_2, hysteresis, reach.margin
        )
    if second_separation.distance > reach.margin:
        return reference_code(second_separation.plane, True)
    if are_boxes:
        first_separation = largest_box_plane_separation(
            features, first, geometry_1, second, to_first, plane_1, hysteresis
        )
    else:
        first_separation = largest_plane_separation(
            geometries, features, first, second, geometry_2, to_first, plane_1, hysteresis, reach.margin
        )
    if first_separation.distance > reach.margin:
        return reference_code(first_separation.plane, False)
    is_second = first_separation.distance <= second_separation.distance + hysteresis
    if plane_1 >= 0:
        is_second = second_separation.distance > first_separation.distance + hysteresis
    distance = wp.max(first_separation.distance, second_separation.distance)
    bias = EDGE_BIAS * reach.size
    if previous == EDGES:
        bias = double(0.5) * bias
    # Edges whose separation is not larger than that of the faces need no search.
    edges_matter = wp.bool(True)
    if are_boxes:
        edge_distance = largest_box_edge_separation(first, second, pose)
        if edge_distance > reach.margin:
            return EDGES
        edges_matter = edge_distance > distance
    edges = EdgeSeparation()
    edges.edge_1 = -1
    if edges_matter:
        edges = largest_edge_separation(
            geometries, features, first, geometry_1, second, geometry_2, pose, distance, reach.margin
        )
    patches[0].gap = double(wp.inf)
    if edges.edge_1 >= 0 and edges.distance > reach.margin:
        return EDGES
    if edges.edge_1 >= 0 and edges.distance > distance + bias:
        patches[0].normal = edges.normal
        add_edges(
            geometries, features, first, second, pose, edges.edge_1, edges.edge_2, edges.normal, kappa, patches,
            candidates, 0,
        )  # fmt: skip
        return EDGES

    side = ReferenceSide()
    second_frame = no_motion()
    plane = second_separation.plane
    side.own = second
    side.other = first
    side.pose = pose
    side.kappa = kappa
    side.is_second = is_second
    if not is_second:
        plane = first_separation.plane
        side.own = first
        side.other = second
        side.pose = to_first
        side.kappa = double(1.0) - kappa
        second_frame = pose
    normal = geometries.normal[geometries.plane_face[plane]]
    patches[0].normal = normal
    if not is_second:
        patches[0].normal = -(pose.rotation * normal)
    offset = plane_offset(geometries, side.own, geometries.plane_face[plane])
    for number in range(features.plane_start[plane], features.plane_start[plane + 1]):
        reference_face = features.plane_face[number]
        for other_face in range(side.other.first_face, side.other.end_face):
            if not faces_oppose(geometries, side, reference_face, other_face):
                continue
            count, start = clip_within_reach(geometries, side, reference_face, other_face, offset, reach, corners)
            add_corners(
                geometries, features, side, second_frame, reference_face, other_face, reach, corners, start, count,
                patches, candidates, 0,
            )  # fmt: skip
    if edges.edge_1 >= 0 and patches[0].count == 0:
        # Nearly parallel edges that cross outside the common area of the faces.
        patches[0].normal = edges.normal
        add_edges(
            geometries, features, first, second, pose, edges.edge_1, edges.edge_2, edges.normal, kappa, patches,
            candidates, 0,
        )  # fmt: skip
        return EDGES
    return reference_code(plane, is_second)
