"""Curved solids as the convex hull of two balls or two circles on an axis, or an ellipsoid, in the frame of a polyhedron.

A capsule is the hull of two balls, a cylinder that of two circles, a cone that of a circle and a point. Along a direction n the lowest
point of such a solid is that of one of both *pieces*; along the normals of its straight lines, both are equally low.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CONE, ELLIPSOID
from warpcontact.kernels.body_contact.solids import RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry

double = wp.float64
vec3d = wp.vec3d
zero, one = wp.constant(double(0.0)), wp.constant(double(1.0))

# Kinds of hulls.
BALLS, CIRCLES, ONE_ELLIPSOID = (wp.constant(i) for i in range(3))
# Sine of the angle between a direction and the axis of a circle up to which the whole circle is equally low.
ALONG_AXIS = wp.constant(double(1.0e-9))


@wp.struct
class CurvedHull:
    """A curved solid in the frame of a polyhedron."""

    kind: wp.int32  # BALLS, CIRCLES or ONE_ELLIPSOID
    first: vec3d  # center of the first piece [m]
    first_radius: double  # [m]
    second: vec3d  # center of the second piece, which equals the first one if there is only one [m]
    second_radius: double  # [m]
    axis: vec3d  # unit vector from the first to the second center
    height: double  # distance of the centers [m]
    slope: double  # component along the axis of the directions along which both pieces are equally low
    squares: wp.mat33d  # S of an ellipsoid y·S⁻¹ y ≤ 1 [m²]


@wp.struct
class PointContact:
    """The contact of a curved solid with a point, an edge or a vertex; in the frame of the polyhedron."""

    gap: double  # negative in overlap; −∞: there is none [m]
    normal: vec3d  # towards the curved solid
    on_curved: vec3d  # [m]


@wp.func
def hull_of(side: SolidGeometry, pose: RelativePose):
    """Returns the ``CurvedHull`` of a curved solid; ``pose``: its pose in the frame of the polyhedron."""
    hull = CurvedHull()
    scale = side.scale
    hull.first = pose.origin
    hull.second = pose.origin
    hull.axis = vec3d(pose.rotation[0, 2], pose.rotation[1, 2], pose.rotation[2, 2])
    hull.first_radius = scale[0]
    hull.second_radius = scale[0]
    if (side.flags & ELLIPSOID) != 0:
        if scale[0] != scale[1] or scale[0] != scale[2]:
            hull.kind = ONE_ELLIPSOID
            hull.squares = pose.rotation * wp.diag(wp.cw_mul(scale, scale)) * wp.transpose(pose.rotation)
        return hull
    if (side.flags & CONE) != 0:
        hull.kind = CIRCLES
        hull.second_radius = zero
        hull.height = scale[2]
        hull.slope = -scale[0] / wp.sqrt(scale[0] * scale[0] + scale[2] * scale[2])
    else:
        half = scale[2]
        if (side.flags & CAPSULE) != 0:
            half -= scale[0]
        else:
            hull.kind = CIRCLES
        hull.first -= half * hull.axis
        hull.height = double(2.0) * half
    hull.second = hull.first + hull.height * hull.axis
    return hull


@wp.func
def lower_piece(hull: CurvedHull, n: vec3d):
    """Returns the piece (0 or 1) with the lowest point along a unit vector."""
    return wp.where(hull.height > zero and wp.dot(n, hull.axis) < hull.slope, 1, 0)


@wp.func
def lowest_of_piece(hull: CurvedHull, piece: int, n: vec3d):
    """Returns the point of a piece that is lowest along a unit vector [m]; of a circle along its axis, the center."""
    center = hull.first
    radius = hull.first_radius
    if piece == 1:
        center = hull.second
        radius = hull.second_radius
    if hull.kind == BALLS:
        return center - radius * n
    if hull.kind == CIRCLES:
        across = n - wp.dot(n, hull.axis) * hull.axis
        size = wp.length(across)
        if size > ALONG_AXIS:
            center -= (radius / size) * across
        return center
    weighted = hull.squares * n
    return center - weighted / wp.sqrt(wp.dot(n, weighted))


@wp.func
def lowest_of_hull(hull: CurvedHull, n: vec3d):
    """Returns the point of a curved solid that is lowest along a unit vector [m]."""
    return lowest_of_piece(hull, lower_piece(hull, n), n)


@wp.func
def curvature_radius(hull: CurvedHull, piece: int, n: vec3d, tangent: vec3d):
    """Returns the radius of curvature of the support function of a piece against ``n``, if n turns along ``tangent`` [m]."""
    radius = wp.where(piece == 1, hull.second_radius, hull.first_radius)
    if hull.kind == BALLS:
        return radius
    if hull.kind == CIRCLES:
        along = wp.dot(n, hull.axis)
        size = wp.sqrt(wp.max(one - along * along, ALONG_AXIS * ALONG_AXIS))
        around = wp.dot(tangent, wp.cross(hull.axis, n))
        return radius * (around * around) / (size * size * size)
    weighted = hull.squares * n
    support = wp.sqrt(wp.dot(n, weighted))
    slip = wp.dot(tangent, weighted) / support
    return (wp.dot(tangent, hull.squares * tangent) - slip * slip) / support


@wp.func
def nearest_surface_point(hull: CurvedHull, position: vec3d, has_ends: bool):
    """Returns the contact of a curved solid that is no ellipsoid with a point; the normal is out of the point.

    Its gap is the distance of the point from the surface, negative inside. If ``has_ends`` is false, flat ends do not count, and a point
    that is next to one of them outside has no contact.
    """
    result = PointContact()
    result.gap = -double(wp.inf)
    between = position - hull.first
    along = wp.dot(between, hull.axis)
    if hull.kind == BALLS:
        center = hull.first + wp.clamp(along, zero, hull.height) * hull.axis
        distance = wp.length(center - position)
        if distance > zero:
            result.normal = (center - position) / distance
            result.gap = distance - hull.first_radius
            result.on_curved = center - hull.first_radius * result.normal
        return result
    across = between - along * hull.axis
    beside = wp.length(across)
    outward = vec3d()
    if beside > zero:
        outward = across / beside
    # In the plane of the point and the axis, the outline has straight lines between the ends of both radii.
    taper = hull.first_radius - hull.second_radius
    slant = wp.sqrt(hull.height * hull.height + taper * taper)
    from_rim = beside - hull.first_radius
    fraction = (along * hull.height - from_rim * taper) / (slant * slant)
    distance = (from_rim * hull.height + along * taper) / slant
    end = wp.max(-along, along - hull.height)
    end_radius = wp.where(-along > along - hull.height, hull.first_radius, hull.second_radius)
    is_below = beside <= end_radius
    if has_ends and is_below and end > wp.min(distance, zero):
        result.gap = end
        result.normal = wp.where(-along > along - hull.height, hull.axis, -hull.axis)
        result.on_curved = position + end * result.normal
    elif fraction >= zero and fraction <= one:
        if beside > zero:
            result.gap = distance
            result.normal = -(hull.height / slant) * outward - (taper / slant) * hull.axis
            result.on_curved = position + distance * result.normal
    elif end <= zero or not is_below or end_radius == zero:
        # A circular edge, or the tip of a cone.
        on_edge = hull.first + hull.first_radius * outward
        if fraction > one:
            on_edge = hull.second + hull.second_radius * outward
        apart = wp.length(on_edge - position)
        if apart > zero:
            result.gap = apart
            result.normal = (on_edge - position) / apart
            result.on_curved = on_edge
    return result
