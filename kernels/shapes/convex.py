"""Contact of two convex shapes: the maximum of the separation g(n) over all directions.

A stationary value g ≥ 0 is the gap, because no two points are closer than the supporting planes. A stationary
overlap up to the sum of the rolling-ball radii is the answer, too (Blaschke's rolling theorem). In deeper overlap
there can be several maxima. For two polyhedral shapes all face normals and edge cross products are tested.
Otherwise ``direction_branch_and_bound.py`` excludes cells of directions, and the ascent (``separation_newton.py``)
restarts from every better direction. The result does not depend on the start, unless overlaps are equal along a
curve: then the search stops after ``MAX_FINE_CELLS``. If any evaluated direction is higher than the best converged
ascent, the status is NOT_CONVERGED.
"""

import functools

import warp as wp
from warpcontact.kernels.shapes import direction_branch_and_bound, separation_newton
from warpcontact.kernels.shapes.base import Shape, ShapeContactPoint, WarmStart, mat33d, one, real, vec3d, zero
from warpcontact.kernels.types import MET, NOT_CONVERGED

#: Maximum number of ascents including those from unproven directions, and of all ascents.
MAX_ASCENTS = 40
MAX_ASCENTS_TOTAL = 80
#: Number of times an ascent with the highest value is continued after its step limit.
MAX_RETRIES = 5

# Largest accepted residual; the second for ill-conditioned shapes, where rounding of n moves points far.
MAX_RESIDUAL = wp.constant(real(1.0e-9))
MAX_RESIDUAL_ILL_CONDITIONED = wp.constant(real(1.0e-6))
# Rounding of g, relative to the size of the pair.
ROUNDING = wp.constant(real(1.0e-14))
# Overlaps that differ by less, relative to the size of the pair, are equal.
TIE = wp.constant(real(1.0e-11))
BIT = wp.constant(wp.int64(1))
# Finest cells per cell of level 1. Until an ascent converges, one start is taken from each of these cells.
COARSE_CELL = wp.constant(wp.int64(direction_branch_and_bound.EDGE * direction_branch_and_bound.EDGE // 4))
NEGATIVE_INFINITY = wp.constant(real(-wp.inf))


@functools.cache
def pair_function(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function for two convex shapes; arguments as in ``pair_dispatch.py``."""
    pair_ascent = separation_newton.functions(A, B)
    CoefficientsA, CoefficientsB, AscentResult, ascend = (
        pair_ascent.CoefficientsA,
        pair_ascent.CoefficientsB,
        pair_ascent.AscentResult,
        pair_ascent.ascend,
    )
    next_direction = direction_branch_and_bound.direction_search(A, B)
    max_residual = MAX_RESIDUAL_ILL_CONDITIONED if A.ill_conditioned or B.ill_conditioned else MAX_RESIDUAL
    # The overlap of polyhedral shapes is least along one of the normals tested by ``best_edge_normal``.
    polyhedral = A.polyhedral and B.polyhedral

    @wp.func
    def best_edge_normal(p_a: CoefficientsA, p_b: CoefficientsB, x: vec3d, R: mat33d, best: real):
        """Returns the face normal or edge cross product with the largest g above ``best``; 0 if there is none."""
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
                # Straight edges are parallel to the axes; a single edge is parallel to z.
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
    def convex_contact(p_a: CoefficientsA, p_b: CoefficientsB, x: vec3d, q: wp.quatd, warm_start: WarmStart):
        R = wp.quat_to_matrix(wp.normalize(q))
        center_offset = x + R * A.inscribed_center(p_a) - B.inscribed_center(p_b)
        size = wp.length(x) + wp.max(A.extents(p_a)) + wp.max(B.extents(p_b))
        inscribed_radius = A.inscribed_radius(p_a) + B.inscribed_radius(p_b)
        margin = A.margin(p_a) + B.margin(p_b)
        unique_depth = A.rolling_ball_radius(p_a) + B.rolling_ball_radius(p_b)
        n = vec3d(zero, zero, one)
        if warm_start.valid != 0:
            n = warm_start.normal
        elif wp.length_sq(center_offset) > zero:
            n = wp.normalize(center_offset)
        found = ShapeContactPoint()
        best = AscentResult()
        ascents = wp.int32(0)
        converged = wp.bool(False)
        search_state = direction_branch_and_bound.SearchState()
        search_state.level = -1
        tried_edge_normals = wp.bool(False)
        highest_value = NEGATIVE_INFINITY
        retries = wp.int32(0)
        searching = wp.bool(True)
        while searching:
            ascent_result = ascend(p_a, p_b, x, R, n, size)
            found.iterations += ascent_result.steps
            accepted = ascent_result.residual <= max_residual
            better = ascent_result.residual < best.residual
            if converged:
                better = False
            if accepted and (not converged or ascent_result.value > best.value):
                better = True
            if ascents == 0 or better:
                best = ascent_result
                converged = accepted
            ascents += 1
            if converged and best.value - margin >= -unique_depth:
                break
            if (
                not accepted
                and ascent_result.value > highest_value
                and ascent_result.steps == separation_newton.MAX_STEPS
                and retries < MAX_RETRIES
            ):
                # The highest value so far, at the step limit: continue.
                retries += 1
                n = ascent_result.normal
                continue
            highest_value = wp.max(highest_value, ascent_result.value)
            retries = 0
            gap = NEGATIVE_INFINITY
            if converged:
                gap = best.value - margin
            searching = False
            if not tried_edge_normals:
                tried_edge_normals = True
                n = best_edge_normal(p_a, p_b, x, R, gap + ROUNDING * size)
                searching = wp.length_sq(n) > zero
            keep_searching = ascents < MAX_ASCENTS
            if converged:
                keep_searching = wp.bool(wp.static(not polyhedral)) and ascents < MAX_ASCENTS_TOTAL
            if keep_searching and not searching:
                end = best.point_a - best.point_b - margin * best.normal
                depth = -gap - TIE * size
                explore = ascents < MAX_ASCENTS
                n, search_state = next_direction(
                    p_a, p_b, x, R, center_offset, inscribed_radius, depth, end, explore, search_state
                )
                searching = wp.length_sq(n) > zero
                if not converged:
                    # Without a bound, continue with the next coarse cell.
                    search_state.cell = (search_state.cell // COARSE_CELL + BIT) * COARSE_CELL
                    search_state.level = -1
        found.gap = best.value - margin
        found.normal = best.normal
        found.point_a = best.point_a - A.margin(p_a) * best.normal
        found.point_b = best.point_b + B.margin(p_b) * best.normal
        found.residual = best.residual
        found.status = NOT_CONVERGED
        if converged and highest_value <= best.value + TIE * size:
            # No evaluated direction is higher, including ascents that did not converge.
            found.status = MET
            found.warm_start.normal = best.normal
            found.warm_start.valid = 1
        return found

    return convex_contact
