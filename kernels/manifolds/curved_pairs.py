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
from warpcontact.kernels.manifolds.curved_edges import nearest_on_segments
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
def axis_of(form: FormCoefficients):
    """Returns the start of the axis segment of a form, and the vector to its end [m]."""
    if form.height > double(0.0):
        return vec3d(), vec3d(double(0.0), double(0.0), form.height)
    return -form.half_axis, double(2.0) * form.half_axis


@wp.func
def between_axes(first: FormCoefficients, second: FormCoefficients, pose: RelativePose):
    """Returns the nearest point of the axis segment of each form to that of the other one, in the frame of the second one [m]."""
    start_1, along_1 = axis_of(first)
    start_2, along_2 = axis_of(second)
    start_1 = moved(pose, start_1)
    along_1 = pose.rotation * along_1
    fraction_1, fraction_2 = nearest_on_segments(start_1, along_1, start_2, along_2)
    return start_1 + fraction_1 * along_1, start_2 + fraction_2 * along_2


@wp.func
def start_direction(first: FormCoefficients, second: FormCoefficients, pose: RelativePose, between: vec3d):
    """Returns the best of some directions, and the separation along it [m].

    They are along ``between``, the vector between the nearest points of both axes, between the centers, and along the axes.
    """
    best = vec3d()
    largest = -double(wp.inf)
    directions = wp.int32(6)
    for k in range(directions):
        direction = vec3d(between)
        if k == 0:
            direction = moved(pose, ConvexForm.inscribed_center(first)) - ConvexForm.inscribed_center(second)
        elif k == 1 or k == 2:
            direction = vec3d(double(0.0), double(0.0), double(2 * k - 3))
        elif k == 3 or k == 4:
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


@wp.func(inline=False)
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
    on_axis_1, on_axis_2 = between_axes(form_1, form_2, pose)
    normal, gap = start_direction(form_1, form_2, pose, on_axis_1 - on_axis_2)
    if gap > reach.margin:
        return
    own = support_feature(first, pose, -normal)
    other = support_feature(second, no_motion(), normal)
    patches[0].gap = double(wp.inf)
    common = CommonNormal()
    common.kappa = kappa
    common.margin = reach.margin
    if not are_parallel_ends(own, other):
        on_first = vec3d()
        on_second = vec3d()
        distance = wp.length(on_axis_1 - on_axis_2)
        if form_1.ball_radius > double(0.0) and form_2.ball_radius > double(0.0) and distance > double(0.0):
            # Spheres and capsules.
            normal = (on_axis_1 - on_axis_2) / distance
            gap = distance - form_1.ball_radius - form_2.ball_radius
            on_first = on_axis_1 - form_1.ball_radius * normal
            on_second = on_axis_2 + form_2.ball_radius * normal
        else:
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
