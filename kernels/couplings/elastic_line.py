"""An elastic cable under its own weight between two points in a vertical plane, solved for its end forces.

All quantities are dimensionless: lengths by the unstretched length, forces by ``scale``. The lower end is at the
origin, the upper at (x, y) with x, y ≥ 0. ``weight`` ω: of the whole cable, 0 to 1. ``give`` e: strain per
tension. ``h`` ≥ 0: horizontal tension. ``v``: upward force of the cable on the lower end; on the upper end it is
−(v + ω). At unstretched length s from the lower end the tension vector is t = (h, v + ω s). The span is the
gradient of a strictly convex function of (h, v), so the solution is unique, and Newton's method with a line search
finds it. No formula subtracts nearly equal numbers, for any taut, slack, vertical or light cable; from the lower
end this includes v + ω.

On a level, frictionless floor, ``height`` is that of an end above the floor. The part on the floor is straight and
has the tension h. A part that rises from there is part of a catenary from its lowest point, so the tension T at its
end follows from its height, and the span increases with h: one equation for one unknown. With h = 0 the part on the
floor is longer than the span requires.
"""

import numpy as np
import warp as wp

# Always float64: the tension of a taut cable depends on a small difference of two lengths.
real = wp.float64
vec2 = wp.vec2d
vec3 = wp.vec3d

# Largest number of evaluations of the span, and of those spent on a warm start.
EVALUATIONS = 20
WARM_EVALUATIONS = 5

zero, one, two, half = (wp.constant(real(value)) for value in (0.0, 1.0, 2.0, 0.5))
# Tolerance on the span, relative to the larger of length and chord. One more Newton step follows.
CLOSE = wp.constant(real(1.0e-10))
# Largest error of the span at which a warm start is used, likewise relative.
MAX_WARM_ERROR = wp.constant(real(0.05))
# Horizontal distance below which a cable is vertical: its horizontal tension is negligible.
VERTICAL = wp.constant(real(1.0e-100))
# Slopes below which a difference of two integrals is less accurate than quadrature.
FLAT = wp.constant(real(3.0e-3))
# Points and weights of Gauss quadrature over half of (−1, 1).
GAUSS_POINT = wp.constant(real(np.sqrt(0.6)))
GAUSS_MIDDLE, GAUSS_SIDE = wp.constant(real(8.0 / 18.0)), wp.constant(real(5.0 / 18.0))
SQRT_24 = wp.constant(real(np.sqrt(24.0)))


@wp.func
def size(a: real, b: real):
    """Returns √(a² + b²)."""
    return wp.sqrt(a * a + b * b)


@wp.func
def scale(weight: real, axial_stiffness: real, excess: real):
    """Returns the unit of force, of the order of the tension.

    ``excess``: (chord − length)/length.
    """
    return weight + axial_stiffness * wp.max(excess, zero)


@wp.func
def mean_slackness(h: real, v: real, weight: real):
    """Returns ∫ ds/|t| over the cable, for tensions that vanish nowhere."""
    v_2 = v + weight
    t_1 = size(h, v)
    t_2 = size(h, v_2)
    total = t_1 + t_2
    # ln((total + weight) / (total − weight)) / weight
    ratio = weight / total
    if ratio < real(0.1):
        q = ratio * ratio
        series = real(wp.static(1.0 / 13.0)) + q * real(wp.static(1.0 / 15.0))
        series = real(wp.static(1.0 / 11.0)) + q * series
        series = real(wp.static(1.0 / 9.0)) + q * series
        series = real(wp.static(1.0 / 7.0)) + q * series
        series = real(0.2) + q * series
        series = real(wp.static(1.0 / 3.0)) + q * series
        series = one + q * series
        return two * series / total
    rest_1 = t_1 + v
    if v < zero:
        rest_1 = h * (h / (t_1 - v))
    rest_2 = t_2 - v_2
    if v_2 > zero:
        rest_2 = h * (h / (t_2 + v_2))
    return wp.log(one + two * weight / (rest_1 + rest_2)) / weight


@wp.func
def mean_tension(h: real, v: real, weight: real):
    """Returns ∫ |t| ds over the cable."""
    v_2 = v + weight
    t_1 = size(h, v)
    t_2 = size(h, v_2)
    first = t_1
    if v > zero or v_2 < zero:
        first = (v + v_2) * (h * h + v * v + v_2 * v_2) / (v_2 * t_2 + v * t_1)
    elif weight > zero:
        first = (v_2 * t_2 - v * t_1) / weight
    second = zero
    if h > zero:
        second = h * h * mean_slackness(h, v, weight)
    return half * (first + second)


@wp.func
def span(h: real, v: real, weight: real, give: real):
    """Returns the position of the upper end; also for a part, with ``v`` at its start and its weight."""
    total = size(h, v) + size(h, v + weight)
    if total == zero:
        return vec2()
    x = zero
    if h > zero:
        x = h * (mean_slackness(h, v, weight) + give)
    return vec2(x, (v + v + weight) * (one / total + half * give))


@wp.func
def steepness(h: real, v: real):
    """Returns v²/|t|³."""
    squared = h * h + v * v
    return v * v / (squared * wp.sqrt(squared))


@wp.func
def span_compliance(h: real, v: real, weight: real, give: real):
    """Returns ∂x/∂h, ∂y/∂v and −∂x/∂v = −∂y/∂h of the span, for tensions that vanish nowhere."""
    v_2 = v + weight
    t_1 = size(h, v)
    t_2 = size(h, v_2)
    total = t_1 + t_2
    twice = v + v_2
    product = t_1 * t_2
    coupled = h * twice / (total * product)
    # ∫ h²/|t|³
    upward = zero
    if v <= zero and v_2 >= zero:
        upward = wp.where(v_2 - v > zero, (v_2 / t_2 - v / t_1) / (v_2 - v), one / t_1)
    else:
        upward = h * h * twice / (product * (v_2 * t_1 + v * t_2))
    # ∫ v²/|t|³
    along = zero
    if wp.max(wp.abs(v), wp.abs(v_2)) < FLAT * h:
        middle = half * twice
        reach = half * weight * GAUSS_POINT
        along = GAUSS_MIDDLE * steepness(h, middle) + GAUSS_SIDE * (
            steepness(h, middle - reach) + steepness(h, middle + reach)
        )
    else:
        along = mean_slackness(h, v, weight) - upward
    return vec3(along + give, upward + give, coupled)


@wp.func
def vertical_force(y: real, weight: real, give: real):
    """Returns ``v`` of a cable with one end above the other."""
    stretched = (y - one) / give - half * weight
    if stretched >= zero:
        return stretched
    # Folded: hangs from both ends.
    return half * weight * (y / (one + half * weight * give) - one)


@wp.func
def stretched_tension(excess: real, sag: real, give: real):
    """Returns the root T of T² (give T − excess) = sag²: mean tension of a shallow cable of strain ``excess``."""
    tension = wp.cbrt(sag * sag / give)
    if excess < zero:
        tension = wp.min(tension, sag / wp.sqrt(-excess))
    else:
        tension += excess / give
    if tension > zero:
        # Newton iteration from above, where the function is convex: the iterates decrease monotonically.
        for _ in range(3):
            bent = tension * (give * tension - excess)
            tension -= (tension * bent - sag * sag) / (two * bent + give * tension * tension)
    return tension


@wp.func
def start(x: real, y: real, chord: real, weight: real, give: real):
    """Returns an initial guess of (h, v): that of an inextensible catenary of the stretched length.

    For such a catenary of length l, sinh ξ/ξ = √(l² − y²)/x, h = ω x/(2 ξ l) and v = ½ ω (y coth ξ/l − 1).
    """
    sag = weight * (x / chord) / SQRT_24
    tension = stretched_tension(chord - one, sag, give)
    xi = half * weight * chord / tension
    if xi < real(0.25):
        # Shallow cable.
        return vec2(tension * (x / chord), tension * (y / chord) - half * weight)
    v = vertical_force(y, weight, give)
    if v < zero:
        length = one + half * give * (v * v + (v + weight) * (v + weight)) / weight
        tall = (length - y) * (length + y)
        if tall > x * x:
            # From the series of sinh, or for large ratios r from ξ = ln(2 r ξ).
            ratio = wp.sqrt(tall) / x
            xi = wp.sqrt(wp.sqrt(real(225.0) + real(120.0) * (ratio - one)) - real(15.0))
            if ratio > real(3.0):
                log = wp.log(two * ratio)
                xi = log + wp.log(log + wp.log(log))
    coth = one
    length = one
    for _ in range(3):
        # Newton's method in ln ξ on the logarithm of the equation; the length is stretched by the tension.
        decay = wp.exp(-two * xi)
        coth = (one + decay) / (one - decay)
        mean = size(y * coth, x / xi)
        length = one + half * weight * give * mean
        squared = (length - y) * (length + y)
        if squared > zero:
            change = (y * y * coth * (one - coth * coth) - x * x / (xi * xi * xi)) / mean
            value = wp.log(squared / (x * x)) - two * (xi + wp.log((one - decay) / (two * xi)))
            rate = length * weight * give * change / squared - two * (coth - one / xi)
            xi *= wp.exp(wp.clamp(-value / (xi * rate), -one, one))
        else:
            xi *= half
    decay = wp.exp(-two * xi)
    coth = (one + decay) / (one - decay)
    return vec2(half * weight * x / (xi * length), half * weight * (y * coth / length - one))


@wp.func
def newton(guess: vec2, x: real, y: real, chord: real, weight: real, give: real, max_error: real, at_most: int):
    """Newton's method from ``guess``. Returns (h, v), the number of evaluations and whether it converged."""
    h = guess[0]
    v = guess[1]
    allowed = CLOSE * wp.max(chord, one)
    step_h = zero
    step_v = zero
    part = one
    slope = zero
    evaluations = wp.int32(0)
    converged = wp.bool(False)
    while evaluations < at_most and not converged:
        evaluations += 1
        reached = span(h, v, weight, give)
        error_x = reached[0] - x
        error_y = reached[1] - y
        error = size(error_x, error_y)
        converged = error <= allowed
        if error > max_error:
            break
        # Derivative of the convex function along the last step. If it is positive, the step was too long.
        rise = error_x * step_h + error_y * step_v
        if rise > real(0.9) * slope and evaluations > 1 and not converged:
            back = part * wp.max(slope / (slope + rise), real(0.1))
            h += (back - part) * step_h
            v += (back - part) * step_v
            part = back
            continue
        rate = span_compliance(h, v, weight, give)
        determinant = rate[0] * rate[1] - rate[2] * rate[2]
        step_h = -(rate[1] * error_x + rate[2] * error_y) / determinant
        step_v = -(rate[2] * error_x + rate[0] * error_y) / determinant
        slope = -(error_x * step_h + error_y * step_v)
        part = one
        if h + step_h < real(0.1) * h:
            # Keeps the horizontal tension positive.
            part = real(-0.9) * h / step_h
        # The step after convergence is not checked, so it is taken only if it is small.
        if not converged or size(step_h, step_v) < real(0.03) * (h + wp.abs(v)):
            h += part * step_h
            v += part * step_v
    return vec2(h, v), evaluations, converged


@wp.func
def solve(warm: vec2, x: real, y: real, weight: real, give: real):
    """Solves for (h, v) from ``warm``, or without warm start if its h is 0.

    Returns (h, v), the number of evaluations and whether it converged. A cable without weight that is not
    stretched has no force.
    """
    chord = size(x, y)
    if weight == zero and chord <= one:
        return vec2(), 0, True
    if x <= VERTICAL:
        return vec2(zero, vertical_force(y, weight, give)), 0, True
    evaluations = wp.int32(0)
    if warm[0] > zero:
        found, evaluations, converged = newton(
            warm, x, y, chord, weight, give, MAX_WARM_ERROR * wp.max(chord, one), WARM_EVALUATIONS
        )
        if converged and wp.isfinite(found[0]) and wp.isfinite(found[1]):
            return found, evaluations, converged
    guess = start(x, y, chord, weight, give)
    found, more, converged = newton(guess, x, y, chord, weight, give, real(wp.inf), EVALUATIONS - evaluations)
    return found, evaluations + more, converged


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
