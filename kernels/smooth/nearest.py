"""The point of a closed surface that is nearest to a place: signed distance, normal and foot."""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.formula import coefficient_struct
from warpcontact.kernels.smooth import around, ascent, convex
from warpcontact.kernels.smooth.base import Nearest, Seed, Shape, one, real, vec3d, zero
from warpcontact.kernels.smooth.ellipsoid import Ellipsoid
from warpcontact.kernels.smooth.sphere import Sphere

# Newton's method for the distance from an ellipsoid ends when a step is rounding; 5 to 8 are usual.
STEPS = wp.constant(wp.int32(60))
ROUNDING = wp.constant(real(1.0e-15))
# A normal to start from where none is known.
UP = wp.constant(vec3d(0.0, 0.0, 1.0))


@wp.func
def from_ellipsoid(p: Any, x: vec3d):
    """Of an ellipsoid: the point a² x/(t + a²) by axis, with the t that puts it onto the surface.

    The left side of Σ (a x/(t + a²))² = 1 is convex and falls beyond −a² of the shortest axis. Its inverse root is
    nearly straight, and Newton's method on that does not overshoot from the left. As t is counted from there, no
    digit of it is lost. Beside the middle of a short axis, that term alone is large next to where it is infinite:
    steps for the sum without it are longer, and do not overshoot either, as each term moves the root on.
    """
    squares = wp.cw_mul(p.semi_axes, p.semi_axes)
    scaled = wp.cw_mul(p.semi_axes, x)
    short = wp.int32(0)
    long = wp.int32(0)
    for i in range(1, 3):
        if squares[i] < squares[short]:
            short = i
        if squares[i] >= squares[long]:
            long = i
    longer = squares - vec3d(squares[short], squares[short], squares[short])
    # Where each term alone is 1: the sum is at least that at the last of these. It is 0 in the middle of the
    # shortest axis, between two nearest points.
    t = zero
    for i in range(3):
        t = wp.max(t, wp.abs(scaled[i]) - longer[i])
    for _i in range(STEPS):
        total = zero
        steep = zero
        step = zero
        # The longest axis alone, with the middle one, and all.
        for k in range(3):
            axis = long
            if k == 1:
                axis = 3 - long - short
            elif k == 2:
                axis = short
            if scaled[axis] != zero:
                part = scaled[axis] / (t + longer[axis])
                total += part * part
                steep += part * part / (t + longer[axis])
                if total > one:
                    step = wp.max(step, (wp.sqrt(total) - one) * total / steep)
        t = t + step
        if step <= ROUNDING * t:
            break
    foot = vec3d()
    rest = one
    for i in range(3):
        if scaled[i] != zero:
            share = scaled[i] / (t + longer[i])
            foot[i] = p.semi_axes[i] * share
            rest -= share * share
    if t == zero and rest > zero:
        # On the middle surface what is missing lies along the shortest axis: the upper one of both.
        foot[short] = p.semi_axes[short] * wp.sqrt(rest)
    found = Nearest()
    found.point = foot
    found.normal = wp.normalize(wp.cw_div(foot, squares))
    found.gap = wp.dot(found.normal, x - foot)
    return found


@wp.func
def facing(n: vec3d, x: vec3d):
    """The direction n on the same sides of three planes of symmetry as a place, where the best is."""
    return vec3d(
        wp.where(x[0] < zero, -wp.abs(n[0]), wp.abs(n[0])),
        wp.where(x[1] < zero, -wp.abs(n[1]), wp.abs(n[1])),
        wp.where(x[2] < zero, -wp.abs(n[2]), wp.abs(n[2])),
    )


def searched(A: type[Shape]) -> bool:
    """Whether the point of a shape that is nearest to a place is searched over all directions, at some cost."""
    return not hasattr(A, "nearest") and A is not Ellipsoid


@functools.cache
def nearest(A: type[Shape]) -> wp.Function:
    """Returns ``(p, x)``: the ``Nearest`` point of a closed shape, in its frame."""
    if hasattr(A, "nearest"):
        return A.nearest
    if A is Ellipsoid:
        return from_ellipsoid
    mirrored = around.mirrored(Sphere, A)
    # As a sphere without radius sees it.
    of_pair = convex.meet(Sphere, A)
    Point = coefficient_struct(Sphere, real)

    @wp.func
    def from_place(p: Any, x: vec3d):
        met = of_pair(Point(), p, x, wp.quatd(zero, zero, zero, one), Seed())
        found = Nearest()
        found.gap = met.gap
        found.normal = met.normal
        found.point = met.point_b
        if wp.static(mirrored):
            # Where a component is next to nothing, the climb may end on the other side.
            n = facing(met.normal, x)
            if wp.dot(n, x) > wp.dot(met.normal, x):
                found.normal = n
                found.gap = wp.dot(n, x - A.support(p, n))
        return found

    return from_place


@functools.cache
def nearest_within(A: type[Shape]) -> wp.Function:
    """Returns ``(p, x, start, enough)``: the ``Nearest`` point of a place that is nearer than ``enough`` [m].

    Of others the gap may be less than the distance, but no less than ``enough``; the normal is that of the plane
    that tells so. ``start`` is a normal to try first.
    """
    if not searched(A):
        exact = nearest(A)

        @wp.func
        def at_once(p: Any, x: vec3d, start: vec3d, enough: real):
            return exact(p, x)

        return at_once
    exact, climb = nearest(A), ascent.functions(Sphere, A).climb
    mirrored = around.mirrored(Sphere, A)
    Point = coefficient_struct(Sphere, real)

    @wp.func
    def from_start(p: Any, x: vec3d, start: vec3d, enough: real):
        n = start
        if wp.static(mirrored):
            n = facing(start, x)
        size = wp.length(x) + wp.max(A.extents(p))
        top = climb(Point(), p, x, wp.identity(n=3, dtype=real), n, size)
        found = Nearest()
        found.gap = top.value - A.margin(p)
        found.normal = top.normal
        if found.gap < enough:
            found = exact(p, x)
        return found

    return from_start
