"""Search for the nearest face in the cell that a point is in, by the threads of a warp of a GPU together.

In the list of the cell is every face that may be nearest to one of its points; each thread looks at one. Threads
that search a tree instead, each for itself, wait for one node after the other.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import cells, search, warps
from warpcontact.kernels import foot as feet
from warpcontact.kernels.search import ROUNDING
from warpcontact.kernels.types import structs

assert cells.IN_CELL == warps.LANES


@functools.cache
def functions(real: type, remembered: int) -> SimpleNamespace:
    """Returns the device functions for ``real`` and a number of faces that are remembered per contact."""
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    near, of_search, of_warp = feet.functions(real), search.functions(real, remembered), warps.functions(real)
    foot_on, nearer, inner = near.foot_on, near.nearer, near.inner
    Recalled, remember, list_faces = of_search.Recalled, of_search.remember, of_search.list_faces
    real_of, least = of_warp.real_of, of_warp.least
    rounding = wp.constant(real(t.epsilon * ROUNDING))
    room = wp.constant(remembered)

    @wp.func
    def nearest_in_cell(
        model: Model,
        patch: int,
        about: int,
        p: vec3,
        margin: real,
        within: real,
        cache: Cache,
        env: int,
        contact: int,
    ):
        """The nearest of the faces of a cell, a face for each thread of a warp.

        Faces are remembered on the inner side and nearer than ``within``. Nothing is known if a face that is not
        in the list may be as near.
        """
        lane = warps.lane()
        row = model.list_face[about, lane]
        own = foot_on(model, wp.max(row, 0), p)
        distance = own.distance
        span = own.span
        if row < 0:
            distance = real(wp.inf)
            span = real(0.0)
        nearest = least(distance)
        # All that may be as near as the nearest, one after the other.
        others = warps.lanes_with(distance <= nearest - rounding * least(-span))
        best = foot_on(model, warps.int_of(row, warps.first_of(others)), p)
        others = warps.without_first(others)
        while others != 0:
            best = nearer(model, best, foot_on(model, warps.int_of(row, warps.first_of(others)), p))
            others = warps.without_first(others)
        best.distance = wp.length(best.to_point)
        answer = Recalled()
        answer.foot = best
        beyond = model.list_reach[about]
        answer.known = nearest + margin < beyond
        if answer.known and nearest >= within and not inner(model, best):
            cache.faces[env, contact] = 0
        elif answer.known:
            before = wp.int32(0)
            for k in range(wp.static(warps.LANES)):
                other = real_of(distance, k)
                if other < distance or (other == distance and k < lane):
                    before += 1
            beyond = wp.min(beyond, nearest + model.patch_skin[patch])
            kept = before < room and distance < beyond
            # The nearest that has no room ends the reach of the list.
            left = real(wp.inf)
            if before >= room:
                left = distance
            if kept:
                slot = contact * room + before
                cache.face[env, slot] = row
                remember(cache, env, slot, own, vec3())
            count = warps.count_of(warps.lanes_with(kept))
            list_faces(cache, env, contact, count, p, wp.min(beyond, least(left)))
        return answer

    return SimpleNamespace(nearest_in_cell=nearest_in_cell)
