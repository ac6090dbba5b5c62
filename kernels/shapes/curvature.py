"""Principal curvatures of shapes where they touch, and those of a pair relative to each other.

Curvatures are those of normal sections, positive where the material is convex: 1/r of a sphere, −1/r of its mould.
Across a sharp edge the curvature is infinite, along it that of the edge in the plane of the normal; at a tip and a
sharp corner both are. Flat faces have none. What lies between two of these, as the seam of a capsule, has that of
one side.

The gap of a pair along a displacement t in the tangent plane opens by ½ t·(S_a + S_b) t: the principal values of
the sum are the relative curvatures, A + B = ½ (κ₁ + κ₂) in Hertz's words.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import (
    LOOSE_AXIS_TOLERANCE,
    Curvature,
    Shape,
    ShapeContactPoint,
    half,
    one,
    real,
    two,
    vec3d,
    zero,
)
from warpcontact.kernels.shapes.capsule import Capsule
from warpcontact.kernels.shapes.charts import chart
from warpcontact.kernels.shapes.cone import Cone
from warpcontact.kernels.shapes.cylinder import Cylinder
from warpcontact.kernels.shapes.ellipsoid import Ellipsoid
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.plane import Plane
from warpcontact.kernels.shapes.rounded_box import RoundedBox
from warpcontact.kernels.shapes.sphere import Sphere
from warpcontact.kernels.shapes.superellipsoid import Superellipsoid
from warpcontact.kernels.shapes.torus import Torus

infinite = wp.constant(real(wp.inf))
# A place is on an edge, and a normal along an axis, within this: of the size, and of a unit vector.
TOLERANCE = wp.constant(real(1.0e-9))


@wp.func
def perpendicular(n: vec3d):
    """A unit vector across the unit vector n."""
    if wp.abs(n[0]) < wp.abs(n[2]):
        return wp.normalize(vec3d(zero, n[2], -n[1]))
    return wp.normalize(vec3d(-n[1], n[0], zero))


@wp.func
def isotropic(k: real, n: vec3d):
    """The same curvature in all directions."""
    found = Curvature()
    found.k_1 = k
    found.k_2 = k
    found.direction = perpendicular(n)
    return found


@wp.func
def ordered(k: real, along: vec3d, other: real, beside: vec3d):
    """Curvature k along a unit vector, and another one beside it, in order."""
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
    """Principal values of the symmetric form of xx, xy, yy on the unit vectors x and y."""
    found = Curvature()
    mean = half * (xx + yy)
    half_difference = half * (xx - yy)
    size = wp.sqrt(half_difference * half_difference + xy * xy)
    found.k_1 = mean - size
    found.k_2 = mean + size
    found.direction = x
    if size > zero:
        # Half the angle of (−apart, −xy): where the form is least.
        angle = half * wp.atan2(-xy, -half_difference)
        found.direction = wp.cos(angle) * x + wp.sin(angle) * y
    return found


@wp.func
def sphere_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Of a sphere."""
    return isotropic(one / p.radius, n)


@wp.func
def plane_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Of a half-space."""
    return isotropic(zero, n)


@wp.func
def curvature_from_radii(radii: wp.mat33d, n: vec3d):
    """Of what has the Hessian ``radii`` of its support function, which are the radii of curvature."""
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
    """Of an ellipsoid: second derivatives of its equation over the length of the first."""
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
    """Of a superellipsoid: infinite, or nearly so, on its edges, and nothing where it is flat."""
    axes = p.semi_axes
    if wp.abs(n[0]) <= LOOSE_AXIS_TOLERANCE and wp.abs(n[1]) <= LOOSE_AXIS_TOLERANCE:
        # At a pole the surface goes by the power 2/e₁ of the distance from the axis, whatever e₂ is.
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
            # The support function has a kink here, of no use for a radius.
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
    """Of a surface about the z axis with the given curvature of its meridian."""
    out = vec3d(point[0], point[1], zero)
    radius = wp.length(out)
    around = wp.cross(vec3d(zero, zero, one), out / radius)
    return ordered(wp.dot(n, out) / (radius * radius), around, meridian, wp.cross(around, n))


@wp.func
def capsule_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Of a capsule."""
    if wp.abs(n[2]) <= TOLERANCE and wp.abs(point[2]) < p.half_length:
        return revolution_curvature(point, n, zero)
    return isotropic(one / p.radius, n)


@wp.func
def cylinder_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Of a cylinder: its mantle, its ends, and the rim between them."""
    if wp.sqrt(n[0] * n[0] + n[1] * n[1]) <= TOLERANCE:
        return isotropic(zero, n)
    if wp.abs(n[2]) <= TOLERANCE:
        return revolution_curvature(point, n, zero)
    return revolution_curvature(point, n, infinite)


@wp.func
def cone_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
    """Of a cone: its mantle, its base, the rim between them, and the tip."""
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
    """Of a box: its faces, edges and corners, by how many axes the normal leans on."""
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
    """Of a torus: a saddle at the inner side."""
    return revolution_curvature(point, n, one / p.minor_radius)


@functools.cache
def curvature(A: type[Shape]) -> wp.Function:
    """Returns ``(p, point, n, u, v)``: the ``Curvature`` at a point of the surface, all in the frame of the shape.

    n is the unit normal of the contact: on an edge there are many. u and v are the parameters of a patch, and
    unused otherwise.

    Raises:
        TypeError: If it is a shape of which no curvature is known.
    """
    if issubclass(A, ParametricSurface):
        jet_of = chart(A).jet

        @wp.func
        def parametric_curvature(p: Any, point: vec3d, n: vec3d, u: real, v: real):
            jet = jet_of(p, 0, u, v)
            # The second fundamental form on unit vectors along x_u and across; convex is positive.
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
        raise TypeError(f"the curvature of {A.__name__} is not known")
    return curvatures[A]


@wp.func
def normal_curvature(c: Curvature, n: vec3d, t: vec3d):
    """Curvature of the section along the unit vector t."""
    beside = wp.cross(n, c.direction)
    first = wp.dot(t, c.direction)
    second = wp.dot(t, beside)
    if second * second <= TOLERANCE * TOLERANCE:
        return c.k_1
    return c.k_1 * first * first + c.k_2 * second * second


@wp.func
def relative_curvature(a: Curvature, b: Curvature, n: vec3d):
    """Relative principal curvatures of two surfaces in one frame, with the normal n of either."""
    infinite_a = a.k_2 == infinite
    infinite_b = b.k_2 == infinite
    if infinite_a or infinite_b:
        found = Curvature()
        found.k_2 = infinite
        found.direction = b.direction
        if infinite_a:
            found.direction = a.direction
        # Two edges leave a direction only if they are parallel; k_1 at a tip is infinite, too.
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
    """Curvatures of a pair where it meets, frame of b."""

    a: Curvature
    b: Curvature
    relative: Curvature  # what Hertz contact takes


@functools.cache
def pair_curvature(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns ``(p_a, p_b, x, rotation, meeting)``: the curvatures of a pair, ``PairCurvature``.

    The relative ones are positive where the surfaces part from the contact, negative where a hollow is narrower
    than what lies in it, infinite on edges.
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
