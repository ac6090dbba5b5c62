"""Local minima of the distance from the center of a sphere to a mesh, for contact in creases.

A position of the surface is a local minimum if it is the closest point of all faces that contain it: inside a face, or on an
edge or a vertex all faces of which have their closest point there. So a convex edge can be a minimum, and a concave edge
cannot, but the faces next to it can.

Only minima with the center on their outer side count, because the others are behind a wall. The closest point of the
surface is the exception: ``closest_point.py`` decides whether it counts.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.narrowphase import search
from warpcontact.kernels.narrowphase.closest_point import BOUNDARY_TOLERANCE, POINT_ROUNDING, ROUNDING
from warpcontact.kernels.types import FEATURE_ACTIVE, FEATURE_BOUNDARY, Struct, structs


class Functions(NamedTuple):
    """Struct and device functions of local minima."""

    Minima: Struct  # numbers of minima
    #: ``(model, query_mesh, p, reach, row, with_boundary, only_closest, distance, normal, position, rows)``: finds the
    #: minima within ``reach``, and writes them to the last four arguments, see ``find_minima``.
    find_minima: wp.Function
    #: ``(distance, normal, count, i, reach, cosine_one, cosine_none)``: share of minimum ``i`` in its group, 0 to 1.
    share: wp.Function


@functools.cache
def functions(real: type, room: int) -> Functions:
    """Returns the struct and the device functions for ``real``.

    ``room``: largest number of minima of a sphere. If there are more, the deepest are kept.
    """
    t = structs(real)
    vec3, Model = t.vec3, t.Model
    face_functions, search_functions = closest_points.functions(real), search.functions(real)
    ClosestPoint, closest_on_face = face_functions.ClosestPoint, face_functions.closest_on_face
    faces_within, query_error = search_functions.faces_within, search_functions.query_error
    max_coordinate = search_functions.max_coordinate
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    point_epsilon = wp.constant(real(t.epsilon * POINT_ROUNDING))
    boundary_tolerance = wp.constant(real(BOUNDARY_TOLERANCE))
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))

    @wp.struct
    class Minima:
        kept: wp.int32  # number of minima that were written
        found: wp.int32  # number of minima within reach
        closest_counts: wp.bool  # whether the first one is the closest point of the surface

    @wp.func
    def rounding(closest: ClosestPoint, extent: real):
        """Returns the rounding error of a closest point [mesh unit]."""
        return wp.max(epsilon * closest.span, point_epsilon * extent)

    @wp.func
    def has_closest_there(model: Model, row: int, p: vec3, closest: ClosestPoint, tolerance: real):
        """Returns whether the closest point of face ``row`` is at the same position."""
        other = closest_on_face(model, row, p)
        return wp.length(other.to_point - closest.to_point) <= tolerance

    @wp.func
    def neighbor_is_nearer(model: Model, edge: int, p: vec3, closest: ClosestPoint, tolerance: real):
        """Returns whether the face across an edge of the face of ``closest`` has its closest point elsewhere."""
        across = model.face_neighbor[closest.row, edge]
        if across < 0:
            return False
        return not has_closest_there(model, across // 3, p, closest, tolerance)

    @wp.func
    def is_minimum(model: Model, query_mesh: int, p: vec3, closest: ClosestPoint, tolerance: real):
        """Returns whether the closest point of a face is a local minimum of the distance."""
        if closest.feature == 0:
            return True
        # Neighbors first, because they reject nearly all positions on edges and vertices.
        if closest.feature < 4:
            if neighbor_is_nearer(model, closest.feature - 1, p, closest, tolerance):
                return False
        else:
            corner = closest.feature - 4
            if neighbor_is_nearer(model, corner, p, closest, tolerance):
                return False
            if neighbor_is_nearer(model, (corner + 2) % 3, p, closest, tolerance):
                return False
        # Then all faces that contain the position, also without a common edge.
        start = model.query_mesh_face_start[query_mesh]
        position = p - closest.to_point
        margin = tolerance + query_error(model, query_mesh, max_coordinate(position), tolerance)
        found = faces_within(model, query_mesh, position, margin)
        face = wp.int32(0)
        while wp.mesh_query_next(found, face):
            if closest_on_face(model, start + face, position).distance <= tolerance:
                if not has_closest_there(model, start + face, p, closest, tolerance):
                    return False
        return True

    @wp.func
    def is_on_boundary(model: Model, closest: ClosestPoint):
        """Returns whether a position is on a boundary edge or vertex."""
        return (wp.int32(model.face_flags[closest.row, closest.feature]) & FEATURE_BOUNDARY) != 0

    @wp.func
    def is_outside(model: Model, closest: ClosestPoint):
        """Returns whether the center is outside a boundary: off the line along the pseudonormal by more than rounding."""
        if not is_on_boundary(model, closest):
            return False
        n = model.face_normal[closest.row, closest.feature]
        sideways = wp.length(closest.to_point - wp.dot(closest.to_point, n) * n)
        # Length of the edge, or for a vertex that of the shorter one of its two edges of this face.
        first = closest.feature - 1
        second = closest.feature - 1
        if closest.feature > 3:
            first = closest.feature - 4
            second = (closest.feature - 2) % 3
        length = wp.min(
            wp.length(model.face_corner[closest.row, (first + 1) % 3] - model.face_corner[closest.row, first]),
            wp.length(model.face_corner[closest.row, (second + 1) % 3] - model.face_corner[closest.row, second]),
        )
        return sideways > boundary_tolerance * length

    @wp.func
    def is_excluded(model: Model, closest: ClosestPoint, with_boundary: bool):
        """Returns whether a position on the outer side does not count: not active, or outside a boundary."""
        if (wp.int32(model.face_flags[closest.row, closest.feature]) & FEATURE_ACTIVE) == 0:
            return True
        return not with_boundary and is_outside(model, closest)

    @wp.func
    def find_minima(
        model: Model,
        query_mesh: int,
        p: vec3,
        reach: real,
        row: int,
        with_boundary: bool,
        only_closest: bool,
        distance: wp.array(dtype=real),
        normal: wp.array(dtype=vec3),
        position: wp.array(dtype=vec3),
        rows: wp.array(dtype=wp.int32),
    ):
        """Finds the local minima of the distance from ``p``, and returns their numbers.

        All quantities are in the frame and unit of the mesh.

        Args:
            model: The model.
            query_mesh: The mesh.
            p: Center of the sphere.
            reach: Its radius.
            row: Face of the closest point of the whole surface.
            with_boundary: Whether positions outside a boundary count.
            only_closest: Whether other minima do not count.
            distance: Distances, [room], the closest point first if it is not excluded, then in ascending order.
            normal: Unit normals, out of the surface, [room]; that of the closest point is not written.
            position: Positions on the surface, [room].
            rows: Faces, [room].
        """
        result = Minima()
        extent = max_coordinate(p)
        nearest = closest_on_face(model, row, p)
        first = wp.int32(0)
        count = wp.int32(0)
        if not is_excluded(model, nearest, with_boundary):
            distance[0] = nearest.distance
            position[0] = p - nearest.to_point
            rows[0] = row
            first = 1
            count = 1
        total = wp.int32(count)
        if not only_closest:
            start = model.query_mesh_face_start[query_mesh]
            found = faces_within(model, query_mesh, p, reach + query_error(model, query_mesh, extent, reach))
            face = wp.int32(0)
            while wp.mesh_query_next(found, face):
                closest = closest_on_face(model, start + face, p)
                if closest.distance >= reach:
                    continue
                pseudonormal = model.face_normal[closest.row, closest.feature]
                side = wp.dot(closest.to_point, pseudonormal)
                if side < zero:
                    continue
                tolerance = rounding(closest, extent)
                is_same = wp.bool(False)
                # The same position as seen from another face. Twice the tolerance: both positions are rounded.
                for i in range(count):
                    if wp.length(p - closest.to_point - position[i]) <= real(2.0) * tolerance:
                        is_same = True
                # Then it is the closest point of the surface, which was decided above.
                if wp.length(closest.to_point - nearest.to_point) <= real(2.0) * tolerance:
                    is_same = True
                if is_same:
                    continue
                if is_excluded(model, closest, with_boundary):
                    continue
                if not is_minimum(model, query_mesh, p, closest, tolerance):
                    continue
                total += 1
                # Insert in ascending order; ties by face, so that the order of the search has no effect.
                index = wp.int32(count)
                while index > first:
                    if distance[index - 1] < closest.distance:
                        break
                    if distance[index - 1] == closest.distance and rows[index - 1] < closest.row:
                        break
                    index = index - 1
                if index >= wp.static(room):
                    continue
                last = wp.min(count, wp.static(room) - 1)
                while last > index:
                    distance[last] = distance[last - 1]
                    normal[last] = normal[last - 1]
                    position[last] = position[last - 1]
                    rows[last] = rows[last - 1]
                    last = last - 1
                distance[index] = closest.distance
                position[index] = p - closest.to_point
                rows[index] = closest.row
                uses_pseudonormal = closest.feature == 0 or closest.distance <= tolerance
                if not uses_pseudonormal and is_on_boundary(model, closest):
                    uses_pseudonormal = not is_outside(model, closest)
                if uses_pseudonormal:
                    normal[index] = pseudonormal
                else:
                    normal[index] = closest.to_point / closest.distance
                count = wp.min(count + 1, wp.static(room))
        result.kept = count
        result.found = total
        result.closest_counts = first == 1
        return result

    @wp.func
    def share(
        penetration: wp.array(dtype=real),
        normal: wp.array(dtype=vec3),
        count: int,
        i: int,
        cosine_one: real,
        cosine_none: real,
    ):
        """Returns the share of minimum ``i`` among those with similar normals: 1 without others.

        Args:
            penetration: Penetrations, [room] [m].
            normal: Unit normals, [room].
            count: Number of minima.
            i: The minimum.
            cosine_one: Cosine of the angle between normals up to which minima act as one.
            cosine_none: Cosine of the angle from which on they act in full; 1: always.
        """
        total = one
        if cosine_none < one:
            for j in range(count):
                if j != i:
                    x = wp.clamp(
                        (wp.dot(normal[i], normal[j]) - cosine_none) / (cosine_one - cosine_none), zero, one
                    )
                    similarity = x * x * (real(3.0) - real(2.0) * x)
                    # A penetration of 0 has no share, and no effect on others.
                    if penetration[j] < penetration[i]:
                        similarity *= penetration[j] / penetration[i]
                    total += similarity
        return one / total

    return Functions(Minima=Minima, find_minima=find_minima, share=share)
