"""Exact derivatives of a contact with respect to poses and sizes of its shapes (implicit-function theorem).

Both points slide on their surfaces so that the normals keep facing each other. With shape operators S, rotation ω
and velocity v of a at its point relative to b, and the displacements p_a and p_b of the points in the tangent
plane,

    S_b p_b = dn,  S_a p_a = ω × n − dn,  p_a = p_b + gap dn − v.

If a curvature is infinite (edge), the equation is written with the radius. The gap changes by n·v only. Where
points are not unique, as for a flat face on a flat face, point derivatives do not exist. A size changes the gap by
the displacement of the surface along the normal; the motion of the points has no effect on it.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import Curvature, Shape, one, real, vec3d, zero
from warpcontact.kernels.shapes.revolution import Cone, Cylinder, Torus
from warpcontact.kernels.shapes.rounded_box import RoundedBox
from warpcontact.kernels.shapes.spheres import Capsule, Ellipsoid, Sphere
from warpcontact.kernels.shapes.superellipsoid import Superellipsoid

vec2d = wp.vec2d
Row1 = wp.types.vector(1, real)
Row12 = wp.types.vector(12, real)
Rows12 = wp.types.matrix((3, 12), real)
infinite = wp.constant(real(wp.inf))
not_a_number = wp.constant(real(wp.nan))
# Determinant of the scaled equations below which the points are not unique.
SINGULAR = wp.constant(real(1.0e-12))


@wp.struct
class Gradients:
    """Derivatives with respect to translation and rotation of a, then of b, in the axes of the arguments."""

    gap: Row12  # [-], [m]
    normal: Rows12  # [1/m], [-]
    point_a: Rows12  # [-], [m]
    point_b: Rows12
    determined: wp.int32  # 0: derivatives of normal and points are NaN


@wp.func
def scaled_shape_operator(c: Curvature, n: vec3d, x: vec3d, y: vec3d, size: real):
    """Returns two matrices C and K on x and y with C dn = K p; K is times ``size`` [m]."""
    beside = wp.cross(n, c.direction)
    first = vec2d(wp.dot(c.direction, x), wp.dot(c.direction, y))
    second = vec2d(wp.dot(beside, x), wp.dot(beside, y))
    # Rows scaled to size 1, also for infinite curvature.
    c_1 = zero
    k_1 = one
    if wp.abs(c.k_1) < infinite:
        c_1 = one / (one + wp.abs(c.k_1) * size)
        k_1 = c.k_1 * size * c_1
    c_2 = zero
    k_2 = one
    if wp.abs(c.k_2) < infinite:
        c_2 = one / (one + wp.abs(c.k_2) * size)
        k_2 = c.k_2 * size * c_2
    along = wp.outer(first, first)
    across = wp.outer(second, second)
    return c_1 * along + c_2 * across, k_1 * along + k_2 * across


@wp.func
def gradients(
    normal: vec3d,
    gap: real,
    point_a: vec3d,
    point_b: vec3d,
    a: Curvature,
    b: Curvature,
    origin_a: vec3d,
    origin_b: vec3d,
):
    """Returns the derivatives of a contact; all vectors are in the same axes, rotations about the two origins."""
    found = Gradients()
    x = wp.normalize(wp.cross(normal, vec3d(normal[1], normal[2], -normal[0])))
    if wp.abs(wp.dot(normal, vec3d(normal[1], normal[2], -normal[0]))) > real(0.9):
        x = wp.normalize(wp.cross(normal, vec3d(-normal[1], normal[2], normal[0])))
    y = wp.cross(normal, x)
    # Scale lengths by a length of the pair.
    size = wp.length(point_a - origin_a) + wp.length(point_b - origin_b) + wp.abs(gap)
    if size == zero:
        size = one
    C_a, K_a = scaled_shape_operator(a, normal, x, y, size)
    C_b, K_b = scaled_shape_operator(b, normal, x, y, size)
    lower = C_a + (gap / size) * K_a
    system = wp.mat44d(
        K_b[0, 0], K_b[0, 1], -C_b[0, 0], -C_b[0, 1],
        K_b[1, 0], K_b[1, 1], -C_b[1, 0], -C_b[1, 1],
        K_a[0, 0], K_a[0, 1], lower[0, 0], lower[0, 1],
        K_a[1, 0], K_a[1, 1], lower[1, 0], lower[1, 1],
    )  # fmt: skip
    found.determined = wp.where(wp.abs(wp.determinant(system)) > SINGULAR, 1, 0)
    inverse = wp.mat44d()
    if found.determined == 1:
        inverse = wp.inverse(system)
    for i in range(12):
        step = vec3d()
        step[i % 3] = one
        v_a = vec3d()
        w_a = vec3d()
        v_b = vec3d()
        w_b = vec3d()
        if i < 3:
            v_a = step
        elif i < 6:
            w_a = step
        elif i < 9:
            v_b = step
        else:
            w_b = step
        relative_rotation = w_a - w_b
        relative_motion = v_a + wp.cross(w_a, point_a - origin_a) - v_b - wp.cross(w_b, point_a - origin_b)
        gap_rate = wp.dot(normal, relative_motion)
        found.gap[i] = gap_rate
        tilt = wp.cross(relative_rotation, normal)
        right = C_a * vec2d(wp.dot(tilt, x), wp.dot(tilt, y))
        right += K_a * (vec2d(wp.dot(relative_motion, x), wp.dot(relative_motion, y)) / size)
        slide = inverse * wp.vec4d(zero, zero, right[0], right[1])
        normal_rate = wp.cross(w_b, normal) + slide[2] * x + slide[3] * y
        point_rate_b = v_b + wp.cross(w_b, point_b - origin_b) + (size * slide[0]) * x + (size * slide[1]) * y
        point_rate_a = point_rate_b + gap_rate * normal + gap * normal_rate
        for k in range(3):
            found.normal[k, i] = wp.where(found.determined == 1, normal_rate[k], not_a_number)
            found.point_a[k, i] = wp.where(found.determined == 1, point_rate_a[k], not_a_number)
            found.point_b[k, i] = wp.where(found.determined == 1, point_rate_b[k], not_a_number)
    return found


@wp.func
def radial_normal(point: vec3d, n: vec3d):
    """Returns the radial component of the normal, away from the z axis."""
    radius = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    if radius == zero:
        return zero
    return (point[0] * n[0] + point[1] * n[1]) / radius


@wp.func
def sphere_size_gradient(p: Any, point: vec3d, n: vec3d):
    """Returns the derivative with respect to the radius."""
    gradient = Row1()
    gradient[0] = one
    return gradient


@wp.func
def ellipsoid_size_gradient(p: Any, point: vec3d, n: vec3d):
    """Returns the derivatives with respect to the semi-axes, for superellipsoids as well."""
    return vec3d(
        n[0] * point[0] / p.semi_axes[0], n[1] * point[1] / p.semi_axes[1], n[2] * point[2] / p.semi_axes[2]
    )


@wp.func
def capsule_size_gradient(p: Any, point: vec3d, n: vec3d):
    """Returns the derivatives with respect to the radius and the half length."""
    along = wp.clamp((point[2] - p.radius * n[2]) / p.half_length, -one, one)
    return vec2d(one, n[2] * along)


@wp.func
def cylinder_size_gradient(p: Any, point: vec3d, n: vec3d):
    """Returns the derivatives with respect to the radius and the half length."""
    across = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    return vec2d(radial_normal(point, n) * across / p.radius, n[2] * point[2] / p.half_length)


@wp.func
def cone_size_gradient(p: Any, point: vec3d, n: vec3d):
    """Returns the derivatives with respect to the radius and the height."""
    across = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    return vec2d(radial_normal(point, n) * across / p.radius, n[2] * point[2] / p.height)


@wp.func
def rounded_box_size_gradient(p: Any, point: vec3d, n: vec3d):
    """Returns the derivatives with respect to the half extents and the radius."""
    total = zero
    gradient = wp.vec4d()
    for i in range(3):
        # Position of the center of the rounding relative to the core box, −1 to 1.
        on = wp.clamp((point[i] - p.radius * n[i]) / (p.half_extents[i] - p.radius), -one, one)
        gradient[i] = n[i] * on
        total += gradient[i]
    gradient[3] = one - total
    return gradient


@wp.func
def torus_size_gradient(p: Any, point: vec3d, n: vec3d):
    """Returns the derivatives with respect to the radii of the core circle and of the tube."""
    return vec2d(radial_normal(point, n), one)


@functools.cache
def size_gradient(A: type[Shape]) -> tuple[tuple[str, ...], wp.Function] | None:
    """Returns the size names of a shape and ``(p, point, n)``: outward displacement of the surface per size.

    The derivative of the gap is this times −1, at the contact point of the shape and its outward normal, in its
    frame. Sizes with three values have three entries. Returns ``None`` if the shape has no sizes. Exponents are
    not included.
    """
    gradients_by_shape = {
        Sphere: (("radius",), sphere_size_gradient),
        Ellipsoid: (("semi_axes",), ellipsoid_size_gradient),
        Superellipsoid: (("semi_axes",), ellipsoid_size_gradient),
        Capsule: (("radius", "half_length"), capsule_size_gradient),
        Cylinder: (("radius", "half_length"), cylinder_size_gradient),
        Cone: (("radius", "height"), cone_size_gradient),
        RoundedBox: (("half_extents", "radius"), rounded_box_size_gradient),
        Torus: (("major_radius", "minor_radius"), torus_size_gradient),
    }
    return gradients_by_shape.get(A)
