"""Shape and end stiffness of catenaries, evaluated on request only."""

import functools

import warp as wp
from warpcontact.kernels.couplings import ends
from warpcontact.kernels.couplings.catenary import CatenarySolution, Settings, one, placement, zero
from warpcontact.kernels.couplings.elastic_line import (
    mean_slackness,
    scale,
    size,
    slack_slope,
    span,
    span_compliance,
    suspended_weight,
)
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import structs


@wp.func
def grounded_point(
    s: wp.float64,
    x: wp.float64,
    h: wp.float64,
    low: wp.float64,
    high: wp.float64,
    weight: wp.float64,
    give: wp.float64,
):
    """Returns the point at ``s`` from the lower end; ``low`` and ``high``: weights suspended from the ends."""
    from_low = low / weight
    from_high = high / weight
    if s < from_low:
        return s * span(h, -low, weight * s, give)
    point_position = from_low * span(h, -low, low, give)
    rest = one - from_low - from_high
    lying = wp.min(s - from_low, rest)
    if h > zero:
        point_position[0] += lying * (one + give * h)
    elif rest > zero:
        # With slack on the floor the shape is not unique; draw it straight.
        point_position[0] += x * lying / rest
    rising = s - from_low - lying
    if rising > zero:
        point_position += rising * span(h, zero, weight * rising, give)
    return point_position


@wp.func
def free_stiffness(h: wp.float64, low: wp.float64, weight: wp.float64, give: wp.float64):
    """Returns −∂F/∂p of either end: horizontal in the plane, vertical, their coupling, and out of the plane."""
    rate = span_compliance(h, low, weight, give)
    across = zero
    if rate[2] != zero:
        across = rate[2] / (rate[0] * rate[1] - rate[2] * rate[2])
    # A cable that hangs straight down from both ends has infinite mean slackness and no stiffness out of the
    # plane.
    return wp.vec4d(
        one / (rate[0] - rate[2] * rate[2] / rate[1]),
        one / (rate[1] - rate[2] * rate[2] / rate[0]),
        across,
        one / (mean_slackness(h, low, weight) + give),
    )


@wp.func
def grounded_stiffness(
    h: wp.float64, x: wp.float64, own: wp.float64, other: wp.float64, weight: wp.float64, give: wp.float64
):
    """Returns the same for the end at height ``own`` of a grounded cable; horizontal: away from the other end."""
    hanging = suspended_weight(h, own, weight, give)
    v = hanging[0]
    tension = h + hanging[1]
    taut = one + give * tension
    # ∂V/∂h = −∂x/∂(height). For an end on the floor, the derivative along the floor.
    leans = zero
    lifts = zero
    if v > zero:
        leans = hanging[1] / (v * taut)
        lifts = weight * tension / (v * taut)
    along = zero
    sideways = zero
    if h > zero:
        along = one / (
            give
            + (slack_slope(h, hanging, give) + slack_slope(h, suspended_weight(h, other, weight, give), give))
            / weight
        )
        sideways = h / x
    return wp.vec4d(along, lifts + leans * leans * along, leans * along, sideways)


@functools.cache
def shapes(real: type, floored: bool) -> wp.Kernel:
    """Returns the kernel of points on one catenary, equidistant in unstretched length from its first end.

    Launch with dim (env, point).
    """
    t = structs(real)
    Model, State = t.Model, t.State
    placing = placement(real, floored)
    point_position, vertical_plane = placing.point_position, placing.vertical_plane
    arm = ends.functions(real).arm

    @unique_kernel()
    def measure_shapes(
        model: Model,
        state: State,
        first: wp.int32,  # coupling
        line: wp.int32,
        settings: wp.array2d(dtype=Settings),
        solution: CatenarySolution,
        points: wp.array2d(dtype=wp.vec3d),  # [env, point] W [m]
    ):
        env, number = wp.tid()
        point_a = model.end_point[2 * (first + line)]
        point_b = model.end_point[2 * (first + line) + 1]
        position_a = point_position(model, state, env, point_a, arm(model, state, env, point_a))
        position_b = point_position(model, state, env, point_b, arm(model, state, env, point_b))
        own = settings[env, line]
        plane = vertical_plane(model.gravity[env, 0], position_a, position_b, own)
        s = wp.float64(number) / wp.float64(points.shape[1] - 1)
        chord = size(plane.run, plane.rise)
        unit = scale(plane.weight, own.axial_stiffness, (chord - own.length) / own.length)
        if unit == zero or own.enabled == 0:
            # No unique shape: draw it straight.
            points[env, number] = position_a + s * (position_b - position_a)
            return
        if plane.b_is_lower == 1:
            s = one - s
        weight = plane.weight / unit
        give = unit / own.axial_stiffness
        h = solution.horizontal[env, line] / unit
        low = solution.low[env, line] / unit
        where = wp.vec2d()
        if solution.grounded[env, line] == 1:
            high = suspended_weight(h, (plane.height + plane.rise) / own.length, weight, give)[0]
            where = grounded_point(s, plane.run / own.length, h, -low, high, weight, give)
        else:
            where = s * span(h, low, weight * s, give)
        points[env, number] = plane.origin + own.length * (where[0] * plane.along + where[1] * plane.up)

    return measure_shapes


@functools.cache
def stiffness(real: type, floored: bool) -> wp.Kernel:
    """Returns the kernel of the derivative of the force on the second end by its position. Launch with dim env."""
    t = structs(real)
    Model, State = t.Model, t.State
    placing = placement(real, floored)
    point_position, vertical_plane = placing.point_position, placing.vertical_plane
    arm = ends.functions(real).arm

    @unique_kernel()
    def measure_stiffness(
        model: Model,
        state: State,
        first: wp.int32,  # coupling
        line: wp.int32,
        settings: wp.array2d(dtype=Settings),
        solution: CatenarySolution,
        rates: wp.array(dtype=wp.mat33d),  # [env] W [N/m]
    ):
        env = wp.tid()
        point_a = model.end_point[2 * (first + line)]
        point_b = model.end_point[2 * (first + line) + 1]
        position_a = point_position(model, state, env, point_a, arm(model, state, env, point_a))
        position_b = point_position(model, state, env, point_b, arm(model, state, env, point_b))
        own = settings[env, line]
        plane = vertical_plane(model.gravity[env, 0], position_a, position_b, own)
        chord = size(plane.run, plane.rise)
        unit = scale(plane.weight, own.axial_stiffness, (chord - own.length) / own.length)
        if unit == zero or own.enabled == 0:
            rates[env] = wp.mat33d()
            return
        weight = plane.weight / unit
        give = unit / own.axial_stiffness
        h = solution.horizontal[env, line] / unit
        along = plane.along
        rate = wp.vec4d()
        if solution.grounded[env, line] == 1:
            low = plane.height / own.length
            high = (plane.height + plane.rise) / own.length
            x = plane.run / own.length
            if plane.b_is_lower == 1:
                along = -along
                rate = grounded_stiffness(h, x, low, high, weight, give)
            else:
                rate = grounded_stiffness(h, x, high, low, weight, give)
        else:
            rate = free_stiffness(h, solution.low[env, line] / unit, weight, give)
        up = plane.up
        in_plane = wp.outer(along, along) + wp.outer(up, up)
        total = rate[0] * wp.outer(along, along) + rate[1] * wp.outer(up, up)
        total += rate[2] * (wp.outer(along, up) + wp.outer(up, along))
        total += rate[3] * (wp.identity(n=3, dtype=wp.float64) - in_plane)
        rates[env] = -unit / own.length * total

    return measure_stiffness
