"""Where shapes of a pile are, how far apart they are, and where they touch."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.piles.base import Form, pile_structs
from warpcontact.kernels.types import natural, structs

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
    other. ``curvatures(pair, first, second, radius_1, radius_2)``: the relative principal ones in order.
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
        body = natural(shapes.body[shape])
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
    def on_side(place: real, axis: vec3):
        """Whether a point of an axis is between its ends: beside it the surface is a cylinder, else a sphere."""
        return wp.abs(place) < real(1.0) and wp.length_sq(axis) > real(0.0)

    @wp.func
    def curvatures(pair: Pair, first: Spot, second: Spot, radius_1: real, radius_2: real):
        k_1 = real(1.0) / radius_1
        k_2 = real(1.0) / radius_2
        # Sides are curved across their axes alone, spheres and caps in all directions.
        side_1 = real(0.0)
        side_2 = real(0.0)
        smaller = real(0.0)
        if wp.static(long):
            if on_side(pair.s, first.axis):
                side_1 = k_1
            if on_side(pair.t, second.axis):
                side_2 = k_2
        larger = wp.max(side_1, side_2)
        if wp.static(long):  # noqa: SIM102  Warp would look at both sides
            if wp.min(side_1, side_2) > real(0.0):
                g = wp.normalize(first.axis)
                h = wp.normalize(second.axis)
                cosine = wp.dot(g, h)
                sine = wp.length(wp.cross(g, h))
                product = side_1 * side_2
                apart = side_1 - side_2
                spread = wp.sqrt(apart * apart + real(4.0) * product * cosine * cosine)
                larger = real(0.5) * (side_1 + side_2 + spread)
                # By their product: as a difference it would be lost between nearly parallel axes.
                smaller = product * sine * sine / larger
        round_1 = k_1 - side_1
        round_2 = k_2 - side_2
        return smaller + (round_1 + round_2), larger + (round_1 + round_2)

    return SimpleNamespace(Spot=Spot, Pair=Pair, spot=spot, nearest=nearest, curvatures=curvatures)
