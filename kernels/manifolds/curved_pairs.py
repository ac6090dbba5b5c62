"""Contact of two curved solids, and of edges and vertices of a polyhedron with a curved solid.

The normal is the direction of the largest separation of both solids, or of the solid and an edge. All points have this normal:
the nearest points, and those at which the features of both in its direction touch (``support_features.py``).
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, corner_count, no_motion
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.candidates import MAX_PATCHES, Candidate, Patch, across
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.convex_form import ConvexForm, FormCoefficients, form_of, form_of_edge
from warpcontact.kernels.manifolds.features import (
    Features,
    edge_feature,
    moved,
    vertex_feature,
    vertex_position,
)
from warpcontact.kernels.manifolds.meshes import patch_for
from warpcontact.kernels.manifolds.separation import edge_bound
from warpcontact.kernels.manifolds.support_features import (
    FLAT_END,
    LINE,
    LYING,
    NEAREST_POINT,
    SupportFeature,
    add_common_points,
    add_pair_of_points,
    support_feature,
)
from warpcontact.kernels.shapes import convex
from warpcontact.kernels.shapes.base import WarmStart
from warpcontact.kernels.types import MET

double = wp.float64
vec3d = wp.vec3d

# Sine up to which two directions count as perpendicular, or parallel.
PERPENDICULAR = wp.constant(double(1.0e-9))
# Sine of the angle up to which two flat ends count as parallel.
PARALLEL_ENDS = wp.constant(double(1.0e-8))
# Distance from the end of an edge, relative to its length, up to which a point is at the vertex.
AT_VERTEX = wp.constant(double(1.0e-9))
separation = convex.pair_function(ConvexForm, ConvexForm)


@wp.func
def start_direction(first: FormCoefficients, second: FormCoefficients, pose: RelativePose):
    """Returns the best of the directions between the centers of two forms and along their axes, and the separation along it [m]."""
    best = vec3d()
    largest = -double(wp.inf)
    directions = wp.int32(5)
    for k in range(directions):
        direction = moved(pose, ConvexForm.inscribed_center(first)) - ConvexForm.inscribed_center(second)
        if k == 1 or k == 2:
            direction = vec3d(double(0.0), double(0.0), double(2 * k - 3))
        elif k > 2:
            direction = double(2 * k - 7) * vec3d(pose.rotation[0, 2], pose.rotation[1, 2], pose.rotation[2, 2])
        if wp.length_sq(direction) == double(0.0):
            continue
        direction = wp.normalize(direction)
        on_first = moved(pose, ConvexForm.support(first, -(wp.transpose(pose.rotation) * direction)))
        value = wp.dot(direction, on_first - ConvexForm.support(second, direction))
        if value > largest:
            largest = value
            best = direction
    return best, largest


@wp.func
def are_parallel_ends(first: SupportFeature, second: SupportFeature):
    """Returns whether two features are flat ends that are parallel to rounding, and above each other.

    The best direction is then between their normals, and its separation is that along one of them to 1e-8 of their radii.
    """
    if first.kind != FLAT_END or second.kind != FLAT_END:
        return False
    if wp.length(wp.cross(first.axis, second.axis)) > PARALLEL_ENDS:
        return False
    return wp.length(across(first.center - second.center, second.axis)) < first.radius + second.radius


@wp.func
def curved_pair_manifold(
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    kappa: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Collects the candidates of two curved solids in the first patch; ``pose``: of the first one in the second's frame."""
    form_1 = form_of(first)
    form_2 = form_of(second)
    normal, gap = start_direction(form_1, form_2, pose)
    own = support_feature(first, pose, -normal)
    other = support_feature(second, no_motion(), normal)
    patches[0].gap = double(wp.inf)
    if not are_parallel_ends(own, other):
        start = WarmStart()
        start.normal = normal
        start.valid = 1
        found = separation(form_1, form_2, pose.origin, wp.quat_from_matrix(pose.rotation), start)
        on_first = found.point_a
        on_second = found.point_b
        if found.status == MET:
            normal = found.normal
            gap = found.gap
        else:
            # The separation along another direction is smaller, so that no contact is lost.
            on_first = moved(pose, ConvexForm.support(form_1, -(wp.transpose(pose.rotation) * normal)))
            on_second = ConvexForm.support(form_2, normal)
        if gap > reach.margin:
            return
        own = support_feature(first, pose, -normal)
        other = support_feature(second, no_motion(), normal)
        nearest = vertex_feature(NEAREST_POINT)
        patches[0].normal = normal
        add_pair_of_points(
            on_first, on_second, gap, nearest, nearest, normal, kappa, reach.margin, patches, candidates, 0
        )
    patches[0].normal = normal
    add_common_points(own, other, normal, kappa, reach.margin, patches, candidates, 0)


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
def is_edge_apart(other: SolidGeometry, pose: RelativePose, start: vec3d, end: vec3d, margin: double):
    """Returns whether an edge is farther than ``margin`` from a capsule around a curved solid."""
    # The axis of the capsule is the z axis of the bounding box.
    radius = wp.max(other.half_extents[0], other.half_extents[1])
    half = other.half_extents[2]
    if (other.flags & CAPSULE) != 0:
        half -= radius
    axis = half * (pose.rotation * vec3d(double(0.0), double(0.0), double(1.0)))
    center = moved(pose, other.center)
    first, second = nearest_on_segments(center - axis, double(2.0) * axis, start, end - start)
    place = center + (double(2.0) * first - double(1.0)) * axis
    return wp.length(start + second * (end - start) - place) > radius + margin


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
def leaves_vertex(geometries: Geometries, features: Features, own: SolidGeometry, vertex: int, direction: vec3d):
    """Returns whether a direction from a vertex of a convex polyhedron leads away from all of its edges."""
    place = vertex_position(geometries, vertex, own)
    for i in range(features.neighbor_start[vertex], features.neighbor_start[vertex + 1]):
        edge = wp.normalize(vertex_position(geometries, features.neighbor[i], own) - place)
        if wp.dot(direction, edge) > PERPENDICULAR:
            return False
    return True


@wp.func
def edge_line(start: vec3d, end: vec3d, edge: wp.vec4i, number: int, pose: RelativePose, direction: vec3d):
    """Returns the ``SupportFeature`` of an edge in the frame of the second solid.

    ``pose``: pose of the polyhedron in that frame. ``direction``: unit vector towards the other solid in that of the polyhedron.
    """
    feature = SupportFeature()
    along = end - start
    if wp.abs(wp.dot(direction, along)) <= LYING * wp.length(along):
        feature.kind = LINE
    feature.start = moved(pose, start)
    feature.end = moved(pose, end)
    feature.start_number = vertex_feature(edge[0])
    feature.end_number = vertex_feature(edge[1])
    feature.number = edge_feature(number)
    return feature


@wp.func
def add_edge(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    edge: wp.vec4i,
    number: int,
    other: SolidGeometry,
    pose: RelativePose,
    second_frame: RelativePose,
    kappa: double,
    own_is_second: bool,
    only_largest: bool,
    least: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the contact of a convex edge, and of its ends, with a curved solid as candidates.

    Returns their separation, and −∞ if the edge is not towards the solid [m].

    Args:
        geometries: The geometries.
        features: Their features.
        own: The polyhedron.
        edge: Vertices and faces of the edge.
        number: Its number.
        other: The curved solid.
        pose: Its pose in the frame of the polyhedron.
        second_frame: Pose of the polyhedron in the frame of the second solid.
        kappa: Points are at kappa × the gap from the polyhedron.
        own_is_second: Whether the polyhedron is the second solid.
        only_largest: Whether to add it only if its separation is above ``least``, and remove all other candidates then.
        least: Largest separation so far [m].
        reach: Lengths that decide which points belong to the manifold.
        patches: The patches.
        candidates: Their candidates.
    """
    start = vertex_position(geometries, edge[0], own)
    end = vertex_position(geometries, edge[1], own)
    if is_edge_apart(other, pose, start, end, reach.margin):
        return -double(wp.inf)
    middle = double(0.5) * (start + end)
    half = double(0.5) * (end - start)
    # Separations of the curved solid from the edge, as stationary values from directions between the normals of both faces. In overlap
    # there may be several.
    gap = -double(wp.inf)
    direction = vec3d()
    place = vec3d()
    on_curved = vec3d()
    at_vertex = wp.bool(False)
    vertex = wp.int32(-1)
    attempts = wp.int32(3)
    for attempt in range(attempts):
        outward = WarmStart()
        # First their mean.
        towards = geometries.normal[edge[2]] + geometries.normal[edge[3]]
        if attempt > 0:
            towards = geometries.normal[edge[1 + attempt]]
        outward.normal = wp.normalize(towards)
        outward.valid = 1
        found = separation(
            form_of(other), form_of_edge(half), pose.origin - middle, wp.quat_from_matrix(pose.rotation), outward
        )
        if found.status != MET or found.gap <= gap:
            continue
        if found.gap > reach.margin or found.gap < -reach.depth:
            continue
        fraction = wp.dot(found.point_b, half) / wp.length_sq(half)
        ends = wp.abs(fraction) >= double(1.0) - AT_VERTEX
        nearer = wp.where(fraction < double(0.0), edge[0], edge[1])
        leaves = wp.bool(True)
        for side in range(2):
            if leaves:
                leaves = leaves_face(geometries, own, edge[2 + side], nearer, ends, start, end, found.normal)
        if leaves and ends:
            # Convex polyhedra have the neighbors of their vertices.
            leaves = leaves_vertex(geometries, features, own, nearer, found.normal)
        if leaves:
            gap = found.gap
            direction = found.normal
            place = middle + found.point_b
            on_curved = middle + found.point_a
            at_vertex = ends
            vertex = nearer
    if gap == -double(wp.inf) or (only_largest and gap <= least):
        return gap
    if only_largest:
        for patch in range(MAX_PATCHES):
            patches[patch].count = 0
    normal = second_frame.rotation * direction
    curved_frame = RelativePose()
    curved_frame.rotation = second_frame.rotation * pose.rotation
    curved_frame.origin = moved(second_frame, pose.origin)
    own_feature = edge_line(start, end, edge, number, second_frame, direction)
    other_feature = support_feature(other, curved_frame, -normal)
    if other_feature.kind == FLAT_END:
        if wp.length(wp.cross(other_feature.axis, normal)) <= PERPENDICULAR:
            # The flat end is the reference of a face next to the edge.
            return gap
    on_own = moved(second_frame, place)
    on_other = moved(second_frame, on_curved)
    own_number = wp.where(at_vertex, vertex_feature(vertex), edge_feature(number))
    nearest = vertex_feature(NEAREST_POINT)
    if own_is_second:
        patch = patch_for(patches, normal, gap)
        if patch >= 0:
            add_pair_of_points(
                on_other, on_own, gap, nearest, own_number, normal, kappa, reach.margin, patches, candidates, patch
            )
            add_common_points(other_feature, own_feature, normal, kappa, reach.margin, patches, candidates, patch)
    else:
        patch = patch_for(patches, -normal, gap)
        if patch >= 0:
            first_kappa = double(1.0) - kappa
            add_pair_of_points(
                on_own, on_other, gap, own_number, nearest, -normal, first_kappa, reach.margin, patches,
                candidates, patch,
            )  # fmt: skip
            add_common_points(
                own_feature, other_feature, -normal, first_kappa, reach.margin, patches, candidates, patch
            )
    return gap


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
    only_largest: bool,
    near: vec3d,
    least: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the contacts of convex edges of a face, and of their ends, with a curved solid as candidates.

    Returns the largest separation of these edges [m]. Arguments as ``curved.CurvedPair``. Only edges whose first face it is are added.
    With ``only_largest``, the one with the largest separation above ``least`` replaces all candidates; ``near`` is a point of the curved
    solid.
    """
    largest = -double(wp.inf)
    vertices = geometries.face[face]
    for i in range(corner_count(vertices)):
        number = features.face_edge[face][i]
        edge = features.edge[number]
        if edge[2] != face or edge[3] < 0:
            continue
        if only_largest and edge_bound(geometries, edge, own, near) <= wp.max(least, largest):
            continue
        along = vertex_position(geometries, edge[1], own) - vertex_position(geometries, edge[0], own)
        if wp.dot(wp.cross(geometries.normal[edge[2]], geometries.normal[edge[3]]), along) > double(0.0):
            gap = add_edge(
                geometries, features, own, edge, number, other, pose, second_frame, kappa, own_is_second, only_largest,
                wp.max(least, largest), reach, patches, candidates,
            )  # fmt: skip
            largest = wp.max(largest, gap)
    return largest
