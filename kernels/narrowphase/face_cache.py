"""The outcome of a search, kept from step to step: most contacts need no search.

As in the neighbour lists of molecular dynamics: faces within a skin of a place are remembered, each with its
distance and the slope of that. A triangle is convex, so its distance is nowhere less than the slope says; and a
point at m from that place is at least the skin less m away from all others. So the nearest is in the list, or a
new one is due, which ``search.py`` makes, or on a CPU ``tree.py``. That one leaves out as well what some face of
the list is nearer than within the skin, so a point that went farther has to have a new one.

A CPU holds these bounds of all faces of a list against the distance of the nearest so far, at each look. On a GPU
threads keep how far a point can move until that may change, and which faces are rivals then.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.lowlevel import simd
from warpcontact.kernels.lowlevel.simd import WIDTH
from warpcontact.kernels.lowlevel.warps import lowest_set_bit
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.types import assume_nonnegative, structs

# Rounding of a distance, in units of epsilon times the size of the differences; wider than a tie of two feet.
ROUNDING = 32.0
# Distance, in units of the size of the differences, from which on rounding turns a direction by little.
MIN_RELATIVE_DISTANCE = 0.002
# Steps for which one face has to do, or two or three, or one more is looked at as well.
LOOKAHEAD_STEPS = 20.0


@functools.cache
def functions(real: type) -> SimpleNamespace:
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
        """The nearest foot, as far as it is known."""

        closest: ClosestPoint
        valid: wp.bool

    @wp.func
    def distance_gradient(closest: ClosestPoint):
        """Slope of the distance of a face; 0 where rounding would turn it."""
        if closest.distance > min_relative_distance * closest.span:
            return (real(1.0) / closest.distance) * closest.to_point
        return vec3()

    @wp.func
    def distance_lower_bound(closest: ClosestPoint, direction: vec3, displacement: vec3):
        """Distance of a face, at least, at a place that the point is ``displacement`` away from."""
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
        """How many faces are remembered per contact."""
        return cache.face.shape[1] // cache.face_count.shape[1]

    @wp.func
    def store_face_list(cache: Cache, env: int, contact: int, count: int, p: vec3, uncached_bound: real):
        """Says what was found from ``p``: ``count`` faces, all others farther than ``uncached_bound``."""
        cache.face_count[env, contact] = count
        cache.valid_radius[env, contact] = real(0.0)
        cache.list_center[env, contact] = p
        cache.uncached_bound[env, contact] = uncached_bound

    @wp.func
    def lead_distance(best: ClosestPoint, direction: vec3, distance: real, limit: real, inverse_limit: real):
        """How far the point can move, in any direction, with ``best`` nearer than a face ``distance`` away.

        Or ``limit``, of which ``inverse_limit`` is the inverse, if it is not less than that.

        A distance changes by no more than the point moved. And better where both lie in about one direction: the
        distance of that face is at least what its slope says, u' being the ``direction`` from its nearest point,
        and the distance from ``best`` at most that from where its foot is now,

            d'(p + v) ≥ d' + u'·v,   d(p + v) ≤ |d u + v| ≤ d + u·v + |v|²/d for |v| ≤ d/2

        so ``best`` leads as long as |v|²/d + |u' − u| |v| < d' − d.
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
        # Most need no root: whether it would be less at |v| = most.
        least = ahead * inverse_limit - limit * per_d - rounded
        if least > real(0.0) and wp.length_sq(direction_change) < least * least and limit < real(0.5) * d:
            return limit
        slope = wp.length(direction_change) + rounded
        far = real(2.0) * ahead / (slope + wp.sqrt(slope * slope + real(4.0) * ahead * per_d))
        return wp.min(wp.max(simple, wp.min(far, real(0.5) * d)), limit)

    @wp.func
    def no_cached_point(model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Takes no remembered face for the nearest."""
        return CachedClosestPoint()

    @wp.func
    def bound_rounding(model: Model, query_mesh: int, best: ClosestPoint, distance_moved: real):
        """Rounding error of a cached distance bound, at ``distance_moved`` from the center of the list."""
        # Slopes were taken no farther away from it than a list reaches.
        return rounding * (
            best.span + best.distance + real(16.0) * (distance_moved + model.query_mesh_skin[query_mesh])
        )

    @wp.func
    def candidate_lower_bound(cache: Cache, env: int, i: int, displacement: vec3, slack: real):
        """Distance of a remembered face, at least, at a place ``displacement`` away from that of the list."""
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
        """Returns the nearer of ``best`` and a remembered face, which is not looked at if it is ``first``."""
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
        """Whether no face that is not in the list is as near as ``best``."""
        distance_moved = wp.length(displacement)
        return best.distance < cache.uncached_bound[env, contact] - distance_moved - bound_rounding(
            model, query_mesh, best, distance_moved
        )

    @wp.func
    def cached_nearest(model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Takes the face that is known to be the nearest here, or one of few."""
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
        """Lets two faces of a list change places."""
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
        """Remembers how far from here the nearest of a list is that, or one of few; those others it puts first."""
        slot = assume_nonnegative(contact * face_capacity(cache))
        # How far the point can move with the nearest ahead of all others, of all but one, two and three of them.
        lead_0 = real(wp.inf)
        lead_1 = real(wp.inf)
        lead_2 = real(wp.inf)
        lead_3 = real(wp.inf)
        inverse_last = real(0.0)
        # Where these are in the list.
        slot_0 = wp.int32(0)
        slot_1 = wp.int32(0)
        slot_2 = wp.int32(0)
        count = cache.face_count[env, contact]
        k = wp.int32(0)
        while k < count:
            i = assume_nonnegative(slot + k)
            if cache.face[env, i] != best.row:
                least = candidate_lower_bound(cache, env, i, displacement, slack)
                leads = lead_distance(best, cache.gradient[env, i], least, lead_3, inverse_last)
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
        # Those that may come as near first are looked at as well, where they would soon be asked for again.
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
        """Returns the device function that looks through a list, by bounds of several faces ``vectorized`` or not.

        On a CPU the first costs less than to know of which one need not ask, as threads of a GPU do.
        """

        @wp.func
        def nearest_candidate(
            model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, step: real
        ):
            """Looks for the nearest point among the remembered faces.

            A look leaves closer bounds, one for sensors as well; in cells, where none are kept, it finds nothing.
            ``step``: how far the point came in the last step, about.
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
                # ``tree.py`` left out what is no nearer within the skin.
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
        """Takes the nearest face if it is among the remembered ones."""
        result = cached_nearest(model, query_mesh, cache, env, contact, p, step)
        if not result.valid:
            result = nearest_candidate(model, query_mesh, cache, env, contact, p, step)
        return result

    return SimpleNamespace(
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
