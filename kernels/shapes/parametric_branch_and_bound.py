"""Global minimum of the signed distance of a parametric surface from a shape, by branch and bound.

Newton's method starts at the nearest cell center of a grid. Then every cell of the grid is checked for a lower
minimum. The signed distance from a convex body is convex, so the tangent plane at one point bounds it from below
over the cell; the second derivatives of the surface bound its deviation from that plane. Cells that are not
excluded are divided into four. Each remaining finest cell is a start for Newton's method, unless it is in the
basin of a minimum already found. Used by ``parametric_contact.py``.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import Plane, Shape, SignedDistance, half, real, two, vec3d, zero
from warpcontact.kernels.shapes.parametric_surface import Jet, ParametricSurface, parametric_jet
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.shapes.signed_distance import UP

vec2d = wp.vec2d

#: Maximum number of divisions of a cell, and the limit for cells where two sides of the shape are equally near.
SMOOTH_LEVELS = 5
LEVELS = 8
#: Number of stored minima, and maximum number of starts of Newton's method.
MAX_MINIMA = 8
MAX_STARTS = wp.constant(wp.int32(32))
#: Maximum number of distance evaluations at cells: distances that are equal along a curve exclude no cell.
MAX_EVALUATIONS = wp.constant(wp.int32(3000))
# Factor on reach and deviation estimated from the center of a cell.
MARGIN = wp.constant(real(1.25))
# Added fraction of the deviation of a cell.
CURVATURE_MARGIN = wp.constant(real(0.25))
# Initial radius of a basin around a minimum, in finest cells.
START_RADIUS = wp.constant(real(2.0))
# Distances that differ by less, relative to the size of the pair, are equal.
TIE = wp.constant(real(1.0e-12))
CELL_COUNT = wp.constant(wp.int32(4**LEVELS))
INFINITE = wp.constant(real(wp.inf))


@wp.struct
class SurfaceSample:
    """The shape as seen from one point of the surface, frame of b."""

    u: vec2d
    jet: Jet
    normal: vec3d  # of the surface
    offset_point: vec3d  # on the offset surface
    closest: SignedDistance  # closest point of the shape to it
    tangent_cosines: vec2d  # of the shape's normal against unit vectors along x_u and x_v
    misalignment: real  # their length: cosine, 0 where the normals are parallel or facing


@wp.struct
class SurfaceElement:
    """A point of the offset surface and its derivatives."""

    z: vec3d
    u: vec3d
    v: vec3d
    uu: vec3d
    uv: vec3d
    vv: vec3d


Slots = wp.types.vector(MAX_MINIMA, real)


@wp.struct
class Search:
    """Minima found so far."""

    best: SurfaceSample
    minimum_u: Slots
    minimum_v: Slots
    basin_u: Slots  # half width of the starts around a minimum that lead to it
    basin_v: Slots
    other_basin_u: Slots  # the same for starts where another side of the shape is nearest than at the best point
    other_basin_v: Slots
    skipped_distance: real  # least distance of the starts skipped beyond ``MAX_STARTS``
    skipped_u: vec2d
    count: wp.int32  # number of minima
    starts: wp.int32
    evaluations: wp.int32  # at cells
    steps: wp.int32  # number of Newton steps
    last_normal: vec3d  # normal of the last evaluation, frame of the shape
    plane_height: real  # height of the tangent plane of the shape with the normal of the best point


@wp.func
def deinterleave(code: wp.int32):
    """Returns the number in the even bits of ``code``."""
    number = wp.int32(0)
    for i in range(LEVELS):
        number += ((code >> (2 * i)) & 1) << i
    return number


@functools.cache
def global_search(
    A: type[Shape], B: type[ParametricSurface], distance_at: wp.Function, refine: wp.Function
) -> wp.Function:
    """Returns ``(p_a, p_b, x, q, offset)``: the ``SurfaceSample`` with the least distance, and the evaluations.

    Args:
        A: The closed shape.
        B: The parametric surface.
        distance_at: Device function of ``signed_distance_within``.
        refine: ``(p_a, p_b, x, q, start, offset)`` → minimum reached by Newton's method, and its steps.
    """
    jet_of, position = parametric_jet(B), B.position
    bounded, is_torus = A is not Plane, A is Torus
    closed_u, closed_v = B.u_periodic, B.v_periodic
    u_0, v_0 = (wp.constant(real(ends[0])) for ends in (B.u_range, B.v_range))
    period_u, period_v = (wp.constant(real(ends[1] - ends[0])) for ends in (B.u_range, B.v_range))
    cells_u, cells_v = (wp.constant(wp.int32(count)) for count in B.scan)
    step_u, step_v = (
        wp.constant(real((ends[1] - ends[0]) / count))
        for count, ends in zip(B.scan, (B.u_range, B.v_range), strict=True)
    )
    finest, fine = 0.5**LEVELS, 0.5**SMOOTH_LEVELS
    fine_u, fine_v = (
        wp.constant(real(fine * (ends[1] - ends[0]) / count))
        for count, ends in zip(B.scan, (B.u_range, B.v_range), strict=True)
    )

    @wp.func
    def element(p_b: Any, u: real, v: real, offset: real):
        jet = jet_of(p_b, u, v)
        at = SurfaceElement()
        at.z = jet.x
        at.u = jet.u
        at.v = jet.v
        at.uu = jet.uu
        at.uv = jet.uv
        at.vv = jet.vv
        if offset != zero:
            n = wp.normalize(wp.cross(jet.u, jet.v))
            form = wp.inverse(
                wp.mat22d(wp.dot(jet.u, jet.u), wp.dot(jet.u, jet.v), wp.dot(jet.u, jet.v), wp.dot(jet.v, jet.v))
            )
            by_u = form * vec2d(wp.dot(n, jet.uu), wp.dot(n, jet.uv))
            by_v = form * vec2d(wp.dot(n, jet.uv), wp.dot(n, jet.vv))
            at.z = jet.x - offset * n
            at.u = jet.u + offset * (by_u[0] * jet.u + by_u[1] * jet.v)
            at.v = jet.v + offset * (by_v[0] * jet.u + by_v[1] * jet.v)
        return at

    @wp.func
    def second_derivatives(p_b: Any, u: real, v: real, offset: real):
        """Returns second derivatives of the offset surface, by differences over a cell of the grid."""
        a = half * step_u
        b = half * step_v
        right = element(p_b, u + a, v, offset)
        possible = element(p_b, u - a, v, offset)
        above = element(p_b, u, v + b, offset)
        below = element(p_b, u, v - b, offset)
        at = SurfaceElement()
        at.uu = (right.u - possible.u) / step_u
        at.uv = (right.v - possible.v) / step_u
        at.vv = (above.v - below.v) / step_v
        return at

    @wp.func
    def max_descent(at: SurfaceElement, n: vec3d, a: real, b: real):
        """Bounds the displacement of the surface along −n from the tangent plane of a cell of half sides a, b."""
        uu = half * a * a * wp.dot(n, at.uu)
        uv = a * b * wp.dot(n, at.uv)
        vv = half * b * b * wp.dot(n, at.vv)
        fall = wp.max(zero, -uu) + wp.max(zero, -vv) + wp.abs(uv)
        if uu >= zero and vv >= zero and uv * uv <= real(4.0) * uu * vv:
            fall = zero
        return fall

    @wp.func
    def curvature_bound(at: SurfaceElement, a: real, b: real):
        """Bounds the distance of the surface from its tangent plane."""
        return half * a * a * wp.length(at.uu) + a * b * wp.length(at.uv) + half * b * b * wp.length(at.vv)

    @wp.func
    def lower_bound(at: SurfaceElement, n: vec3d, gap: real, a: real, b: real, bulge: real):
        """Returns a lower bound of the distance in a cell with its center at ``gap`` from a plane of normal n."""
        across = wp.abs(wp.dot(n, at.u)) * a + wp.abs(wp.dot(n, at.v)) * b
        return gap - across - max_descent(at, n, a, b) - CURVATURE_MARGIN * bulge

    @wp.func
    def tangent_plane_height(p_a: Any, x: vec3d, q: wp.quatd, n: vec3d):
        """Returns the height along n of the tangent plane of the shape with the outward normal n."""
        if wp.static(bounded):
            return wp.dot(n, x + wp.quat_rotate(q, A.support(p_a, wp.quat_rotate_inv(q, n))))
        return wp.dot(n, x)

    @wp.func
    def periodic_distance(difference: real, period: real, closed: bool):
        if closed:
            return wp.abs(difference - period * wp.round(difference / period))
        return wp.abs(difference)

    @wp.func
    def widened(width: real, distance: real, fine: real):
        """Returns the half width of a basin, enlarged by a start at distance ``distance`` that led to its minimum."""
        if distance <= width:
            return width
        return wp.min(distance + half * fine, two * wp.max(width, START_RADIUS * fine))

    @wp.func
    def start_refinement(
        p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, u: vec2d, closest: SignedDistance, offset: real, search: Search
    ):
        """Runs Newton's method from u, unless u is in the basin of a stored minimum; returns the search."""
        is_new = wp.bool(True)
        same_side = wp.dot(closest.normal, wp.quat_rotate_inv(q, search.best.closest.normal)) > half
        # A lower value than all minima belongs to none of them, however near.
        lower = closest.gap < search.best.closest.gap - TIE * wp.abs(search.best.closest.gap)
        for k in range(MAX_MINIMA):
            if k < search.count and not lower:
                distance_u = periodic_distance(search.minimum_u[k] - u[0], period_u, closed_u)
                distance_v = periodic_distance(search.minimum_v[k] - u[1], period_v, closed_v)
                basin_u = wp.where(same_side, search.basin_u[k], search.other_basin_u[k])
                basin_v = wp.where(same_side, search.basin_v[k], search.other_basin_v[k])
                if distance_u <= basin_u and distance_v <= basin_v:
                    is_new = wp.bool(False)
        if is_new and search.starts >= MAX_STARTS:
            if search.starts == MAX_STARTS or closest.gap < search.skipped_distance:
                search.skipped_distance = closest.gap
                search.skipped_u = u
            search.starts += 1
        elif is_new:
            now, steps = refine(p_a, p_b, x, q, u, offset)
            search.steps += steps
            if search.starts == 0 or now.closest.gap < search.best.closest.gap:
                search.best = now
                search.plane_height = tangent_plane_height(p_a, x, q, now.closest.normal)
            search.starts += 1
            same = wp.int32(-1)
            for k in range(MAX_MINIMA):
                if k < search.count:
                    distance_u = periodic_distance(search.minimum_u[k] - now.u[0], period_u, closed_u)
                    distance_v = periodic_distance(search.minimum_v[k] - now.u[1], period_v, closed_v)
                    if distance_u <= START_RADIUS * fine_u and distance_v <= START_RADIUS * fine_v:
                        same = k
            if same < 0:
                same = search.count % MAX_MINIMA
                search.minimum_u[same] = now.u[0]
                search.minimum_v[same] = now.u[1]
                search.basin_u[same] = START_RADIUS * fine_u
                search.basin_v[same] = START_RADIUS * fine_v
                # Next to the point nearest to one side, there may be one nearest to another side.
                search.other_basin_u[same] = real(-1.0)
                search.other_basin_v[same] = real(-1.0)
                search.count += 1
            else:
                distance_u = periodic_distance(search.minimum_u[same] - u[0], period_u, closed_u)
                distance_v = periodic_distance(search.minimum_v[same] - u[1], period_v, closed_v)
                if same_side:
                    search.basin_u[same] = widened(search.basin_u[same], distance_u, fine_u)
                    search.basin_v[same] = widened(search.basin_v[same], distance_v, fine_v)
                else:
                    search.other_basin_u[same] = widened(search.other_basin_u[same], distance_u, fine_u)
                    search.other_basin_v[same] = widened(search.other_basin_v[same], distance_v, fine_v)
        return search

    @wp.func
    def subdivide(
        p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, radius: real, i: int, j: int, offset: real, search: Search
    ):
        """Divides a cell of the grid as far as it is not excluded; returns the search."""
        second = SurfaceElement()
        has_derivatives = wp.bool(False)
        cell = wp.int32(0)
        level = wp.int32(-1)
        while cell < CELL_COUNT:
            if level < 0:
                # The largest cell that begins here.
                level = LEVELS
                while level > 0 and (cell & ((1 << (2 * (LEVELS - level + 1))) - 1)) == 0:
                    level -= 1
            size = real(1 << (LEVELS - level)) * real(finest)
            a = half * step_u * size
            b = half * step_v * size
            u = u_0 + (real(i) + real(deinterleave(cell)) * real(finest)) * step_u + a
            v = v_0 + (real(j) + real(deinterleave(cell >> 1)) * real(finest)) * step_v + b
            at = element(p_b, u, v, offset)
            limit = search.best.closest.gap - TIE * (wp.abs(search.best.closest.gap) + wp.length(at.z - x))
            possible = wp.bool(True)
            if offset != zero:
                if not has_derivatives:
                    flat = wp.length(at.u) * a + wp.length(at.v) * b
                    if wp.static(bounded):
                        possible = wp.length(at.z - x) - radius - two * flat < limit
                    if possible:
                        second = second_derivatives(p_b, u, v, offset)
                        has_derivatives = wp.bool(True)
                at.uu = second.uu
                at.uv = second.uv
                at.vv = second.vv
            bulge = curvature_bound(at, a, b)
            reach = wp.length(at.u) * a + wp.length(at.v) * b + MARGIN * bulge
            if possible:
                # Beyond the tangent plane of the shape with the normal of the best point, or beyond its bounding
                # sphere.
                m = search.best.closest.normal
                possible = lower_bound(at, m, wp.dot(m, at.z) - search.plane_height, a, b, bulge) < limit
                if wp.static(bounded):
                    possible = possible and wp.length(at.z - x) - radius - reach < limit
            if possible:
                point = wp.quat_rotate_inv(q, at.z - x)
                closest = distance_at(p_a, point, search.last_normal, limit)
                search.evaluations += 1
                search.last_normal = closest.normal
                n = wp.quat_rotate(q, closest.normal)
                bound = lower_bound(at, n, closest.gap, a, b, bulge)
                if wp.static(is_torus):
                    # The distance from a circle decreases from its tangent plane around the axis.
                    inmost = wp.sqrt(point[0] * point[0] + point[1] * point[1]) - reach
                    if inmost > zero:
                        bound = wp.max(bound - half * reach * reach / inmost, closest.gap - reach)
                    else:
                        bound = closest.gap - reach
                possible = bound < limit
                # If another side of the shape is nearest than at the best point, both are equally near in between.
                crosses_side = wp.dot(n, search.best.closest.normal) < half and level < LEVELS
                last = level >= SMOOTH_LEVELS and not crosses_side
                if possible and (closest.gap < limit or last or search.evaluations > MAX_EVALUATIONS):
                    search = start_refinement(p_a, p_b, x, q, vec2d(u, v), closest, offset, search)
                    possible = not last and level < LEVELS and search.evaluations <= MAX_EVALUATIONS
            if possible:
                level += 1
            else:
                cell += 1 << (2 * (LEVELS - level))
                level = -1
        return search

    @wp.func
    def closest_sample(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, offset: real):
        """Returns the sample with the least distance over the surface, and the evaluations."""
        radius = zero
        if wp.static(bounded):
            radius = wp.length(A.extents(p_a))
        search = Search()
        smallest_gap = INFINITE
        first = vec2d()
        closest_overall = SignedDistance()
        n = vec3d()
        search.last_normal = UP
        plane_height = INFINITE
        for i in range(cells_u):
            for j in range(cells_v):
                u = u_0 + (real(i) + half) * step_u
                v = v_0 + (real(j) + half) * step_v
                point = position(p_b, u, v)
                # Not nearer than the bounding sphere of the shape.
                in_reach = wp.bool(True)
                if wp.static(bounded):
                    in_reach = wp.length(point - x) - radius - offset < smallest_gap
                if in_reach:
                    if offset != zero:
                        at = element(p_b, u, v, offset)
                        point = at.z
                    if wp.dot(n, point) - plane_height < smallest_gap:
                        closest = distance_at(
                            p_a, wp.quat_rotate_inv(q, point - x), search.last_normal, smallest_gap
                        )
                        search.last_normal = closest.normal
                        search.evaluations += 1
                        if closest.gap < smallest_gap:
                            smallest_gap = closest.gap
                            first = vec2d(u, v)
                            closest_overall = closest
                            n = wp.quat_rotate(q, closest.normal)
                            plane_height = tangent_plane_height(p_a, x, q, n)
        search.steps = search.evaluations
        search.evaluations = 0
        search = start_refinement(p_a, p_b, x, q, first, closest_overall, offset, search)
        for i in range(cells_u):
            corner = position(p_b, u_0 + real(i) * step_u, v_0)
            for j in range(cells_v):
                point = position(p_b, u_0 + (real(i) + half) * step_u, v_0 + (real(j) + half) * step_v)
                crosses_side = position(p_b, u_0 + real(i) * step_u, v_0 + real(j + 1) * step_v)
                here = point - corner
                there = point - crosses_side
                corner = crosses_side
                reach = wp.max(wp.length(here), wp.length(there))
                possible = wp.bool(True)
                if wp.static(bounded):
                    possible = wp.length(point - x) - radius - offset - MARGIN * reach < search.best.closest.gap
                m = search.best.closest.normal
                across = wp.max(wp.abs(wp.dot(m, here)), wp.abs(wp.dot(m, there)))
                possible = (
                    possible
                    and wp.dot(m, point) - search.plane_height - offset - across - CURVATURE_MARGIN * reach
                    < search.best.closest.gap
                )
                if possible:
                    search = subdivide(p_a, p_b, x, q, radius, i, j, offset, search)
        if search.starts > MAX_STARTS and search.skipped_distance < search.best.closest.gap:
            now, steps = refine(p_a, p_b, x, q, search.skipped_u, offset)
            search.steps += steps
            search.best = now
        return search.best, search.evaluations + search.steps

    return closest_sample
