"""Closest point on a face; comparison of two closest points with tie-breaking; descent over adjacent faces.

The closest point belongs to a feature: the face, an edge or a vertex. Sign and direction of a contact follow from
the pseudonormal of the feature, not of the face that a query returned.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel import vector_loads
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.types import FEATURE_ACTIVE, Struct, structs

# Rounding error in units of epsilon times the size of the differences: two distances this close are tied. Not
# wider, because the distances to a face and to the edge of its neighbor differ in second order only, and the
# pseudonormal of an edge gives the side of a point only if the edge is nearest.
TIE = 3.0
# Limits on the faces of a vertex fan and on the steps of a descent; they only guarantee termination. A swept point
# may pass hundreds of faces in one step.
MAX_FAN_FACES = 1024
MAX_DESCENT_STEPS = 4096
# Largest number of steps in which a moving point is tracked.
MAX_TRACK_STEPS = 32


@functools.cache
def closest_point_of_triangle(real: type) -> wp.Function:
    """Returns the device function of the point of a triangle closest to the origin, and of its feature."""
    t = structs(real)
    vec3 = t.vec3
    level = wp.constant(real(1.0 + 8.0 * t.epsilon))

    @wp.struct
    class Hit:
        point: vec3  # closest point
        feature: wp.int32  # column of the feature tables: 0 face, 1–3 edges, 4–6 vertices

    @wp.func
    def along(u: vec3, e: vec3):
        """Returns the position along the edge ``e`` from ``u`` of the point nearest to the origin, 0 to 1."""
        return wp.clamp(-wp.dot(u, e) / wp.dot(e, e), real(0.0), real(1.0))

    @wp.func
    def closest_to_origin(a: vec3, b: vec3, c: vec3, n: vec3):
        """Returns the point of triangle ``abc`` with unit normal ``n`` closest to the origin, and its feature.

        The usual test by barycentric areas subtracts products of lengths and loses all digits in thin triangles.
        Here only lengths are compared, so errors are of the order of rounding.
        """
        hit = Hit()
        ab = b - a
        bc = c - b
        ca = a - c
        if (
            wp.dot(wp.cross(n, ab), a) < real(0.0)
            and wp.dot(wp.cross(n, bc), b) < real(0.0)
            and wp.dot(wp.cross(n, ca), c) < real(0.0)
        ):
            hit.point = wp.dot(a, n) * n
            hit.feature = 0
            return hit
        # Nearest edge. Among equally near points, a point inside an edge is preferred to a vertex.
        t = along(a, ab)
        hit.point = a + t * ab
        hit.feature = 1
        if t == real(0.0):
            hit.feature = 4
        elif t == real(1.0):
            hit.point = b
            hit.feature = 5
        best = wp.length_sq(hit.point)
        t = along(b, bc)
        q = b + t * bc
        feature = wp.int32(2)
        if t == real(0.0):
            feature = 5
        elif t == real(1.0):
            q = c
            feature = 6
        d = wp.length_sq(q)
        if d < best or (feature < 4 and hit.feature > 3 and d <= best * level):
            best = d
            hit.point = q
            hit.feature = feature
        t = along(c, ca)
        q = c + t * ca
        feature = 3
        if t == real(0.0):
            feature = 6
        elif t == real(1.0):
            q = a
            feature = 4
        d = wp.length_sq(q)
        if d < best or (feature < 4 and hit.feature > 3 and d <= best * level):
            hit.point = q
            hit.feature = feature
        return hit

    return closest_to_origin


class Functions(NamedTuple):
    """Struct and device functions of the closest point of a face."""

    ClosestPoint: Struct  # closest point of a face, relative to the query point
    closest_on_face: wp.Function  # closest point of a face
    face_distance: wp.Function  # distance of a face, computed without branches
    is_inside: wp.Function  # whether the query point is on the inner side of the surface
    closer: wp.Function  # nearer closest point, with the smaller distance of both
    lost_tie: wp.Function  # whether the selected closest point is not tied with the smallest distance
    break_tie: wp.Function  # winner among candidates tied with the smallest distance
    descend: wp.Function  # closest point found by descent over adjacent, ever nearer faces
    track: wp.Function  # closest point to a second point on the sheet of a face, by tracking


@functools.cache
def functions(real: type) -> Functions:
    """Returns the struct ``ClosestPoint`` and the device functions for ``real``."""
    t = structs(real)
    vec3, Model = t.vec3, t.Model
    row_of = vector_loads.row_of(real)
    closest_to_origin = closest_point_of_triangle(real)
    tie_epsilon = wp.constant(real(t.epsilon * TIE))
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))

    @wp.struct
    class ClosestPoint:
        """Closest point S of a face, relative to P; relative coordinates have less rounding error."""

        to_point: vec3  # P − S, mesh frame
        row: wp.int32  # of the face, in the face tables
        feature: wp.int32
        distance: real  # |P − S|
        span: real  # size of the coordinate differences, for rounding errors

    @wp.func
    def closest_on_face(model: Model, row: int, p: vec3):
        corners = row_of(model.face_corner, row)
        a = corners[0] - p
        b = corners[1] - p
        c = corners[2] - p
        hit = closest_to_origin(a, b, c, corners[3])
        closest = ClosestPoint()
        closest.to_point = -hit.point
        closest.row = row
        closest.feature = hit.feature
        closest.distance = wp.length(hit.point)
        closest.span = wp.sqrt(wp.max(wp.length_sq(a), wp.length_sq(b)))
        return closest

    @wp.func
    def face_distance(model: Model, row: int, p: vec3):
        """Returns the distance of a face, exact to rounding, computed in the axes of the face without branches."""
        corners = row_of(model.face_corner, row)
        axes = row_of(model.face_frame, row)
        v = p - corners[0]
        x = wp.dot(v, axes[0])
        y = wp.dot(v, axes[1])
        height = wp.dot(v, corners[3])
        shape = axes[2]
        per_square = axes[3]
        # Vertices in these axes: (0, 0), (length, 0) and (c_x, c_y), counterclockwise.
        length = shape[0]
        c_x = shape[1]
        c_y = shape[2]
        t = wp.clamp(x * length * per_square[0], zero, one)
        r_x = x - t * length
        nearest = r_x * r_x + y * y
        b_x = x - length
        e_x = c_x - length
        t = wp.clamp((b_x * e_x + y * c_y) * per_square[1], zero, one)
        r_x = b_x - t * e_x
        r_y = y - t * c_y
        nearest = wp.min(nearest, r_x * r_x + r_y * r_y)
        t = wp.clamp((x * c_x + y * c_y) * per_square[2], zero, one)
        r_x = x - t * c_x
        r_y = y - t * c_y
        nearest = wp.min(nearest, r_x * r_x + r_y * r_y)
        above = y >= zero and e_x * y >= c_y * b_x and c_y * x >= c_x * y
        return wp.sqrt(height * height + wp.where(above, zero, nearest))

    @wp.func
    def is_inside(model: Model, closest: ClosestPoint):
        """Returns whether P is on the inner side of the surface at S."""
        return wp.dot(
            closest.to_point,
            model.face_normal[assume_nonnegative(closest.row), assume_nonnegative(closest.feature)],
        ) < real(0.0)

    @wp.func
    def is_inactive(model: Model, closest: ClosestPoint):
        """Returns whether S is on an inactive face."""
        return (wp.int32(model.face_flags[closest.row, closest.feature]) & FEATURE_ACTIVE) == 0

    @wp.func
    def wins_tie(model: Model, a: ClosestPoint, b: ClosestPoint, tie: real):
        """Returns whether ``a`` wins a tie of two closest points.

        If they coincide, the one on an active face wins. Otherwise, in this order: a face before an edge before a
        vertex, the outer side before the inner, the lower row.
        """
        inactive_a = is_inactive(model, a)
        if inactive_a != is_inactive(model, b) and wp.length(a.to_point - b.to_point) <= tie:
            return not inactive_a
        rank_a = wp.where(a.feature > 3, 2, wp.where(a.feature > 0, 1, 0))
        rank_b = wp.where(b.feature > 3, 2, wp.where(b.feature > 0, 1, 0))
        if rank_a != rank_b:
            return rank_a < rank_b
        inside_a = is_inside(model, a)
        if inside_a != is_inside(model, b):
            return not inside_a
        return a.row < b.row

    @wp.func
    def closer(model: Model, best: ClosestPoint, other: ClosestPoint):
        """Returns the nearer closest point; its ``distance`` is the smaller one, so that ties do not drift.

        Over many candidates the result may depend on their order; see ``lost_tie``.
        """
        tie = tie_epsilon * wp.max(best.span, other.span)
        nearest = wp.min(best.distance, other.distance)
        if other.distance < best.distance - tie or (
            other.distance <= best.distance + tie and wins_tie(model, other, best, tie)
        ):
            best = other
        best.distance = nearest
        return best

    @wp.func
    def lost_tie(best: ClosestPoint):
        """Returns whether the selected closest point is not tied with the smallest distance seen.

        It was tied with an earlier minimum. Candidates that are tied with the final minimum may have been
        rejected.
        """
        return wp.length(best.to_point) > best.distance + tie_epsilon * best.span

    @wp.func
    def break_tie(model: Model, best: ClosestPoint, other: ClosestPoint):
        """Returns the winner among candidates tied with the smallest distance, called once per candidate.

        ``distance`` of ``best`` and of the result is that smallest distance. ``best.row`` < 0: no candidate yet.
        """
        if other.distance > best.distance + tie_epsilon * other.span:
            return best
        if best.row >= 0:
            if not wins_tie(model, other, best, tie_epsilon * wp.max(best.span, other.span)):
                return best
        other.distance = best.distance
        return other

    @wp.func
    def search_vertex_fan(model: Model, best: ClosestPoint, row: int, edge: int, about_end: int, p: vec3):
        """Evaluates the faces around one end of ``edge`` of face ``row``, starting across that edge.

        ``about_end``: 1: around the end of the edge, 0: around its start.
        """
        across = model.face_neighbor[row, edge]
        for _ in range(wp.static(MAX_FAN_FACES)):
            other = across // 3
            if across < 0 or other == row:
                break
            best = closer(model, best, closest_on_face(model, other, p))
            # The neighbor traverses the edge in the opposite direction: its end there is the start here.
            entered = across - 3 * other
            leave = (entered + 2) % 3
            if about_end == 0:
                leave = (entered + 1) % 3
            across = model.face_neighbor[other, leave]
        return best

    @wp.func
    def search_adjacent(model: Model, current: ClosestPoint, best: ClosestPoint, p: vec3):
        """Evaluates the faces adjacent to the feature of ``current``."""
        if current.feature > 3:
            # Start across the edge that begins at this vertex and across the edge that ends there.
            corner = current.feature - 4
            best = search_vertex_fan(model, best, current.row, corner, 0, p)
            best = search_vertex_fan(model, best, current.row, (corner + 2) % 3, 1, p)
        elif current.feature > 0:
            across = model.face_neighbor[current.row, current.feature - 1]
            if across >= 0:
                best = closer(model, best, closest_on_face(model, across // 3, p))
        best.distance = wp.length(best.to_point)
        return best

    @wp.func
    def descend(model: Model, row: int, p: vec3):
        """Returns the closest point found by descent from face ``row`` over adjacent, ever nearer faces."""
        best = closest_on_face(model, row, p)
        for _ in range(wp.static(MAX_DESCENT_STEPS)):
            current = best
            best = search_adjacent(model, current, best, p)
            if best.row == current.row:
                break
        return best

    @wp.func
    def track(model: Model, row: int, p: vec3, q: vec3):
        """Returns the closest point to ``q`` on the sheet whose face ``row`` is nearest to ``p``, by tracking.

        Steps are as long as the distance of the sheet, unless one face remains nearest. A longer step could pass
        an edge, behind which the face that was left would appear nearest.
        """
        closest = closest_on_face(model, row, p)
        length = wp.length(q - p)
        distance = real(0.0)
        while distance < length:
            at_end = closest_on_face(model, closest.row, q)
            if closest.feature == 0 and at_end.feature == 0:
                return at_end
            distance = wp.min(
                distance + wp.max(closest.distance, length / real(wp.static(MAX_TRACK_STEPS))), length
            )
            current = p + (distance / length) * (q - p)
            closest = descend(
                model,
                search_adjacent(model, closest, closest_on_face(model, closest.row, current), current).row,
                current,
            )
        return closest

    return Functions(
        ClosestPoint=ClosestPoint,
        closest_on_face=closest_on_face,
        face_distance=face_distance,
        is_inside=is_inside,
        closer=closer,
        lost_tie=lost_tie,
        break_tie=break_tie,
        descend=descend,
        track=track,
    )
