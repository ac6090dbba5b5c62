"""An elastic cable with a part on a level, frictionless floor, between two suspended parts.

Quantities and arguments are those of ``elastic_line.py``; a height is that of an end above the floor. The part on
the floor is straight and has the tension h. A part that rises from there is part of a catenary from its lowest
point, so the tension T at its end follows from its height, and the span increases with h: one equation for one
unknown. With h = 0 the part on the floor is longer than the span requires.
"""

import warp as wp
from warpcontact.kernels.couplings.elastic_line import CLOSE, EVALUATIONS, half, one, real, two, vec2, zero

# Slopes below which a series is more accurate than a difference of logarithms.
SHALLOW = wp.constant(real(0.1))


@wp.func
def suspended_weight(h: real, height: real, weight: real, give: real):
    """Returns V, the weight suspended from an end at ``height``, and T − h there."""
    taut = one + h * give
    lifted = height * weight
    more = two * lifted / (taut + wp.sqrt(taut * taut + two * give * lifted))
    return vec2(wp.sqrt(more * (more + two * h)), more)


@wp.func
def slack(h: real, v: real):
    """Returns V − h asinh(V/h): ``weight`` times the length minus the horizontal span of a rising part."""
    if v == zero:
        return zero
    if v < SHALLOW * h:
        z = v / h
        q = z * z
        series = real(wp.static(105.0 / 3456.0)) - q * real(wp.static(945.0 / 42240.0))
        series = real(wp.static(15.0 / 336.0)) - q * series
        series = real(wp.static(3.0 / 40.0)) - q * series
        series = real(wp.static(1.0 / 6.0)) - q * series
        return v * q * series
    if h == zero:
        return v
    return v - h * wp.log((v + wp.sqrt(h * h + v * v)) / h)


@wp.func
def slack_slope(h: real, hanging: vec2, give: real):
    """Returns −∂/∂h of ``slack`` at constant height; h > 0."""
    v = hanging[0]
    if v == zero:
        return zero
    tension = h + hanging[1]
    curved = zero
    z = v / h
    if z < SHALLOW:
        q = z * z
        curved = real(wp.static(15.0 / 56.0)) - q * real(wp.static(35.0 / 144.0))
        curved = real(0.3) - q * curved
        curved = z * q * (real(wp.static(1.0 / 3.0)) - q * curved)
    else:
        curved = wp.log(z + wp.sqrt(one + z * z)) - v / tension
    return curved - hanging[1] * hanging[1] / (v * tension * (one + tension * give))


@wp.func
def solve_grounded(warm: real, x: real, height_1: real, height_2: real, weight: real, give: real):
    """Solves for h from ``warm``, or without warm start if it is 0; ``weight`` must be positive.

    Returns h, the number of evaluations and whether it converged. If more weight is suspended than there is, the
    solution does not touch the floor.
    """
    hanging = suspended_weight(zero, height_1, weight, give)[0] + suspended_weight(zero, height_2, weight, give)[0]
    if x <= one - hanging / weight:
        return zero, 0, True
    allowed = CLOSE * wp.max(x, one)
    # Bounds on h: without rise, the cable would reach farther.
    low = wp.max((x - one) / give, zero)
    high = real(wp.inf)
    h = warm
    if h <= low:
        # Initial guess from the series for shallow parts.
        root = wp.sqrt(height_1)
        bent = height_1 * root
        root = wp.sqrt(height_2)
        bent = (bent + height_2 * root) * wp.sqrt(two * weight) / real(3.0)
        h = wp.cbrt(bent / give)
        if x < one:
            h = wp.min(h, bent / (one - x))
        h = low + h * h
    evaluations = wp.int32(0)
    converged = wp.int32(0)
    while evaluations < EVALUATIONS and converged == 0:
        evaluations += 1
        hanging_1 = suspended_weight(h, height_1, weight, give)
        hanging_2 = suspended_weight(h, height_2, weight, give)
        short = slack(h, hanging_1[0]) + slack(h, hanging_2[0])
        residual = one + h * give - short / weight - x
        if wp.abs(residual) <= allowed:
            converged = 1
        if residual < zero:
            low = h
        else:
            high = h
        rate = give + (slack_slope(h, hanging_1, give) + slack_slope(h, hanging_2, give)) / weight
        better = h - residual / rate
        if better > low and better < high:
            # After convergence one more step, which is not checked.
            h = better
        elif converged == 0:
            h = wp.where(residual > zero, low + real(0.1) * (h - low), half * (low + high))
    return h, evaluations, converged == 1
