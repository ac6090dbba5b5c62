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
from warpcontact.kernels import foot as feet
from warpcontact.kernels import simd
from warpcontact.kernels.simd import WIDTH
from warpcontact.kernels.types import natural, structs
from warpcontact.kernels.warps import first_of

# Rounding of a distance, in units of epsilon times the size of the differences; wider than a tie of two feet.
ROUNDING = 32.0
# Distance, in units of the size of the differences, from which on rounding turns a direction by little.
STEADY = 0.002
# Steps for which one face has to do, or two or three, or one more is looked at as well.
SOON = 20.0


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    near, as_near = feet.functions(real), simd.as_near(real)
    Foot, foot_on, nearer, fallen = near.Foot, near.foot_on, near.nearer, near.fallen
    rounding = wp.constant(real(t.epsilon * ROUNDING))
    steady = wp.constant(real(STEADY))
    soon = wp.constant(real(SOON))

    @wp.struct
    class Recalled:
        """The nearest foot, as far as it is known."""

        foot: Foot
        known: wp.bool

    @wp.func
    def slope_of(foot: Foot):
        """Slope of the distance of a face; 0 where rounding would turn it."""
        if foot.distance > steady * foot.span:
            return (real(1.0) / foot.distance) * foot.to_point
        return vec3()

    @wp.func
    def least_of(foot: Foot, direction: vec3, gone: vec3):
        """Distance of a face, at least, at a place that the point is ``gone`` away from."""
        if foot.distance > steady * foot.span:
            return foot.distance - wp.dot(direction, gone)
        return real(0.0)

    @wp.func
    def remember(cache: Cache, env: int, slot: int, foot: Foot, gone: vec3):
        """Keeps the distance of a face and its slope, as seen from the place of the list, ``gone`` away."""
        direction = slope_of(foot)
        cache.distance[env, slot] = least_of(foot, direction, gone)
        cache.direction[env, slot] = direction

    @wp.func
    def room_of(cache: Cache):
        """How many faces are remembered per contact."""
        return cache.face.shape[1] // cache.faces.shape[1]

    @wp.func
    def list_faces(cache: Cache, env: int, contact: int, count: int, p: vec3, beyond: real):
        """Says what was found from ``p``: ``count`` faces, all others farther than ``beyond``."""
        cache.faces[env, contact] = count
        cache.sure[env, contact] = real(0.0)
        cache.place[env, contact] = p
        cache.beyond[env, contact] = beyond

    @wp.func
    def lead(best: Foot, direction: vec3, distance: real, most: real, per_most: real):
        """How far the point can move, in any direction, with ``best`` nearer than a face ``distance`` away.

        Or ``most``, of which ``per_most`` is the inverse, if it is not less than that.

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
        if ahead <= real(0.0) or d <= rounded or simple >= most:
            return wp.min(simple, most)
        per_d = real(1.0) / d
        turn = direction - per_d * best.to_point
        rounded = per_d * rounded
        # Most need no root: whether it would be less at |v| = most.
        least = ahead * per_most - most * per_d - rounded
        if least > real(0.0) and wp.length_sq(turn) < least * least and most < real(0.5) * d:
            return most
        slope = wp.length(turn) + rounded
        far = real(2.0) * ahead / (slope + wp.sqrt(slope * slope + real(4.0) * ahead * per_d))
        return wp.min(wp.max(simple, wp.min(far, real(0.5) * d)), most)

    @wp.func
    def recall_nothing(model: Model, patch: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Takes no remembered face for the nearest."""
        return Recalled()

    @wp.func
    def slack_of(model: Model, patch: int, best: Foot, moved: real):
        """Rounding of what is remembered of a distance, at a place ``moved`` away from that of the list."""
        # Slopes were taken no farther away from it than a list reaches.
        return rounding * (best.span + best.distance + real(16.0) * (moved + model.patch_skin[patch]))

    @wp.func
    def least_listed(cache: Cache, env: int, i: int, gone: vec3, slack: real):
        """Distance of a remembered face, at least, at a place ``gone`` away from that of the list."""
        return cache.distance[env, i] + wp.dot(cache.direction[env, i], gone) - slack

    @wp.func
    def nearer_listed(
        model: Model, cache: Cache, env: int, i: int, first: int, p: vec3, gone: vec3, slack: real, best: Foot
    ):
        """Returns the nearer of ``best`` and a remembered face, which is not looked at if it is ``first``."""
        face = cache.face[env, i]
        if least_listed(cache, env, i, gone, slack) > best.distance or face == first:
            return best
        other = foot_on(model, face, p)
        remember(cache, env, i, other, gone)
        return nearer(model, best, other)

    @wp.func
    def reached(model: Model, patch: int, cache: Cache, env: int, contact: int, gone: vec3, best: Foot):
        """Whether no face that is not in the list is as near as ``best``."""
        moved = wp.length(gone)
        return best.distance < cache.beyond[env, contact] - moved - slack_of(model, patch, best, moved)

    @wp.func
    def recall_sure(model: Model, patch: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Takes the face that is known to be the nearest here, or one of few."""
        answer = Recalled()
        answer.known = False
        if cache.faces[env, contact] != 0:
            answer.known = wp.length(p - cache.sure_place[env, contact]) < cache.sure[env, contact]
        if answer.known:
            first = cache.nearest[env, contact]
            best = foot_on(model, first, p)
            gone = p - cache.place[env, contact]
            moved = wp.length(gone)
            if not (moved < cache.beyond[env, contact]):
                answer.known = False
                return answer
            rivals = cache.rivals[env, contact]
            if rivals > 0:
                slot = natural(contact * room_of(cache))
                slack = slack_of(model, patch, best, moved)
                k = wp.int32(0)
                while k < rivals:
                    best = nearer_listed(model, cache, env, natural(slot + k), first, p, gone, slack, best)
                    k += 1
                if fallen(best):
                    answer.known = False
                    return answer
                best.distance = wp.length(best.to_point)
            answer.foot = best
            answer.known = reached(model, patch, cache, env, contact, gone, best)
        return answer

    @wp.func
    def swap(cache: Cache, env: int, slot: int, k: int, other: int):
        """Lets two faces of a list change places."""
        if k != other:
            i = natural(slot + k)
            j = natural(slot + other)
            face = wp.int32(cache.face[env, i])
            cache.face[env, i] = cache.face[env, j]
            cache.face[env, j] = face
            distance = real(cache.distance[env, i])
            cache.distance[env, i] = cache.distance[env, j]
            cache.distance[env, j] = distance
            direction = vec3(cache.direction[env, i])
            cache.direction[env, i] = cache.direction[env, j]
            cache.direction[env, j] = direction

    @wp.func
    def be_sure(cache: Cache, env: int, contact: int, p: vec3, gone: vec3, slack: real, best: Foot, step: real):
        """Remembers how far from here the nearest of a list is that, or one of few; those others it puts first."""
        slot = natural(contact * room_of(cache))
        # How far the point can move with the nearest ahead of all others, of all but one, two and three of them.
        sure_0 = real(wp.inf)
        sure_1 = real(wp.inf)
        sure_2 = real(wp.inf)
        sure_3 = real(wp.inf)
        per_last = real(0.0)
        # Where these are in the list.
        at_0 = wp.int32(0)
        at_1 = wp.int32(0)
        at_2 = wp.int32(0)
        count = cache.faces[env, contact]
        k = wp.int32(0)
        while k < count:
            i = natural(slot + k)
            if cache.face[env, i] != best.row:
                least = least_listed(cache, env, i, gone, slack)
                leads = lead(best, cache.direction[env, i], least, sure_3, per_last)
                if leads < sure_3:
                    sure_3 = wp.max(leads, sure_2)
                    per_last = real(1.0) / sure_3
                    if leads < sure_2:
                        sure_2 = wp.max(leads, sure_1)
                        at_2 = wp.where(leads < sure_1, at_1, k)
                        if leads < sure_1:
                            sure_1 = wp.max(leads, sure_0)
                            at_1 = wp.where(leads < sure_0, at_0, k)
                            if leads < sure_0:
                                sure_0 = leads
                                at_0 = wp.int32(k)
            k += 1
        # Those that may come as near first are looked at as well, where they would soon be asked for again.
        sure = sure_0
        rivals = wp.int32(0)
        if sure_0 < soon * step:
            sure = sure_1
            rivals = 1
            swap(cache, env, slot, 0, at_0)
            at_1 = wp.where(at_1 == 0, at_0, at_1)
            at_2 = wp.where(at_2 == 0, at_0, at_2)
            if sure_1 < soon * step:
                sure = sure_2
                rivals = 2
                swap(cache, env, slot, 1, at_1)
                at_2 = wp.where(at_2 == 1, at_1, at_2)
                if sure_2 < soon * step:
                    sure = sure_3
                    rivals = 3
                    swap(cache, env, slot, 2, at_2)
        cache.rivals[env, contact] = rivals
        cache.sure[env, contact] = sure
        cache.sure_place[env, contact] = p
        cache.nearest[env, contact] = best.row

    def looking_through(at_once: bool) -> wp.Function:
        """Returns the device function that looks through a list, by bounds of several faces ``at_once`` or not.

        On a CPU the first costs less than to know of which one need not ask, as threads of a GPU do.
        """

        @wp.func
        def recall_listed(model: Model, patch: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
            """Looks for the nearest point among the remembered faces.

            A look leaves closer bounds, one for sensors as well; in cells, where none are kept, it finds nothing.
            ``step``: how far the point came in the last step, about.
            """
            answer = Recalled()
            answer.known = False
            count = cache.faces[env, contact]
            if count == 0:
                return answer
            first = cache.nearest[env, contact]
            best = foot_on(model, first, p)
            answer.foot = best
            gone = p - cache.place[env, contact]
            moved = wp.length(gone)
            if not (moved < cache.beyond[env, contact]):
                return answer
            slot = natural(contact * room_of(cache))
            slack = slack_of(model, patch, best, moved)
            settled = wp.bool(True)
            if wp.static(at_once):
                asked = wp.bool(False)
                k = wp.int32(0)
                while k < count:
                    start = natural(slot + k)
                    those = as_near(
                        cache.distance, cache.direction, cache.face, env, start, count - k, gone, slack,
                        best.distance, first,
                    )  # fmt: skip
                    while those != 0:
                        asked = True
                        i = natural(start + first_of(those))
                        best = nearer_listed(model, cache, env, i, first, p, gone, slack, best)
                        those = those & (those - 1)
                    k += wp.static(WIDTH)
                if asked:
                    settled = not fallen(best)
                    best.distance = wp.length(best.to_point)
            else:
                k = wp.int32(0)
                while k < count:
                    best = nearer_listed(model, cache, env, natural(slot + k), first, p, gone, slack, best)
                    k += 1
                settled = not fallen(best)
                best.distance = wp.length(best.to_point)
            answer.foot = best
            answer.known = settled and reached(model, patch, cache, env, contact, gone, best)
            if wp.static(at_once):
                # ``tree.py`` left out what is no nearer within the skin.
                answer.known = answer.known and moved + slack < model.patch_skin[patch]
            if wp.static(not at_once):  # noqa: SIM102  Warp would evaluate both sides
                if answer.known:
                    be_sure(cache, env, contact, p, gone, slack, best, step)
            return answer

        return recall_listed

    recall_listed, recall_at_once = looking_through(at_once=False), looking_through(at_once=True)

    @wp.func
    def recall(model: Model, patch: int, cache: Cache, env: int, contact: int, p: vec3, step: real):
        """Takes the nearest face if it is among the remembered ones."""
        answer = recall_sure(model, patch, cache, env, contact, p, step)
        if not answer.known:
            answer = recall_listed(model, patch, cache, env, contact, p, step)
        return answer

    return SimpleNamespace(
        slope_of=slope_of,
        list_faces=list_faces,
        least_of=least_of,
        remember=remember,
        room_of=room_of,
        recall=recall,
        recall_at_once=recall_at_once,
        recall_listed=recall_listed,
        recall_nothing=recall_nothing,
        recall_sure=recall_sure,
    )
