"""Manifold of two solids of which one is not convex, or an open surface.

Pairs of opposing faces touch where their common area, seen along the normal of one of them, has a small gap. Of both, the
face above whose plane the whole other face is higher is the reference. Areas that are narrower than deep are side walls that
overlap, and do not count. Faces with equal normals, within 1°, are one patch. Convex edges that cross are a patch of one point, unless
a patch of faces has their normal. If there are more than the arrays of a thread hold, those with the smallest gaps remain.
"""

import warp as wp
from warpcontact.kernels.body_contact.face_trees import next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.solids import (
    HAS_BOUNDARY,
    Geometries,
    RelativePose,
    corner_count,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    SolidGeometry,
    are_boxes_apart,
    bounding_box,
    plane_offset,
)
from warpcontact.kernels.manifolds.candidates import Candidate, Patch
from warpcontact.kernels.manifolds.collect import (
    Reach,
    ReferenceSide,
    add_corners,
    add_edges,
    clip_within_reach,
    faces_oppose,
    width_of,
)
from warpcontact.kernels.manifolds.face_clipping import (
    ClippedCorner,
    corner_height,
    heights_of_outline,
    outline_box,
)
from warpcontact.kernels.manifolds.features import Features, moved, vertex_position
from warpcontact.kernels.manifolds.separation import arcs_cross, closest_on_lines, common_normal

double = wp.float64
vec3d = wp.vec3d

# Cosine of the angle up to which two normals belong to one patch, 1°.
SAME_NORMAL = wp.constant(double(0.99984769515639))
# Depth along the normal of a face, relative to that of crossing edges of this face, below which only the face has a contact. Edges that
# are nearly parallel, such as those of a hole and of a part that lies on it, have common normals into the wall of the hole.
SHALLOW = wp.constant(double(0.1))
# Distance relative to the size by which the second solid is preferred as the reference.
PREFERENCE = wp.constant(double(1.0e-6))


@wp.func
def patch_for(patches: wp.array(dtype=Patch), normal: vec3d, gap: double):
    """Returns the patch for points with a normal, emptied if it is another one; −1 if all have smaller gaps.

    The first patch stores the smallest gap of areas without a patch.
    """
    worst = wp.int32(-1)
    largest = gap
    for patch in range(patches.shape[0]):
        if patches[patch].count == 0:
            patches[patch].normal = normal
            patches[patch].gap = double(wp.inf)
            return patch
        if wp.dot(patches[patch].normal, normal) > SAME_NORMAL:
            return patch
        if patches[patch].gap > largest:
            largest = patches[patch].gap
            worst = patch
    lost = gap
    if worst >= 0:
        lost = patches[worst].gap
        patches[worst].normal = normal
        patches[worst].gap = double(wp.inf)
        patches[worst].count = 0
    patches[0].lost_gap = wp.min(patches[0].lost_gap, lost)
    return worst


@wp.func
def add_crossing_edge(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    number_1: int,
    number_2: int,
    kappa: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the crossing of two convex edges as a patch of one point if they are within reach."""
    edge_1 = features.edge[number_1]
    edge_2 = features.edge[number_2]
    n_1 = pose.rotation * geometries.normal[edge_1[2]]
    n_2 = pose.rotation * geometries.normal[edge_1[3]]
    if not arcs_cross(n_1, n_2, geometries.normal[edge_2[2]], geometries.normal[edge_2[3]]):
        return
    normal = common_normal(geometries, edge_1, edge_2, first, second, pose)
    if wp.length_sq(normal) == double(0.0):
        return
    start_1 = moved(pose, vertex_position(geometries, edge_1[0], first))
    end_1 = moved(pose, vertex_position(geometries, edge_1[1], first))
    start_2 = vertex_position(geometries, edge_2[0], second)
    end_2 = vertex_position(geometries, edge_2[1], second)
    gap = wp.dot(normal, start_1 - start_2)
    if gap > reach.margin or gap < -reach.depth:
        return
    if gap < double(0.0):
        # Depth along the normals of the four faces, relative to that along the common normal.
        least = wp.min(wp.dot(normal, geometries.normal[edge_2[2]]), wp.dot(normal, geometries.normal[edge_2[3]]))
        least = wp.min(least, -wp.max(wp.dot(normal, n_1), wp.dot(normal, n_2)))
        if least < SHALLOW:
            return
    for patch in range(patches.shape[0]):
        if patches[patch].count > 0 and wp.dot(patches[patch].normal, normal) > SAME_NORMAL:
            return
    fraction_1, fraction_2 = closest_on_lines(start_1, end_1, start_2, end_2)
    inside = fraction_1 >= double(0.0) and fraction_1 <= double(1.0)
    if not (inside and fraction_2 >= double(0.0) and fraction_2 <= double(1.0)):
        return
    patch = patch_for(patches, normal, gap)
    if patch >= 0:
        add_edges(
            geometries,
            features,
            first,
            second,
            pose,
            number_1,
            number_2,
            normal,
            kappa,
            patches,
            candidates,
            patch,
        )


@wp.func
def owns_sharp_edge(features: Features, geometry: int, face: int, i: int):
    """Returns the edge ``i`` of a face if it is convex and the face is the first of its two faces; otherwise −1."""
    edge = features.face_edge[face][i]
    if edge >= features.sharp_end[geometry] or features.edge[edge][2] != face:
        return -1
    return edge


@wp.func
def add_crossing_edges(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    geometry_1: int,
    second: SolidGeometry,
    geometry_2: int,
    pose: RelativePose,
    kappa: double,
    reach: Reach,
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the crossings of convex edges within reach as patches of one point."""
    still = no_motion()
    box = bounding_box(first, pose, reach.margin)
    leaf = next_leaf_in_box(pending, 0, start_traversal(pending, 0, second), geometries, second, still, box)
    while leaf.end_face > leaf.first_face:
        for face_2 in range(leaf.first_face, leaf.end_face):
            near = outline_box(geometries, features, second, face_2, reach.margin)
            if are_boxes_apart(near, box):
                continue
            count_2 = corner_count(geometries.face[face_2])
            top = start_traversal(pending, leaf.top, first)
            other = next_leaf_in_box(pending, leaf.top, top, geometries, first, pose, near)
            while other.end_face > other.first_face:
                for face_1 in range(other.first_face, other.end_face):
                    count_1 = corner_count(geometries.face[face_1])
                    for k in range(count_2):
                        number_2 = owns_sharp_edge(features, geometry_2, face_2, k)
                        for i in range(count_1):
                            number_1 = owns_sharp_edge(features, geometry_1, face_1, i)
                            if number_1 >= 0 and number_2 >= 0:
                                add_crossing_edge(
                                    geometries, features, first, second, pose, number_1, number_2, kappa, reach,
                                    patches, candidates,
                                )  # fmt: skip
                other = next_leaf_in_box(pending, leaf.top, other.top, geometries, first, pose, near)
        leaf = next_leaf_in_box(pending, 0, leaf.top, geometries, second, still, box)


@wp.func
def add_face_pair(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    from_other: RelativePose,
    second_frame: RelativePose,
    reference_face: int,
    other_face: int,
    is_open: bool,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the corners of the common area of two faces as candidates if the first one is their reference.

    ``from_other``: pose of the reference solid in the frame of the other one. ``second_frame``: in that of the second one.
    ``is_open``: whether the reference solid is an open surface, which always has the reference face.
    """
    if not faces_oppose(geometries, side, reference_face, other_face):
        return
    normal = geometries.normal[reference_face]
    offset = plane_offset(geometries, side.own, reference_face)
    count, start = clip_within_reach(
        geometries, features, side, reference_face, reference_face, other_face, other_face, offset, reach, corners
    )
    if count == 0:
        return
    if not is_open:
        # The height of each whole face above the other one.
        other_offset = plane_offset(geometries, side.other, other_face)
        own_height, _highest = heights_of_outline(
            geometries, features, side.own, from_other, reference_face, geometries.normal[other_face], other_offset
        )
        other_height, _highest_2 = heights_of_outline(
            geometries, features, side.other, side.pose, other_face, normal, offset
        )
        preference = PREFERENCE * reach.size
        if other_height <= own_height - wp.where(side.is_second, preference, -preference):
            return
    gap = double(wp.inf)
    for i in range(count):
        gap = wp.min(gap, corner_height(corners[start + i]))
    if gap > reach.margin or (gap < double(0.0) and width_of(corners, start, count, normal) < -gap):
        return
    normal_2 = second_frame.rotation * normal
    if not side.is_second:
        normal_2 = -normal_2
    patch = patch_for(patches, normal_2, gap)
    if patch >= 0:
        add_corners(
            geometries, features, side, second_frame, reference_face, reference_face, other_face, other_face, reach,
            corners, start, count, patches, candidates, patch,
        )  # fmt: skip


@wp.func(inline=False)
def mesh_manifold(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    geometry_1: int,
    second: SolidGeometry,
    geometry_2: int,
    pose: RelativePose,
    kappa: double,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Collects the candidates of two bounded solids in patches.

    Arguments as ``convex.convex_manifold``; ``pending`` is working memory of traversals.
    """
    is_open = (second.flags & HAS_BOUNDARY) != 0
    still = no_motion()
    for number in range(wp.where(is_open, 1, 2)):
        side = ReferenceSide()
        second_frame = no_motion()
        side.own = second
        side.other = first
        side.pose = pose
        side.kappa = kappa
        side.is_second = True
        if number == 1:
            side.own = first
            side.other = second
            side.pose = inverse_pose(pose)
            side.kappa = double(1.0) - kappa
            side.is_second = False
            second_frame = pose
        from_other = inverse_pose(side.pose)
        box = bounding_box(side.other, side.pose, reach.margin)
        top = start_traversal(pending, 0, side.own)
        leaf = next_leaf_in_box(pending, 0, top, geometries, side.own, still, box)
        while leaf.end_face > leaf.first_face:
            for reference_face in range(leaf.first_face, leaf.end_face):
                near = outline_box(geometries, features, side.own, reference_face, reach.margin)
                if are_boxes_apart(near, box):
                    continue
                # Faces of the other solid may also be below.
                below = reach.depth * geometries.normal[reference_face]
                near.lower -= wp.max(below, vec3d())
                near.upper -= wp.min(below, vec3d())
                top = start_traversal(pending, leaf.top, side.other)
                other = next_leaf_in_box(pending, leaf.top, top, geometries, side.other, side.pose, near)
                while other.end_face > other.first_face:
                    for other_face in range(other.first_face, other.end_face):
                        add_face_pair(
                            geometries, features, side, from_other, second_frame, reference_face, other_face, is_open,
                            reach, corners, patches, candidates,
                        )  # fmt: skip
                    other = next_leaf_in_box(pending, leaf.top, other.top, geometries, side.other, side.pose, near)
            leaf = next_leaf_in_box(pending, 0, leaf.top, geometries, side.own, still, box)
    add_crossing_edges(
        geometries,
        features,
        first,
        geometry_1,
        second,
        geometry_2,
        pose,
        kappa,
        reach,
        pending,
        patches,
        candidates,
    )
