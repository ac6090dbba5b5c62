"""Intersections of rays with unit spheres, cylinders and cones, and the normals there."""

import warp as wp
from warpcontact.kernels.rendering.world import CONE, CYLINDER, SPHERE

# Distance along a ray that hits nothing.
NO_HIT = wp.constant(-1.0)
_FAR = wp.constant(1.0e30)


@wp.func
def first_positive(enter: float, leave: float):
    """Returns the distance at which a ray enters a convex body, or leaves it if the ray starts inside."""
    if enter > leave:
        return NO_HIT
    if enter > 0.0:
        return enter
    return leave


@wp.func
def intersect_sphere(o: wp.vec3, d: wp.vec3):
    """Returns the distance along the ray from ``o`` along ``d`` to the unit sphere; not positive: none."""
    # Relative to the point nearest to the center, so that a distant origin does not cancel digits.
    squared = wp.dot(d, d)
    nearest = -wp.dot(o, d) / squared
    p = o + nearest * d
    discriminant = 1.0 - wp.dot(p, p)
    if discriminant < 0.0:
        return NO_HIT
    half = wp.sqrt(discriminant / squared)
    return first_positive(nearest - half, nearest + half)


@wp.func
def intersect_cylinder(o: wp.vec3, d: wp.vec3):
    """Returns the distance to the unit cylinder; see ``intersect_sphere``."""
    nearest = -wp.dot(o - wp.vec3(0.0, 0.0, 0.5), d) / wp.dot(d, d)
    p = o + nearest * d
    enter = -_FAR
    leave = _FAR
    a = d[0] * d[0] + d[1] * d[1]
    c = p[0] * p[0] + p[1] * p[1] - 1.0
    if a > 0.0:
        b = p[0] * d[0] + p[1] * d[1]
        root = b * b - a * c
        if root < 0.0:
            return NO_HIT
        enter = (-b - wp.sqrt(root)) / a
        leave = (-b + wp.sqrt(root)) / a
    elif c > 0.0:
        return NO_HIT
    if d[2] != 0.0:
        bottom = -p[2] / d[2]
        top = (1.0 - p[2]) / d[2]
        enter = wp.max(enter, wp.min(bottom, top))
        leave = wp.min(leave, wp.max(bottom, top))
    elif p[2] < 0.0 or p[2] > 1.0:
        return NO_HIT
    return first_positive(nearest + enter, nearest + leave)


@wp.func
def nearer_cone_hit(t: float, p: wp.vec3, d: wp.vec3, start: float, best: float):
    """Returns ``start + t`` if that point is between base and tip and nearer than ``best``, else ``best``."""
    z = p[2] + t * d[2]
    if z >= 0.0 and z <= 1.0 and start + t > 0.0 and start + t < best:
        return start + t
    return best


@wp.func
def intersect_cone(o: wp.vec3, d: wp.vec3):
    """Returns the distance to the unit cone; see ``intersect_sphere``."""
    nearest = -wp.dot(o - wp.vec3(0.0, 0.0, 0.5), d) / wp.dot(d, d)
    p = o + nearest * d
    best = _FAR
    a = d[0] * d[0] + d[1] * d[1] - d[2] * d[2]
    b = p[0] * d[0] + p[1] * d[1] + (1.0 - p[2]) * d[2]
    c = p[0] * p[0] + p[1] * p[1] - (1.0 - p[2]) * (1.0 - p[2])
    if wp.abs(a) > 1.0e-6 * wp.dot(d, d):
        root = b * b - a * c
        if root >= 0.0:
            best = nearer_cone_hit((-b - wp.sqrt(root)) / a, p, d, nearest, best)
            best = nearer_cone_hit((-b + wp.sqrt(root)) / a, p, d, nearest, best)
    elif b != 0.0:
        best = nearer_cone_hit(-0.5 * c / b, p, d, nearest, best)
    if d[2] != 0.0:
        t = -p[2] / d[2]
        x = p[0] + t * d[0]
        y = p[1] + t * d[1]
        if x * x + y * y <= 1.0 and nearest + t > 0.0 and nearest + t < best:
            best = nearest + t
    return wp.where(best < _FAR, best, NO_HIT)


@wp.func
def intersect_shape(kind: int, o: wp.vec3, d: wp.vec3):
    """Returns the distance along a ray to a shape of this kind, in its frame; not positive: none."""
    if kind == SPHERE:
        return intersect_sphere(o, d)
    if kind == CYLINDER:
        return intersect_cylinder(o, d)
    return intersect_cone(o, d)


@wp.func
def shape_normal(kind: int, p: wp.vec3, scale: wp.vec3):
    """Returns the outer normal at a point of a shape of this kind, in its frame."""
    if kind == SPHERE:
        return p
    radius = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    if kind == CONE:
        if p[2] * scale[2] < wp.abs(1.0 - p[2] - radius) * scale[0]:
            return wp.vec3(0.0, 0.0, -1.0)
        return wp.vec3(p[0], p[1], radius)
    # Cylinder: the nearest of side and ends.
    side = wp.abs(1.0 - radius) * scale[0]
    if wp.abs(p[2]) * scale[2] < side:
        return wp.vec3(0.0, 0.0, -1.0)
    if wp.abs(1.0 - p[2]) * scale[2] < side:
        return wp.vec3(0.0, 0.0, 1.0)
    return wp.vec3(p[0], p[1], 0.0)
