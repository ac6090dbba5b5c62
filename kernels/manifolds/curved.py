"""Manifolds of curved solids on half-spaces and on the faces, edges and vertices of polyhedra.

On a plane, the points of a curved solid are its lowest points: the point of a sphere or ellipsoid, the ends of the lowest line of
a capsule, cylinder or cone, and points of the circular edge of a flat end: the lowest one, and four that are fixed to the
solid, so that they are defined if it stands upright. On a face, they are cut by its edges. Edges and vertices of a polyhedron touch
a curved solid as another solid does (``curved_pairs.py``).
"""

import warp as wp
from warpcontact.kernels.body_contact.face_trees import next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, no_motion
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, bounding_box, plane_offset
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, add_candidate
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.convex import EDGE_BIAS, EDGES, NO_REFERENCE, Reference
from warpcontact.kernels.manifolds.curved_edge_points import add_edge_contact, add_edges, add_vertex_below_end
from warpcontact.kernels.manifolds.curved_edges import (
    EdgeContact,
    contact_with_edge,
    is_largest_of_all,
    largest_edge_contact,
)
from warpcontact.kernels.manifolds.curved_hull import CurvedHull, hull_of, lowest_of_hull
from warpcontact.kernels.manifolds.curved_separation import (
    CurvedPair,
    CurvedSeparation,
    Support,
    separation_of_faces,
    support_points,
)
from warpcontact.kernels.manifolds.face_clipping import ON_EDGE
from warpcontact.kernels.manifolds.features import (
    Feature,
    Features,
    edge_feature,
    moved,
    plane_feature,
    vertex_feature,
    vertex_position,
)
from warpcontact.kernels.manifolds.meshes import patch_for
from warpcontact.kernels.manifolds.separation import height_above_plane
from warpcontact.kernels.manifolds.support_features import (
    CIRCLE_ENTRY,
    CIRCLE_EXIT,
    COVERED,
    CUT_LINE,
    FACING_END,
    LINE_END,
    LINE_START,
    end_height,
    flat_end,
)

double = wp.float64
vec3d = wp.vec3d

# Distance relative to the size by which a face is preferred to the flat end of a curved solid as the reference.
PREFERENCE = wp.constant(double(1.0e-6))
# Distance relative to the size by which the lowest point may be deeper than those above a face.
FACE_HYSTERESIS = wp.constant(double(2.0e-4))
# Distance relative to the size by which points may be deeper than the overlap of a convex polyhedron and a curved solid.
SAME_DEPTH = wp.constant(double(1.0e-6))
# Rounding of separations, relative to the size.
ROUNDING = wp.constant(double(1.0e-12))


@wp.func
def add_curved_above(
    curved: SolidGeometry,
    plane: int,
    pose: RelativePose,
    kappa: double,
    reach: Reach,
    supports: wp.array(dtype=Support),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the points of a curved solid near a half-space z ≤ 0 as candidates of the first patch.

    ``plane``: number of its plane. ``pose``: of the curved solid in the frame of the half-space.
    """
    patches[0].normal = vec3d(double(0.0), double(0.0), double(1.0))
    patches[0].gap = double(wp.inf)
    direction = wp.transpose(pose.rotation) * vec3d(double(0.0), double(0.0), double(-1.0))
    count = support_points(curved.flags, curved.scale, direction, supports)
    for i in range(count):
        position = moved(pose, supports[i].position)
        gap = position[2]
        if gap <= reach.margin:
            position[2] = kappa * gap
            feature = Feature()
            feature.first = vertex_feature(supports[i].number)
            feature.second = plane_feature(plane)
            add_candidate(patches, candidates, 0, position, gap, feature)


@wp.struct
class FaceReference:
    """The normal along which gaps above a face are measured, and the patch of its points."""

    normal: vec3d  # out of the polyhedron, in its frame
    cosine: double  # of this normal and that of the face
    patch: wp.int32


@wp.func
def curved_feature(curved_number: int, own_feature: int, own_is_second: bool):
    """Returns the feature of a point of a curved solid on a feature of a polyhedron."""
    feature = Feature()
    feature.first = wp.where(own_is_second, vertex_feature(curved_number), own_feature)
    feature.second = wp.where(own_is_second, own_feature, vertex_feature(curved_number))
    return feature


@wp.func
def add_point(
    pair: CurvedPair,
    reference: FaceReference,
    position: vec3d,
    gap: double,
    curved_number: int,
    own_feature: int,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds a point of a curved solid with a gap from a face of the polyhedron as a candidate, if it is within reach."""
    if gap > reach.margin or gap < -reach.depth:
        return
    acting = position - ((double(1.0) - pair.kappa) * gap) * reference.normal
    feature = curved_feature(curved_number, own_feature, pair.own_is_second)
    add_candidate(patches, candidates, reference.patch, moved(pair.second_frame, acting), gap, feature)


@wp.func
def distance_inside(
    geometries: Geometries, features: Features, own: SolidGeometry, outline: int, normal: vec3d, position: vec3d
):
    """Returns the smallest distance of a point from the edges of an outline, in its plane; negative outside [m]."""
    last = features.outline_start[outline + 1]
    start = vertex_position(geometries, features.outline_vertex[last - 1], own)
    least = double(wp.inf)
    for i in range(features.outline_start[outline], last):
        end = vertex_position(geometries, features.outline_vertex[i], own)
        least = wp.min(least, wp.dot(wp.normalize(wp.cross(normal, end - start)), position - start))
        start = end
    return least


@wp.func
def add_line(
    geometries: Geometries,
    features: Features,
    pair: CurvedPair,
    face: int,
    outline: int,
    reference: FaceReference,
    start: vec3d,
    end: vec3d,
    start_height: double,
    end_height: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the ends of the part of a line of a curved solid that is above an outline of a face as candidates."""
    normal = geometries.normal[face]
    tolerance = ON_EDGE * reach.size
    first = double(0.0)
    last = double(1.0)
    first_edge = wp.int32(-1)
    last_edge = wp.int32(-1)
    last_corner = features.outline_start[outline + 1] - 1
    corner = vertex_position(geometries, features.outline_vertex[last_corner], pair.own)
    edge_number = features.outline_edge[last_corner]
    for i in range(features.outline_start[outline], last_corner + 1):
        following = vertex_position(geometries, features.outline_vertex[i], pair.own)
        inward = wp.normalize(wp.cross(normal, following - corner))
        at_start = wp.dot(inward, start - corner) + tolerance
        at_end = wp.dot(inward, end - corner) + tolerance
        if at_start < double(0.0) and at_end < double(0.0):
            return
        if (at_start < double(0.0)) != (at_end < double(0.0)):
            fraction = at_start / (at_start - at_end)
            if at_start < double(0.0) and fraction > first:
                first = fraction
                first_edge = edge_number
            elif at_end < double(0.0) and fraction < last:
                last = fraction
                last_edge = edge_number
        corner = following
        edge_number = features.outline_edge[i]
    lowest = wp.min(start_height, end_height)
    # A short part of a deep line is above a side wall of a polyhedron that is not convex.
    is_short = (last - first) * wp.length(end - start) < -lowest * reference.cosine
    if last < first or (is_short and not pair.is_convex):
        return
    own_feature = plane_feature(features.face_plane[face])
    number = wp.int32(LINE_START)
    if first_edge >= 0:
        own_feature = edge_feature(first_edge)
        number = CUT_LINE
    gap = reference.cosine * (start_height + first * (end_height - start_height))
    add_point(pair, reference, start + first * (end - start), gap, number, own_feature, reach, patches, candidates)
    own_feature = plane_feature(features.face_plane[face])
    number = LINE_END
    if last_edge >= 0:
        own_feature = edge_feature(last_edge)
        number = CUT_LINE
    gap = reference.cosine * (start_height + last * (end_height - start_height))
    add_point(pair, reference, start + last * (end - start), gap, number, own_feature, reach, patches, candidates)


@wp.func
def on_end(pair: CurvedPair, position: vec3d, normal: vec3d, z: double):
    """Returns the point of the plane of a flat end above a point of the polyhedron, in the frame of the curved solid.

    Also returns its height along ``normal``, the normal of the reference [m]. ``z``: coordinate of the flat end [m].
    """
    to_curved = wp.transpose(pair.pose.rotation)
    local = to_curved * (position - pair.pose.origin)
    along = to_curved * normal
    height = (z - local[2]) / along[2]
    return local + height * along, height


@wp.func
def add_flat_end(
    geometries: Geometries,
    features: Features,
    pair: CurvedPair,
    outline: int,
    reference: FaceReference,
    z: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the vertices of an outline below a flat end, and the crossings of its edges with the circular edge, as candidates."""
    normal = reference.normal
    radius = pair.other.scale[0]
    first = features.outline_start[outline]
    last = features.outline_start[outline + 1] - 1
    following = vertex_position(geometries, features.outline_vertex[first], pair.own)
    b, b_height = on_end(pair, following, normal, z)
    for i in range(first, last + 1):
        corner = vec3d(following)
        a = vec3d(b)
        a_height = double(b_height)
        following = vertex_position(
            geometries, features.outline_vertex[wp.where(i == last, first, i + 1)], pair.own
        )
        b, b_height = on_end(pair, following, normal, z)
        if a[0] * a[0] + a[1] * a[1] <= radius * radius:
            add_point(
                pair, reference, corner + a_height * normal, a_height, COVERED,
                vertex_feature(features.outline_vertex[i]), reach, patches, candidates,
            )  # fmt: skip
        # |a + t (b − a)|² = r² in the plane of the end.
        along = wp.vec2d(b[0] - a[0], b[1] - a[1])
        square = wp.dot(along, along)
        if square == double(0.0):
            continue
        middle = -(a[0] * along[0] + a[1] * along[1]) / square
        beyond = middle * middle - (a[0] * a[0] + a[1] * a[1] - radius * radius) / square
        if beyond <= double(0.0):
            continue
        for root in range(2):
            t = middle + wp.where(root == 0, -wp.sqrt(beyond), wp.sqrt(beyond))
            if t < double(0.0) or t > double(1.0):
                continue
            height = a_height + t * (b_height - a_height)
            position = corner + t * (following - corner) + height * normal
            number = wp.where(root == 0, CIRCLE_ENTRY, CIRCLE_EXIT)
            edge = edge_feature(features.outline_edge[i])
            add_point(pair, reference, position, height, number, edge, reach, patches, candidates)


@wp.func
def add_curved_on_face(
    geometries: Geometries,
    features: Features,
    pair: CurvedPair,
    hull: CurvedHull,
    face: int,
    outline: int,
    end_normal: vec3d,
    bias: double,
    reach: Reach,
    supports: wp.array(dtype=Support),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the points of a curved solid above an outline of a face of a polyhedron as candidates.

    Args:
        geometries: The geometries.
        features: Their features.
        pair: The pair.
        hull: The curved solid in the frame of the polyhedron.
        face: The face.
        outline: The outline.
        end_normal: Normal of the flat end with the largest separation of a convex pair, towards the curved solid; zero: none.
        bias: Distance by which the lowest point of a convex pair may be deeper than those above the outline [m].
        reach: Lengths that decide which points belong to the manifold.
        supports: Working memory of ``support_points``.
        patches: The patches.
        candidates: Their candidates.
    """
    normal = geometries.normal[face]
    offset = plane_offset(geometries, pair.own, face)
    lowest = wp.dot(normal, lowest_of_hull(hull, normal)) - offset
    direction = -(wp.transpose(pair.pose.rotation) * normal)
    flags = pair.other.flags
    side = flat_end(flags, direction)
    if lowest > reach.margin or (side == 0 and lowest < -reach.depth):
        return
    reference = FaceReference()
    reference.normal = normal
    reference.cosine = double(1.0)
    z = end_height(flags, pair.other.scale, side)
    if side != 0:
        # The flat end is the reference if the whole outline is farther from its plane than the end is from that of the face,
        # and the end is that with the largest separation of a convex pair.
        middle = moved(pair.pose, vec3d(double(0.0), double(0.0), z))
        axis = double(side) * hull.axis
        nearest = double(wp.inf)
        for i in range(features.outline_start[outline], features.outline_start[outline + 1]):
            corner = vertex_position(geometries, features.outline_vertex[i], pair.own)
            nearest = wp.min(nearest, wp.dot(axis, corner - middle))
        may_be_reference = not pair.is_convex or wp.dot(end_normal, axis) < double(0.0)
        if may_be_reference and nearest > lowest + PREFERENCE * reach.size:
            reference.normal = -axis
            reference.cosine = wp.dot(normal, reference.normal)
            lowest = nearest
        elif not pair.is_convex:
            # A flat end that extends over the face by less than it is deep touches another face.
            inside = distance_inside(geometries, features, pair.own, outline, normal, middle)
            if inside + pair.other.scale[0] < -lowest:
                return
    if lowest > reach.margin or lowest < -reach.depth:
        return
    normal_2 = pair.second_frame.rotation * reference.normal
    if not pair.own_is_second:
        normal_2 = -normal_2
    reference.patch = patch_for(patches, normal_2, lowest)
    if reference.patch < 0:
        return
    before = patches[reference.patch].count
    gap_before = patches[reference.patch].gap
    patches[reference.patch].gap = double(wp.inf)
    count = support_points(flags, pair.other.scale, direction, supports)
    start = moved(pair.pose, supports[0].position)
    start_height = wp.dot(normal, start) - offset
    plane = plane_feature(features.face_plane[face])
    tolerance = -ON_EDGE * reach.size
    if count == 1:
        if distance_inside(geometries, features, pair.own, outline, normal, start) >= tolerance:
            add_point(pair, reference, start, start_height, LINE_START, plane, reach, patches, candidates)
    else:
        end = moved(pair.pose, supports[1].position)
        line_end_height = wp.dot(normal, end) - offset
        add_line(
            geometries, features, pair, face, outline, reference, start, end, start_height, line_end_height, reach,
            patches, candidates,
        )  # fmt: skip
        for i in range(2, count):
            position = moved(pair.pose, supports[i].position)
            gap = reference.cosine * (wp.dot(normal, position) - offset)
            if gap > reach.margin:
                continue
            if distance_inside(geometries, features, pair.own, outline, normal, position) >= tolerance:
                add_point(pair, reference, position, gap, supports[i].number, plane, reach, patches, candidates)
        if side != 0:
            add_flat_end(geometries, features, pair, outline, reference, z, reach, patches, candidates)
    # If the lowest point is not above the face, an edge of the face, or of the solid, has the contact.
    if not pair.is_convex:
        bias = FACE_HYSTERESIS * reach.size
    if patches[reference.patch].gap > lowest + bias:
        patches[reference.patch].count = before
        patches[reference.patch].gap = double(wp.inf)
    patches[reference.patch].gap = wp.min(patches[reference.patch].gap, gap_before)


@wp.func
def add_deepest_point(
    geometries: Geometries,
    features: Features,
    pair: CurvedPair,
    hull: CurvedHull,
    best: CurvedSeparation,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the point with the largest separation along a face or flat end as a candidate, which need not be above it."""
    reference = FaceReference()
    reference.normal = best.end_normal
    number = wp.int32(COVERED)
    own_feature = vertex_feature(best.vertex)
    position = vertex_position(geometries, best.vertex, pair.own) + best.distance * reference.normal
    if best.vertex == 0:
        reference.normal = geometries.normal[geometries.plane_face[best.plane]]
        number = LINE_START
        own_feature = plane_feature(best.plane)
        position = lowest_of_hull(hull, reference.normal)
    normal_2 = pair.second_frame.rotation * reference.normal
    if not pair.own_is_second:
        normal_2 = -normal_2
    reference.patch = patch_for(patches, normal_2, best.distance)
    add_point(pair, reference, position, best.distance, number, own_feature, reach, patches, candidates)


@wp.func
def candidate_count(patches: wp.array(dtype=Patch)):
    """Returns the number of candidates of all patches."""
    found = wp.int32(0)
    for patch in range(patches.shape[0]):
        found += patches[patch].count
    return found


@wp.func
def smallest_gap(patches: wp.array(dtype=Patch)):
    """Returns the smallest gap of the candidates of all patches, infinite without any [m]."""
    gap = double(wp.inf)
    for patch in range(patches.shape[0]):
        if patches[patch].count > 0:
            gap = wp.min(gap, patches[patch].gap)
    return gap


@wp.func
def add_all_faces_and_edges(
    geometries: Geometries,
    features: Features,
    pair: CurvedPair,
    hull: CurvedHull,
    reach: Reach,
    supports: wp.array(dtype=Support),
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the points of a curved solid on all faces and convex edges of a polyhedron that is not convex as candidates."""
    box = bounding_box(pair.other, pair.pose, reach.margin)
    still = no_motion()
    kinds = wp.int32(2)
    for kind in range(kinds):
        leaf = next_leaf_in_box(
            pending, 0, start_traversal(pending, 0, pair.own), geometries, pair.own, still, box
        )
        while leaf.end_face > leaf.first_face:
            for face in range(leaf.first_face, leaf.end_face):
                if kind == 0:
                    add_edges(geometries, features, pair, hull, face, reach, patches, candidates)
                else:
                    add_curved_on_face(
                        geometries, features, pair, hull, face, face, vec3d(), double(0.0), reach, supports, patches,
                        candidates,
                    )  # fmt: skip
            leaf = next_leaf_in_box(pending, 0, leaf.top, geometries, pair.own, still, box)


@wp.func(inline=False)
def curved_manifold(
    geometries: Geometries,
    features: Features,
    geometry: int,
    pair: CurvedPair,
    previous: int,
    likely: wp.vec4i,
    reach: Reach,
    supports: wp.array(dtype=Support),
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Collects the candidates of a polyhedron and a curved solid in patches; returns their ``Reference``.

    Those of a convex polyhedron have the normal of the face or flat end with the largest separation, or of the edge if its
    separation is larger by more than a small bias, as those of two convex polyhedra.

    Args:
        geometries: The geometries.
        features: Their features.
        geometry: That of the polyhedron.
        pair: The pair.
        previous: Code of the reference of the last step.
        likely: The plane with the largest separation in the last step, the vertex nearest to a flat end, and 1 + the edge with the
            largest separation, or 0.
        reach: Lengths that decide which points belong to the manifold.
        supports: Working memory of ``support_points``.
        pending: Working memory of traversals.
        patches: The patches.
        candidates: Their candidates.
    """
    result = Reference()
    result.code = NO_REFERENCE
    result.likely = likely
    hull = hull_of(pair.other, pair.pose)
    if not pair.is_convex:
        add_all_faces_and_edges(geometries, features, pair, hull, reach, supports, pending, patches, candidates)
        return result
    infinite = double(wp.inf)
    edge = EdgeContact()
    edge.gap = -infinite
    # The edge of the last step first.
    number = likely[2] - 1
    if number >= features.edge_start[geometry] and number < features.sharp_end[geometry]:
        edge = contact_with_edge(geometries, features, pair.own, number, pair.other, pair.pose, hull, infinite)
        if edge.gap > reach.margin:
            return result
    best = separation_of_faces(
        geometries, features, geometry, pair, hull, likely, reach.margin, ROUNDING * reach.size, pending
    )
    result.likely = wp.vec4i(best.plane, best.vertex, 0, 0)
    if best.distance > reach.margin:
        return result
    bias = EDGE_BIAS * reach.size
    if previous == EDGES:
        bias = double(0.5) * bias
    tolerance = SAME_DEPTH * reach.size
    # Solids overlap by no more than along the best normal. Deeper points are those of other sides.
    reach.depth = tolerance - best.distance
    attempts = wp.int32(2)
    for attempt in range(attempts):
        # Without edges first, if none has a larger separation.
        if attempt == 1 or not best.is_largest:
            if not is_largest_of_all(hull, edge, ROUNDING * reach.size):
                edge = largest_edge_contact(
                    geometries, features, geometry, pair, hull, edge, best.near, -reach.depth, reach.margin
                )
            if edge.gap >= -reach.depth:
                result.likely[2] = 1 + edge.edge
                if edge.gap > reach.margin:
                    return result
                if attempt == 1 or edge.gap > best.distance + bias:
                    add_edge_contact(geometries, features, pair, edge, reach, patches, candidates)
                    result.code = EDGES
                    if attempt == 0 or candidate_count(patches) > 0:
                        return result
        if attempt == 1:
            # The largest separation of an ellipsoid that is deeper than its radii of curvature may be along any other direction.
            if best.distance < double(0.0):
                result.code = NO_REFERENCE
                add_deepest_point(geometries, features, pair, hull, best, reach, patches, candidates)
            return result
        for plane in range(pair.own.first_plane, pair.own.end_plane):
            # The lowest point is at most as high as any other one. A flat end may be the reference.
            face = geometries.plane_face[plane]
            is_near = best.vertex > 0 and wp.abs(wp.dot(geometries.normal[face], hull.axis)) > FACING_END
            if is_near or height_above_plane(geometries, pair.own, plane, best.near) >= -reach.depth:
                for i in range(features.plane_outline_start[plane], features.plane_outline_start[plane + 1]):
                    outline = features.plane_outline[i]
                    add_curved_on_face(
                        geometries, features, pair, hull, face, outline, best.end_normal, bias, reach, supports,
                        patches, candidates,
                    )  # fmt: skip
        if best.vertex > 0 and smallest_gap(patches) > best.distance + bias:
            add_vertex_below_end(geometries, features, geometry, pair, best, reach, patches, candidates)
        if candidate_count(patches) > 0:
            return result
    return result
