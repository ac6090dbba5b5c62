"""Manifold of two spheres or capsules: the points within a radius of a segment.

All points have the normal of the nearest points of both axes. Parallel capsules also touch at the ends of their common length.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE
from warpcontact.kernels.body_contact.solids import RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, add_candidate
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.curved_features import nearest_on_segments
from warpcontact.kernels.manifolds.features import Feature, vertex_feature

double = wp.float64
vec3d = wp.vec3d


@wp.func
def half_axis(side: SolidGeometry):
    """Returns half of the length of the axis of a sphere or capsule, along z [m]."""
    length = double(0.0)
    if (side.flags & CAPSULE) != 0:
        length = side.scale[2] - side.scale[0]
    return vec3d(double(0.0), double(0.0), length)


@wp.func
def add_axis_points(
    normal: vec3d,
    on_first: vec3d,
    on_second: vec3d,
    number: int,
    radii: wp.vec2d,
    kappa: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the contact of two points of axes, in the frame of the second solid, as a candidate of the first patch.

    ``radii``: of the first and the second solid [m].
    """
    gap = wp.length(on_first - on_second) - radii[0] - radii[1]
    if gap > reach.margin:
        return
    feature = Feature()
    feature.first = vertex_feature(number)
    feature.second = vertex_feature(number)
    position = on_second + (radii[1] + kappa * gap) * normal
    add_candidate(patches, candidates, 0, position, gap, feature)


@wp.func
def capsule_manifold(
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    kappa: double,
    reach: Reach,
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Collects the candidates of two spheres or capsules in the first patch; ``pose``: of the first one in the second's frame."""
    half_1 = pose.rotation * half_axis(first)
    half_2 = half_axis(second)
    start_1 = pose.origin - half_1
    start_2 = -half_2
    along_1 = double(2.0) * half_1
    along_2 = double(2.0) * half_2
    fraction_1 = double(0.5)
    fraction_2 = double(0.5)
    if wp.length_sq(along_2) > double(0.0):
        fraction_1, fraction_2 = nearest_on_segments(start_1, along_1, start_2, along_2)
    elif wp.length_sq(along_1) > double(0.0):
        fraction_1 = wp.clamp(-wp.dot(start_1, along_1) / wp.length_sq(along_1), double(0.0), double(1.0))
    on_first = start_1 + fraction_1 * along_1
    on_second = start_2 + fraction_2 * along_2
    distance = wp.length(on_first - on_second)
    radii = wp.vec2d(first.scale[0], second.scale[0])
    if distance == double(0.0) or distance - radii[0] - radii[1] > reach.margin:
        return
    normal = (on_first - on_second) / distance
    patches[0].normal = normal
    patches[0].gap = double(wp.inf)
    add_axis_points(normal, on_first, on_second, 0, radii, kappa, reach, patches, candidates)
    if wp.length_sq(along_1) == double(0.0) or wp.length_sq(along_2) == double(0.0):
        return
    for end in range(2):
        at_end = wp.where(end == 0, double(0.0), double(1.0))
        on_first = start_1 + at_end * along_1
        fraction_2 = wp.dot(on_first - start_2, along_2) / wp.length_sq(along_2)
        if fraction_2 >= double(0.0) and fraction_2 <= double(1.0):
            on_second = start_2 + fraction_2 * along_2
            add_axis_points(normal, on_first, on_second, 1 + end, radii, kappa, reach, patches, candidates)
        on_second = start_2 + at_end * along_2
        fraction_1 = wp.dot(on_second - start_1, along_1) / wp.length_sq(along_1)
        if fraction_1 >= double(0.0) and fraction_1 <= double(1.0):
            on_first = start_1 + fraction_1 * along_1
            add_axis_points(normal, on_first, on_second, 3 + end, radii, kappa, reach, patches, candidates)
