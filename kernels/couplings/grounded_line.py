"""An elastic line of which a part rests on a level floor without friction, between two parts that hang.

Numbers, ends and arguments are those of ``elastic_line.py``; a height is that of an end above the floor, in
unstretched lengths. What lies on the floor is straight and has the tension h throughout. A part that rises from
there is part of a catenary from its lowest point, so the tension T at its end follows from its height alone, and
the span grows with h: one equation with one unknown. With h = 0 more of the line lies there than has to.
"""

import warp as wp
from warpcontact.kernels.couplings.elastic_line import CLOSE, EVALUATIONS, half, one, real, two, vec2, zero

# Slopes below which a series is nearer than a difference of logarithms.
SHALLOW = wp.constant(real(0.1))


@wp.func
def lift(h: real, height: real, weight: real, give: real):
    """V, the weight of the part that hangs from an end at ``height``, and T − h there."""
    taut = one + h * give
    lifted = height * weight
    more = two * lifted / (taut + wp.sqrt(taut * taut + two * give * lifted))
    return vec2(wp.sqrt(more * (more + two * h)), more)


@wp.func
def shortfall(h: real, v: real):
    """V − h asinh(V/h): times 1/weight, how much shorter than itself a rising part reaches."""
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
def fall(h: real, hanging: vec2, give: real):
    """−∂/∂h of ``shortfall`` at a constant height; h > 0."""
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
    """Solves for h from ``warm``, unless that is 0; also the evaluations used, and whether the span is met.

    ``weight`` must be above 0. A solution with more weight hanging than there is does not touch the floor.
    """
    hanging = lift(zero, height_1, weight, give)[0] + lift(zero, height_2, weight, give)[0]
    if x <= one - hanging / weight:
        return zero, 0, True
    allowed = CLOSE * wp.max(x, one)
    # Between these; no line reaches farther than one that does not rise.
    low = wp.max((x - one) / give, zero)
    high = real(wp.inf)
    h = warm
    if h <= low:
        # From the series for shallow parts.
        root = wp.sqrt(height_1)
        bent = height_1 * root
        root = wp.sqrt(height_2)
        bent = (bent + height_2 * root) * wp.sqrt(two * weight) / real(3.0)
        h = wp.cbrt(bent / give)
        if x < one:
            h = wp.min(h, bent / (one - x))
        h = low + h * h
    used = wp.int32(0)
    met = wp.int32(0)
    while used < EVALUATIONS and met == 0:
        used += 1
        hanging_1 = lift(h, height_1, weight, give)
        hanging_2 = lift(h, height_2, weight, give)
        short = shortfall(h, hanging_1[0]) + shortfall(h, hanging_2[0])
        off = one + h * give - short / weight - x
        if wp.abs(off) <= allowed:
            met = 1
        if off < zero:
            low = h
        else:
            high = h
        rate = give + (fall(h, hanging_1, give) + fall(h, hanging_2, give)) / weight
        better = h - off / rate
        if better > low and better < high:
            # Once it is met, a last step that is not looked at.
            h = better
        elif met == 0:
            h = wp.where(off > zero, low + real(0.1) * (h - low), half * (low + high))
    return h, used, met == 1
