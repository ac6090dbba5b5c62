"""The nearest face, and lists of those that may be it near a point, by a tree over the faces of a patch; on a CPU.

What bounds a node is convex, as a triangle is: its distance is nowhere less than its slope says. So a node is left
out of a list, with all of its faces, where it is farther than the list reaches, and where no way within the skin
makes it as near as a face that is known. On a fine mesh beneath a sphere the latter does: there all that is about
as near lies in the same direction, and draws away or nears alike. ``warpcontact/tree.py`` makes the tree.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import branches, recall, search
from warpcontact.kernels import foot as feet
from warpcontact.kernels.types import natural, structs

# Of the skin: how far a list is made ahead of a point, which serves for longer then. Less than one, for ties.
AHEAD = 0.8


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    near, of_list, of_tree = feet.functions(real), recall.functions(real), branches.functions(real)
    of_search = search.functions(real)
    Foot, foot_on, nearer, fallen = near.Foot, near.foot_on, near.nearer, near.fallen
    extent_of, unsure_of = of_search.extent_of, of_search.unsure_of
    nearest_of_all = of_search.nearest_of_all
    slope_of, least_of = of_list.slope_of, of_list.least_of
    room_of, list_faces = of_list.room_of, of_list.list_faces
    Leader, way_from_root, next_place = of_tree.Leader, of_tree.way_from_root, of_tree.next_place
    ahead_of = wp.constant(real(AHEAD))
    rounding = wp.constant(real(t.epsilon * recall.ROUNDING))

    @wp.func
    def rounding_of(extent: real, foot: Foot):
        """How much nearer than ``foot`` the nearest face may be of a point with coordinates up to ``extent``."""
        return rounding * (extent + foot.span)

    @wp.func
    def nearest(model: Model, patch: int, p: vec3, hint: int):
        """Returns the nearest foot; ``hint`` is a face that may be near, or none."""
        tree = model.patch_tree[patch]
        start = model.patch_face_start[patch]
        row = hint
        if row < start or row >= model.patch_face_start[patch + 1]:
            row = start
        best = foot_on(model, row, p)
        way = way_from_root()
        place = next_place(way, model.tree_bound, tree, p, best.distance, Leader())
        while place >= 0:
            best = nearer(model, best, foot_on(model, start + model.tree_face[place], p))
            place = next_place(way, model.tree_bound, tree, p, best.distance, Leader())
        if fallen(best):
            best = nearest_of_all(model, patch, p, best, unsure_of(model, patch, extent_of(p), best.distance))
        best.distance = wp.length(best.to_point)
        return best

    @wp.func
    def leader_of(best: Foot, far: real):
        """Returns a foot as what leads."""
        leader = Leader()
        leader.far = far
        leader.distance = best.distance
        per_distance = real(1.0) / best.distance
        leader.direction = per_distance * best.to_point
        leader.rounding = rounding * best.span * per_distance
        return leader

    @wp.func
    def way_ahead(model: Model, patch: int, cache: Cache, env: int, contact: int, p: vec3, distance: real):
        """From a point to where its list is to be made, in the direction in which it left that of the last.

        As far as a part of what the last list reached beyond the nearest face: what there was room for.
        """
        moved = p - cache.place[env, contact]
        length = wp.length(moved)
        reached = wp.min(cache.beyond[env, contact] - distance, model.patch_skin[patch])
        # Not where it never was, nor after a jump, nor where a state was not finite.
        if length > real(0.0) and length <= real(2.0) * reached:
            return (ahead_of * reached / length) * moved
        return vec3()

    @wp.func
    def remember_about(model: Model, patch: int, p: vec3, foot: Foot, cache: Cache, env: int, contact: int):
        """Lists the faces that may be nearest near a place ahead of ``p``, with its nearest ``foot``.

        All others are farther from that place than is kept as ``beyond``, or no nearer than some other within the
        skin of it.
        """
        at = p + way_ahead(model, patch, cache, env, contact, p, foot.distance)
        skin = model.patch_skin[patch]
        beyond = foot.distance + skin
        tree = model.patch_tree[patch]
        start = model.patch_face_start[patch]
        best = foot_on(model, foot.row, at)
        room = room_of(cache)
        slot = natural(contact * room)
        count = wp.int32(0)
        way = way_from_root()
        looking = wp.bool(True)
        while looking:
            found = next_place(way, model.tree_bound, tree, at, beyond, leader_of(best, skin))
            looking = found >= 0
            if looking:
                row = start + model.tree_face[found]
                other = foot_on(model, row, at)
                direction = slope_of(other)
                least = least_of(other, direction, vec3())
                if least < beyond:
                    if other.distance < best.distance:
                        best = other
                    place = slot + count
                    if count == room:
                        # The farthest makes room, and ends the reach of the list.
                        beyond = least
                        for k in range(room):
                            i = natural(slot + k)
                            if cache.distance[env, i] > beyond:
                                beyond = cache.distance[env, i]
                                place = i
                    else:
                        count += 1
                    if place < slot + room:
                        place = natural(place)
                        cache.face[env, place] = row
                        cache.distance[env, place] = least
                        cache.direction[env, place] = direction
        list_faces(cache, env, contact, count, at, beyond)

    return SimpleNamespace(nearest=nearest, rounding_of=rounding_of, remember_about=remember_about)
