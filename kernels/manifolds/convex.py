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
)
from warpcontact.kernels.manifolds.boxes import (
    box_corner,
    is_box,
    largest_box_edge_separation,
    largest_box_plane_separation,
)
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, add_candidate
from warpcontact.kernels.manifolds.collect import (
    Reach,
    ReferenceSide,
    add_edges,
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
from warpcontact.kernels.manifolds.reference_plane import add_reference_plane
from warpcontact.kernels.manifolds.separation import (
    EdgeSeparation,
    PlaneSeparation,
    closest_on_edges,
    edge_of_geometry,
    height_above_plane,
    is_near_surface,
    largest_edge_separation,
    largest_plane_separation,
    lowest_vertex,
    separation_of_edges,
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


@wp.struct
class Reference:
    """The reference of a pair of convex solids, and the planes and vertices with which the next search starts."""

    code: wp.int32  # from ``reference_code``, or EDGES
    # The planes of the first and second solid with the largest separation, and the vertices of the first and second solid
    # nearest to that of the other one, or −1 − number of the edges of a pair; a search starts with those of the last step.
    likely: wp.vec4i


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


@wp.func(inline=False)
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


@wp.func(inline=False)
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
    likely: wp.vec4i,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Collects the candidates of two bounded convex solids in the first patch; returns their ``Reference``.

    Args:
        geometries: The geometries.
        features: Their features.
        first: The first solid.
        geometry_1: Its geometry.
        second: The second solid.
        geometry_2: Its geometry.
        pose: Pose of the first solid in the frame of the second one.
        kappa: Points are at kappa × the gap from the second solid.
        previous: Code of the reference of the last step.
        likely: Planes and vertices of the last step, see ``Reference``.
        reach: Lengths that decide which points belong to the manifold.
        corners: Working memory of ``clip_face``.
        pending: Working memory of ``PENDING_NODES`` numbers.
        patches: The patches.
        candidates: Their candidates.
    """
    hysteresis = FACE_HYSTERESIS * reach.size
    to_first = inverse_pose(pose)
    plane_1 = previous_plane(previous, first, False)
    plane_2 = previous_plane(previous, second, True)
    are_boxes = is_box(features, geometry_1) and is_box(features, geometry_2)
    result = Reference()
    result.likely = likely
    second_separation = PlaneSeparation()
    first_separation = PlaneSeparation()
    bias = EDGE_BIAS * reach.size
    if previous == EDGES:
        bias = double(0.5) * bias
    is_flat = wp.bool(False)
    guess = EdgeSeparation()
    guess.distance = -double(wp.inf)
    guess.edge_1 = -1
    # Points of both solids near the other one, in its frame.
    position_1 = vec3d()
    position_2 = vec3d()
    if are_boxes:
        second_separation = largest_box_plane_separation(
            features, second, geometry_2, first, pose, plane_2, hysteresis
        )
        first_separation = largest_box_plane_separation(
            features, first, geometry_1, second, to_first, plane_1, hysteresis
        )
        normal_1 = geometries.normal[geometries.plane_face[first_separation.plane]]
        normal_2 = geometries.normal[geometries.plane_face[second_separation.plane]]
        position_1 = moved(pose, box_corner(first, -(to_first.rotation * normal_2)))
        position_2 = moved(to_first, box_corner(second, -(pose.rotation * normal_1)))
    else:
        # First the edges of the last step, which exclude planes that they replace.
        if previous == EDGES:
            edge_1 = edge_of_geometry(features, geometry_1, -1 - likely[2])
            edge_2 = edge_of_geometry(features, geometry_2, -1 - likely[3])
            if edge_1 >= 0 and edge_2 >= 0:
                guess = separation_of_edges(geometries, features, first, second, pose, edge_1, edge_2)
                if guess.distance > reach.margin:
                    result.code = EDGES
                    return result
                likely[2] = features.edge[edge_1][0]
                likely[3] = features.edge[edge_2][0]
        # Then the solid that had the reference face, or else the second one.
        starts_with_second = plane_1 < 0
        least = guess.distance - bias
        for number in range(2):
            own_is_second = starts_with_second == (number == 0)
            own = second
            own_geometry = geometry_2
            other = first
            other_geometry = geometry_1
            own_pose = pose
            preferred = plane_2
            likely_plane = likely[1]
            likely_vertex = likely[2]
            if not own_is_second:
                own = first
                own_geometry = geometry_1
                other = second
                other_geometry = geometry_2
                own_pose = to_first
                preferred = plane_1
                likely_plane = likely[0]
                likely_vertex = likely[3]
            found = largest_plane_separation(
                geometries, features, own, own_geometry, other, other_geometry, own_pose, preferred, likely_plane,
                likely_vertex, hysteresis, least, reach.margin, pending,
            )  # fmt: skip
            if own_is_second:
                second_separation = found
                position_1 = found.witness
                result.likely[1] = found.plane
                result.likely[2] = found.vertex
            else:
                first_separation = found
                position_2 = found.witness
                result.likely[0] = found.plane
                result.likely[3] = found.vertex
            if found.distance > reach.margin:
                result.code = reference_code(found.plane, own_is_second)
                return result
            least = wp.max(least, found.distance)
            if number == 0 and found.is_certain and guess.distance <= found.distance + bias:
                if is_near_surface(geometries, features, own, found.plane, found.witness):
                    # The witness is a point of both solids, or above a face. No axis has a larger separation by which another
                    # face, or edges, replace this face.
                    is_flat = True
                    height = height_above_plane(geometries, own, found.plane, found.witness)
                    normal = geometries.normal[geometries.plane_face[found.plane]]
                    on_own = found.witness - wp.max(height, double(0.0)) * normal
                    if own_is_second:
                        first_separation.distance = -double(wp.inf)
                        position_2 = moved(to_first, on_own)
                    else:
                        second_separation.distance = -double(wp.inf)
                        position_1 = moved(pose, on_own)
                    break
    if wp.max(first_separation.distance, second_separation.distance) > reach.margin:
        is_second = second_separation.distance > reach.margin
        result.code = reference_code(
            wp.where(is_second, second_separation.plane, first_separation.plane), is_second
        )
        return result
    is_second = first_separation.distance <= second_separation.distance + hysteresis
    if plane_1 >= 0:
        is_second = second_separation.distance > first_separation.distance + hysteresis
    distance = wp.max(first_separation.distance, second_separation.distance)
    relevant = wp.min(distance + bias, wp.max(reach.margin, distance))
    if are_boxes:
        edge_distance = largest_box_edge_separation(first, second, pose)
        if edge_distance > reach.margin:
            result.code = EDGES
            return result
        is_flat = edge_distance <= relevant

    side = ReferenceSide()
    second_frame = no_motion()
    plane = second_separation.plane
    nearest = second_separation.vertex
    side.own = second
    side.other = first
    side.pose = pose
    side.kappa = kappa
    side.is_second = is_second
    overlap = wp.max(-second_separation.distance, double(0.0))
    if not is_second:
        plane = first_separation.plane
        nearest = first_separation.vertex
        side.own = first
        side.other = second
        side.pose = to_first
        side.kappa = double(1.0) - kappa
        second_frame = pose
        overlap = wp.max(-first_separation.distance, double(0.0))
    normal = geometries.normal[geometries.plane_face[plane]]
    if are_boxes:
        other_geometry = wp.where(is_second, geometry_1, geometry_2)
        nearest = features.corner[features.corner_start[other_geometry]]
        along = wp.transpose(side.pose.rotation) * normal
        nearest = lowest_vertex(geometries, features, side.other, along, nearest)
    edges = EdgeSeparation()
    edges.edge_1 = -1
    for attempt in range(2):
        # At first edges that replace the face, or are apart; then all, if the face has no points.
        if attempt == 1 or not is_flat:
            if attempt == 0 and guess.distance > relevant:
                point_1, point_2 = closest_on_edges(
                    geometries, features, first, second, pose, guess.edge_1, guess.edge_2
                )
                position_1 = point_1
                position_2 = moved(to_first, point_2)
            else:
                guess.edge_1 = -1
                guess.distance = wp.where(attempt == 0, relevant, distance)
            edges = largest_edge_separation(
                geometries, features, first, geometry_1, second, geometry_2, pose, position_1, position_2, guess,
                reach.margin, pending,
            )  # fmt: skip
        if edges.edge_1 >= 0:
            # In the second attempt also nearly parallel edges that cross outside the common area of the faces.
            result.code = EDGES
            result.likely[2] = -1 - edges.edge_1
            result.likely[3] = -1 - edges.edge_2
            if edges.distance > reach.margin:
                return result
            patches[0].gap = double(wp.inf)
            patches[0].normal = edges.normal
            add_edges(
                geometries, features, first, second, pose, edges.edge_1, edges.edge_2, edges.normal, kappa, patches,
                candidates, 0,
            )  # fmt: skip
            return result
        if attempt == 0:
            patches[0].gap = double(wp.inf)
            patches[0].normal = normal
            if not is_second:
                patches[0].normal = -(pose.rotation * normal)
            add_reference_plane(
                geometries, features, side, second_frame, plane, overlap, nearest, reach, corners, pending, patches,
                candidates,
            )  # fmt: skip
            if patches[0].count > 0:
                break
    result.code = reference_code(plane, is_second)
    return result
