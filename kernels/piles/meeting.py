"""Where shapes of a pile are, how far apart they are, and where they touch."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.piles.base import Form, pile_structs
from warpcontact.kernels.types import structs

# Segments at a smaller angle than the root of this are parallel.
PARALLEL = 1.0e-10


@wp.func
def _within(value: wp.float64):
    return wp.clamp(value, wp.float64(-1.0), wp.float64(1.0))


@wp.func
def closest_on_segments(d: wp.vec3d, g: wp.vec3d, h: wp.vec3d):
    """Parameters (s, t) in −1…1 of the closest points of two segments.

    ``d`` is from the middle of the second to that of the first, ``g`` and ``h`` from the middles to the ends. Of
    parallel segments side by side it is the middle of where they overlap.
    """
    a = wp.dot(g, g)
    b = wp.dot(g, h)
    c = wp.dot(h, h)
    e = wp.dot(g, d)
    f = wp.dot(h, d)
    zero = wp.float64(0.0)
    s, t = zero, zero
    if a == zero:
        if c > zero:
            t = _within(f / c)
        return s, t
    if c == zero:
        return _within(-e / a), t
    det = a * c - b * b
    if det > wp.float64(PARALLEL) * a * c:
        s = _within((b * f - c * e) / det)
    else:
        # Ends of the second along the first; where both are side by side, in the middle.
        one = (-e - b) / a
        other = (-e + b) / a
        low = wp.max(wp.min(one, other), wp.float64(-1.0))
        high = wp.min(wp.max(one, other), wp.float64(1.0))
        s = _within(wp.float64(0.5) * (low + high))
        if low > high:
            s = wp.where(wp.max(one, other) < wp.float64(-1.0), wp.float64(-1.0), wp.float64(1.0))
    t = (f + s * b) / c
    if wp.abs(t) > wp.float64(1.0):
        t = _within(t)
        s = _within((t * b - e) / a)
    return s, t


@functools.cache
def functions(form: Form, real: type) -> SimpleNamespace:
    """Returns the device functions of piles of one form.

    ``spot(shapes, state, env, shape)``: where a shape is. ``nearest(first, second)``: how two of them lie to each
    other. ``curvatures(first, second, pair, radius_1, radius_2)``: principal curvatures of the gap of two of
    them, the smaller first.
    """
    t = structs(real)
    vec3, State = t.vec3, t.State
    Shapes = pile_structs(real).Shapes
    wide, narrow = frames.functions(real).wide, frames.functions(real).narrow
    placed, long = form.placed, form.long

    @wp.struct
    class Spot:
        """Where the middle of a shape is: at ``base`` + ``rest``, as fine as shapes are near each other."""

        base: vec3  # centre of mass of its body, W [m]
        rest: vec3  # what rounding left of that, and from there to the middle, W [m]
        axis: vec3  # to the middle of an end, W [m]

    @wp.struct
    class Pair:
        """How two shapes lie to each other."""

        apart: vec3  # from the point of the second that is nearest, on its axis, to that of the first, W [m]
        s: real  # where these are, −1…1
        t: real

    @wp.func
    def spot(shapes: Shapes, state: State, env: int, shape: int):
        found = Spot()
        body = shapes.body[shape]
        found.base = state.body_position[env, body]
        found.rest = state.body_position_remainder[env, body]
        if wp.static(placed):
            found.rest += wp.quat_rotate(state.body_orientation[env, body], shapes.offset[env, shape])
        if wp.static(long):
            found.axis = wp.quat_rotate(state.body_orientation[env, body], shapes.axis[env, shape])
        return found

    @wp.func
    def nearest(first: Spot, second: Spot):
        pair = Pair()
        pair.apart = (first.base - second.base) + (first.rest - second.rest)
        if wp.static(long):
            d = wide(pair.apart)
            g = wide(first.axis)
            h = wide(second.axis)
            s, t = closest_on_segments(d, g, h)
            pair.s = real(s)
            pair.t = real(t)
            pair.apart = narrow(d + s * g - t * h)
        return pair

    @wp.func
    def straight(axis: vec3, place: real, radius: real):
        """By how much the curvature along an axis is less than around it: on the side of a capsule all of it."""
        if wp.abs(place) < real(1.0) and wp.length_sq(axis) > real(0.0):
            return real(1.0) / radius
        return real(0.0)

    @wp.func
    def curvatures(first: Spot, second: Spot, pair: Pair, radius_1: real, radius_2: real):
        # (1/r₁ + 1/r₂) I − p a aᵀ − q b bᵀ with the axes a, b, whose last two terms have the trace p + q and the
        # determinant p q sin² of the angle between them. No small number is a difference of large ones.
        p = straight(first.axis, pair.s, radius_1)
        q = straight(second.axis, pair.t, radius_2)
        across = real(1.0) / radius_1 + real(1.0) / radius_2
        half = real(0.5) * (p + q)
        less = real(0.0)
        if p > real(0.0) and q > real(0.0):
            area = wp.length(wp.cross(first.axis, second.axis))
            sine = area / (wp.length(first.axis) * wp.length(second.axis))
            of_both = p * q * sine * sine
            less = of_both / (half + wp.sqrt(wp.max(half * half - of_both, real(0.0))))
        return (across - (p + q)) + less, across - less

    return SimpleNamespace(Spot=Spot, Pair=Pair, spot=spot, nearest=nearest, curvatures=curvatures)
