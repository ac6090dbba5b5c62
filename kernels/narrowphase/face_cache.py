"""Cache of candidate faces for closest-point queries.

Like a neighbor list in molecular dynamics: a search at point p₀ stores all faces within distance d_min + skin,
each with its distance and gradient. Because a triangle is convex, its distance at p is at least d₀ + ∇d₀·(p − p₀).
A face that is not stored is at distance ≥ bound − |p − p₀|. If the smallest stored distance is below that bound,
the result is exact; otherwise the cache is rebuilt (``search.py``; on a CPU ``bvh_search.py``, whose lists also
omit dominated faces and are valid only within the skin). CPU kernels test the bounds of all listed faces with
vector instructions. GPU kernels store the radius within which the nearest face, or one of at most three others,
remains nearest.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel import simd
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.simd import WIDTH
from warpcontact.kernels.lowlevel.warps import lowest_set_bit
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.types import structs

# Rounding error of a distance, in units of epsilon times the size of the differences. Wider than a tie.
ROUNDING = 32.0
# Smallest distance, in units of the size of the differences, at which rounding errors of a direction are
# negligible.
MIN_RELATIVE_DISTANCE = 0.002
# Number of steps for which the valid radius should suffice; otherwise up to three more candidates are tested.
LOOKAHEAD_STEPS = 20.0


class Functions(NamedTuple):
    """Device functions of cached faces."""

    distance_gradient: wp.Function  # gradient of the distance of a face
    store_face_list: wp.Function  # stores the header of a list
    distance_lower_bound: wp.Function  # lower bound on the distance of a face from a shifted point
    cache_face: wp.Function  # stores the distance of a face and its gradient
    face_capacity: wp.Function  # number of faces that can be cached per contact
    cached_closest: wp.Function  # ``cached_nearest`` or, if that fails, ``nearest_candidate``
    nearest_candidate_simd: wp.Function  # ``nearest_candidate``, testing the bounds of several faces at a time
    nearest_candidate: wp.Function  # closest point on the cached faces, if the list suffices
    no_cached_point: wp.Function  # invalid result, for kernels without a face cache
    cached_nearest: wp.Function  # closest point on the stored nearest face and its tied candidates, if still valid


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    face_functions, candidates_within = closest_points.functions(real), simd.candidates_within(real)
    ClosestPoint, closest_on_face, closer, lost_tie = (
        face_functions.ClosestPoint,
        face_functions.closest_on_face,
        face_functions.closer,
        face_functions.lost_tie,
    )
    rounding = wp.constant(real(t.epsilon * ROUNDING))
    min_relative_distance = wp.constant(real(MIN_RELATIVE_DISTANCE))
    lookahead_steps = wp.constant(real(LOOKAHEAD_STEPS))

    @wp.struct
    class CachedClosestPoint:
        """Closest point from the cache, if valid."""

        closest: ClosestPoint
        valid: wp.bool

    @wp.func
    def distance_gradient(closest: ClosestPoint):
        """Returns the gradient of the distance of a face; 0 where rounding would dominate it."""
        if closest.distance > min_relative_distance * closest.span:
            return (real(1.0) / closest.distance) * closest.to_point
        return vec3()

    @wp.func
    def distance_lower_bound(closest: ClosestPoint, direction: vec3, displacement: vec3):
        """Returns a lower bound on the distance of a face from the point shifted by −``displacement``."""
        if closest.distance > min_relative_distance * closest.span:
            return closest.distance - wp.dot(direction, displacement)
        return real(0.0)

    @wp.func
    def cache_face(cache: Cache, env: int, slot: int, closest: ClosestPoint, displacement: vec3):
        """Stores the distance of a face and its gradient, relative to the center of the list."""
        direction = distance_gradient(closest)
        cache.distance[env, slot] = distance_lower_bound(closest, direction, displacement)
        cache.gradient[env, slot] = direction

    @wp.func
    def face_capacity(cache: Cache):
        """Returns the number of faces that can be cached per contact."""
        return cache.face.shape[1] // cache.face_count.shape[1]

    @wp.func
    def store_face_list(cache: Cache, env: int, contact: int, count: int, p: vec3, uncached_bound: real):
        """Stores the header of a list: ``count`` faces around ``p``, all others farther than ``uncached_bound``."""
        cache.face_count[env, contact] = count
        cache.valid_radius[env, contact] = real(0.0)
        cache.list_center[env, contact] = p
        cache.uncached_bound[env, contact] = uncached_bound

    @wp.func
    def lead_distance(best: ClosestPoint, direction: vec3, distance: real, limit: real, inverse_limit: real):
        """Returns a displacement up to which ``best`` stays nearer than another face, at most ``limit``.

        ``inverse_limit`` is 1/``limit``. A distance d changes by at most the displacement |v|. A better bound
        holds if both faces lie in about the same direction. With the gradient u' = ``direction`` of the other
        face's distance d', and u the unit vector from the closest point of ``best``,

            d'(p + v) ≥ d' + u'·v,   d(p + v) ≤ |d u + v| ≤ d + u·v + |v|²/d for |v| ≤ d/2

        so ``best`` stays nearest while |v|²/d + |u' − u| |v| < d' − d.
        """
        d = best.distance
        ahead = distance - d
        simple = real(0.5) * ahead
        rounded = rounding * best.span
        if ahead <= real(0.0) or d <= rounded or simple >= limit:
            return wp.min(simple, limit)
        per_d = real(1.0) / d
        direction_change = direction - per_d * best.to_point
        rounded = per_d * rounded
        # Usually no root is needed: evaluate the condition at |v| = limit.
        lower_bound = ahead * inverse_limit - limit * per_d - rounded
        if (
            lower_bound > real(0.0)
            and wp.length_sq(direction_change) < lower_bound * lower_bound
            and limit < real(0.5) * d
        ):
            return limit
        slope = wp.length(direction_change) + rounded
        far = real(2.0) * ahead / (slope + wp.sqrt(slope * slope + real(4.0) * ahead * per_d))
        return wp.min(wp.max(simple, wp.min(far, real(0.5) * d)), limit)

    @wp.func
    def no_cached_point(model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Returns an invalid result, for kernels without a face cache."""
        return CachedClosestPoint()

    @wp.func
    def bound_rounding(model: Model, query_mesh: int, best: ClosestPoint, distance_moved: real):
        """Returns the rounding error of a cached bound, ``distance_moved`` from the list center."""
        # Gradients were computed at points within the reach of the list.
        return rounding * (
            best.span + best.distance + real(16.0) * (distance_moved + model.query_mesh_skin[query_mesh])
        )

    @wp.func
    def candidate_lower_bound(cache: Cache, env: int, i: int, displacement: vec3, slack: real):
        """Returns a lower bound on the distance of a cached face, ``displacement`` from the list center."""
        return cache.distance[env, i] + wp.dot(cache.gradient[env, i], displacement) - slack

    @wp.func
    def closer_candidate(
        model: Model,
        cache: Cache,
        env: int,
        i: int,
        first: int,
        p: vec3,
        displacement: vec3,
        slack: real,
        best: ClosestPoint,
    ):
        """Returns the nearer of ``best`` and a cached face; skips face ``first``."""
        face = cache.face[env, i]
        if candidate_lower_bound(cache, env, i, displacement, slack) > best.distance or face == first:
            return best
        other = closest_on_face(model, face, p)
        cache_face(cache, env, i, other, displacement)
        return closer(model, best, other)

    @wp.func
    def list_suffices(
        model: Model, query_mesh: int, cache: Cache, env: int, contact: int, displacement: vec3, best: ClosestPoint
    ):
        """Returns whether ``best`` is nearer than all faces that are not cached."""
        distance_moved = wp.length(displacement)
        return best.distance < cache.uncached_bound[env, contact] - distance_moved - bound_rounding(
            model, query_mesh, best, distance_moved
        )

    @wp.func
    def cached_nearest(model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Returns the closest point on the stored nearest face and its tied candidates, if still valid."""
        result = CachedClosestPoint()
        result.valid = False
        if cache.face_count[env, contact] != 0:
            result.valid = wp.length(p - cache.valid_center[env, contact]) < cache.valid_radius[env, contact]
        if result.valid:
            first = cache.nearest[env, contact]
            best = closest_on_face(model, first, p)
            displacement = p - cache.list_center[env, contact]
            distance_moved = wp.length(displacement)
            if not (distance_moved < cache.uncached_bound[env, contact]):
                result.valid = False
                return result
            tied_count = cache.tied_count[env, contact]
            if tied_count > 0:
                slot = assume_nonnegative(contact * face_capacity(cache))
                slack = bound_rounding(model, query_mesh, best, distance_moved)
                k = wp.int32(0)
                while k < tied_count:
                    best = closer_candidate(
                        model, cache, env, assume_nonnegative(slot + k), first, p, displacement, slack, best
                    )
                    k += 1
                if lost_tie(best):
                    result.valid = False
                    return result
                best.distance = wp.length(best.to_point)
            result.closest = best
            result.valid = list_suffices(model, query_mesh, cache, env, contact, displacement, best)
        return result

    @wp.func
    def swap(cache: Cache, env: int, slot: int, k: int, other: int):
        """Swaps two faces of a list."""
        if k != other:
            i = assume_nonnegative(slot + k)
            j = assume_nonnegative(slot + other)
            face = wp.int32(cache.face[env, i])
            cache.face[env, i] = cache.face[env, j]
            cache.face[env, j] = face
            distance = real(cache.distance[env, i])
            cache.distance[env, i] = cache.distance[env, j]
            cache.distance[env, j] = distance
            direction = vec3(cache.gradient[env, i])
            cache.gradient[env, i] = cache.gradient[env, j]
            cache.gradient[env, j] = direction

    @wp.func
    def store_valid_radius(
        cache: Cache,
        env: int,
        contact: int,
        p: vec3,
        displacement: vec3,
        slack: real,
        best: ClosestPoint,
        step: real,
    ):
        """Stores the radius around ``p`` in which ``best`` or one of ``tied_count`` other faces is nearest."""
        slot = assume_nonnegative(contact * face_capacity(cache))
        # Displacements up to which the nearest face leads all others, all but one, all but two and all but three.
        lead_0 = real(wp.inf)
        lead_1 = real(wp.inf)
        lead_2 = real(wp.inf)
        lead_3 = real(wp.inf)
        inverse_last = real(0.0)
        # Their positions in the list.
        slot_0 = wp.int32(0)
        slot_1 = wp.int32(0)
        slot_2 = wp.int32(0)
        count = cache.face_count[env, contact]
        k = wp.int32(0)
        while k < count:
            i = assume_nonnegative(slot + k)
            if cache.face[env, i] != best.row:
                lower_bound = candidate_lower_bound(cache, env, i, displacement, slack)
                leads = lead_distance(best, cache.gradient[env, i], lower_bound, lead_3, inverse_last)
                if leads < lead_3:
                    lead_3 = wp.max(leads, lead_2)
                    inverse_last = real(1.0) / lead_3
                    if leads < lead_2:
                        lead_2 = wp.max(leads, lead_1)
                        slot_2 = wp.where(leads < lead_1, slot_1, k)
                        if leads < lead_1:
                            lead_1 = wp.max(leads, lead_0)
                            slot_1 = wp.where(leads < lead_0, slot_0, k)
                            if leads < lead_0:
                                lead_0 = leads
                                slot_0 = wp.int32(k)
            k += 1
        # If the radius is too small for the next steps, move up to three competing faces to the front of the list.
        valid_radius = lead_0
        tied_count = wp.int32(0)
        if lead_0 < lookahead_steps * step:
            valid_radius = lead_1
            tied_count = 1
            swap(cache, env, slot, 0, slot_0)
            slot_1 = wp.where(slot_1 == 0, slot_0, slot_1)
            slot_2 = wp.where(slot_2 == 0, slot_0, slot_2)
            if lead_1 < lookahead_steps * step:
                valid_radius = lead_2
                tied_count = 2
                swap(cache, env, slot, 1, slot_1)
                slot_2 = wp.where(slot_2 == 1, slot_1, slot_2)
                if lead_2 < lookahead_steps * step:
                    valid_radius = lead_3
                    tied_count = 3
                    swap(cache, env, slot, 2, slot_2)
        cache.tied_count[env, contact] = tied_count
        cache.valid_radius[env, contact] = valid_radius
        cache.valid_center[env, contact] = p
        cache.nearest[env, contact] = best.row

    def candidate_search(vectorized: bool) -> wp.Function:
        """Returns the device function that searches a list, testing the bounds of several faces at a time or not.

        On a CPU, vectorized tests of all faces cost less than maintaining the valid radius, as GPU threads do.
        """

        @wp.func
        def nearest_candidate(
            model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, step: real
        ):
            """Returns the closest point on the cached faces, if the list suffices.

            Replaces the bounds of evaluated faces by tighter ones. ``step``: Displacement of the point in the last
            step, approximate [mesh unit].
            """
            result = CachedClosestPoint()
            result.valid = False
            count = cache.face_count[env, contact]
            if count == 0:
                return result
            first = cache.nearest[env, contact]
            best = closest_on_face(model, first, p)
            result.closest = best
            displacement = p - cache.list_center[env, contact]
            distance_moved = wp.length(displacement)
            if not (distance_moved < cache.uncached_bound[env, contact]):
                return result
            slot = assume_nonnegative(contact * face_capacity(cache))
            slack = bound_rounding(model, query_mesh, best, distance_moved)
            settled = wp.bool(True)
            if wp.static(vectorized):
                any_candidate = wp.bool(False)
                k = wp.int32(0)
                while k < count:
                    start = assume_nonnegative(slot + k)
                    candidates = candidates_within(
                        cache.distance,
                        cache.gradient,
                        cache.face,
                        env,
                        start,
                        count - k,
                        displacement,
                        slack,
                        best.distance,
                        first,
                    )
                    while candidates != 0:
                        any_candidate = True
                        i = assume_nonnegative(start + lowest_set_bit(candidates))
                        best = closer_candidate(model, cache, env, i, first, p, displacement, slack, best)
                        candidates = candidates & (candidates - 1)
                    k += wp.static(WIDTH)
                if any_candidate:
                    settled = not lost_tie(best)
                    best.distance = wp.length(best.to_point)
            else:
                k = wp.int32(0)
                while k < count:
                    best = closer_candidate(
                        model, cache, env, assume_nonnegative(slot + k), first, p, displacement, slack, best
                    )
                    k += 1
                settled = not lost_tie(best)
                best.distance = wp.length(best.to_point)
            result.closest = best
            result.valid = settled and list_suffices(model, query_mesh, cache, env, contact, displacement, best)
            if wp.static(vectorized):
                # Lists of ``bvh_search.py`` omit dominated faces and are valid within the skin only.
                result.valid = result.valid and distance_moved + slack < model.query_mesh_skin[query_mesh]
            if wp.static(not vectorized):
                if result.valid:
                    store_valid_radius(cache, env, contact, p, displacement, slack, best, step)
            return result

        return nearest_candidate

    nearest_candidate, nearest_candidate_simd = (
        candidate_search(vectorized=False),
        candidate_search(vectorized=True),
    )

    @wp.func
    def cached_closest(model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Returns the closest point from the stored nearest face or, if that fails, from the cached faces."""
        result = cached_nearest(model, query_mesh, cache, env, contact, p, step)
        if not result.valid:
            result = nearest_candidate(model, query_mesh, cache, env, contact, p, step)
        return result

    return Functions(
        distance_gradient=distance_gradient,
        store_face_list=store_face_list,
        distance_lower_bound=distance_lower_bound,
        cache_face=cache_face,
        face_capacity=face_capacity,
        cached_closest=cached_closest,
        nearest_candidate_simd=nearest_candidate_simd,
        nearest_candidate=nearest_candidate,
        no_cached_point=no_cached_point,
        cached_nearest=cached_nearest,
    )
