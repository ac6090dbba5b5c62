"""Newton ascent to a local maximum of the separation g(n) of two convex shapes.

In the plane n + τ normal to n, g is G(n + τ)/|n + τ|, and near n

    G = g + τ·c − ½ τ·H τ − Σ |(n + τ)·k|

c is the difference of the support points of the smooth parts, H the sum of their Hessians. The kinks k are edges;
two or more active ones (n·k = 0) make a face; that of a cone is curved. g is stationary if c plus a combination of
active kinks is parallel to n; it then joins the contact points. Otherwise the remainder is the ascent direction.
Newton steps use the Hessian H + g 1 and stop at a kink that reverses the slope. No step lowers g by more than
rounding.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.shapes import zonotope
from warpcontact.kernels.shapes.base import AXIS_TOLERANCE, LOOSE_AXIS_TOLERANCE, Shape, mat33d, real, vec3d
from warpcontact.kernels.shapes.separation import perpendicular, separation_functions
from warpcontact.kernels.types import Struct

vec2d = wp.vec2d

#: Maximum number of steps of one ascent, and of trials of one step.
MAX_STEPS = 60
MAX_TRIALS = 30
#: Kinds of first trials for ill-conditioned shapes: Newton, the Gauss map of each shape, and the power law.
TRIAL_KINDS = 4

zero, one, two, half = (wp.constant(real(value)) for value in (0.0, 1.0, 2.0, 0.5))
# Residual at which the ascent stops, and accepted residuals if it stagnates; the last one is for ill-conditioned
# shapes, where rounding of n moves points far.
TARGET_RESIDUAL = wp.constant(real(1.0e-15))
ACCEPTED_RESIDUAL = wp.constant(real(1.0e-10))
ACCEPTED_RESIDUAL_ILL_CONDITIONED = wp.constant(real(1.0e-7))
# Rounding of g, relative to the size of the pair.
ROUNDING = wp.constant(real(1.0e-15))
# Longest step, as the tangent of an angle.
MAX_STEP = wp.constant(real(1.0))
# Required rise relative to the initial slope; for the first trial, relative to the model.
MIN_RISE = wp.constant(real(1.0e-4))
MIN_RISE_FIRST = wp.constant(real(0.2))
# Smallest predicted rise, relative to the size of the pair; largest gauge of a point on the surface.
MIN_SLOPE = wp.constant(real(1.0e-14))
GAUGE_LIMIT = wp.constant(real(1.0 + 1.0e-9))
# Relative change of a component of n above which ``power_law_step`` corrects the step.
MIN_CHANGE = wp.constant(real(0.2))
# Relative difference below which two principal curvatures are equal.
EQUAL_CURVATURES = wp.constant(real(1.0e-12))
TINY = wp.constant(real(1.0e-300))


@wp.func
def newton(q_11: real, q_12: real, q_22: real, rho: vec2d):
    """Returns |Q|⁻¹ rho: Newton's ascent step with absolute eigenvalues, for functions that are not concave."""
    mean = half * (q_11 + q_22)
    radius = wp.sqrt(real(0.25) * (q_11 - q_22) * (q_11 - q_22) + q_12 * q_12)
    if mean > radius:
        determinant = q_11 * q_22 - q_12 * q_12
        if determinant > TINY:
            return vec2d(q_22 * rho[0] - q_12 * rho[1], q_11 * rho[1] - q_12 * rho[0]) / determinant
    high = vec2d(one, zero)
    if radius > EQUAL_CURVATURES * wp.abs(mean):
        # Eigenvector, from the larger of two columns.
        if q_11 > q_22:
            high = wp.normalize(vec2d(mean + radius - q_22, q_12))
        else:
            high = wp.normalize(vec2d(q_12, mean + radius - q_11))
    low = vec2d(-high[1], high[0])
    along_high = wp.dot(rho, high) / wp.max(wp.abs(mean + radius), TINY)
    along_low = wp.dot(rho, low) / wp.max(wp.abs(mean - radius), TINY)
    return along_high * high + along_low * low


class Functions(NamedTuple):
    """Structs and the device function of an ascent on the separation of a pair of shape classes."""

    ascend: wp.Function  # ascent from a direction
    AscentResult: Struct  # end of an ascent
    CoefficientsA: Struct  # coefficients of shape a
    CoefficientsB: Struct  # coefficients of shape b


@functools.cache
def functions(A: type[Shape], B: type[Shape]) -> Functions:
    """Returns the struct ``AscentResult`` and the device function ``ascend``."""
    pair_functions = separation_functions(A, B)
    KinkVector, CoefficientsA, CoefficientsB, evaluate_separation = (
        pair_functions.KinkVector,
        pair_functions.CoefficientsA,
        pair_functions.CoefficientsB,
        pair_functions.evaluate_separation,
    )
    kink_count, kink_count_a = pair_functions.kink_count, pair_functions.kink_count_a
    KinkMatrix2 = wp.types.matrix((max(kink_count, 1), 2), real)
    distribute = zonotope.zonotope_projection(max(kink_count, 1))
    discs = A.discs + B.discs
    ill_conditioned = A.ill_conditioned or B.ill_conditioned
    accepted_residual = ACCEPTED_RESIDUAL_ILL_CONDITIONED if ill_conditioned else ACCEPTED_RESIDUAL
    axis_tolerance_a, axis_tolerance_b = (
        wp.constant(LOOSE_AXIS_TOLERANCE if shape.ill_conditioned else AXIS_TOLERANCE) for shape in (A, B)
    )

    @wp.struct
    class AscentResult:
        value: real  # g at the end [m]
        normal: vec3d
        point_a: vec3d  # without the margins [m]
        point_b: vec3d  # [m]
        residual: real  # relative to the size of the pair
        steps: wp.int32

    @wp.func
    def project_onto_edges(
        p_a: CoefficientsA,
        p_b: CoefficientsB,
        x: vec3d,
        R: mat33d,
        n: vec3d,
        kinks: pair_functions.KinkMatrix,
        first: int,
        second: int,
    ):
        """Returns the unit vector next to n that is normal to one edge or to two."""
        if wp.static(A.curved_kink or B.curved_kink):
            # Loop bound in a variable, so that Warp does not unroll: unrolled, compilation for GPUs takes minutes.
            iterations = wp.int32(4)
            for _ in range(iterations):
                separation = evaluate_separation(p_a, p_b, x, R, n)
                k = separation.kinks[first] - separation.kink_values[first] * n
                step = -(separation.kink_values[first] / wp.dot(k, k)) * k
                if second >= 0:
                    m = separation.kinks[second] - separation.kink_values[second] * n
                    triple_product = wp.dot(n, wp.cross(k, m))
                    if wp.abs(triple_product) > AXIS_TOLERANCE * wp.length(k) * wp.length(m):
                        step = (
                            separation.kink_values[first] * wp.cross(n, m)
                            - separation.kink_values[second] * wp.cross(n, k)
                        ) / triple_product
                n = wp.normalize(n + step)
            return n
        k = kinks[first]
        if second >= 0:
            across = wp.cross(k, kinks[second])
            size = wp.length(across)
            if size > AXIS_TOLERANCE * wp.length(k) * wp.length(kinks[second]):
                return (wp.where(wp.dot(across, n) < zero, -one, one) / size) * across
        return wp.normalize(n - (wp.dot(n, k) / wp.dot(k, k)) * k)

    @wp.func
    def disc_normal_near(n: vec3d, axis: vec3d, one_only: int, d: vec3d):
        """Returns the normal of the disc that a step d approaches, or 0."""
        cosine = wp.dot(n, axis)
        pole = axis
        if cosine < zero and one_only == 0:
            pole = -axis
            cosine = -cosine
        if cosine < half:
            return vec3d()
        # The step approaches the pole or passes by it.
        to_pole = pole / cosine - n
        part = wp.clamp(wp.dot(to_pole, d) / wp.dot(d, d), zero, one)
        if wp.length_sq(to_pole - part * d) > real(0.25) * wp.length_sq(to_pole):
            return vec3d()
        return pole

    @wp.func
    def power_law_step(p_a: CoefficientsA, p_b: CoefficientsB, R: mat33d, n: vec3d, d: vec3d):
        """Corrects the step d for support points that follow powers of components of n."""
        worst = MIN_CHANGE
        second = MIN_CHANGE
        axis = vec3d()
        axis_2 = vec3d()
        extra_1 = real(0.0)
        extra_2 = real(0.0)
        powers_a = vec3d(one, one, one)
        powers_b = vec3d(one, one, one)
        if wp.static(A.ill_conditioned):
            powers_a = A.support_powers(p_a)
        if wp.static(B.ill_conditioned):
            powers_b = B.support_powers(p_b)
        axes = wp.int32(6)
        for i in range(axes):
            w = vec3d()
            power = real(1.0)
            if i < 3:
                w = vec3d(R[0, i], R[1, i], R[2, i])
                power = powers_a[i]
            else:
                w[i - 3] = one
                power = powers_b[i - 3]
            u = wp.dot(n, w)
            change = wp.dot(d, w)
            if power < real(0.9) and wp.abs(u) > LOOSE_AXIS_TOLERANCE and wp.abs(change) > second * wp.abs(u):
                z = one + power * change / u
                target = u * wp.sign(z) * wp.pow(wp.abs(z), one / power)
                extra = wp.clamp(target - u, -half, half) - change
                if wp.abs(change) > worst * wp.abs(u):
                    second = worst
                    axis_2 = axis
                    extra_2 = extra_1
                    worst = wp.abs(change / u)
                    axis = w
                    extra_1 = extra
                else:
                    second = wp.abs(change / u)
                    axis_2 = w
                    extra_2 = extra
        if worst == MIN_CHANGE:
            return d
        k = axis - wp.dot(axis, n) * n
        if second > MIN_CHANGE:
            m = axis_2 - wp.dot(axis_2, n) * n
            triple_product = wp.dot(n, wp.cross(k, m))
            if wp.abs(triple_product) > real(0.1) * wp.length(k) * wp.length(m):
                return d + (extra_2 * wp.cross(n, k) - extra_1 * wp.cross(n, m)) / triple_product
        return d + (extra_1 / wp.dot(k, k)) * k

    @wp.func
    def ascend(p_a: CoefficientsA, p_b: CoefficientsB, x: vec3d, R: mat33d, start: vec3d, size: real):
        """Ascends from the unit vector ``start``; ``size`` [m] is the size of the pair.

        It may jump to a disc normal with a higher g, across lower values or past another maximum.
        """
        n = start
        separation = evaluate_separation(p_a, p_b, x, R, n)
        result = AscentResult()
        signs = KinkVector()
        e_1 = vec3d()
        e_2 = vec3d()
        offset = vec2d()
        remainder = vec2d()
        ratio = real(0.0)
        active_kinks = wp.int32(0)
        disc = real(0.0)
        last = real(wp.inf)
        stalls = wp.int32(0)
        searching = wp.bool(True)
        best_residual = real(wp.inf)
        best_direction = vec3d()
        fallback = wp.int32(0)
        slide_a = vec3d()
        slide_b = vec3d()
        while searching:
            e_1 = perpendicular(n)
            e_2 = wp.cross(n, e_1)
            c = separation.point_a - separation.point_b
            rho = vec2d(wp.dot(c, e_1), wp.dot(c, e_2))
            # Inactive kinks contribute ±k, active kinks any multiple of k between −1 and 1.
            kinks_2d = KinkMatrix2()
            active_kinks = wp.int32(0)
            edge = wp.int32(-1)
            ratio = zero
            if wp.static(kink_count > 0):
                for i in range(wp.static(kink_count)):
                    k = separation.kinks[i]
                    kinks_2d[i] = vec2d(wp.dot(k, e_1), wp.dot(k, e_2))
                    signs[i] = zero
                    if wp.abs(separation.kink_values[i]) > wp.where(
                        i < kink_count_a, axis_tolerance_a, axis_tolerance_b
                    ) * wp.length(k):
                        signs[i] = wp.sign(separation.kink_values[i])
                        rho -= signs[i] * kinks_2d[i]
                    elif wp.length_sq(k) > zero:
                        active_kinks += 1 << i
            offset = rho
            if wp.static(kink_count > 0) and active_kinks != 0:
                signs, rho, edge, ratio = distribute(kinks_2d, active_kinks, signs, rho)
            disc = separation.disc_radius_a + separation.disc_radius_b
            remainder = rho
            if wp.static(discs > 0) and disc > zero:
                rho *= wp.max(one - disc / wp.max(wp.length(rho), TINY), zero)
            steepness = wp.length(rho)
            result.residual = steepness / size
            if result.residual < accepted_residual and result.residual > half * last:
                stalls += 1
            if result.residual <= TARGET_RESIDUAL or stalls > 2 or result.steps == MAX_STEPS:
                break
            last = result.residual
            result.steps += 1

            hessian = separation.hessian_a + separation.hessian_b
            if wp.static(A.curved_kink):
                hessian += (separation.kink_curvature_a * signs[0]) * separation.hessian_a
            if wp.static(B.curved_kink):
                hessian += (separation.kink_curvature_b * signs[kink_count_a]) * separation.hessian_b
            along_1 = hessian * e_1
            q_11 = wp.dot(e_1, along_1) + separation.value
            q_12 = wp.dot(e_2, along_1)
            q_22 = wp.dot(e_2, hessian * e_2) + separation.value
            d = vec2d()
            if active_kinks != 0 or disc > zero:
                u = rho / steepness
                curvature = q_11 * u[0] * u[0] + two * q_12 * u[0] * u[1] + q_22 * u[1] * u[1]
                d = (steepness / wp.max(wp.abs(curvature), TINY)) * u
            else:
                d = newton(q_11, q_12, q_22, rho)
            length = wp.length(d)
            if length > MAX_STEP:
                d *= MAX_STEP / length
            slope = wp.dot(rho, d)
            if wp.static(ill_conditioned):
                # If g cannot rise although the points are not aligned with n, n is exact to rounding, and one of
                # the points may slide along a face that is flat to rounding.
                if slope < MIN_SLOPE * size:
                    # g is flat to rounding. The residual decides between Newton's step and the direction of the
                    # line between the points.
                    if result.residual < half * best_residual:
                        best_residual = result.residual
                        best_direction = n
                        fallback = 0
                    elif result.residual != best_residual:
                        n = best_direction
                        separation = evaluate_separation(p_a, p_b, x, R, n)
                        continue
                    if fallback < 2 and active_kinks == 0:
                        turn = d
                        if fallback == 1:
                            # Only if the points are apart.
                            apart = steepness < half * wp.abs(separation.value)
                            turn = wp.where(apart, rho / separation.value, vec2d())
                        fallback += 1
                        n = wp.normalize(n + turn[0] * e_1 + turn[1] * e_2)
                        separation = evaluate_separation(p_a, p_b, x, R, n)
                        continue
                    rest = rho[0] * e_1 + rho[1] * e_2
                    if wp.static(A.ill_conditioned):
                        on_a = separation.point_a - rest
                        for i in range(wp.static(A.kinks)):
                            on_a -= signs[i] * separation.kinks[i]
                        if A.gauge(p_a, (on_a - x) * R) <= GAUGE_LIMIT:
                            slide_a = -rest
                            result.residual = zero
                    if wp.static(B.ill_conditioned):
                        on_b = separation.point_b + rest
                        for i in range(wp.static(B.kinks)):
                            on_b += signs[kink_count_a + i] * separation.kinks[kink_count_a + i]
                        if result.residual > zero and B.gauge(p_b, on_b) <= GAUGE_LIMIT:
                            slide_b = rest
                            result.residual = zero
                    if result.residual == zero:
                        break
            # Fraction of the step up to the kink that reverses the slope.
            part = real(1.0)
            stopping_edge = wp.int32(-1)
            predicted_rise = half * slope
            if wp.static(kink_count > 0):
                curvature_along = wp.max(q_11 * d[0] * d[0] + two * q_12 * d[0] * d[1] + q_22 * d[1] * d[1], zero)
                crossed = zero
                crossing_fraction = zero
                passed = active_kinks
                kink_total = wp.int32(kink_count)
                for _ in range(kink_total):
                    nearest = wp.int32(-1)
                    at = part
                    for i in range(kink_total):
                        rate = kinks_2d[i, 0] * d[0] + kinks_2d[i, 1] * d[1]
                        ahead = (passed >> i) & 1 == 0 and separation.kink_values[i] * rate < zero
                        if ahead and wp.abs(separation.kink_values[i]) < at * wp.abs(rate):
                            at = -separation.kink_values[i] / rate
                            nearest = i
                    if nearest >= 0 and stopping_edge < 0:
                        passed += 1 << nearest
                        slope_drop = two * wp.abs(kinks_2d[nearest, 0] * d[0] + kinks_2d[nearest, 1] * d[1])
                        crossed += slope_drop
                        crossing_fraction += slope_drop * at
                        if slope - crossed - at * curvature_along <= zero:
                            stopping_edge = nearest
                            part = at
                predicted_rise = wp.max(
                    part * (slope - crossed - half * part * curvature_along) + crossing_fraction, zero
                )
            d_3 = d[0] * e_1 + d[1] * e_2
            pole = vec3d()
            if wp.static(discs > 0) and disc == zero:
                if wp.static(A.discs > 0):
                    # a is evaluated along −n: its disc with normal −z corresponds to n = +z.
                    pole = disc_normal_near(n, vec3d(R[0, 2], R[1, 2], R[2, 2]), wp.static(int(A.discs == 1)), d_3)
                if wp.static(B.discs > 0):
                    other = disc_normal_near(n, vec3d(zero, zero, -one), wp.static(int(B.discs == 1)), d_3)
                    if wp.dot(n, other) > wp.dot(n, pole):
                        pole = other
            done = wp.bool(False)
            trial_count = wp.int32(0)
            if wp.static(ill_conditioned):
                best_rise = real(-wp.inf)
                best = n
                best_separation = separation
            while not done and trial_count < MAX_TRIALS:
                trial_count += 1
                trial = pole
                to_pole = wp.length_sq(pole) > zero
                is_newton_step = not to_pole
                if is_newton_step:
                    trial = wp.normalize(n + part * d_3)
                # A separate ``if``: Warp removes a branch only if its whole condition is static.
                if wp.static(ill_conditioned):
                    if (
                        is_newton_step
                        and (active_kinks == 0 or edge >= 0)
                        and stopping_edge < 0
                        and trial_count <= TRIAL_KINDS
                    ):
                        is_newton_step = False
                        # Normals at the predicted positions of the support points, then the power-law step.
                        if wp.static(A.ill_conditioned):
                            if trial_count == 2:
                                to = separation.point_a - separation.hessian_a * d_3 - x
                                trial = -(R * A.gauss_map(p_a, to * R))
                        if wp.static(B.ill_conditioned):
                            if trial_count == 3:
                                trial = B.gauss_map(p_b, separation.point_b + separation.hessian_b * d_3)
                        if trial_count == TRIAL_KINDS:
                            trial = wp.normalize(n + power_law_step(p_a, p_b, R, n, d_3))
                if wp.static(kink_count > 0):
                    if edge >= 0 and not to_pole:
                        trial = project_onto_edges(p_a, p_b, x, R, trial, separation.kinks, edge, stopping_edge)
                    elif stopping_edge >= 0 and not to_pole:
                        trial = project_onto_edges(p_a, p_b, x, R, trial, separation.kinks, stopping_edge, -1)
                trial_separation = evaluate_separation(p_a, p_b, x, R, trial)
                rise = trial_separation.value - separation.value
                done = rise > zero
                if wp.static(ill_conditioned):
                    if not (is_newton_step or to_pole):
                        # Newton's step if it rises enough, otherwise the best of all trials.
                        if rise > best_rise:
                            best_rise = rise
                            best = trial
                            best_separation = trial_separation
                        done = trial_count == 1 and rise >= MIN_RISE_FIRST * predicted_rise
                        if trial_count == TRIAL_KINDS and best_rise > ROUNDING * size:
                            done = True
                            trial = best
                            trial_separation = best_separation
                if is_newton_step:
                    # The first trial must reach a fraction of the model's rise, shorter steps a fraction of the
                    # slope.
                    required_rise = wp.where(
                        trial_count == 1, MIN_RISE_FIRST * predicted_rise, MIN_RISE * part * slope
                    )
                    done = rise >= required_rise - ROUNDING * size
                if done:
                    n = trial
                    separation = trial_separation
                elif is_newton_step:
                    stopping_edge = -1
                    reduction = half * slope * part / wp.max(slope * part - rise, TINY)
                    part *= wp.clamp(reduction, real(0.05), half)
                pole = vec3d()
            searching = done

        absorbed = remainder
        if wp.static(discs > 0 and kink_count > 0) and disc > zero and ratio > zero:
            # Points on discs and on faces are displaced in the same proportion.
            share = disc / (disc + wp.length(offset) / ratio)
            absorbed = share * offset
            for i in range(wp.static(kink_count)):
                if (active_kinks >> i) & 1 == 1:
                    signs[i] *= one - share
        result.value = separation.value
        result.normal = n
        result.point_a = separation.point_a + slide_a
        result.point_b = separation.point_b + slide_b
        if wp.static(kink_count > 0):
            for i in range(wp.static(kink_count)):
                if i < kink_count_a:
                    result.point_a -= signs[i] * separation.kinks[i]
                else:
                    result.point_b += signs[i] * separation.kinks[i]
        if wp.static(discs > 0) and disc > zero:
            across = absorbed[0] * e_1 + absorbed[1] * e_2
            if wp.length(absorbed) > disc:
                across *= disc / wp.length(absorbed)
            result.point_a -= (separation.disc_radius_a / disc) * across
            result.point_b += (separation.disc_radius_b / disc) * across
        return result

    return Functions(
        ascend=ascend, AscentResult=AscentResult, CoefficientsA=CoefficientsA, CoefficientsB=CoefficientsB
    )
