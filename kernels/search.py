"""Search for the face nearest to a point, and its outcome kept from step to step: most contacts need no search.

As in the neighbour lists of molecular dynamics: faces within a skin are remembered, each with its distance. A
point that moved by m since then is at least that distance less m away from each, and from all others at least the
skin less m; so the nearest is among the first few, or the list has to be made anew.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels.types import REMEMBERED, structs

# Rounding of a distance, in units of epsilon times the size of the differences; wider than a tie of two feet.
ROUNDING = 32.0


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    near = feet.functions(real)
    Foot, foot_on, nearer = near.Foot, near.foot_on, near.nearer
    rounding = wp.constant(real(t.epsilon * ROUNDING))
    room = wp.constant(REMEMBERED)

    @wp.struct
    class Recalled:
        """The nearest foot, as far as it is known."""

        foot: Foot
        known: wp.bool

    @wp.func
    def recall(model: Model, cache: Cache, env: int, contact: int, p: vec3):
        """Looks for the nearest point among the remembered faces."""
        answer = Recalled()
        answer.known = False
        count = cache.faces[env, contact]
        if count == 0:
            return answer
        if wp.length(p - cache.sure_place[env, contact]) < cache.sure[env, contact]:
            answer.foot = foot_on(model, cache.nearest[env, contact], p)
            answer.known = True
            return answer
        slot = contact * room
        moved = wp.length(p - cache.place[env, contact])
        best = foot_on(model, cache.face[env, slot], p)
        slack = moved + rounding * (best.span + best.distance + moved)
        # No other face is nearer than this.
        second = cache.beyond[env, contact] - slack
        for i in range(1, count):
            least = cache.distance[env, slot + i] - slack
            if least > best.distance:
                second = wp.min(second, least)
            else:
                other = foot_on(model, cache.face[env, slot + i], p)
                second = wp.min(second, wp.max(best.distance, other.distance))
                best = nearer(model, best, other)
        answer.known = best.distance < cache.beyond[env, contact] - slack
        best.distance = wp.length(best.to_point)
        answer.foot = best
        if answer.known:
            # Until it moved half the difference no other face can be as near.
            cache.sure[env, contact] = real(0.5) * (second - best.distance) - (slack - moved)
            cache.sure_place[env, contact] = p
            cache.nearest[env, contact] = best.row
        return answer

    @wp.func
    def box_about(model: Model, patch: int, p: vec3, reach: real):
        """Faces whose boxes come within ``reach``, none too few: nothing but their boxes is trusted to float32."""
        centre = wp.vec3f(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
        around = wp.vec3f(wp.float32(reach), wp.float32(reach), wp.float32(reach))
        return wp.mesh_query_aabb(model.patch_mesh[patch], centre - around, centre + around)

    @wp.func
    def nearest_of_all(model: Model, patch: int, p: vec3, first: Foot, margin: real):
        """Looks again at all faces about as near as ``first``, in the precision of the simulation.

        Makes the choice on edges and medial axes independent of the traversal, and exact in float64.
        """
        start = model.patch_face_start[patch]
        best = first
        boxes = box_about(model, patch, p, first.distance + margin)
        face = wp.int32(0)
        while wp.mesh_query_aabb_next(boxes, face):
            best = nearer(model, best, foot_on(model, start + face, p))
        best.distance = wp.length(best.to_point)
        return best

    @wp.func
    def nearest_to_remember(
        model: Model, patch: int, p: vec3, first: Foot, margin: real, cache: Cache, env: int, contact: int
    ):
        """The same, looking farther and remembering the faces."""
        start = model.patch_face_start[patch]
        best = first
        # All others are farther than this.
        beyond = first.distance + model.patch_skin[patch]
        boxes = box_about(model, patch, p, beyond + margin)
        face = wp.int32(0)
        slot = contact * room
        count = wp.int32(0)
        while wp.mesh_query_aabb_next(boxes, face):
            other = foot_on(model, start + face, p)
            best = nearer(model, best, other)
            if other.distance < beyond:
                place = count
                if count < room:
                    count += 1
                else:
                    # The farthest makes room, or has none, and ends the reach of the list.
                    place = wp.int32(0)
                    for i in range(1, REMEMBERED):
                        if cache.distance[env, slot + i] > cache.distance[env, slot + place]:
                            place = i
                    farthest = cache.distance[env, slot + place]
                    beyond = wp.max(farthest, other.distance)
                    if other.distance >= farthest:
                        continue
                cache.distance[env, slot + place] = other.distance
                cache.face[env, slot + place] = start + face
        best.distance = wp.length(best.to_point)
        # The nearest first: often no other is looked at.
        for i in range(1, count):
            if cache.face[env, slot + i] == best.row:
                cache.face[env, slot + i] = cache.face[env, slot]
                cache.face[env, slot] = best.row
                distance = cache.distance[env, slot + i]
                cache.distance[env, slot + i] = cache.distance[env, slot]
                cache.distance[env, slot] = distance
        cache.faces[env, contact] = count
        cache.sure[env, contact] = real(0.0)
        cache.place[env, contact] = p
        cache.beyond[env, contact] = beyond
        return best

    return SimpleNamespace(recall=recall, nearest_of_all=nearest_of_all, nearest_to_remember=nearest_to_remember)
