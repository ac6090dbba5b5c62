"""Contact of two curved solids.

The normal is the direction of the largest separation of both solids. All points have this normal: the nearest points, and those at
which the features of both in its direction touch (``support_features.py``).
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import RelativePose, no_motion
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.candidates import Candidate, Patch, across
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.convex_form import ConvexForm, FormCoefficients, form_of, separation
from warpcontact.kernels.manifolds.features import moved, vertex_feature
from warpcontact.kernels.manifolds.support_features import (
    FLAT_END,
    NEAREST_POINT,
    CommonNormal,
    SupportFeature,
    add_common_points,
    add_pair_of_points,
    support_feature,
)
from warpcontact.kernels.shapes.base import WarmStart
from warpcontact.kernels.types import MET

double = wp.float64
vec3d = wp.vec3d

# Sine of the angle up to which two flat ends count as parallel.
PARALLEL_ENDS = wp.constant(double(1.0e-8))


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
    if gap > reach.margin:
        return
    own = support_feature(first, pose, -normal)
    other = support_feature(second, no_motion(), normal)
    patches[0].gap = double(wp.inf)
    common = CommonNormal()
    common.kappa = kappa
    common.margin = reach.margin
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
        common.normal = normal
        patches[0].normal = normal
        add_pair_of_points(common, on_first, on_second, gap, nearest, nearest, patches, candidates)
    common.normal = normal
    patches[0].normal = normal
    add_common_points(common, own, other, patches, candidates)
