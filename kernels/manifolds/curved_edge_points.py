"""Points at which edges and vertices of a polyhedron touch a curved solid.

An edge touches a curved solid as another solid does (``support_features.py``): at the nearest points, and as a line.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, corner_count
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, across
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.curved_edges import PERPENDICULAR, EdgeContact, contact_with_edge, is_edge_apart
from warpcontact.kernels.manifolds.curved_hull import CurvedHull
from warpcontact.kernels.manifolds.curved_separation import CurvedPair, CurvedSeparation
from warpcontact.kernels.manifolds.features import Features, edge_feature, moved, vertex_feature, vertex_position
from warpcontact.kernels.manifolds.meshes import patch_for
from warpcontact.kernels.manifolds.support_features import (
    COVERED,
    LINE,
    LYING,
    NEAREST_POINT,
    CommonNormal,
    SupportFeature,
    add_common_points,
    add_pair_of_points,
    flat_end,
    support_feature,
)

double = wp.float64
vec3d = wp.vec3d


@wp.func
def edge_line(geometries: Geometries, features: Features, pair: CurvedPair, contact: EdgeContact):
    """Returns the ``SupportFeature`` of an edge of the polyhedron with a contact, in the frame of the second solid."""
    edge = features.edge[contact.edge]
    feature = SupportFeature()
    start = vertex_position(geometries, edge[0], pair.own)
    along = vertex_position(geometries, edge[1], pair.own) - start
    if wp.abs(wp.dot(contact.normal, along)) <= LYING * wp.length(along):
        feature.kind = LINE
    feature.start = moved(pair.second_frame, start)
    feature.end = moved(pair.second_frame, start + along)
    feature.start_number = vertex_feature(edge[0])
    feature.end_number = vertex_feature(edge[1])
    feature.number = edge_feature(contact.edge)
    return feature


@wp.func
def common_normal(pair: CurvedPair, normal: vec3d, gap: double, margin: double, patches: wp.array(dtype=Patch)):
    """Returns the ``CommonNormal`` of the curved solid and the polyhedron, and the pose of the curved solid in the second frame.

    ``normal``: out of the polyhedron, in its frame.
    """
    common = CommonNormal()
    common.normal = pair.second_frame.rotation * normal
    common.kappa = pair.kappa
    common.margin = margin
    common.is_swapped = not pair.own_is_second
    common.patch = patch_for(patches, wp.where(pair.own_is_second, common.normal, -common.normal), gap)
    curved_frame = RelativePose()
    curved_frame.rotation = pair.second_frame.rotation * pair.pose.rotation
    curved_frame.origin = moved(pair.second_frame, pair.pose.origin)
    return common, curved_frame


@wp.func
def is_along_end(pair: CurvedPair, normal: vec3d):
    """Returns whether a flat end of the curved solid is normal to a direction towards it."""
    local = wp.transpose(pair.pose.rotation) * normal
    sine = wp.sqrt(local[0] * local[0] + local[1] * local[1])
    return flat_end(pair.other.flags, -local) != 0 and sine <= PERPENDICULAR


@wp.func
def add_vertex_below_end(
    geometries: Geometries,
    features: Features,
    geometry: int,
    pair: CurvedPair,
    best: CurvedSeparation,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the vertex that is nearest to a flat end, and the crossings of its edges with the circular edge, as candidates.

    No face at the vertex is turned towards the flat end.
    """
    common, curved_frame = common_normal(pair, best.end_normal, best.distance, reach.margin, patches)
    if common.patch < 0:
        return
    end = support_feature(pair.other, curved_frame, -common.normal)
    position = moved(pair.second_frame, vertex_position(geometries, best.vertex, pair.own))
    if wp.length(across(position - end.center, end.axis)) <= end.radius:
        add_pair_of_points(
            common, position + best.distance * common.normal, position, best.distance, vertex_feature(COVERED),
            vertex_feature(best.vertex), patches, candidates,
        )  # fmt: skip
    contact = EdgeContact()
    contact.normal = best.end_normal
    for number in range(features.edge_start[geometry], features.sharp_end[geometry]):
        edge = features.edge[number]
        if edge[0] == best.vertex or edge[1] == best.vertex:
            contact.edge = number
            add_common_points(common, end, edge_line(geometries, features, pair, contact), patches, candidates)


@wp.func
def add_edge_contact(
    geometries: Geometries,
    features: Features,
    pair: CurvedPair,
    contact: EdgeContact,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the points at which an edge of a polyhedron, or an end of it, touches a curved solid as candidates."""
    if is_along_end(pair, contact.normal):
        # The flat end is the reference of a face next to the edge.
        return
    common, curved_frame = common_normal(pair, contact.normal, contact.gap, reach.margin, patches)
    if common.patch < 0:
        return
    other_feature = support_feature(pair.other, curved_frame, -common.normal)
    number = wp.where(contact.vertex >= 0, vertex_feature(contact.vertex), edge_feature(contact.edge))
    on_curved = moved(pair.second_frame, contact.on_curved)
    on_edge = moved(pair.second_frame, contact.on_edge)
    add_pair_of_points(
        common, on_curved, on_edge, contact.gap, vertex_feature(NEAREST_POINT), number, patches, candidates
    )
    add_common_points(common, other_feature, edge_line(geometries, features, pair, contact), patches, candidates)


@wp.func
def add_edges(
    geometries: Geometries,
    features: Features,
    pair: CurvedPair,
    hull: CurvedHull,
    face: int,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the contacts of the convex edges of a polyhedron whose first face it is as candidates."""
    for i in range(corner_count(geometries.face[face])):
        number = features.face_edge[face][i]
        edge = features.edge[number]
        if edge[2] != face or edge[3] < 0:
            continue
        start = vertex_position(geometries, edge[0], pair.own)
        end = vertex_position(geometries, edge[1], pair.own)
        if wp.dot(wp.cross(geometries.normal[face], geometries.normal[edge[3]]), end - start) <= double(0.0):
            continue
        if is_edge_apart(pair.other, pair.pose, start, end, reach.margin):
            continue
        contact = contact_with_edge(
            geometries, features, pair.own, number, pair.other, pair.pose, hull, reach.depth
        )
        if contact.gap <= reach.margin and contact.gap >= -reach.depth:
            add_edge_contact(geometries, features, pair, contact, reach, patches, candidates)
