"""Nearest face, and face lists for ``face_cache.py``, by the BVH of a query mesh; CPU only.

The bounds of a node are convex, as triangles are, so their distance is at least its linear extrapolation. A node
is omitted from a list if it is farther than the reach of the list, or if it stays farther than a listed face for
every displacement within the skin. On a fine mesh below a sphere the second criterion is decisive: faces at about
the same distance lie in about the same direction, so their order rarely changes. ``warpcontact/geometry/bvh.py``
builds the BVH, ``lowlevel/bvh8.py`` traverses it. Queries of ``wp.Mesh`` are slower on a CPU: ``docs/scheduling.md``
has the figures.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel import bvh8
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.narrowphase import face_cache, search
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.types import structs

# Offset of a list ahead of the moving point, as a fraction of the skin. A list ahead is valid longer. Less than
# one, to leave a margin for ties.
AHEAD_FRACTION = 0.8
# Stack entries: up to eight per level. A BVH of 2³¹ faces has eleven levels.
STACK_SIZE = 96


class Functions(NamedTuple):
    """Device functions of searches in the BVH."""

    closest_in_bvh: wp.Function  # closest point on a query mesh
    rounding_error: wp.Function  # bound on the error of a distance
    cache_faces_near: wp.Function  # caches the faces that may be nearest around a center ahead of a point


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model, Cache = t.vec3, t.Model, t.Cache
    face_functions, cache_functions = closest_points.functions(real), face_cache.functions(real)
    search_functions = search.functions(real)
    ClosestPoint, closest_on_face, closer, lost_tie = (
        face_functions.ClosestPoint,
        face_functions.closest_on_face,
        face_functions.closer,
        face_functions.lost_tie,
    )
    max_coordinate, query_error = search_functions.max_coordinate, search_functions.query_error
    refine_closest = search_functions.refine_closest
    distance_gradient, distance_lower_bound = (
        cache_functions.distance_gradient,
        cache_functions.distance_lower_bound,
    )
    face_capacity, store_face_list = cache_functions.face_capacity, cache_functions.store_face_list
    ahead_fraction = wp.constant(real(AHEAD_FRACTION))
    rounding = wp.constant(real(t.epsilon * face_cache.ROUNDING))
    Nodes = wp.types.vector(length=STACK_SIZE, dtype=wp.int32)
    Distances = wp.types.vector(length=STACK_SIZE, dtype=real)

    @wp.struct
    class Traversal:
        """State of a traversal: a stack of nodes, among the children of one node the nearest on top."""

        count: wp.int32
        node: Nodes
        lower_bound: Distances  # lower bound on the distance of the faces of each node

    @wp.struct
    class PruningReference:
        """A closest point, used to prune faces that stay farther while the query point moves.

        See ``face_cache.lead_distance``.
        """

        far: real  # largest displacement of the query point; 0: no pruning
        distance: real
        direction: vec3  # unit, from the closest point to the query point
        rounding: real  # rounding error of the direction

    @wp.func
    def start_traversal():
        """Returns a traversal that starts at the root."""
        traversal = Traversal()
        traversal.count = 1
        return traversal

    next_leaf = bvh8.next_leaf_function(real, Traversal, PruningReference, face_cache.ROUNDING)

    @wp.func
    def rounding_error(extent: real, closest: ClosestPoint):
        """Returns a bound on the error of a distance, for coordinates up to ``extent``."""
        return rounding * (extent + closest.span)

    @wp.func
    def closest_in_bvh(model: Model, query_mesh: int, p: vec3, hint: int):
        """Returns the closest point on a query mesh; ``hint`` is a row that may be near, or invalid."""
        tree = model.query_mesh_bvh[query_mesh]
        start = model.query_mesh_face_start[query_mesh]
        row = hint
        if row < start or row >= model.query_mesh_face_start[query_mesh + 1]:
            row = start
        best = closest_on_face(model, row, p)
        traversal = start_traversal()
        leaf = next_leaf(traversal, model.bvh_bound, tree, p, best.distance, PruningReference())
        while leaf >= 0:
            best = closer(model, best, closest_on_face(model, start + model.bvh_face[leaf], p))
            leaf = next_leaf(traversal, model.bvh_bound, tree, p, best.distance, PruningReference())
        if lost_tie(best):
            best = refine_closest(
                model, query_mesh, p, best, query_error(model, query_mesh, max_coordinate(p), best.distance)
            )
        best.distance = wp.length(best.to_point)
        return best

    @wp.func
    def pruning_reference(best: ClosestPoint, far: real):
        """Returns a closest point as the reference that prunes faces within the displacement ``far``."""
        reference = PruningReference()
        reference.far = far
        reference.distance = best.distance
        per_distance = real(1.0) / best.distance
        reference.direction = per_distance * best.to_point
        reference.rounding = rounding * best.span * per_distance
        return reference

    @wp.func
    def offset_ahead(model: Model, query_mesh: int, cache: Cache, env: int, contact: int, p: vec3, distance: real):
        """Returns the offset from a point to the center of its next list, in its direction of motion.

        The length is a fraction of the distance that the last list reached beyond its nearest face.
        """
        offset = p - cache.list_center[env, contact]
        length = wp.length(offset)
        reserve = wp.min(cache.uncached_bound[env, contact] - distance, model.query_mesh_skin[query_mesh])
        # No offset for a first list, after a jump or from a non-finite state.
        if length > real(0.0) and length <= real(2.0) * reserve:
            return (ahead_fraction * reserve / length) * offset
        return vec3()

    @wp.func
    def cache_faces_near(
        model: Model, query_mesh: int, p: vec3, closest: ClosestPoint, cache: Cache, env: int, contact: int
    ):
        """Caches the faces that may be nearest around a center ahead of ``p``; ``closest`` is nearest to ``p``.

        All other faces are farther from the center than the stored ``uncached_bound``, or stay farther than a
        listed face for every displacement within the skin.
        """
        center = p + offset_ahead(model, query_mesh, cache, env, contact, p, closest.distance)
        skin = model.query_mesh_skin[query_mesh]
        reach = closest.distance + skin
        tree = model.query_mesh_bvh[query_mesh]
        start = model.query_mesh_face_start[query_mesh]
        best = closest_on_face(model, closest.row, center)
        capacity = face_capacity(cache)
        slot = assume_nonnegative(contact * capacity)
        count = wp.int32(0)
        traversal = start_traversal()
        searching = wp.bool(True)
        while searching:
            leaf_found = next_leaf(traversal, model.bvh_bound, tree, center, reach, pruning_reference(best, skin))
            searching = leaf_found >= 0
            if searching:
                row = start + model.bvh_face[leaf_found]
                other = closest_on_face(model, row, center)
                direction = distance_gradient(other)
                lower_bound = distance_lower_bound(other, direction, vec3())
                if lower_bound < reach:
                    if other.distance < best.distance:
                        best = other
                    leaf = slot + count
                    if count == capacity:
                        # Replace the farthest face; its bound limits the reach of the list.
                        reach = lower_bound
                        for k in range(capacity):
                            i = assume_nonnegative(slot + k)
                            if cache.distance[env, i] > reach:
                                reach = cache.distance[env, i]
                                leaf = i
                    else:
                        count += 1
                    if leaf < slot + capacity:
                        leaf = assume_nonnegative(leaf)
                        cache.face[env, leaf] = row
                        cache.distance[env, leaf] = lower_bound
                        cache.gradient[env, leaf] = direction
        store_face_list(cache, env, contact, count, center, reach)

    return Functions(
        closest_in_bvh=closest_in_bvh, rounding_error=rounding_error, cache_faces_near=cache_faces_near
    )
