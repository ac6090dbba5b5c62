"""Where two convex shapes meet: the largest value of g(n) over all directions.

A direction where g is stationary is the answer if g is not negative there: the vector between the contact
points is as long as g, and no two points of the bodies can be nearer than the planes g apart. So it is in
overlap no deeper than the sum of the radii of spheres that roll inside both surfaces (Blaschke): a sphere of
that size fits into the set of all differences of points of the two bodies where it touches its boundary, and no
other part of the boundary is nearer. In deeper overlap there may be several, however good the start. Of two
bodies with straight edges, the normals of faces and of pairs of edges are all there are. Of others, bounds on
cells of directions rule out all where the bodies come apart by less, and the climb starts again from any direction
that is better than its end, until there is none. So the answer does not depend on where climbs happen to end, but
for a body that can leave another by ways of one length all along a curve: there the search stops at a number of
cells. An end that is lower than a direction met on the way, from where no climb arrived, is no answer.
"""

import functools

import warp as wp
from warpcontact.kernels.smooth import around, ascent
from warpcontact.kernels.smooth.base import Meeting, Seed, Shape, mat33d, one, real, vec3d, zero
from warpcontact.kernels.types import MET, NOT_CONVERGED

#: Most climbs from directions that are not known to be better, and of all.
CLIMBS = 40
MOST_CLIMBS = 80
#: How often a climb that is higher than all others goes on where its steps are used up.
AGAIN = 5

# A residual above this is no solution; of steep shapes, whose points the rounding of n moves far.
ALLOWED = wp.constant(real(1.0e-9))
ALLOWED_STEEP = wp.constant(real(1.0e-6))
# Rounding of g, of the size of the pair.
NOISE = wp.constant(real(1.0e-14))
# Ways apart that differ by no more, of the size of the pair, are as short as each other.
TIE = wp.constant(real(1.0e-11))
BIT = wp.constant(wp.int64(1))
# Cells of the finest in one of those that climbs start from as long as none has arrived.
COARSE = wp.constant(wp.int64(around.EDGE * around.EDGE // 4))
NOTHING = wp.constant(real(-wp.inf))


@functools.cache
def meet(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of two convex shapes, see ``meet.py``."""
    of_pair = ascent.functions(A, B)
    Of_a, Of_b, Climb, climb = of_pair.Of_a, of_pair.Of_b, of_pair.Climb, of_pair.climb
    next_direction = around.function(A, B)
    allowed = ALLOWED_STEEP if A.steep or B.steep else ALLOWED
    # The overlap of bodies with straight edges is least along one of the normals that ``ahead`` knows.
    polyhedral = A.polyhedral and B.polyhedral

    @wp.func
    def ahead(p_a: Of_a, p_b: Of_b, x: vec3d, R: mat33d, best: real):
        """Of the normals of faces, and of two straight edges, the one with the largest g above ``best``."""
        normal = vec3d()
        largest = real(best)
        count = wp.int32(wp.static(12 + 2 * A.kinks * B.kinks))
        for i in range(count):
            n = vec3d()
            k = i // 2
            if k < 3:
                n[k] = one
            elif k < 6:
                n = vec3d(R[0, k - 3], R[1, k - 3], R[2, k - 3])
            else:
                # Straight edges lie along the axes; one of a single edge is along z.
                if wp.static(A.kinks > 0 and B.kinks > 0):
                    j = (k - 6) % wp.static(max(A.kinks, 1)) + wp.static(2 if A.kinks == 1 else 0)
                    m = (k - 6) // wp.static(max(A.kinks, 1)) + wp.static(2 if B.kinks == 1 else 0)
                    axis = vec3d()
                    axis[m] = one
                    n = wp.cross(vec3d(R[0, j], R[1, j], R[2, j]), axis)
                    n = wp.normalize(n)
            if i % 2 == 1:
                n = -n
            if wp.length_sq(n) > zero:
                value = wp.dot(n, x + R * A.support(p_a, -(n * R)) - B.support(p_b, n))
                if value > largest:
                    largest = value
                    normal = n
        return normal

    @wp.func
    def meet_convex(p_a: Of_a, p_b: Of_b, x: vec3d, q: wp.quatd, seed: Seed):
        R = wp.quat_to_matrix(wp.normalize(q))
        apart = x + R * A.centre(p_a) - B.centre(p_b)
        size = wp.length(x) + wp.max(A.extents(p_a)) + wp.max(B.extents(p_b))
        inner = A.inner(p_a) + B.inner(p_b)
        margin = A.margin(p_a) + B.margin(p_b)
        sure = A.rolling(p_a) + B.rolling(p_b)
        n = vec3d(zero, zero, one)
        if seed.known != 0:
            n = seed.normal
        elif wp.length_sq(apart) > zero:
            n = wp.normalize(apart)
        found = Meeting()
        best = Climb()
        climbs = wp.int32(0)
        met = wp.bool(False)
        place = around.Place()
        place.level = -1
        begun = wp.bool(False)
        highest = NOTHING
        again = wp.int32(0)
        searching = wp.bool(True)
        while searching:
            one_climb = climb(p_a, p_b, x, R, n, size)
            found.iterations += one_climb.steps
            good = one_climb.residual <= allowed
            better = one_climb.residual < best.residual
            if met:
                better = False
            if good and (not met or one_climb.value > best.value):
                better = True
            if climbs == 0 or better:
                best = one_climb
                met = good
            climbs += 1
            if met and best.value - margin >= -sure:
                break
            if not good and one_climb.value > highest and one_climb.steps == ascent.STEPS and again < AGAIN:
                # Higher than all, and still on its way.
                again += 1
                n = one_climb.normal
                continue
            highest = wp.max(highest, one_climb.value)
            again = 0
            gap = NOTHING
            if met:
                gap = best.value - margin
            searching = False
            if not begun:
                begun = True
                n = ahead(p_a, p_b, x, R, gap + NOISE * size)
                searching = wp.length_sq(n) > zero
            go_on = climbs < CLIMBS
            if met:
                go_on = wp.bool(wp.static(not polyhedral)) and climbs < MOST_CLIMBS
            if go_on and not searching:
                end = best.point_a - best.point_b - margin * best.normal
                depth = -gap - TIE * size
                explore = climbs < CLIMBS
                n, place = next_direction(p_a, p_b, x, R, apart, inner, depth, end, explore, place)
                searching = wp.length_sq(n) > zero
                if not met:
                    # No bound yet, and so a start all around.
                    place.cell = (place.cell // COARSE + BIT) * COARSE
                    place.level = -1
        found.gap = best.value - margin
        found.normal = best.normal
        found.point_a = best.point_a - A.margin(p_a) * best.normal
        found.point_b = best.point_b + B.margin(p_b) * best.normal
        found.residual = best.residual
        found.status = NOT_CONVERGED
        if met and highest <= best.value + TIE * size:
            # Nothing higher is known, not even where a climb did not arrive.
            found.status = MET
            found.seed.normal = best.normal
            found.seed.known = 1
        return found

    return meet_convex
