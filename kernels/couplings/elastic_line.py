"""An elastic line under its own weight between two points in a vertical plane, solved for its end forces.

All in numbers without units: lengths by the unstretched length, forces by ``scale`` of the line. The lower end is
at the origin, the upper at (x, y) with x, y ≥ 0. Arguments:

- ``weight`` ω of the whole line, 0 to 1,
- ``give`` e, the strain that a tension of 1 makes,
- ``h`` ≥ 0, the horizontal tension, and ``v``, the vertical force of the line on the lower end, up. On the upper
  end it is −(v + ω).

At unstretched length s from the lower end the tension vector is t = (h, v + ω s). The span of the line is the
gradient of a strictly convex function of (h, v), so one (h, v) belongs to every span, and Newton's method with a
line search finds it. No formula subtracts numbers that are nearly equal, however taut, slack, upright or light the
line is; seen from the lower end, that holds for v + ω, too.
"""

import numpy as np
import warp as wp

# Always: the tension of a taut line hangs on the small difference of two lengths.
real = wp.float64
vec2 = wp.vec2d
vec3 = wp.vec3d

# Evaluations of the span, of which a warm start may take the first few before it is given up.
EVALUATIONS = 20
WARM_EVALUATIONS = 5

zero, one, two, half = (wp.constant(real(value)) for value in (0.0, 1.0, 2.0, 0.5))
# Where a span is as it should be, of the larger of length and chord; a last step follows, unchecked.
CLOSE = wp.constant(real(1.0e-10))
# A warm start that is farther off is not worth its while.
MAX_WARM_ERROR = wp.constant(real(0.05))
# A line this upright hangs straight down: its horizontal tension is lost beside its weight.
VERTICAL = wp.constant(real(1.0e-100))
# Slopes below which the difference of two integrals loses more than a quadrature.
FLAT = wp.constant(real(3.0e-3))
# Points and weights of Gauss over half of (−1, 1).
GAUSS_POINT = wp.constant(real(np.sqrt(0.6)))
GAUSS_MIDDLE, GAUSS_SIDE = wp.constant(real(8.0 / 18.0)), wp.constant(real(5.0 / 18.0))
SQRT_24 = wp.constant(real(np.sqrt(24.0)))


@wp.func
def size(a: real, b: real):
    """√(a² + b²)."""
    return wp.sqrt(a * a + b * b)


@wp.func
def scale(weight: real, axial_stiffness: real, excess: real):
    """Unit of force for a line whose chord is longer than the line by the part ``excess`` of it.

    Tensions are neither large nor small beside it.
    """
    return weight + axial_stiffness * wp.max(excess, zero)


@wp.func
def mean_slackness(h: real, v: real, weight: real):
    """∫ ds/|t| over the line, for tensions that vanish nowhere."""
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
    """∫ |t| ds over the line."""
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
    """Where the upper end is; also of a part of a line, by ``v`` at its beginning, its weight and its length."""
    total = size(h, v) + size(h, v + weight)
    if total == zero:
        return vec2()
    x = zero
    if h > zero:
        x = h * (mean_slackness(h, v, weight) + give)
    return vec2(x, (v + v + weight) * (one / total + half * give))


@wp.func
def steepness(h: real, v: real):
    """v²/|t|³."""
    squared = h * h + v * v
    return v * v / (squared * wp.sqrt(squared))


@wp.func
def span_compliance(h: real, v: real, weight: real, give: real):
    """How the span changes: ∂x/∂h, ∂y/∂v, −∂x/∂v = −∂y/∂h; for tensions that vanish nowhere."""
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
    """``v`` of a line whose ends are above one another."""
    stretched = (y - one) / give - half * weight
    if stretched >= zero:
        return stretched
    # Folded: it hangs down from both ends.
    return half * weight * (y / (one + half * weight * give) - one)


@wp.func
def stretched_tension(excess: real, sag: real, give: real):
    """Root T of T² (give T − excess) = sag², the mean tension of a shallow line of strain ``excess``."""
    tension = wp.cbrt(sag * sag / give)
    if excess < zero:
        tension = wp.min(tension, sag / wp.sqrt(-excess))
    else:
        tension += excess / give
    if tension > zero:
        # From above, where the function is convex: it only falls.
        for _ in range(3):
            bent = tension * (give * tension - excess)
            tension -= (tension * bent - sag * sag) / (two * bent + give * tension * tension)
    return tension


@wp.func
def start(x: real, y: real, chord: real, weight: real, give: real):
    """First guess of (h, v): as a line that hangs like one of its stretched length that stretches no more.

    Of such a line of length l, sinh ξ/ξ = √(l² − y²)/x, h = ω x/(2 ξ l) and v = ½ ω (y coth ξ/l − 1).
    """
    sag = weight * (x / chord) / SQRT_24
    tension = stretched_tension(chord - one, sag, give)
    xi = half * weight * chord / tension
    if xi < real(0.25):
        # Shallow.
        return vec2(tension * (x / chord), tension * (y / chord) - half * weight)
    v = vertical_force(y, weight, give)
    if v < zero:
        length = one + half * give * (v * v + (v + weight) * (v + weight)) / weight
        tall = (length - y) * (length + y)
        if tall > x * x:
            # From the series of sinh, or from ξ = ln(2 r ξ), whichever fits.
            ratio = wp.sqrt(tall) / x
            xi = wp.sqrt(wp.sqrt(real(225.0) + real(120.0) * (ratio - one)) - real(15.0))
            if ratio > real(3.0):
                log = wp.log(two * ratio)
                xi = log + wp.log(log + wp.log(log))
    coth = one
    length = one
    for _ in range(3):
        # Newton's method on the logarithm, over that of ξ; its tension stretches it.
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
    """Newton's method from ``guess``: (h, v), the evaluations it took, whether the span is met."""
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
        off_x = reached[0] - x
        off_y = reached[1] - y
        off = size(off_x, off_y)
        converged = off <= allowed
        if off > max_error:
            break
        # How the convex function changes along the step just taken: too far if it rises.
        rise = off_x * step_h + off_y * step_v
        if rise > real(0.9) * slope and evaluations > 1 and not converged:
            back = part * wp.max(slope / (slope + rise), real(0.1))
            h += (back - part) * step_h
            v += (back - part) * step_v
            part = back
            continue
        rate = span_compliance(h, v, weight, give)
        determinant = rate[0] * rate[1] - rate[2] * rate[2]
        step_h = -(rate[1] * off_x + rate[2] * off_y) / determinant
        step_v = -(rate[2] * off_x + rate[0] * off_y) / determinant
        slope = -(off_x * step_h + off_y * step_v)
        part = one
        if h + step_h < real(0.1) * h:
            # The horizontal tension stays above 0.
            part = real(-0.9) * h / step_h
        # A last step, which is not looked at, may only be small.
        if not converged or size(step_h, step_v) < real(0.03) * (h + wp.abs(v)):
            h += part * step_h
            v += part * step_v
    return vec2(h, v), evaluations, converged


@wp.func
def solve(warm: vec2, x: real, y: real, weight: real, give: real):
    """Solves for (h, v) from ``warm``, unless its h is 0; also the evaluations used, and whether it is met.

    A line without weight that is not stretched has no force.
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
