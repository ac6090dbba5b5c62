"""Nearest-face search with Warp's mesh query, and face lists for ``face_cache.py`` on a GPU.

With a cache, a CPU searches with its own BVH: ``bvh_search.py``.
"""

import functools
from typing import NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels.narrowphase import face_cache
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.types import structs

# Rounding error of the query, in units of float32 epsilon (the precision of its mesh) times coordinates.
QUERY_ROUNDING = 16.0


class Functions(NamedTuple):
    """Device functions of mesh queries."""

    max_coordinate: wp.Function  # largest absolute coordinate, which determines rounding
    query_error: wp.Function  # how much nearer the nearest face may be than the one that a query found
    faces_within: wp.Function  # faces within a reach, and possibly others
    refine_closest: wp.Function  # closest point among all faces about as near as a given one


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model = t.vec3, t.Model
    face_functions = closest_points.functions(real)
    ClosestPoint, closest_on_face, closer, lost_tie, break_tie = (
        face_functions.ClosestPoint,
        face_functions.closest_on_face,
        face_functions.closer,
        face_functions.lost_tie,
        face_functions.break_tie,
    )

    query_rounding = wp.constant(real(float(np.finfo(np.float32).eps) * QUERY_ROUNDING))

    @wp.func
    def max_coordinate(p: vec3):
        """Returns the largest absolute coordinate, which determines rounding."""
        return wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.abs(p[2]))

    @wp.func
    def query_error(model: Model, query_mesh: int, extent: real, distance: real):
        """Returns how much nearer the nearest face may be than the one that the query found at ``distance``."""
        return model.query_mesh_error[query_mesh] + query_rounding * (extent + distance)

    @wp.func
    def faces_within(model: Model, query_mesh: int, p: vec3, reach: real):
        """Returns the faces within ``reach`` and possibly others. ``reach`` must include rounding.

        On a thin face, the float32 query may return a wrong closest point, but still a point of that face.
        """
        centre = wp.vec3f(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
        return wp.mesh_query_sphere(
            model.query_mesh_id[query_mesh], centre, wp.float32(reach + model.query_mesh_thin_length[query_mesh])
        )

    @wp.func
    def refine_closest(model: Model, query_mesh: int, p: vec3, first: ClosestPoint, margin: real):
        """Searches again among all faces about as near as ``first``, in the precision of the simulation.

        Makes the result on edges and medial axes independent of the traversal order, and exact in float64.
        ``margin`` must be large enough to include ``first``.
        """
        start = model.query_mesh_face_start[query_mesh]
        best = first
        breaking_ties = wp.bool(False)
        searching = wp.bool(True)
        while searching:
            found = faces_within(model, query_mesh, p, first.distance + margin)
            face = wp.int32(0)
            while wp.mesh_query_next(found, face):
                other = closest_on_face(model, start + face, p)
                if breaking_ties:
                    best = break_tie(model, best, other)
                else:
                    best = closer(model, best, other)
            searching = not breaking_ties and lost_tie(best)
            if searching:
                # Second pass: break ties among the candidates within rounding of the smallest distance.
                breaking_ties = True
                best.row = -1
        best.distance = wp.length(best.to_point)
        return best

    return Functions(
        max_coordinate=max_coordinate,
        query_error=query_error,
        faces_within=faces_within,
        refine_closest=refine_closest,
    )


@functools.cache
def closest_and_cache(real: type, capacity: int) -> wp.Function:
    """Returns the device function that finds the closest point and caches the faces near it, for a GPU.

    Args:
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        capacity: Number of faces to cache per contact, at most the capacity of the cache.
    """
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    face_functions, cache_functions, search_functions = (
        closest_points.functions(real),
        face_cache.functions(real),
        functions(real),
    )
    ClosestPoint, closest_on_face, closer = (
        face_functions.ClosestPoint,
        face_functions.closest_on_face,
        face_functions.closer,
    )
    cache_face, face_capacity = cache_functions.cache_face, cache_functions.face_capacity
    faces_within, store_face_list = search_functions.faces_within, cache_functions.store_face_list
    Distances = wp.types.vector(length=capacity, dtype=real)
    Rows = wp.types.vector(length=capacity, dtype=wp.int32)

    @wp.func
    def closest_and_cache(
        model: Model,
        query_mesh: int,
        p: vec3,
        first: ClosestPoint,
        margin: real,
        cache: Cache,
        env: int,
        contact: int,
    ):
        """Returns the result of ``refine_closest`` with a larger reach, and caches the faces found.

        ``distance`` of the result is the smallest found. If ``lost_tie`` holds, the caller must refine the result.
        """
        start = model.query_mesh_face_start[query_mesh]
        best = first
        reach = first.distance + model.query_mesh_skin[query_mesh]
        found = faces_within(model, query_mesh, p, reach + margin)
        face = wp.int32(0)
        # Sorted by distance. Loops with a constant range are unrolled, so the vectors stay in registers.
        distances = Distances(real(wp.inf))
        rows = Rows(-1)
        while wp.mesh_query_next(found, face):
            other = closest_on_face(model, start + face, p)
            best = closer(model, best, other)
            if other.distance < reach:
                distance = other.distance
                row = start + face
                for i in range(wp.static(capacity)):
                    if distance < distances[i]:
                        replaced = distances[i]
                        replaced_row = rows[i]
                        distances[i] = distance
                        rows[i] = row
                        distance = replaced
                        row = replaced_row
                # A face that drops out limits the reach of the list.
                reach = wp.min(reach, distance)
        slot = contact * face_capacity(cache)
        count = wp.int32(0)
        for i in range(wp.static(capacity)):
            if rows[i] >= 0:
                cache.face[env, slot + i] = rows[i]
                cache_face(cache, env, slot + i, closest_on_face(model, rows[i], p), vec3())
                count += 1
        store_face_list(cache, env, contact, count, p, reach)
        return best

    return closest_and_cache
