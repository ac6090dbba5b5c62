"""Reuse of the points of pairs whose relative pose is nearly that of their last search.

Points are searched again if a point of the smaller solid may have moved by more than ``REUSE_DISTANCE`` × its size relative to
the other solid since the last search, not since the last step, or if anything else has changed that they depend on.
Otherwise their gaps follow to first order from that of the search: a gap changes by g · d, with the displacement d of the first
solid at the point, relative to the second one. g is the normal for a vertex on a face parallel to it. In general, g is normal to
both features that touch, with g · n = 1, so that it includes that the point slides along them. Positions follow the
features that touch; the points of a solid that rolls follow its axis. Normals are fixed to one solid. A single point between the
nearest points of both solids follows the curvature of their surfaces (``nearest_points.py``).

With the displacement d and the size or radius of curvature r, errors of gaps are of the order of d²/r, 10⁻¹⁴ of the size. Where
an edge cuts a line of a curved solid, g is the normal, and the error is at most d times the slope of the line. Errors of positions
and normals are at most d and d/r. Points that the search has not found have gaps of at least the margin less 2 d. Errors do not add up
from step to step.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CURVED, CYLINDER, ELLIPSOID
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, no_motion
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, largest_extent
from warpcontact.kernels.manifolds.candidates import CANDIDATES, Candidate, Patch, candidate_feature
from warpcontact.kernels.manifolds.features import Feature, Features, vertex_feature
from warpcontact.kernels.manifolds.nearest_points import (
    EDGE,
    PLANE,
    edge_direction,
    feature_kind,
    nearest_motion,
    surface_part,
)
from warpcontact.kernels.manifolds.records import PairSearch
from warpcontact.kernels.manifolds.support_features import NEAREST_POINT

double = wp.float64
vec3d = wp.vec3d

#: Largest displacement of a point relative to the size of the smaller solid, up to which the points of a pair are reused.
REUSE_DISTANCE = 1.0e-7
LARGEST = wp.constant(double(REUSE_DISTANCE))
# Sine of two edges, and cosine of a feature and the normal, below which the normal is the gradient of a gap.
NEARLY_PARALLEL = wp.constant(double(1.0e-3))


@wp.func
def displacement_at(search: PairSearch, pose: RelativePose, position: vec3d):
    """Returns the displacement since a search of the first solid at a position, in the frame of the second one [m].

    It is zero if the pose is the same, without rounding.
    """
    local = wp.transpose(search.rotation) * (position - search.origin)
    return (pose.rotation - search.rotation) * local + (pose.origin - search.origin)


@wp.func
def largest_displacement(search: PairSearch, pose: RelativePose, first: SolidGeometry, second: SolidGeometry):
    """Returns a bound of the displacement of points of the smaller solid relative to the other one since a search [m]."""
    center = search.rotation * first.center + search.origin
    radius = wp.length(first.half_extents)
    # The extent of a half-space is zero.
    extent = largest_extent(second)
    if extent > double(0.0) and extent < largest_extent(first):
        center = second.center
        radius = wp.length(second.half_extents)
    squares = double(0.0)
    for i in range(3):
        for k in range(3):
            turn = pose.rotation[i, k] - search.rotation[i, k]
            squares += turn * turn
    # |R − R₀| = 2 sin(θ/2) is 1/√2 of the Frobenius norm.
    return wp.length(displacement_at(search, pose, center)) + wp.sqrt(double(0.5) * squares) * radius


@wp.func
def is_reusable(
    search: PairSearch,
    geometry_1: int,
    geometry_2: int,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    kappa: double,
    margin: double,
    size: double,
):
    """Returns whether the points of the last search are those of a pose.

    Args:
        search: The last search.
        geometry_1: Geometry of the first solid.
        geometry_2: Geometry of the second solid.
        first: The first solid.
        second: The second solid.
        pose: Pose of the first solid in the frame of the second one.
        kappa: Setting of the pair.
        margin: Largest gap of a point [m].
        size: Size of the smaller solid [m].
    """
    if search.is_valid == 0 or search.geometry_1 != geometry_1 or search.geometry_2 != geometry_2:
        return False
    if not (search.scale_1 == first.scale and search.scale_2 == second.scale and search.kappa == kappa):
        return False
    limit = LARGEST * size
    if wp.abs(margin - search.margin) > limit:
        return False
    return largest_displacement(search, pose, first, second) <= limit


@wp.func
def gap_gradient(
    geometries: Geometries,
    features: Features,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    feature: Feature,
    normal: vec3d,
):
    """Returns the gradient of the gap of a point of two polyhedra over displacements of the first one.

    ``pose``: of the first solid in the frame of the second one. ``normal``: of the point, in that frame.
    """
    kind_1 = feature_kind(feature.first)
    kind_2 = feature_kind(feature.second)
    across = normal
    if kind_1 == PLANE:
        across = pose.rotation * geometries.normal[geometries.plane_face[(feature.first - 1) // 3]]
    elif kind_2 == PLANE:
        across = geometries.normal[geometries.plane_face[(feature.second - 1) // 3]]
    elif kind_1 == EDGE and kind_2 == EDGE:
        along_1 = pose.rotation * edge_direction(geometries, features, feature.first, first)
        across = wp.cross(along_1, edge_direction(geometries, features, feature.second, second))
    height = wp.dot(across, normal)
    if wp.abs(height) < NEARLY_PARALLEL:
        return normal
    return across / height


@wp.func
def roll_radius(first: SolidGeometry, second: SolidGeometry):
    """Returns ``PairSearch.roll`` of two solids, of which at most one is curved; NaN if it varies along the surface [m]."""
    side = first
    sign = double(1.0)
    if (second.flags & CURVED) != 0:
        side = second
        sign = double(-1.0)
    if (side.flags & CURVED) == 0:
        return double(0.0)
    is_sphere = (side.flags & ELLIPSOID) != 0 and side.scale[0] == side.scale[1] and side.scale[0] == side.scale[2]
    if is_sphere or (side.flags & (CYLINDER | CAPSULE)) != 0:
        return sign * side.scale[0]
    return double(wp.nan)


@wp.func
def is_nearest_point(feature: Feature):
    """Returns whether a point is that of the nearest points of both solids."""
    nearest = vertex_feature(NEAREST_POINT)
    return feature.first == nearest or feature.second == nearest


@wp.func
def are_on_faces(patches: wp.array(dtype=Patch), candidates: wp.array(dtype=Candidate)):
    """Returns whether the normals of all patches of a polyhedron and a curved solid are those of faces.

    Others turn if the solid rolls on an edge; their patches have the nearest points of both solids.
    """
    for patch in range(patches.shape[0]):
        for i in range(CANDIDATES * patch, CANDIDATES * patch + patches[patch].count):
            if is_nearest_point(candidate_feature(candidates[i])):
                return False
    return True


@wp.struct
class MovedPoint:
    """A point of an earlier search at the present pose, in the frame of the second solid."""

    position: vec3d  # [m]
    normal: vec3d  # out of the second solid
    gap: double  # [m]


@wp.func
def motion_of_nearest(
    geometries: Geometries,
    features: Features,
    search: PairSearch,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    point: MovedPoint,
    feature: Feature,
):
    """Returns the ``NearestMotion`` since a search, in which ``point`` was found between the nearest points of both solids."""
    before = RelativePose()
    before.origin = search.origin
    before.rotation = search.rotation
    on_first = point.position + ((double(1.0) - search.kappa) * point.gap) * point.normal
    on_second = point.position - (search.kappa * point.gap) * point.normal
    part_1 = surface_part(geometries, features, first, before, feature.first, on_first, -point.normal)
    part_2 = surface_part(geometries, features, second, no_motion(), feature.second, on_second, point.normal)
    turned = (pose.rotation - search.rotation) * (wp.transpose(search.rotation) * point.normal)
    displacement = displacement_at(search, pose, on_first)
    size = largest_extent(first)
    if largest_extent(second) > double(0.0):
        size = wp.min(size, largest_extent(second))
    return nearest_motion(part_1, part_2, point.normal, point.gap, displacement, turned, size)


@wp.func
def moved_nearest(
    geometries: Geometries,
    features: Features,
    search: PairSearch,
    first: SolidGeometry,
    second: SolidGeometry,
    pose: RelativePose,
    point: MovedPoint,
    feature: Feature,
):
    """Returns the ``MovedPoint`` of ``point``, which a search found between the nearest points of both solids."""
    motion = motion_of_nearest(geometries, features, search, first, second, pose, point, feature)
    result = MovedPoint()
    result.gap = point.gap + wp.dot(point.normal, displacement_at(search, pose, point.position))
    result.normal = wp.normalize(point.normal + motion.turn)
    on_second = point.position - (search.kappa * point.gap) * point.normal
    shift = motion.shift - wp.dot(motion.shift, point.normal) * point.normal
    result.position = on_second + shift + (search.kappa * result.gap) * result.normal
    return result


@wp.func
def moved_point(
    search: PairSearch,
    pose: RelativePose,
    point: MovedPoint,
    gradient: vec3d,
    feature_1: int,
):
    """Returns the ``MovedPoint`` of ``point``, which a search found on a face.

    Args:
        search: The search.
        pose: Present pose of the first solid in the frame of the second one.
        point: The point at the search.
        gradient: Gradient of its gap.
        feature_1: Its feature of the first solid.
    """
    displacement = displacement_at(search, pose, point.position)
    result = MovedPoint()
    result.gap = point.gap + wp.dot(gradient, displacement)
    result.normal = point.normal
    if search.normal_on_first == 1:
        result.normal = pose.rotation * (wp.transpose(search.rotation) * point.normal)
    # The center of curvature does not turn as a solid rolls. A vertex is fixed to its solid; edges share the displacement.
    shift = (double(1.0) - double(0.5) * double(feature_kind(feature_1))) * displacement
    if search.roll != double(0.0):
        shift = displacement_at(search, pose, point.position + search.roll * point.normal)
        if search.roll < double(0.0):
            shift = displacement - shift
    along = search.kappa * (result.gap - point.gap) - wp.dot(shift, point.normal)
    result.position = point.position + shift + along * point.normal
    return result
