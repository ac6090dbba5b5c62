"""Signed distance of a point from a closed shape, with closest point and normal."""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes import convex, direction_branch_and_bound, separation_newton
from warpcontact.kernels.shapes.base import Shape, SignedDistance, WarmStart, one, real, vec3d, zero
from warpcontact.kernels.shapes.spheres import Ellipsoid, Sphere

# Newton's method for the distance from an ellipsoid ends when a step is rounding, usually after 5 to 8 steps.
MAX_STEPS = wp.constant(wp.int32(60))
ROUNDING = wp.constant(real(1.0e-15))
# Initial normal if there is no other guess.
UP = wp.constant(vec3d(0.0, 0.0, 1.0))


@wp.func
def ellipsoid_distance(p: Any, x: vec3d):
    """Returns the ``SignedDistance`` of an ellipsoid: closest point a² x/(t + a²) per axis, t from its equation.

    The left side of Σ (a x/(t + a²))² = 1 is convex and decreases for t > −a² of the shortest axis. Its inverse
    square root is nearly linear, and Newton's method applied to it does not overshoot from the left. t is measured
    from that pole, so no digits are lost. Near the middle plane of a short axis, the term of that axis dominates
    next to its pole. Steps for the sum without it are longer and do not overshoot either, because each term
    increases the root.
    """
    squares = wp.cw_mul(p.semi_axes, p.semi_axes)
    scaled = wp.cw_mul(p.semi_axes, x)
    shortest = wp.int32(0)
    longest = wp.int32(0)
    for i in range(1, 3):
        if squares[i] < squares[shortest]:
            shortest = i
        if squares[i] >= squares[longest]:
            longest = i
    longer = squares - vec3d(squares[shortest], squares[shortest], squares[shortest])
    # Start at the last t where one term alone is 1: the sum is at least 1 there. t is 0 in the middle plane of the
    # shortest axis, between two closest points.
    t = zero
    for i in range(3):
        t = wp.max(t, wp.abs(scaled[i]) - longer[i])
    for _i in range(MAX_STEPS):
        total = zero
        slope_sum = zero
        step = zero
        # Steps for the longest axis, the two longest, and all.
        for k in range(3):
            axis = longest
            if k == 1:
                axis = 3 - longest - shortest
            elif k == 2:
                axis = shortest
            if scaled[axis] != zero:
                part = scaled[axis] / (t + longer[axis])
                total += part * part
                slope_sum += part * part / (t + longer[axis])
                if total > one:
                    step = wp.max(step, (wp.sqrt(total) - one) * total / slope_sum)
        t = t + step
        if step <= ROUNDING * t:
            break
    closest = vec3d()
    remainder = one
    for i in range(3):
        if scaled[i] != zero:
            fraction = scaled[i] / (t + longer[i])
            closest[i] = p.semi_axes[i] * fraction
            remainder -= fraction * fraction
    if t == zero and remainder > zero:
        # In the middle plane the remainder is along the shortest axis; of the two points take the upper one.
        closest[shortest] = p.semi_axes[shortest] * wp.sqrt(remainder)
    result = SignedDistance()
    result.point = closest
    result.normal = wp.normalize(wp.cw_div(closest, squares))
    result.gap = wp.dot(result.normal, x - closest)
    return result


@wp.func
def mirror_to(n: vec3d, x: vec3d):
    """Mirrors n to the octant of x, which contains the maximum of the separation."""
    return vec3d(
        wp.where(x[0] < zero, -wp.abs(n[0]), wp.abs(n[0])),
        wp.where(x[1] < zero, -wp.abs(n[1]), wp.abs(n[1])),
        wp.where(x[2] < zero, -wp.abs(n[2]), wp.abs(n[2])),
    )


def needs_search(A: type[Shape]) -> bool:
    """Returns whether the signed distance of a shape needs a search over all directions."""
    return not hasattr(A, "signed_distance") and A is not Ellipsoid


@functools.cache
def signed_distance(A: type[Shape]) -> wp.Function:
    """Returns ``(p, x)``: the ``SignedDistance`` of a closed shape, in its frame."""
    if hasattr(A, "signed_distance"):
        return A.signed_distance
    if A is Ellipsoid:
        return ellipsoid_distance
    symmetric = direction_branch_and_bound.shares_symmetry(Sphere, A)
    # The contact of the shape with a sphere of radius 0.
    sphere_contact = convex.pair_function(Sphere, A)
    PointCoefficients = coefficient_struct(Sphere, real)

    @wp.func
    def searched_distance(p: Any, x: vec3d):
        contact = sphere_contact(PointCoefficients(), p, x, wp.quatd(zero, zero, zero, one), WarmStart())
        result = SignedDistance()
        result.gap = contact.gap
        result.normal = contact.normal
        result.point = contact.point_b
        if wp.static(symmetric):
            # With a component of n near zero, the ascent may end on the other side.
            n = mirror_to(contact.normal, x)
            if wp.dot(n, x) > wp.dot(contact.normal, x):
                result.normal = n
                result.gap = wp.dot(n, x - A.support(p, n))
        return result

    return searched_distance


@functools.cache
def signed_distance_within(A: type[Shape]) -> wp.Function:
    """Returns ``(p, x, start, threshold)``: the ``SignedDistance``, exact if the gap is below ``threshold`` [m].

    Otherwise the gap is a lower bound that is not below ``threshold``, and the normal is that of the separating
    plane that gives it. ``start`` is the initial normal.
    """
    if not needs_search(A):
        exact = signed_distance(A)

        @wp.func
        def exact_distance(p: Any, x: vec3d, start: vec3d, threshold: real):
            return exact(p, x)

        return exact_distance
    exact, ascend = signed_distance(A), separation_newton.functions(Sphere, A).ascend
    symmetric = direction_branch_and_bound.shares_symmetry(Sphere, A)
    PointCoefficients = coefficient_struct(Sphere, real)

    @wp.func
    def distance_from_start(p: Any, x: vec3d, start: vec3d, threshold: real):
        n = start
        if wp.static(symmetric):
            n = mirror_to(start, x)
        size = wp.length(x) + wp.max(A.extents(p))
        maximum = ascend(PointCoefficients(), p, x, wp.identity(n=3, dtype=real), n, size)
        result = SignedDistance()
        result.gap = maximum.value - A.margin(p)
        result.normal = maximum.normal
        if result.gap < threshold:
            result = exact(p, x)
        return result

    return distance_from_start
