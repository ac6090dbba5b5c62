"""Principal curvatures of shapes at a contact point, and relative curvatures of a pair.

Curvatures are those of normal sections, positive for convex material: 1/r of a sphere, −1/r of its mold. Across a
sharp edge the curvature is infinite; along it, that of the edge in the plane of the normal. At a tip or a sharp
corner both are infinite. Flat faces have zero curvature. A boundary between two regions, such as the seam of a
capsule, has the curvature of one of them.

Along a displacement t in the tangent plane the gap opens by ½ t·(S_a + S_b) t with the shape operators S. The
principal values of S_a + S_b are the relative curvatures; in Hertz theory A + B = ½ (κ₁ + κ₂).
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import (
    LOOSE_AXIS_TOLERANCE,
    Curvature,
    Plane,
    Shape,
    ShapeContactPoint,
    half,
    one,
    real,
    two,
    vec3d,
    zero,
)
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface, parametric_jet
from warpcontact.kernels.shapes.revolution import Cone, Cylinder, Torus
from warpcontact.kernels.shapes.rounded_box import RoundedBox
from warpcontact.kernels.shapes.separation import perpendicular
from warpcontact.kernels.shapes.spheres import Capsule, Ellipsoid, Sphere
from warpcontact.kernels.shapes.superellipsoid import Superellipsoid

infinite = wp.constant(real(wp.inf))
# Tolerance for points on an edge (relative to the size) and for normals along an axis.
TOLERANCE = wp.constant(real(1.0e-9))


@wp.func
def isotropic(k: real, n: vec3d):
    """Returns the same curvature in all directions."""
    found = Curvature()
    found.k_1 = k
    found.k_2 = k
    found.direction = perpendicular(n)
    return found


@wp.func
def ordered(k: real, along: vec3d, other: real, beside: vec3d):
    """Returns curvature k along a unit vector and another one normal to it, in ascending order."""
    found = Curvature()
    found.k_1 = k
    found.k_2 = other
    found.direction = along
    if other < k:
        found.k_1 = other
        found.k_2 = k
        found.direction = beside
    return found


@wp.func
def principal(xx: real, xy: real, yy: real, x: vec3d, y: vec3d):
    """Returns the principal values of the symmetric form with entries xx, xy, yy on the unit vectors x and y."""
    found = Curvature()
    mean = half * (xx + yy)
    half_difference = half * (xx - yy)
    size = wp.sqrt(half_difference * half_difference + xy * xy)
    found.k_1 = mean - size
    found.k_2 = mean + size
    found.direction = x
    if size > zero:
        # Direction of the smaller value: half the angle of (−half_difference, −xy).
        angle = half * wp.atan2(-xy, -half_difference)
        found.direction = wp.cos(angle) * x + wp.sin(angle) * y
    return found


@wp.func
def sphere_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a sphere."""
    return isotropic(one / p.radius, n)


@wp.func
def plane_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a half-space."""
    return isotropic(zero, n)


@wp.func
def curvature_from_radii(radii: wp.mat33d, n: vec3d):
    """Returns the curvature from the Hessian of the support function, whose principal values are the radii."""
    x = perpendicular(n)
    y = wp.cross(n, x)
    radii_of_curvature = principal(wp.dot(x, radii * x), wp.dot(x, radii * y), wp.dot(y, radii * y), x, y)
    found = Curvature()
    # The larger radius is the smaller curvature.
    found.k_1 = one / wp.max(radii_of_curvature.k_2, zero)
    found.k_2 = one / wp.max(radii_of_curvature.k_1, zero)
    found.direction = wp.cross(n, radii_of_curvature.direction)
    return found


@wp.func
def ellipsoid_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of an ellipsoid: second derivatives of its equation over the size of its gradient."""
    slope = wp.cw_div(wp.cw_div(point, p.semi_axes), p.semi_axes)
    size = wp.length(slope)
    x = perpendicular(n)
    y = wp.cross(n, x)
    x_scaled = wp.cw_div(x, p.semi_axes)
    y_scaled = wp.cw_div(y, p.semi_axes)
    xx = wp.dot(x_scaled, x_scaled) / size
    yy = wp.dot(y_scaled, y_scaled) / size
    return principal(xx, wp.dot(x_scaled, y_scaled) / size, yy, x, y)


@wp.func
def superellipsoid_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a superellipsoid: infinite or very large on edges, zero on flat points."""
    axes = p.semi_axes
    if wp.abs(n[0]) <= LOOSE_AXIS_TOLERANCE and wp.abs(n[1]) <= LOOSE_AXIS_TOLERANCE:
        # At a pole the height depends on the power 2/e₁ of the distance from the axis, independent of e₂.
        if p.exponents[0] < one:
            return isotropic(zero, n)
        if p.exponents[0] > one:
            return isotropic(infinite, n)
        return ordered(
            axes[2] / (axes[0] * axes[0]),
            vec3d(one, zero, zero),
            axes[2] / (axes[1] * axes[1]),
            vec3d(zero, one, zero),
        )
    flat = wp.int32(0)
    along = vec3d()
    for i in range(3):
        exponent = p.exponents[1]
        if i == 2:
            exponent = p.exponents[0]
        if wp.abs(n[i]) <= LOOSE_AXIS_TOLERANCE and exponent < one:
            # The support function has a kink here, so it gives no radius in this direction.
            flat += 1
            along = vec3d()
            along[i] = one
    if flat > 1:
        return isotropic(zero, n)
    expansion = Superellipsoid.expand(p, n)
    if flat == 1:
        beside = wp.normalize(wp.cross(n, along))
        radius = wp.max(wp.dot(beside, expansion.hessian * beside), zero)
        return ordered(zero, along, one / radius, beside)
    return curvature_from_radii(expansion.hessian, n)


@wp.func
def revolution_curvature(point: vec3d, n: vec3d, meridian: real):
    """Returns the curvature of a surface of revolution about z with the given curvature of its meridian."""
    out = vec3d(point[0], point[1], zero)
    radius = wp.length(out)
    around = wp.cross(vec3d(zero, zero, one), out / radius)
    return ordered(wp.dot(n, out) / (radius * radius), around, meridian, wp.cross(around, n))


@wp.func
def capsule_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a capsule."""
    if wp.abs(n[2]) <= TOLERANCE and wp.abs(point[2]) < p.half_length:
        return revolution_curvature(point, n, zero)
    return isotropic(one / p.radius, n)


@wp.func
def cylinder_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a cylinder: mantle, ends and the edges between them."""
    if wp.sqrt(n[0] * n[0] + n[1] * n[1]) <= TOLERANCE:
        return isotropic(zero, n)
    if wp.abs(n[2]) <= TOLERANCE:
        return revolution_curvature(point, n, zero)
    return revolution_curvature(point, n, infinite)


@wp.func
def cone_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a cone: mantle, base, the edge between them, and the tip."""
    if n[2] < zero and wp.sqrt(n[0] * n[0] + n[1] * n[1]) <= TOLERANCE:
        return isotropic(zero, n)
    if point[2] >= (one - TOLERANCE) * p.height:
        return isotropic(infinite, n)
    slant = wp.sqrt(p.radius * p.radius + p.height * p.height)
    if wp.abs(n[2] - p.radius / slant) <= TOLERANCE:
        return revolution_curvature(point, n, zero)
    return revolution_curvature(point, n, infinite)


@wp.func
def rounded_box_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a box: face, edge or vertex, by the number of nonzero components of the normal."""
    axis_count = wp.int32(0)
    free_axis = wp.int32(0)
    for i in range(3):
        if wp.abs(n[i]) > TOLERANCE:
            axis_count += 1
        else:
            free_axis = i
    if axis_count == 1:
        return isotropic(zero, n)
    if axis_count == 3:
        return isotropic(one / p.radius, n)
    found = Curvature()
    found.k_2 = one / p.radius
    found.direction[free_axis] = one
    return found


@wp.func
def torus_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Returns the curvature of a torus: a saddle on the inner side."""
    return revolution_curvature(point, n, one / p.minor_radius)


@functools.cache
def curvature(A: type[Shape]) -> wp.Function:
    """Returns ``(p, point, n, u, v)``: the ``Curvature`` at a point of the surface, in the frame of the shape.

    n is the unit normal of the contact; on an edge it is not determined by the point. u and v are the parameters
    of a parametric surface, and unused otherwise.

    Raises:
        TypeError: If the shape has no curvature function.
    """
    if issubclass(A, ParametricSurface):
        jet_of = parametric_jet(A)

        @wp.func
        def parametric_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
            jet = jet_of(p, u, v)
            # Second fundamental form on unit vectors along x_u and normal to it; convex is positive.
            length = wp.length(jet.u)
            x = jet.u / length
            normal = wp.normalize(wp.cross(jet.u, jet.v))
            y = wp.cross(normal, x)
            # x_v = c x + w y
            c = wp.dot(jet.v, x)
            w = wp.dot(jet.v, y)
            uu = -wp.dot(normal, jet.uu) / (length * length)
            uv = -wp.dot(normal, jet.uv) / length
            vv = -wp.dot(normal, jet.vv)
            xy = (uv - c * uu) / w
            yy = (vv - two * c * uv + c * c * uu) / (w * w)
            return principal(uu, xy, yy, x, y)

        return parametric_curvature
    curvatures = {
        Sphere: sphere_curvature,
        Plane: plane_curvature,
        Ellipsoid: ellipsoid_curvature,
        Superellipsoid: superellipsoid_curvature,
        Cylinder: cylinder_curvature,
        Capsule: capsule_curvature,
        Cone: cone_curvature,
        RoundedBox: rounded_box_curvature,
        Torus: torus_curvature,
    }
    if A not in curvatures:
        raise TypeError(f"{A.__name__} has no curvature function")
    return curvatures[A]


@wp.func
def normal_curvature(c: Curvature, n: vec3d, t: vec3d):
    """Returns the normal curvature along the unit vector t."""
    beside = wp.cross(n, c.direction)
    first = wp.dot(t, c.direction)
    second = wp.dot(t, beside)
    if second * second <= TOLERANCE * TOLERANCE:
        return c.k_1
    return c.k_1 * first * first + c.k_2 * second * second


@wp.func
def relative_curvature(a: Curvature, b: Curvature, n: vec3d):
    """Returns the relative principal curvatures of two surfaces in one frame, with a common normal line n."""
    infinite_a = a.k_2 == infinite
    infinite_b = b.k_2 == infinite
    if infinite_a or infinite_b:
        found = Curvature()
        found.k_2 = infinite
        found.direction = b.direction
        if infinite_a:
            found.direction = a.direction
        # For two edges, k_1 is finite only if they are parallel; at a tip it is infinite.
        found.k_1 = normal_curvature(a, n, found.direction) + normal_curvature(b, n, found.direction)
        return found
    x = a.direction
    y = wp.cross(n, x)
    c = wp.dot(b.direction, x)
    s = wp.dot(b.direction, y)
    xx = a.k_1 + b.k_1 * c * c + b.k_2 * s * s
    yy = a.k_2 + b.k_1 * s * s + b.k_2 * c * c
    return principal(xx, (b.k_1 - b.k_2) * c * s, yy, x, y)


@wp.struct
class PairCurvature:
    """Curvatures of both surfaces of a pair at the contact, frame of b."""

    a: Curvature
    b: Curvature
    relative: Curvature  # relative curvatures, as used by Hertz theory


@functools.cache
def pair_curvature(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns ``(p_a, p_b, x, rotation, contact)``: the ``PairCurvature`` of a contact point.

    Relative curvatures are positive where the surfaces diverge from the contact, negative where a concave surface
    is more curved than the other one, and infinite on edges.
    """
    curvature_a, curvature_b = curvature(A), curvature(B)

    @wp.func
    def evaluate(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, contact: ShapeContactPoint):
        q = wp.normalize(rotation)
        found = PairCurvature()
        u = contact.warm_start.u
        point_a = wp.quat_rotate_inv(q, contact.point_a - x)
        found.a = curvature_a(p_a, point_a, wp.quat_rotate_inv(q, -contact.normal), u[2], u[3])
        found.a.direction = wp.quat_rotate(q, found.a.direction)
        found.b = curvature_b(p_b, contact.point_b, contact.normal, u[0], u[1])
        found.relative = relative_curvature(found.a, found.b, contact.normal)
        return found

    return evaluate
