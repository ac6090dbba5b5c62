"""Where two convex shapes meet: the largest value of g(n) over all directions.

A direction where g is stationary is the answer if g is not negative there: the vector between the contact points
is as long as g, and no two points of the bodies can be nearer than the planes g apart. It is, too, in overlap no
deeper than the sum of the radii of spheres that roll inside both surfaces (Blaschke): a sphere of that size fits in
the set of all differences of points of the two bodies where it touches its border, and no other part of the border
is nearer. In deeper overlap there may be several, however good the start: directions all around are looked at, and
the climb starts again from the best of them.
"""

import functools
import math

import warp as wp
from warpcontact.kernels.smooth import ascent
from warpcontact.kernels.smooth.base import Meeting, Seed, Shape
from warpcontact.kernels.types import MET, NOT_CONVERGED

real = wp.float64
vec3d = wp.vec3d
mat33d = wp.mat33d

#: Directions that are looked at, and how many of the best a climb starts from.
DIRECTIONS = 96
STARTS = 4

zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
# A residual above this is no solution.
ALLOWED = wp.constant(real(1.0e-9))
# Starts are at least this far apart: cosine.
ALIKE = wp.constant(real(0.85))
LATITUDE = wp.constant(real(2.0 / DIRECTIONS))
GOLDEN_COSINE = wp.constant(real(math.cos(math.pi * (3.0 - math.sqrt(5.0)))))
GOLDEN_SINE = wp.constant(real(math.sin(math.pi * (3.0 - math.sqrt(5.0)))))
NOTHING = wp.constant(real(-wp.inf))


@functools.cache
def meet(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of two convex shapes, see ``meet.py``."""
    of_pair = ascent.functions(A, B)
    Of_a, Of_b, Climb, climb = of_pair.Of_a, of_pair.Of_b, of_pair.Climb, of_pair.climb
    Starts = wp.types.matrix((STARTS, 3), real)
    Values = wp.types.vector(STARTS, real)

    @wp.func
    def scan(p_a: Of_a, p_b: Of_b, x: vec3d, R: mat33d, apart: vec3d, depth: real):
        """Looks all around for directions along which the overlap might be less than ``depth``: the best few."""
        starts = Starts()
        values = Values()
        for k in range(STARTS):
            values[k] = NOTHING
        inner = A.inner(p_a) + B.inner(p_b)
        extents_a = A.extents(p_a)
        extents_b = B.extents(p_b)
        cosine = real(1.0)
        sine = real(0.0)
        count = wp.int32(DIRECTIONS + 12)
        for i in range(count):
            n = vec3d()
            if i < DIRECTIONS:
                # A spiral; every other turn by a third each as it is, and denser where one of the shapes is flat.
                z = (real(i) + real(0.5)) * LATITUDE - one
                across = wp.sqrt(one - z * z)
                n = vec3d(across * cosine, across * sine, z)
                turned = cosine * GOLDEN_COSINE - sine * GOLDEN_SINE
                sine = sine * GOLDEN_COSINE + cosine * GOLDEN_SINE
                cosine = turned
                if i % 3 == 1:
                    n = wp.normalize(wp.cw_div(n, extents_b))
                elif i % 3 == 2:
                    n = R * wp.normalize(wp.cw_div(n, extents_a))
            else:
                # The axes of both.
                k = i - DIRECTIONS
                n[(k // 2) % 3] = wp.where(k % 2 == 0, one, -one)
                if k >= 6:
                    n = R * n
            # Spheres inside both overlap by more?
            if inner - wp.dot(n, apart) < depth:
                value = wp.dot(n, x + R * A.support(p_a, -(n * R)) - B.support(p_b, n))
                worst = wp.int32(0)
                near = wp.int32(-1)
                for k in range(STARTS):
                    if values[k] < values[worst]:
                        worst = k
                    if values[k] > NOTHING and wp.dot(starts[k], n) > ALIKE:
                        near = k
                if near >= 0:
                    worst = near
                if value > values[worst]:
                    values[worst] = value
                    starts[worst] = n
        return starts, values

    @wp.func
    def meet_convex(p_a: Of_a, p_b: Of_b, x: vec3d, q: wp.quatd, seed: Seed):
        R = wp.quat_to_matrix(wp.normalize(q))
        apart = x + R * A.centre(p_a) - B.centre(p_b)
        size = wp.length(x) + wp.max(A.extents(p_a)) + wp.max(B.extents(p_b))
        margin = A.margin(p_a) + B.margin(p_b)
        sure = A.rolling(p_a) + B.rolling(p_b)
        n = vec3d(zero, zero, one)
        if seed.known != 0:
            n = seed.normal
        elif wp.length_sq(apart) > zero:
            n = wp.normalize(apart)
        found = Meeting()
        best = Climb()
        starts = Starts()
        values = Values()
        met = wp.bool(False)
        trial = wp.int32(0)
        while trial <= STARTS:
            one_climb = climb(p_a, p_b, x, R, n, size)
            found.iterations += one_climb.steps
            good = one_climb.residual <= ALLOWED
            if (
                trial == 0
                or (good and (not met or one_climb.value > best.value))
                or (not met and one_climb.residual < best.residual)
            ):
                best = one_climb
                met = good
            if met and best.value - margin >= -sure:
                break
            if trial == 0:
                depth = real(wp.inf)
                if met:
                    depth = margin - best.value
                starts, values = scan(p_a, p_b, x, R, apart, depth)
            next = wp.int32(-1)
            for k in range(STARTS):
                if values[k] > NOTHING and next < 0:
                    next = k
            if next < 0:
                break
            n = starts[next]
            values[next] = NOTHING
            trial += 1
        found.gap = best.value - margin
        found.normal = best.normal
        found.point_a = best.point_a - A.margin(p_a) * best.normal
        found.point_b = best.point_b + B.margin(p_b) * best.normal
        found.residual = best.residual
        found.status = NOT_CONVERGED
        if met:
            found.status = MET
            found.seed.normal = best.normal
            found.seed.known = 1
        return found

    return meet_convex
