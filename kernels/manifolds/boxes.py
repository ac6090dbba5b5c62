"""Separation of two boxes along the normals of their faces and normal to their edges, by projection of half extents."""

import warp as wp
from warpcontact.kernels.body_contact.solids import RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.features import Features
from warpcontact.kernels.manifolds.separation import NO_COMMON_NORMAL, PlaneSeparation

double = wp.float64
vec3d = wp.vec3d


@wp.func
def is_box(features: Features, geometry: int):
    """Returns whether a geometry is a box with the axes of its frame."""
    return features.box_plane[6 * geometry] >= 0


@wp.func
def offset_of_boxes(first: SolidGeometry, second: SolidGeometry, pose: RelativePose):
    """Returns the vector from the center of the second box to that of the first one, in the frame of the second [m]."""
    return pose.origin + pose.rotation * first.center - second.center


@wp.func
def box_corner(box: SolidGeometry, direction: vec3d):
    """Returns the corner of a box that is farthest along a direction, in its frame [m]."""
    corner = box.center
    for i in range(3):
        corner[i] = corner[i] + wp.where(direction[i] < double(0.0), -box.half_extents[i], box.half_extents[i])
    return corner


@wp.func
def largest_box_plane_separation(
    features: Features,
    own: SolidGeometry,
    geometry: int,
    other: SolidGeometry,
    pose: RelativePose,
    preferred_plane: int,
    hysteresis: double,
):
    """Returns the ``PlaneSeparation`` of the face of a box with the largest separation from another box.

    Args:
        features: Features of the geometries.
        own: The box.
        geometry: Its geometry.
        other: The other box.
        pose: Pose of the other box in the frame of the box.
        preferred_plane: This plane is returned if its separation is larger, less ``hysteresis``; −1: none.
        hysteresis: Advantage of the preferred plane [m].
    """
    between = offset_of_boxes(other, own, pose)
    result = PlaneSeparation()
    result.distance = -double(wp.inf)
    result.plane = -1
    preferred = -double(wp.inf)
    for axis in range(3):
        reach = own.half_extents[axis]
        for k in range(3):
            reach += wp.abs(pose.rotation[axis, k]) * other.half_extents[k]
        for side in range(2):
            plane = features.box_plane[6 * geometry + 2 * axis + side]
            distance = wp.where(side == 1, between[axis], -between[axis]) - reach
            if plane == preferred_plane:
                preferred = distance
            if distance > result.distance:
                result.distance = distance
                result.plane = plane
    if preferred >= result.distance - hysteresis:
        result.distance = preferred
        result.plane = preferred_plane
    return result


@wp.func
def largest_box_edge_separation(first: SolidGeometry, second: SolidGeometry, pose: RelativePose):
    """Returns the largest separation of two boxes normal to an edge of each [m]; −∞ if all edges are parallel."""
    R = pose.rotation
    between = offset_of_boxes(first, second, pose)
    largest = -double(wp.inf)
    for i in range(3):
        i_1 = (i + 1) % 3
        i_2 = (i + 2) % 3
        for k in range(3):
            # Axis: edge i of the first box × edge k of the second box.
            k_1 = (k + 1) % 3
            k_2 = (k + 2) % 3
            sine_squared = R[k_1, i] * R[k_1, i] + R[k_2, i] * R[k_2, i]
            if sine_squared <= NO_COMMON_NORMAL * NO_COMMON_NORMAL:
                continue
            projected = wp.abs(between[k_2] * R[k_1, i] - between[k_1] * R[k_2, i])
            reach = first.half_extents[i_1] * wp.abs(R[k, i_2]) + first.half_extents[i_2] * wp.abs(R[k, i_1])
            reach += second.half_extents[k_1] * wp.abs(R[k_2, i]) + second.half_extents[k_2] * wp.abs(R[k_1, i])
            largest = wp.max(largest, (projected - reach) / wp.sqrt(sine_squared))
    return largest
