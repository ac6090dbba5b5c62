"""Candidates for the points of a patch, and the choice of at most four of them.

Candidates are in arrays of a thread with ``CANDIDATES`` entries per patch. Of more candidates, those that are extreme in
``DIRECTIONS`` directions and the deepest remain.
"""

import warp as wp
from warpcontact.kernels.manifolds.features import Feature, is_before, same_feature

double = wp.float64
vec3d = wp.vec3d

#: Patches of a pair with a polyhedron that is not convex, and of a convex polyhedron with a curved solid.
MAX_PATCHES, CURVED_PATCHES = 6, 4
#: Points of a patch.
POINTS = 4
#: Candidates of a patch.
CANDIDATES = 32
#: Directions whose extreme candidates remain if there are too many.
DIRECTIONS = 16
# Relative difference of gaps and distances below which the feature decides, not rounding.
TIE = wp.constant(double(1.0e-3))
# Distance of candidates, relative to the size, below which they are one point.
SAME_POINT = wp.constant(double(1.0e-6))
# Difference of gaps, relative to the size, and relative difference of distances up to which points of the last step are preferred.
SAME_DEPTH = wp.constant(double(1.0e-5))
PREFERENCE = wp.constant(double(0.05))
COSINE_STEP = wp.constant(double(0.9238795325112867))  # of 2 π/16
SINE_STEP = wp.constant(double(0.3826834323650898))
LARGEST = wp.constant(double(1.0e300))


@wp.struct
class Patch:
    """A patch while its candidates are collected, in the frame of the second solid."""

    normal: vec3d  # out of the second solid
    gap: double  # smallest gap [m]
    count: wp.int32  # number of candidates
    lost_gap: double  # in the first patch: smallest gap of the areas of the pair that have no patch [m]


#: A candidate for a point, in the frame of the second solid: its position K [m]; its gap, negative in overlap [m]; the numbers of its
#: ``Feature``; and 1 if it was a point in the last step. A vector, because compilers unroll the initialization of arrays of structs.
Candidate = wp.types.vector(length=7, dtype=wp.float64)


@wp.func
def candidate_position(one: Candidate):
    """Returns the position of a candidate [m]."""
    return vec3d(one[0], one[1], one[2])


@wp.func
def candidate_gap(one: Candidate):
    """Returns the gap of a candidate [m]."""
    return one[3]


@wp.func
def candidate_feature(one: Candidate):
    """Returns the ``Feature`` of a candidate."""
    feature = Feature()
    feature.first = wp.int32(one[4])
    feature.second = wp.int32(one[5])
    return feature


@wp.func
def was_point_before(one: Candidate):
    """Returns 1 if a candidate was a point in the last step."""
    return wp.int32(one[6])


@wp.func
def axes_across(normal: vec3d):
    """Returns two unit vectors normal to a unit vector and to each other."""
    side = wp.where(normal[2] < double(0.0), double(-1.0), double(1.0))
    a = double(-1.0) / (side + normal[2])
    b = normal[0] * normal[1] * a
    first = vec3d(double(1.0) + side * normal[0] * normal[0] * a, side * b, -side * normal[0])
    second = vec3d(b, side + normal[1] * normal[1] * a, -normal[1])
    return first, second


@wp.func(inline=False)
def keep_extremes(candidates: wp.array(dtype=Candidate), first: int, count: int, normal: vec3d):
    """Removes candidates that are not extreme in a direction across ``normal``; returns the number of the others."""
    u_axis, v_axis = axes_across(normal)
    kept = wp.int32(0)
    # First the deepest one, then the extremes of the directions in turn. Those are moved to the front.
    cosine = double(1.0)
    sine = double(0.0)
    for direction in range(DIRECTIONS + 1):
        along = cosine * u_axis + sine * v_axis
        best = wp.int32(-1)
        largest = -LARGEST
        for i in range(count):
            value = wp.dot(along, candidate_position(candidates[first + i]))
            if direction == 0:
                value = -candidate_gap(candidates[first + i])
            if value > largest:
                largest = value
                best = i
        if direction > 0:
            turned = COSINE_STEP * cosine - SINE_STEP * sine
            sine = SINE_STEP * cosine + COSINE_STEP * sine
            cosine = turned
        if best >= kept:
            one = candidates[first + best]
            other = candidates[first + kept]
            candidates[first + kept] = one
            candidates[first + best] = other
            kept += 1
    return kept


@wp.func(inline=False)
def add_candidate(
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    patch: int,
    position: vec3d,
    gap: double,
    feature: Feature,
):
    """Adds a candidate to a patch; of several with one feature, the deepest remains."""
    first = CANDIDATES * patch
    count = patches[patch].count
    patches[patch].gap = wp.min(patches[patch].gap, gap)
    one = Candidate(
        position[0], position[1], position[2], gap, double(feature.first), double(feature.second), double(0.0)
    )
    for i in range(count):
        if same_feature(candidate_feature(candidates[first + i]), feature):
            if gap < candidate_gap(candidates[first + i]):
                candidates[first + i] = one
            return
    if count == CANDIDATES:
        count = keep_extremes(candidates, first, count, patches[patch].normal)
    candidates[first + count] = one
    patches[patch].count = count + 1


@wp.func
def across(difference: vec3d, normal: vec3d):
    """Returns the part of a vector that is normal to ``normal``."""
    return difference - wp.dot(difference, normal) * normal


@wp.func(inline=False)
def choose_points(
    patch: Patch, candidates: wp.array(dtype=Candidate), first: int, size: double, chosen: wp.array(dtype=wp.int32)
):
    """Chooses at most four candidates of a patch; returns their number and writes them to ``chosen``.

    The deepest one, of equally deep ones that farthest from their mean; the one farthest from it; the one farthest from the
    line through both; and the one farthest outside the triangle of these. Of nearly equal ones, a point of the last step, and
    of these the one with the first feature.

    Args:
        patch: The patch.
        candidates: The candidates of all patches.
        first: Index of the first candidate of the patch.
        size: Length relative to which candidates differ [m].
        chosen: Receives the indices of the candidates.
    """
    n = patch.normal
    if patch.count == 0:
        return 0
    found = wp.int32(0)
    origin = vec3d()
    deepest = -LARGEST
    for i in range(patch.count):
        origin += candidate_position(candidates[first + i]) / double(patch.count)
        deepest = wp.max(deepest, -candidate_gap(candidates[first + i]))
    triangle = wp.mat33d()
    for number in range(POINTS):
        # The largest value within the tie, in two passes.
        largest = -LARGEST
        for i in range(patch.count):
            value = candidate_value(candidates[first + i], number, origin, triangle, n)
            if number > 0 or -candidate_gap(candidates[first + i]) >= deepest - SAME_POINT * size:
                largest = wp.max(largest, value)
        if number > 0 and largest <= SAME_POINT * size:
            if number == 1:
                return found
            continue
        best = wp.int32(-1)
        best_was_point = wp.int32(0)
        for i in range(patch.count):
            was_point = was_point_before(candidates[first + i])
            # Distances of candidates at the same place are rounding errors.
            limit = largest - wp.max(wp.where(was_point == 1, PREFERENCE, TIE) * largest, SAME_POINT * size)
            tolerance = wp.where(was_point == 1, SAME_DEPTH, SAME_POINT) * size
            if number == 0 and -candidate_gap(candidates[first + i]) < deepest - tolerance:
                continue
            if candidate_value(candidates[first + i], number, origin, triangle, n) < limit:
                continue
            is_first = best < 0 or was_point > best_was_point
            if was_point == best_was_point and best >= 0:
                is_first = is_before(
                    candidate_feature(candidates[first + i]), candidate_feature(candidates[first + best])
                )
            if is_first:
                best = i
                best_was_point = was_point
        chosen[found] = first + best
        found += 1
        position = candidate_position(candidates[first + best])
        if number == 0:
            origin = position
        if number < 3:
            triangle[number] = position
    return found


@wp.func
def candidate_value(one: Candidate, number: int, origin: vec3d, triangle: wp.mat33d, n: vec3d):
    """Returns the distance by which point ``number`` of a patch is chosen [m].

    Args:
        one: The candidate.
        number: Number of the point.
        origin: Mean of all candidates for the first point, the first point for the second one.
        triangle: The points that were chosen, as rows.
        n: Normal of the patch.
    """
    if number <= 1:
        return wp.length(across(candidate_position(one) - origin, n))
    along = wp.normalize(across(triangle[1] - triangle[0], n))
    if number == 2:
        return wp.abs(wp.dot(wp.cross(n, along), candidate_position(one) - triangle[0]))
    # Distances outside the edges of the triangle, which may be in either order.
    turn = wp.where(wp.dot(wp.cross(n, along), triangle[2] - triangle[0]) > double(0.0), double(-1.0), double(1.0))
    largest = -LARGEST
    for i in range(3):
        start = triangle[i]
        end = triangle[wp.where(i == 2, 0, i + 1)]
        outward = turn * wp.normalize(wp.cross(n, across(end - start, n)))
        largest = wp.max(largest, wp.dot(outward, candidate_position(one) - start))
    return largest
