"""Solids with curved surfaces: spheres, ellipsoids, cylinders, cones and capsules.

A curved solid has the sizes (r, r, r), (a, b, c), (r, r, l), (r, r, h) and (r, r, l + r) as its scale. In its frame it is
centered at the origin, or has the center of its base there (cone).

It is made of one *part*, a capsule of three: a cylinder and two half balls. In the coordinates of a ``Section``, a part is the
set v² ≤ k₀ + k₁ z + k₂ z² − x² with z between two limits, where x and z are linear in u and in the depth t. So columns and
sections with planes have closed forms.

A curved solid has up to three *sheets*: its curved surface, and its flat ends.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import RelativePose

double = wp.float64
vec3d = wp.vec3d

# Kinds, as properties of a geometry.
ELLIPSOID = 16
CYLINDER = 32
CONE = 64
CAPSULE = 128
#: Properties of which a curved solid has one.
CURVED = ELLIPSOID | CYLINDER | CONE | CAPSULE

# Sine of an angle between an axis and a normal below which the axis has no direction in the plane.
UPRIGHT = wp.constant(double(1.0e-12))
TINY = wp.constant(double(1.0e-300))


@wp.struct
class Profile:
    """One part of a curved solid: v² ≤ k_0 + k_1 z + k_2 z² − x², lower ≤ z ≤ upper."""

    k_0: double
    k_1: double
    k_2: double
    lower: double
    upper: double


@wp.struct
class Section:
    """A plane and the columns below it, in coordinates in which the parts of a curved solid have a ``Profile``.

    The point (u, v) of the plane at depth t has x = x_0 + x_u u + x_t t and z = z_0 + z_u u + z_t t. Lengths are in metres, of an
    ellipsoid in units of its semi-axes.
    """

    center: vec3d  # the point u = v = 0 of the plane [m]
    u_axis: vec3d  # [m per unit of u]
    v_axis: vec3d  # [m per unit of v]
    u_dual: vec3d  # u = u_dual · (position − center) [units per m]
    v_dual: vec3d
    area: double  # of the unit square of u and v [m²]
    x_0: double
    x_u: double
    x_t: double
    z_0: double
    z_u: double
    z_t: double
    has_tip: wp.bool  # whether the tip of a cone is below the plane
    u_tip: double  # u of the tip of a cone
    tip_height: double  # above the plane [m]


@wp.func
def part_count(flags: int):
    """Returns the number of parts of a curved solid."""
    if flags & CAPSULE:
        return wp.int32(3)
    return wp.int32(1)


@wp.func
def profile_of(flags: int, scale: vec3d, part: int):
    """Returns the ``Profile`` of a part of a curved solid."""
    profile = Profile()
    r = scale[0]
    if flags & CYLINDER:
        profile.k_0 = r * r
        profile.lower = -scale[2]
        profile.upper = scale[2]
    elif flags & CONE:
        slope = r / scale[2]
        profile.k_0 = r * r
        profile.k_1 = double(-2.0) * r * slope
        profile.k_2 = slope * slope
        profile.upper = scale[2]
    elif flags & CAPSULE:
        length = scale[2] - r
        profile.k_0 = r * r
        profile.lower = -length
        profile.upper = length
        if part > 0:
            profile.k_0 = r * r - length * length
            profile.k_2 = double(-1.0)
            # The limit beyond the end of the ball does not cut it.
            if part == 1:
                profile.k_1 = double(2.0) * length
                profile.lower = length
                profile.upper = length + double(2.0) * r
            else:
                profile.k_1 = double(-2.0) * length
                profile.lower = -length - double(2.0) * r
                profile.upper = -length
    else:
        profile.k_0 = double(1.0)
        profile.k_2 = double(-1.0)
        profile.lower = double(-2.0)
        profile.upper = double(2.0)
    return profile


@wp.func
def with_radius(profile: Profile, flags: int, scale: vec3d, offset: double):
    """Returns the profile of the points deeper than ``offset`` below the curved surface, and whether there are any.

    None of an ellipsoid that is not a sphere.
    """
    radius = scale[0]
    if flags & ELLIPSOID:
        ratio = double(1.0) - offset / radius
        profile.k_0 = ratio * ratio
        return profile, ratio > double(0.0) and radius == scale[1] and radius == scale[2]
    inner = radius - offset
    if flags & CONE:
        slope = radius / scale[2]
        inner = radius - offset * wp.sqrt(double(1.0) + slope * slope)
        profile.k_1 = double(-2.0) * inner * slope
        profile.upper = wp.min(profile.upper, inner / slope)
    profile.k_0 += inner * inner - radius * radius
    return profile, inner > double(0.0)


@wp.func
def perpendicular(direction: vec3d, normal: vec3d):
    """Returns the component of a vector perpendicular to a unit normal."""
    return direction - wp.dot(direction, normal) * normal


@wp.func
def section_of(flags: int, scale: vec3d, pose: RelativePose, origin: vec3d, in_plane: vec3d, normal: vec3d):
    """Returns the ``Section`` of a curved solid with a plane, below which columns run along −normal.

    Args:
        flags: Kind of the solid.
        scale: Its sizes [m].
        pose: Its pose in the frame of the plane.
        origin: A point of the plane [m].
        in_plane: A unit vector in the plane.
        normal: Unit normal of the plane.
    """
    section = Section()
    height = wp.dot(normal, pose.origin - origin)
    if flags & ELLIPSOID:
        # In coordinates in which the solid is a unit sphere. Columns are oblique there.
        to_solid = wp.transpose(pose.rotation)
        mapped_normal = wp.cw_mul(scale, to_solid * normal)
        stretch = wp.length(mapped_normal)
        normal_s = mapped_normal / stretch
        column = -wp.cw_div(to_solid * normal, scale)
        along = perpendicular(column, normal_s)
        if wp.length(along) < UPRIGHT * wp.length(column):
            along = perpendicular(wp.cw_div(to_solid * in_plane, scale), normal_s)
        u_s = wp.normalize(along)
        v_s = wp.cross(normal_s, u_s)
        # The plane is at this distance from the center.
        section.x_0 = -height / stretch
        section.x_t = wp.dot(column, normal_s)
        section.z_u = double(1.0)
        section.z_t = wp.dot(column, u_s)
        section.u_axis = pose.rotation * wp.cw_mul(scale, u_s)
        section.v_axis = pose.rotation * wp.cw_mul(scale, v_s)
        section.u_dual = pose.rotation * wp.cw_div(u_s, scale)
        section.v_dual = pose.rotation * wp.cw_div(v_s, scale)
        section.center = pose.origin + section.x_0 * (pose.rotation * wp.cw_mul(scale, normal_s))
        section.area = wp.length(wp.cross(section.u_axis, section.v_axis))
        return section
    axis = vec3d(pose.rotation[0, 2], pose.rotation[1, 2], pose.rotation[2, 2])
    along = perpendicular(axis, normal)
    if wp.length(along) < UPRIGHT:
        along = perpendicular(in_plane, axis)
    u = wp.normalize(along)
    v = wp.normalize(wp.cross(normal, u))
    u = wp.cross(v, normal)
    across = wp.cross(v, axis)
    section.u_axis = u
    section.v_axis = v
    section.u_dual = u
    section.v_dual = v
    section.center = pose.origin - height * normal
    section.area = double(1.0)
    section.x_u = wp.dot(across, u)
    section.x_t = -wp.dot(across, normal)
    section.x_0 = height * section.x_t
    section.z_u = wp.dot(axis, u)
    section.z_t = -wp.dot(axis, normal)
    section.z_0 = height * section.z_t
    if flags & CONE:
        tip = pose.origin + scale[2] * axis
        section.tip_height = wp.dot(normal, tip - origin)
        section.has_tip = section.tip_height < double(0.0)
        section.u_tip = wp.dot(u, tip - section.center)
    return section


@wp.func
def position_in_section(section: Section, u: double, v: double):
    """Returns the point (u, v) of the plane [m]."""
    return section.center + u * section.u_axis + v * section.v_axis


@wp.func
def width_squared(section: Section, profile: Profile, start: double, slope: double):
    """Returns the coefficients (c₀, c₁, c₂) of the largest v² = c₀ + c₁ u + c₂ u² at depths t = start + slope × u."""
    z_0 = section.z_0 + section.z_t * start
    z_u = section.z_u + section.z_t * slope
    x_0 = section.x_0 + section.x_t * start
    x_u = section.x_u + section.x_t * slope
    return vec3d(
        profile.k_0 + profile.k_1 * z_0 + profile.k_2 * z_0 * z_0 - x_0 * x_0,
        profile.k_1 * z_u + double(2.0) * (profile.k_2 * z_0 * z_u - x_0 * x_u),
        profile.k_2 * z_u * z_u - x_u * x_u,
    )


@wp.func
def polynomial(coefficients: vec3d, u: double):
    """Returns c₀ + c₁ u + c₂ u²."""
    return coefficients[0] + u * (coefficients[1] + u * coefficients[2])


@wp.func
def real_roots(coefficients: vec3d):
    """Returns the roots of c₀ + c₁ u + c₂ u², in ascending order, and whether they are real; infinite without c₂."""
    c_2 = coefficients[2]
    if c_2 == double(0.0):
        c_2 = TINY
    discriminant = coefficients[1] * coefficients[1] - double(4.0) * c_2 * coefficients[0]
    if discriminant < double(0.0):
        return double(0.0), double(0.0), False
    q = double(-0.5) * (
        coefficients[1]
        + wp.where(coefficients[1] < double(0.0), double(-1.0), double(1.0)) * wp.sqrt(discriminant)
    )
    if q == double(0.0):
        return double(0.0), double(0.0), True
    first = q / c_2
    second = coefficients[0] / q
    return wp.min(first, second), wp.max(first, second), True


@wp.func
def limit_depth(section: Section, z: double):
    """Returns the depth t = start + slope × u at which z has a value, as (start, slope), and whether there is one."""
    if wp.abs(section.z_t) < UPRIGHT:
        return wp.vec2d(), False
    return wp.vec2d((z - section.z_0) / section.z_t, -section.z_u / section.z_t), True


@wp.func
def depths_between_limits(section: Section, profile: Profile, u: double):
    """Returns the depths t ≥ 0 at which z is within its limits, as (least, largest); least > largest: none."""
    if wp.abs(section.z_t) < UPRIGHT:
        z = section.z_0 + section.z_u * u
        if z < profile.lower or z > profile.upper:
            return wp.vec2d(double(1.0), double(0.0))
        return wp.vec2d(double(0.0), double(wp.inf))
    z = section.z_0 + section.z_u * u
    first = (profile.lower - z) / section.z_t
    second = (profile.upper - z) / section.z_t
    return wp.vec2d(wp.max(wp.min(first, second), double(0.0)), wp.max(first, second))


@wp.func
def largest_width_squared(section: Section, profile: Profile, u: double):
    """Returns the largest v² of a part at any depth t ≥ 0; negative: there is none."""
    depths = depths_between_limits(section, profile, u)
    if depths[0] > depths[1]:
        return double(-1.0)
    column = column_quadratic(section, profile, u, double(0.0))
    largest = polynomial(column, depths[0])
    if depths[1] < double(wp.inf):
        largest = wp.max(largest, polynomial(column, depths[1]))
    if column[2] < double(0.0):
        vertex = wp.clamp(double(-0.5) * column[1] / column[2], depths[0], depths[1])
        largest = wp.max(largest, polynomial(column, vertex))
    return largest


@wp.func
def column_quadratic(section: Section, profile: Profile, u: double, v: double):
    """Returns the coefficients in t of k₀ + k₁ z + k₂ z² − x² − v² along the column at (u, v)."""
    z = section.z_0 + section.z_u * u
    x = section.x_0 + section.x_u * u
    return vec3d(
        profile.k_0 + profile.k_1 * z + profile.k_2 * z * z - x * x - v * v,
        profile.k_1 * section.z_t + double(2.0) * (profile.k_2 * z * section.z_t - x * section.x_t),
        profile.k_2 * section.z_t * section.z_t - section.x_t * section.x_t,
    )


@wp.func
def interval_of_quadratic(coefficients: vec3d, limits: wp.vec2d, z_slope: double):
    """Returns the interval of t within limits in which c₀ + c₁ t + c₂ t² ≥ 0; the first value is larger if there is none.

    Args:
        coefficients: (c₀, c₁, c₂) along a line through a part of a curved solid.
        limits: Values of t at which z is within its limits.
        z_slope: Derivative of z with respect to t.
    """
    result = limits
    if coefficients[2] == double(0.0) and coefficients[1] == double(0.0):
        # Along the generators of a cylinder.
        if coefficients[0] < double(0.0):
            return wp.vec2d(double(1.0), double(0.0))
        return result
    first, second, are_real = real_roots(coefficients)
    if coefficients[2] > double(0.0):
        # Into one of the two nappes of a cone: that of smaller z.
        if are_real:
            if z_slope > double(0.0):
                result[1] = wp.min(result[1], first)
            else:
                result[0] = wp.max(result[0], second)
        return result
    if not are_real:
        return wp.vec2d(double(1.0), double(0.0))
    if coefficients[2] == double(0.0):
        # Parallel to a generator of a cone, or rounding: one root is infinite.
        root = -coefficients[0] / coefficients[1]
        if coefficients[1] > double(0.0):
            result[0] = wp.max(result[0], root)
        else:
            result[1] = wp.min(result[1], root)
        return result
    return wp.vec2d(wp.max(result[0], first), wp.min(result[1], second))


@wp.func
def column_interval(section: Section, profile: Profile, u: double, v: double):
    """Returns the depths t ≥ 0 at which the column at (u, v) enters and leaves a part; the first is larger if it does not."""
    return interval_of_quadratic(
        column_quadratic(section, profile, u, v), depths_between_limits(section, profile, u), section.z_t
    )


@wp.func
def exit_depth_of(section: Section, flags: int, scale: vec3d, u: double, v: double):
    """Returns the depth at which the column at the point (u, v) of a curved solid leaves the solid; negative: it does not."""
    depth = double(-1.0)
    for part in range(part_count(flags)):
        interval = column_interval(section, profile_of(flags, scale, part), u, v)
        if interval[0] <= interval[1]:
            depth = wp.max(depth, interval[1])
    return depth
