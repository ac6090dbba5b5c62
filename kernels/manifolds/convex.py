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
    box_corner,
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
)
from warpcontact.kernels.manifolds.face_clipping import (
    FACING,
    ClippedCorner,
    clip_outline,
    low_vertices,
    outline_box,
)
from warpcontact.kernels.manifolds.features import (
    Feature,
    Features,
    moved,
    outline_of_face,
    plane_feature,
    vertex_feature,
    vertex_position,
)
from warpcontact.kernels.manifolds.separation import (
    EdgeSeparation,
    PlaneSeparation,
    face_is_nearest,
    largest_edge_separation,
    largest_plane_separation,
)

double = wp.float64
vec3d = wp.vec3d

# Values of a reference that are no face: none, and two edges.
NO_REFERENCE, EDGES = wp.constant(0), wp.constant(-1)
# Faces that are clipped at a time, those of a leaf at most, and planes with several faces that are not clipped twice.
CLIPPED_FACES, LEAF_FACES, TREATED_PLANES = (wp.constant(i) for i in (32, 8, 16))
# Cosine of two faces from which on they are nearly parallel, 6°.
PARALLEL_FACES = wp.constant(double(0.9945))
# Rounding of separations, relative to the size.
ROUNDING = wp.constant(double(1.0e-12))
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
    # nearest to that of the other one; a search starts with those of the last step.
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
def add_reference_plane(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    second_frame: RelativePose,
    plane: int,
    overlap: double,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the corners of the common areas of a plane and the faces of the other solid as candidates of the first patch.

    Faces that are not nearly parallel to the plane, with at most two vertices within reach, add no points to those of their
    neighbors: of them, only the one that is most nearly parallel counts.

    ``overlap``: depth of the other solid below the plane [m]. ``second_frame``: pose of the reference solid in the frame of
    the second one.
    """
    reference_face = geometries.plane_face[plane]
    normal = geometries.normal[reference_face]
    offset = plane_offset(geometries, side.own, reference_face)
    # Normal in the frame of the other solid.
    along = wp.transpose(side.pose.rotation) * normal
    for number in range(features.plane_outline_start[plane], features.plane_outline_start[plane + 1]):
        reference_outline = features.plane_outline[number]
        box = outline_box(geometries, features, side.own, reference_outline, reach.margin)
        box.lower -= wp.max(overlap * normal, vec3d())
        box.upper -= wp.min(overlap * normal, vec3d())
        # Below the pending nodes: faces to be clipped, and planes of several faces that were treated.
        treated = wp.int32(0)
        steepest = wp.int32(-1)
        least = -FACING
        top = start_traversal(pending, CLIPPED_FACES + TREATED_PLANES, side.other)
        is_complete = wp.bool(False)
        while not is_complete:
            clipped = wp.int32(0)
            while clipped < CLIPPED_FACES - LEAF_FACES and not is_complete:
                leaf = next_leaf_in_box(
                    pending, CLIPPED_FACES + TREATED_PLANES, top, geometries, side.other, side.pose, box
                )
                top = leaf.top
                for other_face in range(leaf.first_face, leaf.end_face):
                    cosine = wp.dot(along, geometries.normal[other_face])
                    if cosine >= -FACING:
                        continue
                    other_plane = features.face_plane[other_face]
                    outline = outline_of_face(features, other_face)
                    is_treated = wp.bool(False)
                    if outline != other_face:
                        for i in range(CLIPPED_FACES, CLIPPED_FACES + treated):
                            is_treated = is_treated or pending[i] == other_plane
                        if not is_treated and treated < TREATED_PLANES:
                            pending[CLIPPED_FACES + treated] = other_plane
                            treated += 1
                    if is_treated:
                        continue
                    low = low_vertices(
                        geometries, features, side.other, side.pose, outline, normal, offset + reach.margin
                    )
                    if low == 0:
                        continue
                    if low > 2 or cosine < -PARALLEL_FACES:
                        pending[clipped] = other_face
                        clipped += 1
                        if cosine < least:
                            least = cosine
                            steepest = -1
                    elif cosine < least:
                        least = cosine
                        steepest = other_face
                is_complete = leaf.end_face == leaf.first_face
            if is_complete and steepest >= 0:
                pending[clipped] = steepest
                clipped += 1
            for i in range(clipped):
                other_face = pending[i]
                other_outline = outline_of_face(features, other_face)
                count, start = clip_outline(
                    geometries, features, side.own, reference_face, reference_outline, side.other, other_face,
                    other_outline, side.pose, reach.size, corners,
                )  # fmt: skip
                add_corners(
                    geometries, features, side, second_frame, reference_face, reference_outline, other_face,
                    other_outline, reach, corners, start, count, patches, candidates, 0,
                )  # fmt: skip


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
        # First the solid that had the reference face, or else the second one.
        starts_with_second = plane_1 < 0
        for number in range(2):
            own_is_second = starts_with_second == (number == 0)
            own = second
            other = first
            other_geometry = geometry_1
            own_pose = pose
            preferred = plane_2
            likely_plane = likely[1]
            likely_vertex = likely[2]
            if not own_is_second:
                own = first
                other = second
                other_geometry = geometry_2
                own_pose = to_first
                preferred = plane_1
                likely_plane = likely[0]
                likely_vertex = likely[3]
            found = largest_plane_separation(
                geometries, features, own, other, other_geometry, own_pose, preferred, likely_plane, likely_vertex,
                hysteresis, reach.margin,
            )  # fmt: skip
            position = moved(own_pose, vertex_position(geometries, found.vertex, other))
            if own_is_second:
                second_separation = found
                position_1 = position
                result.likely[1] = found.plane
                result.likely[2] = found.vertex
            else:
                first_separation = found
                position_2 = position
                result.likely[0] = found.plane
                result.likely[3] = found.vertex
            if found.distance > reach.margin:
                result.code = reference_code(found.plane, own_is_second)
                return result
            limit = found.distance + ROUNDING * reach.size
            if number == 0 and face_is_nearest(geometries, features, own, found, position, limit):
                # No axis has a larger separation.
                is_flat = True
                if own_is_second:
                    first_separation.distance = -double(wp.inf)
                else:
                    second_separation.distance = -double(wp.inf)
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
    if are_boxes:
        edge_distance = largest_box_edge_separation(first, second, pose)
        if edge_distance > reach.margin:
            result.code = EDGES
            return result
        is_flat = edge_distance <= distance

    side = ReferenceSide()
    second_frame = no_motion()
    plane = second_separation.plane
    side.own = second
    side.other = first
    side.pose = pose
    side.kappa = kappa
    side.is_second = is_second
    overlap = wp.max(-second_separation.distance, double(0.0))
    if not is_second:
        plane = first_separation.plane
        side.own = first
        side.other = second
        side.pose = to_first
        side.kappa = double(1.0) - kappa
        second_frame = pose
        overlap = wp.max(-first_separation.distance, double(0.0))
    normal = geometries.normal[geometries.plane_face[plane]]
    edges = EdgeSeparation()
    edges.edge_1 = -1
    for attempt in range(2):
        patches[0].gap = double(wp.inf)
        # Without edges first, if their separation is not larger than that of the faces.
        if attempt == 1 or not is_flat:
            edges = largest_edge_separation(
                geometries, features, first, geometry_1, second, geometry_2, pose, position_1, position_2, distance,
                reach.margin, pending,
            )  # fmt: skip
            if edges.edge_1 >= 0 and edges.distance > reach.margin:
                result.code = EDGES
                return result
        if edges.edge_1 < 0 or edges.distance <= distance + bias:
            patches[0].normal = normal
            if not is_second:
                patches[0].normal = -(pose.rotation * normal)
            add_reference_plane(
                geometries,
                features,
                side,
                second_frame,
                plane,
                overlap,
                reach,
                corners,
                pending,
                patches,
                candidates,
            )
            if patches[0].count > 0:
                result.code = reference_code(plane, is_second)
                return result
        if edges.edge_1 >= 0:
            # Also nearly parallel edges that cross outside the common area of the faces.
            patches[0].normal = edges.normal
            add_edges(
                geometries, features, first, second, pose, edges.edge_1, edges.edge_2, edges.normal, kappa, patches,
                candidates, 0,
            )  # fmt: skip
            result.code = EDGES
            return result
        if not is_flat:
            break
    result.code = reference_code(plane, is_second)
    return result
