"""Search for the face nearest to a point by a query of Warp, and lists of those near it for ``recall.py``.

A CPU that remembers searches by a tree of its own: ``tree.py``.
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels import recall
from warpcontact.kernels.types import structs

# Rounding of the query, in units of epsilon of float32, in which its mesh is stored, times coordinates.
QUERY_ROUNDING = 16.0


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model = t.vec3, t.Model
    near = feet.functions(real)
    Foot, foot_on, nearer, fallen, taken = near.Foot, near.foot_on, near.nearer, near.fallen, near.taken

    query_rounding = wp.constant(real(float(np.finfo(np.float32).eps) * QUERY_ROUNDING))

    @wp.func
    def extent_of(p: vec3):
        """The largest of its coordinates, with which they round."""
        return wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.abs(p[2]))

    @wp.func
    def unsure_of(model: Model, patch: int, extent: real, distance: real):
        """How much nearer the nearest face may be than one at ``distance`` that the query found."""
        return model.patch_slack[patch] + query_rounding * (extent + distance)

    @wp.func
    def faces_about(model: Model, patch: int, p: vec3, reach: real):
        """Faces within ``reach``, which has to be wide enough for rounding, and some others.

        In float32 a point of a thin face is taken for its nearest that is not, but it is one of the face.
        """
        centre = wp.vec3f(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
        return wp.mesh_query_sphere(model.patch_mesh[patch], centre, wp.float32(reach + model.patch_thin[patch]))

    @wp.func
    def nearest_of_all(model: Model, patch: int, p: vec3, first: Foot, margin: real):
        """Looks again at all faces about as near as ``first``, in the precision of the simulation.

        Makes the choice on edges and medial axes independent of the traversal, and exact in float64. ``margin`` is
        so wide that ``first`` is among them.
        """
        start = model.patch_face_start[patch]
        best = first
        again = wp.bool(False)
        looking = wp.bool(True)
        while looking:
            found = faces_about(model, patch, p, first.distance + margin)
            face = wp.int32(0)
            while wp.mesh_query_next(found, face):
                other = foot_on(model, start + face, p)
                if again:  # noqa: SIM108  Warp would evaluate both sides
                    best = taken(model, best, other)
                else:
                    best = nearer(model, best, other)
            looking = not again and fallen(best)
            if looking:
                # Once more, now that it is known how near the nearest is.
                again = True
                best.row = -1
        best.distance = wp.length(best.to_point)
        return best

    return SimpleNamespace(
        extent_of=extent_of,
        unsure_of=unsure_of,
        faces_about=faces_about,
        nearest_of_all=nearest_of_all,
    )


@functools.cache
def nearest_to_remember(real: type, remembered: int) -> wp.Function:
    """Returns the device function that lists faces, for threads side by side, which wait for each other.

    Args:
        real: Type of a real number.
        remembered: Faces that are remembered per contact, not more than the cache has room for.
    """
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    near, of_list, of_search = feet.functions(real), recall.functions(real), functions(real)
    Foot, foot_on, nearer = near.Foot, near.foot_on, near.nearer
    remember, room_of = of_list.remember, of_list.room_of
    faces_about, list_faces = of_search.faces_about, of_list.list_faces
    Distances = wp.types.vector(length=remembered, dtype=real)
    Rows = wp.types.vector(length=remembered, dtype=wp.int32)

    @wp.func
    def nearest_to_remember(
        model: Model, patch: int, p: vec3, first: Foot, margin: real, cache: Cache, env: int, contact: int
    ):
        """As ``nearest_of_all``, looking farther and remembering the faces, in registers while they are found.

        Of the foot ``distance`` is that of the nearest: if it is ``fallen``, another may have to be taken.
        """
        start = model.patch_face_start[patch]
        best = first
        beyond = first.distance + model.patch_skin[patch]
        found = faces_about(model, patch, p, beyond + margin)
        face = wp.int32(0)
        # The nearest first: loops over a constant are unrolled.
        distances = Distances(real(wp.inf))
        rows = Rows(-1)
        while wp.mesh_query_next(found, face):
            other = foot_on(model, start + face, p)
            best = nearer(model, best, other)
            if other.distance < beyond:
                distance = other.distance
                row = start + face
                for i in range(wp.static(remembered)):
                    if distance < distances[i]:
                        farther = distances[i]
                        farther_row = rows[i]
                        distances[i] = distance
                        rows[i] = row
                        distance = farther
                        row = farther_row
                # The farthest makes room, and ends the reach of the list.
                beyond = wp.min(beyond, distance)
        slot = contact * room_of(cache)
        count = wp.int32(0)
        for i in range(wp.static(remembered)):
            if rows[i] >= 0:
                cache.face[env, slot + i] = rows[i]
                remember(cache, env, slot + i, foot_on(model, rows[i], p), vec3())
                count += 1
        list_faces(cache, env, contact, count, p, beyond)
        return best

    return nearest_to_remember
