"""Signed distances from superellipsoids by directions that bound them; independent of the solver.

The signed distance of a point y from a convex body is the maximum of n·y − h(n) over all directions n, with the
support function h. Each direction gives a lower bound, so one direction can prove that a point is at least as far
as some distance. The result never exceeds the distance.
"""

import warp as wp

# Number of angles of start directions in the octant of y: 15° apart, between the planes of symmetry.
STARTS = wp.constant(7)
# Upper bound on the improvement from a start, relative to the size of the body: ½ (7.5° √2)².
SPARE = wp.constant(wp.float64(0.017))
mat77d = wp.types.matrix((7, 7), wp.float64)


@wp.func
def norm(x: wp.float64, y: wp.float64, exponent: wp.float64):
    longest = wp.max(x, y)
    if longest == wp.float64(0.0):
        return longest
    sum_ = wp.float64(1.0) + wp.pow(wp.min(x, y) / longest, exponent)
    return longest * wp.pow(sum_, wp.float64(1.0) / exponent)


@wp.func
def separation(axes: wp.vec3d, exponents: wp.vec2d, n: wp.vec3d, y: wp.vec3d):
    """Distance of y beyond the support plane across n of a superellipsoid; the support function is the dual norm."""
    two = wp.float64(2.0)
    flat = norm(wp.abs(axes[0] * n[0]), wp.abs(axes[1] * n[1]), two / (two - exponents[1]))
    return wp.dot(n, y) - norm(flat, wp.abs(axes[2] * n[2]), two / (two - exponents[0]))


@wp.func
def ascend(
    axes: wp.vec3d, exponents: wp.vec2d, start: wp.vec3d, y: wp.vec3d, longest: wp.float64, shortest: wp.float64,
    enough: wp.float64,
):  # fmt: skip
    """Maximum found by a pattern search, or a sufficient value, and its direction.

    Components of y and of the direction are not negative.
    """
    n = start
    value = separation(axes, exponents, n, y)
    size = longest
    turn = wp.float64(0.0)
    while size > shortest and value < enough:
        e_1 = wp.vec3d(wp.float64(0.0), n[2], -n[1])
        if wp.abs(n[0]) > wp.float64(0.6):
            e_1 = wp.vec3d(-n[2], wp.float64(0.0), n[0])
        e_1 = wp.normalize(e_1)
        e_2 = wp.cross(n, e_1)
        best = n
        turn += wp.float64(0.37)
        angle = turn
        for _i in range(8):
            angle += wp.float64(wp.pi / 4.0)
            m = wp.normalize(n + size * (wp.cos(angle) * e_1 + wp.sin(angle) * e_2))
            now = separation(axes, exponents, m, y)
            if now > value:
                value = now
                best = m
        # Steps along the edges of nearly sharp bodies, where a component of n is 0 or almost constant, and onto
        # them.
        for i in range(3):
            axis = wp.vec3d()
            axis[i] = wp.float64(1.0)
            level = size * wp.cross(n, axis)
            for k in range(3):
                m = n - n[i] * axis
                if k == 1:
                    m = n + level
                elif k == 2:
                    m = n - level
                if wp.length(m) > wp.float64(0.5):
                    m = wp.normalize(m)
                    now = separation(axes, exponents, m, y)
                    if now > value:
                        value = now
                        best = m
        step = best - n
        if wp.length(step) == wp.float64(0.0):
            size = wp.float64(0.5) * size
        n = best
        # Repeats the step while the value increases.
        while wp.length(step) > wp.float64(0.0):
            m = wp.normalize(n + step)
            now = separation(axes, exponents, m, y)
            if now > value:
                value = now
                step = wp.float64(1.5) * (m - n)
                n = m
            else:
                step = wp.vec3d()
        # Across a plane of symmetry there may be a maximum that is lower than its mirror image.
        m = wp.vec3d(wp.abs(n[0]), wp.abs(n[1]), wp.abs(n[2]))
        now = separation(axes, exponents, m, y)
        if now > value:
            value = now
            n = m
    return value, n


@wp.func
def octant(i: wp.int32, k: wp.int32):
    up = wp.float64(i) * wp.float64(wp.pi / 12.0)
    around = wp.float64(k) * wp.float64(wp.pi / 12.0)
    return wp.vec3d(wp.cos(up) * wp.cos(around), wp.cos(up) * wp.sin(around), wp.sin(up))


@wp.func
def distance_lower_bound(axes: wp.vec3d, exponents: wp.vec2d, known: wp.vec3d, y: wp.vec3d, enough: wp.float64):
    """Signed distance of y, or a sufficient lower bound, and its direction.

    The body is symmetric, so the octant of y contains the best direction.

    Args:
        axes: Semi-axes [m].
        exponents: ε₁ and ε₂.
        known: Direction that is tried first.
        y: Point in the frame of the body [m].
        enough: The search stops at this value [m].
    """
    side = wp.vec3d(wp.sign(y[0]), wp.sign(y[1]), wp.sign(y[2]))
    z = wp.cw_mul(side, y)
    n = wp.vec3d(wp.abs(known[0]), wp.abs(known[1]), wp.abs(known[2]))
    value = separation(axes, exponents, n, z)
    if value < enough:
        # From outside there is one maximum, from inside several. The best starts lead to the global one.
        top = wp.float64(-wp.inf)
        values = mat77d()
        for i in range(STARTS):
            for k in range(STARTS):
                values[i, k] = separation(axes, exponents, octant(i, k), z)
                top = wp.max(top, values[i, k])
        top -= SPARE * wp.length(axes)
        for i in range(STARTS):
            for k in range(STARTS):
                # All starts of the last row are the pole.
                if values[i, k] > top and value < enough and (i < STARTS - 1 or k == 0):
                    now, m = ascend(axes, exponents, octant(i, k), z, wp.float64(0.1), wp.float64(3e-4), enough)
                    if now > value:
                        value = now
                        n = m
        if value < enough:
            value, n = ascend(axes, exponents, n, z, wp.float64(1e-2), wp.float64(1e-9), enough)
    return value, wp.cw_mul(side, n)
