"""Contact of edges and vertices of a polyhedron with spheres, capsules, and the curved surface of cylinders.

These are the points within a radius of an axis, so the normal is that from the nearest point of an edge to that of the axis.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CYLINDER, ELLIPSOID
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, corner_count
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, add_candidate
from warpcontact.kernels.manifolds.circular_edges import circular_edge_contact
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.features import (
    Feature,
    Features,
    edge_feature,
    moved,
    vertex_feature,
    vertex_position,
)
from warpcontact.kernels.manifolds.meshes import patch_for

double = wp.float64
vec3d = wp.vec3d

#: Number of the point at which edges and vertices touch a curved surface.
AXIS_POINT = 14
#: Numbers of the points at which edges touch the circular edges of a cylinder.
CIRCLE_POINT = 15
# Cosine up to which a direction counts as perpendicular to an edge or face.
PERPENDICULAR = wp.constant(double(1.0e-9))


@wp.func
def curved_feature(curved_number: int, own_feature: int, own_is_second: bool):
    """Returns the feature of a point of a curved solid on a feature of a polyhedron."""
    feature = Feature()
    feature.first = wp.where(own_is_second, vertex_feature(curved_number), own_feature)
    feature.second = wp.where(own_is_second, own_feature, vertex_feature(curved_number))
    return feature


@wp.func
def nearest_on_segments(start_1: vec3d, along_1: vec3d, start_2: vec3d, along_2: vec3d):
    """Returns the fractions of the nearest points of two segments; the first one may be a point."""
    between = start_1 - start_2
    a = wp.dot(along_1, along_1)
    b = wp.dot(along_1, along_2)
    c = wp.dot(along_2, along_2)
    d = wp.dot(along_1, between)
    e = wp.dot(along_2, between)
    scale = a * c - b * b
    first = double(0.5)
    if scale > PERPENDICULAR * PERPENDICULAR * a * c:
        first = wp.clamp((b * e - c * d) / scale, double(0.0), double(1.0))
    second = wp.clamp((b * first + e) / c, double(0.0), double(1.0))
    if a > double(0.0):
        first = wp.clamp((b * second - d) / a, double(0.0), double(1.0))
    return first, second


@wp.func
def leaves_face(
    geometries: Geometries,
    own: SolidGeometry,
    face: int,
    vertex: int,
    at_vertex: bool,
    start: vec3d,
    end: vec3d,
    direction: vec3d,
):
    """Returns whether a direction from an edge of a face leads away from the face, and from its other edge at a vertex.

    ``vertex``: the vertex, if ``at_vertex``. ``start``, ``end``: ends of the edge [m].
    """
    normal = geometries.normal[face]
    vertices = geometries.face[face]
    count = corner_count(vertices)
    # Inward in the plane of the face, for any order of the ends.
    inward = wp.normalize(wp.cross(normal, end - start))
    total = vec3d()
    for i in range(count):
        total += vertex_position(geometries, vertices[i], own) - start
    if wp.dot(inward, total) < double(0.0):
        inward = -inward
    if not at_vertex:
        return wp.dot(direction, inward) <= PERPENDICULAR
    place = vertex_position(geometries, vertex, own)
    for i in range(count):
        following = wp.where(i == count - 1, 0, i + 1)
        neighbor = wp.int32(-1)
        if vertices[i] == vertex:
            neighbor = vertices[following]
        elif vertices[following] == vertex:
            neighbor = vertices[i]
        if neighbor >= 0:
            edge = wp.normalize(vertex_position(geometries, neighbor, own) - place)
            if wp.dot(direction, edge) > PERPENDICULAR:
                return False
    return True


@wp.func
def add_edges_of_face(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    face: int,
    other: SolidGeometry,
    pose: RelativePose,
    second_frame: RelativePose,
    kappa: double,
    own_is_second: bool,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the contacts of convex edges of a face, and of their ends, with a curved solid as candidates.

    Arguments as ``curved.CurvedPair``. Only edges whose first face it is are added.
    """
    if (other.flags & (ELLIPSOID | CAPSULE | CYLINDER)) == 0:
        return
    radius = other.scale[0]
    half = double(0.0)
    if (other.flags & CAPSULE) != 0:
        half = other.scale[2] - radius
    elif (other.flags & CYLINDER) != 0:
        half = other.scale[2]
    axis = half * (pose.rotation * vec3d(double(0.0), double(0.0), double(1.0)))
    vertices = geometries.face[face]
    for i in range(corner_count(vertices)):
        number = features.face_edge[face][i]
        edge = features.edge[number]
        if edge[2] != face or edge[3] < 0:
            continue
        normal_1 = geometries.normal[edge[2]]
        normal_2 = geometries.normal[edge[3]]
        start = vertex_position(geometries, edge[0], own)
        end = vertex_position(geometries, edge[1], own)
        if wp.dot(wp.cross(normal_1, normal_2), end - start) <= double(0.0):
            # Flat or concave.
            continue
        if (other.flags & CYLINDER) != 0:
            for side in range(2):
                contact = circular_edge_contact(
                    other, pose, wp.where(side == 0, -1, 1), start, end, normal_1 + normal_2, reach.margin
                )
                if contact.found == 0:
                    continue
                if not leaves_face(geometries, own, edge[2], 0, False, start, end, contact.normal):
                    continue
                if not leaves_face(geometries, own, edge[3], 0, False, start, end, contact.normal):
                    continue
                out_of_second = second_frame.rotation * contact.normal
                if not own_is_second:
                    out_of_second = -out_of_second
                patch = patch_for(patches, out_of_second, contact.gap)
                if patch >= 0:
                    feature = curved_feature(CIRCLE_POINT + side, edge_feature(number), own_is_second)
                    acting = moved(second_frame, contact.place + (kappa * contact.gap) * contact.normal)
                    add_candidate(patches, candidates, patch, acting, contact.gap, feature)
        first, second = nearest_on_segments(pose.origin - axis, double(2.0) * axis, start, end - start)
        if (other.flags & CYLINDER) != 0 and (first <= double(0.0) or first >= double(1.0)):
            continue
        place = start + second * (end - start)
        difference = pose.origin + (double(2.0) * first - double(1.0)) * axis - place
        distance = wp.length(difference)
        gap = distance - radius
        if distance <= double(0.0) or gap > reach.margin or gap < -reach.depth:
            continue
        direction = difference / distance
        at_vertex = second <= double(0.0) or second >= double(1.0)
        vertex = wp.where(second <= double(0.0), edge[0], edge[1])
        if not leaves_face(geometries, own, edge[2], vertex, at_vertex, start, end, direction):
            continue
        if not leaves_face(geometries, own, edge[3], vertex, at_vertex, start, end, direction):
            continue
        out_of_second = second_frame.rotation * direction
        if not own_is_second:
            out_of_second = -out_of_second
        patch = patch_for(patches, out_of_second, gap)
        if patch < 0:
            continue
        own_feature = wp.where(at_vertex, vertex_feature(vertex), edge_feature(number))
        feature = curved_feature(AXIS_POINT, own_feature, own_is_second)
        acting = moved(second_frame, place + (kappa * gap) * direction)
        add_candidate(patches, candidates, patch, acting, gap, feature)
