"""From a direction up to a maximum of g(n), of two convex shapes.

In the plane n + τ across n, g(n) is G(n + τ)/|n + τ|, and near n

    G = g + τ·c − ½ τ·H τ − Σ |(n + τ)·k|

with the smooth parts of both support functions: c is the difference of the two points where planes with this
normal touch, H the sum of the Hessians. The kinks k are straight edges, two or more of them a face; a cone has one
that is curved. Where c, less what the edges that n stands across can take, is along n, g is stationary, and this c
is the vector between the two contact points. Otherwise what is left points uphill. Steps are Newton's, with the
Hessian H + g 1, and end where they meet an edge that turns the slope; from there on the direction stays across the
edge, or leaves it. No step goes down by more than rounding.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.smooth import pair, zonotope
from warpcontact.kernels.smooth.base import ACROSS, ON_AXIS, Shape, mat33d, real, vec3d
from warpcontact.kernels.smooth.pair import tangent

vec2d = wp.vec2d

#: Steps of one climb, and trials of one step.
STEPS = 60
TRIALS = 30
#: Ways of the first trial where points run far: Newton's, one for each shape, and one by powers.
WAYS = 4

zero, one, two, half = (wp.constant(real(value)) for value in (0.0, 1.0, 2.0, 0.5))
# A residual that rounding does not let fall much further, and those below which a climb that stands still has
# arrived; of steep shapes, whose points the rounding of n moves far, the second.
TARGET = wp.constant(real(1.0e-15))
CLOSE = wp.constant(real(1.0e-10))
CLOSE_STEEP = wp.constant(real(1.0e-7))
# Rounding of g, of the size of the pair.
NOISE = wp.constant(real(1.0e-15))
# The longest step, as the tangent of an angle.
LONGEST = wp.constant(real(1.0))
# Of the rise at the first slope, what a step must bring; and more where there are several ways to go.
LEAST = wp.constant(real(1.0e-4))
MOST = wp.constant(real(0.2))
# Of the size of the pair, a rise too small to look for; and of that of a shape, how far outside a point may be.
SLIDES = wp.constant(real(1.0e-14))
INSIDE = wp.constant(real(1.0 + 1.0e-9))
# Of a component of n, the change from which its power is looked at.
OFF = wp.constant(real(0.2))
# Two principal curvatures that differ by less, of their mean, are the same.
SAME = wp.constant(real(1.0e-12))
TINY = wp.constant(real(1.0e-300))


@wp.func
def newton(q_11: real, q_12: real, q_22: real, rho: vec2d):
    """|Q|⁻¹ rho: Newton's step uphill, also where the function is not concave."""
    mean = half * (q_11 + q_22)
    radius = wp.sqrt(real(0.25) * (q_11 - q_22) * (q_11 - q_22) + q_12 * q_12)
    if mean > radius:
        determinant = q_11 * q_22 - q_12 * q_12
        if determinant > TINY:
            return vec2d(q_22 * rho[0] - q_12 * rho[1], q_11 * rho[1] - q_12 * rho[0]) / determinant
    high = vec2d(one, zero)
    if radius > SAME * wp.abs(mean):
        # Its eigenvector, from the larger of two columns.
        if q_11 > q_22:
            high = wp.normalize(vec2d(mean + radius - q_22, q_12))
        else:
            high = wp.normalize(vec2d(q_12, mean + radius - q_11))
    low = vec2d(-high[1], high[0])
    along_high = wp.dot(rho, high) / wp.max(wp.abs(mean + radius), TINY)
    along_low = wp.dot(rho, low) / wp.max(wp.abs(mean - radius), TINY)
    return along_high * high + along_low * low


@functools.cache
def functions(A: type[Shape], B: type[Shape]) -> SimpleNamespace:
    """Returns the struct ``Climb`` of a result and the device function ``climb``."""
    view_of = pair.functions(A, B)
    Row, Of_a, Of_b, look = view_of.Row, view_of.Of_a, view_of.Of_b, view_of.look
    count, of_a = view_of.count, view_of.of_a
    Flat = wp.types.matrix((max(count, 1), 2), real)
    divide = zonotope.function(max(count, 1))
    discs = A.discs + B.discs
    steep = A.steep or B.steep
    close = CLOSE_STEEP if steep else CLOSE
    across_a, across_b = (wp.constant(ACROSS if shape.steep else ON_AXIS) for shape in (A, B))

    @wp.struct
    class Climb:
        value: real  # g at the end [m]
        normal: vec3d
        point_a: vec3d  # without the margins [m]
        point_b: vec3d  # [m]
        residual: real  # over the size of the pair
        steps: wp.int32

    @wp.func
    def held(p_a: Of_a, p_b: Of_b, x: vec3d, R: mat33d, n: vec3d, kinks: view_of.Rows, first: int, second: int):
        """The unit vector next to n that is across one edge or two."""
        if wp.static(A.bent or B.bent):
            # To a variable, so that it stays a loop: unrolled, GPUs take minutes to compile it.
            rounds = wp.int32(4)
            for _ in range(rounds):
                view = look(p_a, p_b, x, R, n)
                k = view.kinks[first] - view.at[first] * n
                step = -(view.at[first] / wp.dot(k, k)) * k
                if second >= 0:
                    m = view.kinks[second] - view.at[second] * n
                    turned = wp.dot(n, wp.cross(k, m))
                    if wp.abs(turned) > ON_AXIS * wp.length(k) * wp.length(m):
                        step = (view.at[first] * wp.cross(n, m) - view.at[second] * wp.cross(n, k)) / turned
                n = wp.normalize(n + step)
            return n
        k = kinks[first]
        if second >= 0:
            across = wp.cross(k, kinks[second])
            size = wp.length(across)
            if size > ON_AXIS * wp.length(k) * wp.length(kinks[second]):
                return (wp.where(wp.dot(across, n) < zero, -one, one) / size) * across
        return wp.normalize(n - (wp.dot(n, k) / wp.dot(k, k)) * k)

    @wp.func
    def pole_ahead(n: vec3d, axis: vec3d, one_only: int, d: vec3d):
        """The normal of a disc that a step d comes near to, or nothing."""
        cosine = wp.dot(n, axis)
        pole = axis
        if cosine < zero and one_only == 0:
            pole = -axis
            cosine = -cosine
        if cosine < half:
            return vec3d()
        # A step that comes near to it, or passes it by.
        to_pole = pole / cosine - n
        part = wp.clamp(wp.dot(to_pole, d) / wp.dot(d, d), zero, one)
        if wp.length_sq(to_pole - part * d) > real(0.25) * wp.length_sq(to_pole):
            return vec3d()
        return pole

    @wp.func
    def steeper(p_a: Of_a, p_b: Of_b, R: mat33d, n: vec3d, d: vec3d):
        """A step like d, but so that points that go by powers of components of n move as far as meant."""
        worst = OFF
        second = OFF
        axis = vec3d()
        axis_2 = vec3d()
        more = real(0.0)
        more_2 = real(0.0)
        powers_a = vec3d(one, one, one)
        powers_b = vec3d(one, one, one)
        if wp.static(A.steep):
            powers_a = A.steepness(p_a)
        if wp.static(B.steep):
            powers_b = B.steepness(p_b)
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
            if power < real(0.9) and wp.abs(u) > ACROSS and wp.abs(change) > second * wp.abs(u):
                z = one + power * change / u
                target = u * wp.sign(z) * wp.pow(wp.abs(z), one / power)
                extra = wp.clamp(target - u, -half, half) - change
                if wp.abs(change) > worst * wp.abs(u):
                    second = worst
                    axis_2 = axis
                    more_2 = more
                    worst = wp.abs(change / u)
                    axis = w
                    more = extra
                else:
                    second = wp.abs(change / u)
                    axis_2 = w
                    more_2 = extra
        if worst == OFF:
            return d
        k = axis - wp.dot(axis, n) * n
        if second > OFF:
            m = axis_2 - wp.dot(axis_2, n) * n
            turned = wp.dot(n, wp.cross(k, m))
            if wp.abs(turned) > real(0.1) * wp.length(k) * wp.length(m):
                return d + (more_2 * wp.cross(n, k) - more * wp.cross(n, m)) / turned
        return d + (more / wp.dot(k, k)) * k

    @wp.func
    def climb(p_a: Of_a, p_b: Of_b, x: vec3d, R: mat33d, start: vec3d, size: real):
        """Climbs from the unit vector ``start``; ``size`` [m] is that of the pair.

        It may leap to the normal of a disc that is higher, over lower ground or past a summit.
        """
        n = start
        view = look(p_a, p_b, x, R, n)
        result = Climb()
        signs = Row()
        e_1 = vec3d()
        e_2 = vec3d()
        offset = vec2d()
        left = vec2d()
        ratio = real(0.0)
        tied = wp.int32(0)
        disc = real(0.0)
        last = real(wp.inf)
        stalls = wp.int32(0)
        climbing = wp.bool(True)
        sharp = real(wp.inf)
        sharpest = vec3d()
        way = wp.int32(0)
        slid_a = vec3d()
        slid_b = vec3d()
        while climbing:
            e_1 = tangent(n)
            e_2 = wp.cross(n, e_1)
            c = view.point_a - view.point_b
            rho = vec2d(wp.dot(c, e_1), wp.dot(c, e_2))
            # What the edges take: those that n is not across pull one way, the others as is needed.
            flat = Flat()
            tied = wp.int32(0)
            edge = wp.int32(-1)
            ratio = zero
            if wp.static(count > 0):
                for i in range(wp.static(count)):
                    k = view.kinks[i]
                    flat[i] = vec2d(wp.dot(k, e_1), wp.dot(k, e_2))
                    signs[i] = zero
                    if wp.abs(view.at[i]) > wp.where(i < of_a, across_a, across_b) * wp.length(k):
                        signs[i] = wp.sign(view.at[i])
                        rho -= signs[i] * flat[i]
                    elif wp.length_sq(k) > zero:
                        tied += 1 << i
            offset = rho
            if wp.static(count > 0) and tied != 0:
                signs, rho, edge, ratio = divide(flat, tied, signs, rho)
            disc = view.disc_a + view.disc_b
            left = rho
            if wp.static(discs > 0) and disc > zero:
                rho *= wp.max(one - disc / wp.max(wp.length(rho), TINY), zero)
            steepness = wp.length(rho)
            result.residual = steepness / size
            if result.residual < close and result.residual > half * last:
                stalls += 1
            if result.residual <= TARGET or stalls > 2 or result.steps == STEPS:
                break
            last = result.residual
            result.steps += 1

            hessian = view.hessian_a + view.hessian_b
            if wp.static(A.bent):
                hessian += (view.bend_a * signs[0]) * view.hessian_a
            if wp.static(B.bent):
                hessian += (view.bend_b * signs[of_a]) * view.hessian_b
            along_1 = hessian * e_1
            q_11 = wp.dot(e_1, along_1) + view.value
            q_12 = wp.dot(e_2, along_1)
            q_22 = wp.dot(e_2, hessian * e_2) + view.value
            d = vec2d()
            if tied != 0 or disc > zero:
                u = rho / steepness
                curved = q_11 * u[0] * u[0] + two * q_12 * u[0] * u[1] + q_22 * u[1] * u[1]
                d = (steepness / wp.max(wp.abs(curved), TINY)) * u
            else:
                d = newton(q_11, q_12, q_22, rho)
            length = wp.length(d)
            if length > LONGEST:
                d *= LONGEST / length
            slope = wp.dot(rho, d)
            if wp.static(steep):  # noqa: SIM102
                # Nothing to gain, and yet the points are not across from each other: n is as good as it can be
                # rounded, and one of them slides along a face that is flat for all that n tells.
                if slope < SLIDES * size:
                    # g is flat for rounding. The residual tells whether Newton's step is a good one, or the normal
                    # where the point stays.
                    if result.residual < half * sharp:
                        sharp = result.residual
                        sharpest = n
                        way = 0
                    elif result.residual != sharp:
                        n = sharpest
                        view = look(p_a, p_b, x, R, n)
                        continue
                    if way < 2 and tied == 0:
                        turn = d
                        if way == 1:
                            # The points are to be apart for that.
                            apart = steepness < half * wp.abs(view.value)
                            turn = wp.where(apart, rho / view.value, vec2d())
                        way += 1
                        n = wp.normalize(n + turn[0] * e_1 + turn[1] * e_2)
                        view = look(p_a, p_b, x, R, n)
                        continue
                    rest = rho[0] * e_1 + rho[1] * e_2
                    if wp.static(A.steep):
                        on_a = view.point_a - rest
                        for i in range(wp.static(A.kinks)):
                            on_a -= signs[i] * view.kinks[i]
                        if A.gauge(p_a, (on_a - x) * R) <= INSIDE:
                            slid_a = -rest
                            result.residual = zero
                    if wp.static(B.steep):
                        on_b = view.point_b + rest
                        for i in range(wp.static(B.kinks)):
                            on_b += signs[of_a + i] * view.kinks[of_a + i]
                        if result.residual > zero and B.gauge(p_b, on_b) <= INSIDE:
                            slid_b = rest
                            result.residual = zero
                    if result.residual == zero:
                        break
            # Where the step meets an edge that turns the slope.
            part = real(1.0)
            met = wp.int32(-1)
            promised = half * slope
            if wp.static(count > 0):
                bent = wp.max(q_11 * d[0] * d[0] + two * q_12 * d[0] * d[1] + q_22 * d[1] * d[1], zero)
                crossed = zero
                crossed_at = zero
                passed = tied
                many = wp.int32(count)
                for _ in range(many):
                    nearest = wp.int32(-1)
                    at = part
                    for i in range(many):
                        rate = flat[i, 0] * d[0] + flat[i, 1] * d[1]
                        ahead = (passed >> i) & 1 == 0 and view.at[i] * rate < zero
                        if ahead and wp.abs(view.at[i]) < at * wp.abs(rate):
                            at = -view.at[i] / rate
                            nearest = i
                    if nearest >= 0 and met < 0:
                        passed += 1 << nearest
                        drop = two * wp.abs(flat[nearest, 0] * d[0] + flat[nearest, 1] * d[1])
                        crossed += drop
                        crossed_at += drop * at
                        if slope - crossed - at * bent <= zero:
                            met = nearest
                            part = at
                promised = wp.max(part * (slope - crossed - half * part * bent) + crossed_at, zero)
            d_3 = d[0] * e_1 + d[1] * e_2
            pole = vec3d()
            if wp.static(discs > 0) and disc == zero:
                if wp.static(A.discs > 0):
                    # Along −n: a disc with the normal −z of a lies in +z.
                    pole = pole_ahead(n, vec3d(R[0, 2], R[1, 2], R[2, 2]), wp.static(int(A.discs == 1)), d_3)
                if wp.static(B.discs > 0):
                    other = pole_ahead(n, vec3d(zero, zero, -one), wp.static(int(B.discs == 1)), d_3)
                    if wp.dot(n, other) > wp.dot(n, pole):
                        pole = other
            done = wp.bool(False)
            tried = wp.int32(0)
            if wp.static(steep):
                most = real(-wp.inf)
                best = n
                best_seen = view
            while not done and tried < TRIALS:
                tried += 1
                trial = pole
                to_pole = wp.length_sq(pole) > zero
                ordinary = not to_pole
                if ordinary:
                    trial = wp.normalize(n + part * d_3)
                # What is static stands alone: Warp leaves out nothing else.
                if wp.static(steep):  # noqa: SIM102
                    if ordinary and (tied == 0 or edge >= 0) and met < 0 and tried <= WAYS:
                        ordinary = False
                        # The normals where the points would go; powers of both.
                        if wp.static(A.steep):  # noqa: SIM102
                            if tried == 2:
                                to = view.point_a - view.hessian_a * d_3 - x
                                trial = -(R * A.gauss(p_a, to * R))
                        if wp.static(B.steep):  # noqa: SIM102
                            if tried == 3:
                                trial = B.gauss(p_b, view.point_b + view.hessian_b * d_3)
                        if tried == WAYS:
                            trial = wp.normalize(n + steeper(p_a, p_b, R, n, d_3))
                if wp.static(count > 0):
                    if edge >= 0 and not to_pole:
                        trial = held(p_a, p_b, x, R, trial, view.kinks, edge, met)
                    elif met >= 0 and not to_pole:
                        trial = held(p_a, p_b, x, R, trial, view.kinks, met, -1)
                seen = look(p_a, p_b, x, R, trial)
                rise = seen.value - view.value
                done = rise > zero
                if wp.static(steep):  # noqa: SIM102
                    if not (ordinary or to_pole):
                        # Newton's step if it is good, or else the best of all.
                        if rise > most:
                            most = rise
                            best = trial
                            best_seen = seen
                        done = tried == 1 and rise >= MOST * promised
                        if tried == WAYS and most > NOISE * size:
                            done = True
                            trial = best
                            seen = best_seen
                if ordinary:
                    # The model's rise tells whether the step is a good one; a shorter one only has to rise.
                    asked = wp.where(tried == 1, MOST * promised, LEAST * part * slope)
                    done = rise >= asked - NOISE * size
                if done:
                    n = trial
                    view = seen
                elif ordinary:
                    met = -1
                    back = half * slope * part / wp.max(slope * part - rise, TINY)
                    part *= wp.clamp(back, real(0.05), half)
                pole = vec3d()
            climbing = done

        taken = left
        if wp.static(discs > 0 and count > 0) and disc > zero and ratio > zero:
            # Discs and faces are displaced alike.
            share = disc / (disc + wp.length(offset) / ratio)
            taken = share * offset
            for i in range(wp.static(count)):
                if (tied >> i) & 1 == 1:
                    signs[i] *= one - share
        result.value = view.value
        result.normal = n
        result.point_a = view.point_a + slid_a
        result.point_b = view.point_b + slid_b
        if wp.static(count > 0):
            for i in range(wp.static(count)):
                if wp.static(i < of_a):
                    result.point_a -= signs[i] * view.kinks[i]
                else:
                    result.point_b += signs[i] * view.kinks[i]
        if wp.static(discs > 0) and disc > zero:
            across = taken[0] * e_1 + taken[1] * e_2
            if wp.length(taken) > disc:
                across *= disc / wp.length(taken)
            result.point_a -= (view.disc_a / disc) * across
            result.point_b += (view.disc_b / disc) * across
        return result

    return SimpleNamespace(climb=climb, Climb=Climb, Of_a=Of_a, Of_b=Of_b)
