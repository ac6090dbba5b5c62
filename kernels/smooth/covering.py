"""The least distance of a patch from a shape, over all of the patch: no place of it is left that may be nearer.

From the best of a grid of places Newton's method goes on to a minimum. Whether there is another one that is
lower, is then asked of every cell of the grid. The signed distance from a convex body is a convex function, so
the tangent plane at one place of a cell bounds it from below in all of the cell; the patch bends away from that
by no more than its second derivatives tell. Cells that are not ruled out are divided into four, again and
again. Of the finest ones that are left, each is a start for Newton's method, unless a minimum that is known
lies beside it.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.smooth.base import Nearest, Shape, half, real, two, vec3d, zero
from warpcontact.kernels.smooth.nearest import UP
from warpcontact.kernels.smooth.patch import Jet, ParametricSurface, jet_of_patch
from warpcontact.kernels.smooth.plane import Plane
from warpcontact.kernels.smooth.torus import Torus

vec2d = wp.vec2d

#: How often a cell of the grid is divided into four, and where two sides of the shape are as near.
SMOOTH = 5
LEVELS = 8
#: Minima that are kept in mind, and how often Newton's method starts at most.
KNOWN = 8
STARTS = wp.constant(wp.int32(32))
#: Most cells that are looked at closely. Where distances are equal all along a curve, there is no end.
MOST = wp.constant(wp.int32(3000))
# What is taken as reach and bend of a cell, of what its middle tells.
MARGIN = wp.constant(real(1.25))
# By how much the bend of a cell is taken too large.
SPARE = wp.constant(real(0.25))
# How near a start is to a minimum that is known, in terms of the finest cells.
BESIDE = wp.constant(real(2.0))
# Distances that differ by no more, of the size of the pair, are equal.
TIE = wp.constant(real(1.0e-12))
END = wp.constant(wp.int32(4**LEVELS))
FAR = wp.constant(real(wp.inf))


@wp.struct
class Sight:
    """The shape from one place of the patch, frame of b."""

    u: vec2d
    jet: Jet
    normal: vec3d  # of the patch
    place: vec3d  # on the lowered patch
    near: Nearest  # of the shape from there
    tilt: vec2d  # of the shape's normal against unit vectors along x_u and x_v
    lean: real  # their length: cosine, 0 where the normals are parallel or facing


@wp.struct
class Element:
    """A place of the lowered patch and its tangents."""

    z: vec3d
    u: vec3d
    v: vec3d
    uu: vec3d
    uv: vec3d
    vv: vec3d


Slots = wp.types.vector(KNOWN, real)


@wp.struct
class Search:
    """What is known of the minima."""

    best: Sight
    known_u: Slots
    known_v: Slots
    wide_u: Slots  # how far around a minimum starts lead to it
    wide_v: Slots
    turned_u: Slots  # and those where another side of the shape is nearest than at the best place
    turned_v: Slots
    rest: real  # the least distance where no start is left
    rest_u: vec2d
    count: wp.int32  # of the known
    starts: wp.int32
    looks: wp.int32  # at cells
    steps: wp.int32  # of Newton's method
    beside: vec3d  # normal of the last look, frame of the shape
    plane: real  # what touches the shape across the normal of the best


@wp.func
def every_other_bit(code: wp.int32):
    """The number of the even bits of ``code``."""
    number = wp.int32(0)
    for i in range(LEVELS):
        number += ((code >> (2 * i)) & 1) << i
    return number


@functools.cache
def covering(
    A: type[Shape], B: type[ParametricSurface], of_place: wp.Function, polish: wp.Function
) -> wp.Function:
    """Returns ``(p_a, p_b, x, q, lowered)``: the ``Sight`` with the least distance, and how many were taken.

    Args:
        A: The closed shape.
        B: The patch.
        of_place: That of ``nearest_within``.
        polish: ``(p_a, p_b, x, q, start, lowered)`` → the minimum that Newton's method comes to, and its steps.
    """
    jet_of, position = jet_of_patch(B), B.position
    bounded, ring = A is not Plane, A is Torus
    closed_u, closed_v = B.u_periodic, B.v_periodic
    u_0, v_0 = (wp.constant(real(ends[0])) for ends in (B.u_range, B.v_range))
    period_u, period_v = (wp.constant(real(ends[1] - ends[0])) for ends in (B.u_range, B.v_range))
    cells_u, cells_v = (wp.constant(wp.int32(count)) for count in B.scan)
    step_u, step_v = (
        wp.constant(real((ends[1] - ends[0]) / count))
        for count, ends in zip(B.scan, (B.u_range, B.v_range), strict=True)
    )
    finest, fine = 0.5**LEVELS, 0.5**SMOOTH
    fine_u, fine_v = (
        wp.constant(real(fine * (ends[1] - ends[0]) / count))
        for count, ends in zip(B.scan, (B.u_range, B.v_range), strict=True)
    )

    @wp.func
    def element(p_b: Any, u: real, v: real, lowered: real):
        jet = jet_of(p_b, 0, u, v)
        at = Element()
        at.z = jet.x
        at.u = jet.u
        at.v = jet.v
        at.uu = jet.uu
        at.uv = jet.uv
        at.vv = jet.vv
        if lowered != zero:
            n = wp.normalize(wp.cross(jet.u, jet.v))
            form = wp.inverse(
                wp.mat22d(wp.dot(jet.u, jet.u), wp.dot(jet.u, jet.v), wp.dot(jet.u, jet.v), wp.dot(jet.v, jet.v))
            )
            by_u = form * vec2d(wp.dot(n, jet.uu), wp.dot(n, jet.uv))
            by_v = form * vec2d(wp.dot(n, jet.uv), wp.dot(n, jet.vv))
            at.z = jet.x - lowered * n
            at.u = jet.u + lowered * (by_u[0] * jet.u + by_u[1] * jet.v)
            at.v = jet.v + lowered * (by_v[0] * jet.u + by_v[1] * jet.v)
        return at

    @wp.func
    def bends(p_b: Any, u: real, v: real, lowered: real):
        """Second derivatives of the lowered patch, by differences over a cell of the grid."""
        a = half * step_u
        b = half * step_v
        right = element(p_b, u + a, v, lowered)
        left = element(p_b, u - a, v, lowered)
        above = element(p_b, u, v + b, lowered)
        below = element(p_b, u, v - b, lowered)
        at = Element()
        at.uu = (right.u - left.u) / step_u
        at.uv = (right.v - left.v) / step_u
        at.vv = (above.v - below.v) / step_v
        return at

    @wp.func
    def falls(at: Element, n: vec3d, a: real, b: real):
        """How far the patch may go along −n from the tangent plane of a cell with half sides a and b."""
        uu = half * a * a * wp.dot(n, at.uu)
        uv = a * b * wp.dot(n, at.uv)
        vv = half * b * b * wp.dot(n, at.vv)
        fall = wp.max(zero, -uu) + wp.max(zero, -vv) + wp.abs(uv)
        if uu >= zero and vv >= zero and uv * uv <= real(4.0) * uu * vv:
            fall = zero
        return fall

    @wp.func
    def bulge_of(at: Element, a: real, b: real):
        """How far the patch may be from its tangent plane."""
        return half * a * a * wp.length(at.uu) + a * b * wp.length(at.uv) + half * b * b * wp.length(at.vv)

    @wp.func
    def floor_of(at: Element, n: vec3d, gap: real, a: real, b: real, bulge: real):
        """What no place of a cell is nearer than, if its middle is so far beyond a plane with the normal n."""
        across = wp.abs(wp.dot(n, at.u)) * a + wp.abs(wp.dot(n, at.v)) * b
        return gap - across - falls(at, n, a, b) - SPARE * bulge

    @wp.func
    def beyond(p_a: Any, x: vec3d, q: wp.quatd, n: vec3d):
        """The plane with the outward normal n that touches the shape: how far it is along n."""
        if wp.static(bounded):
            return wp.dot(n, x + wp.quat_rotate(q, A.support(p_a, wp.quat_rotate_inv(q, n))))
        return wp.dot(n, x)

    @wp.func
    def beside(difference: real, period: real, closed: bool):
        if closed:
            return wp.abs(difference - period * wp.round(difference / period))
        return wp.abs(difference)

    @wp.func
    def wider(wide: real, off: real, fine: real):
        """How far around a minimum starts lead to it, as one does that is so far off."""
        if off <= wide:
            return wide
        return wp.min(off + half * fine, two * wp.max(wide, BESIDE * fine))

    @wp.func
    def started(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, u: vec2d, near: Nearest, lowered: real, search: Search):
        """The search after Newton's method from u, unless a minimum that is known lies beside it."""
        fresh = wp.bool(True)
        same_side = wp.dot(near.normal, wp.quat_rotate_inv(q, search.best.near.normal)) > half
        # However near, what is lower than all that is known is none of them.
        lower = near.gap < search.best.near.gap - TIE * wp.abs(search.best.near.gap)
        for k in range(KNOWN):
            if k < search.count and not lower:
                off_u = beside(search.known_u[k] - u[0], period_u, closed_u)
                off_v = beside(search.known_v[k] - u[1], period_v, closed_v)
                wide_u = wp.where(same_side, search.wide_u[k], search.turned_u[k])
                wide_v = wp.where(same_side, search.wide_v[k], search.turned_v[k])
                if off_u <= wide_u and off_v <= wide_v:
                    fresh = wp.bool(False)
        if fresh and search.starts >= STARTS:
            if search.starts == STARTS or near.gap < search.rest:
                search.rest = near.gap
                search.rest_u = u
            search.starts += 1
        elif fresh:
            now, steps = polish(p_a, p_b, x, q, u, lowered)
            search.steps += steps
            if search.starts == 0 or now.near.gap < search.best.near.gap:
                search.best = now
                search.plane = beyond(p_a, x, q, now.near.normal)
            search.starts += 1
            same = wp.int32(-1)
            for k in range(KNOWN):
                if k < search.count:
                    off_u = beside(search.known_u[k] - now.u[0], period_u, closed_u)
                    off_v = beside(search.known_v[k] - now.u[1], period_v, closed_v)
                    if off_u <= BESIDE * fine_u and off_v <= BESIDE * fine_v:
                        same = k
            if same < 0:
                same = search.count % KNOWN
                search.known_u[same] = now.u[0]
                search.known_v[same] = now.u[1]
                search.wide_u[same] = BESIDE * fine_u
                search.wide_v[same] = BESIDE * fine_v
                # Beside what is nearest to one side there may be what is to another.
                search.turned_u[same] = real(-1.0)
                search.turned_v[same] = real(-1.0)
                search.count += 1
            else:
                off_u = beside(search.known_u[same] - u[0], period_u, closed_u)
                off_v = beside(search.known_v[same] - u[1], period_v, closed_v)
                if same_side:
                    search.wide_u[same] = wider(search.wide_u[same], off_u, fine_u)
                    search.wide_v[same] = wider(search.wide_v[same], off_v, fine_v)
                else:
                    search.turned_u[same] = wider(search.turned_u[same], off_u, fine_u)
                    search.turned_v[same] = wider(search.turned_v[same], off_v, fine_v)
        return search

    @wp.func
    def divided(
        p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, radius: real, i: int, j: int, lowered: real, search: Search
    ):
        """The search after a cell of the grid: it is divided as far as it is not ruled out."""
        bent = Element()
        known = wp.bool(False)
        cell = wp.int32(0)
        level = wp.int32(-1)
        while cell < END:
            if level < 0:
                # The largest cell that begins here.
                level = LEVELS
                while level > 0 and (cell & ((1 << (2 * (LEVELS - level + 1))) - 1)) == 0:
                    level -= 1
            size = real(1 << (LEVELS - level)) * real(finest)
            a = half * step_u * size
            b = half * step_v * size
            u = u_0 + (real(i) + real(every_other_bit(cell)) * real(finest)) * step_u + a
            v = v_0 + (real(j) + real(every_other_bit(cell >> 1)) * real(finest)) * step_v + b
            at = element(p_b, u, v, lowered)
            limit = search.best.near.gap - TIE * (wp.abs(search.best.near.gap) + wp.length(at.z - x))
            left = wp.bool(True)
            if lowered != zero:
                if not known:
                    flat = wp.length(at.u) * a + wp.length(at.v) * b
                    if wp.static(bounded):
                        left = wp.length(at.z - x) - radius - two * flat < limit
                    if left:
                        bent = bends(p_b, u, v, lowered)
                        known = wp.bool(True)
                at.uu = bent.uu
                at.uv = bent.uv
                at.vv = bent.vv
            bulge = bulge_of(at, a, b)
            reach = wp.length(at.u) * a + wp.length(at.v) * b + MARGIN * bulge
            if left:
                # Beyond the plane that touches the shape where it is nearest to the best place, or the sphere
                # around it.
                m = search.best.near.normal
                left = floor_of(at, m, wp.dot(m, at.z) - search.plane, a, b, bulge) < limit
                if wp.static(bounded):
                    left = left and wp.length(at.z - x) - radius - reach < limit
            if left:
                place = wp.quat_rotate_inv(q, at.z - x)
                near = of_place(p_a, place, search.beside, limit)
                search.looks += 1
                search.beside = near.normal
                n = wp.quat_rotate(q, near.normal)
                floor = floor_of(at, n, near.gap, a, b, bulge)
                if wp.static(ring):
                    # The distance from a circle falls away from its tangent plane around the axis.
                    inmost = wp.sqrt(place[0] * place[0] + place[1] * place[1]) - reach
                    if inmost > zero:
                        floor = wp.max(floor - half * reach * reach / inmost, near.gap - reach)
                    else:
                        floor = near.gap - reach
                left = floor < limit
                # Where another side of the shape is nearest than at the best place, both are as near in between.
                other = wp.dot(n, search.best.near.normal) < half and level < LEVELS
                last = level >= SMOOTH and not other
                if left and (near.gap < limit or last or search.looks > MOST):
                    search = started(p_a, p_b, x, q, vec2d(u, v), near, lowered, search)
                    left = not last and level < LEVELS and search.looks <= MOST
            if left:
                level += 1
            else:
                cell += 1 << (2 * (LEVELS - level))
                level = -1
        return search

    @wp.func
    def deepest(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, lowered: real):
        """The least distance over the patch."""
        radius = zero
        if wp.static(bounded):
            radius = wp.length(A.extents(p_a))
        search = Search()
        least = FAR
        first = vec2d()
        nearest_of_all = Nearest()
        n = vec3d()
        search.beside = UP
        plane = FAR
        for i in range(cells_u):
            for j in range(cells_v):
                u = u_0 + (real(i) + half) * step_u
                v = v_0 + (real(j) + half) * step_v
                place = position(p_b, u, v)
                # No nearer than the sphere around the shape.
                near_enough = wp.bool(True)
                if wp.static(bounded):
                    near_enough = wp.length(place - x) - radius - lowered < least
                if near_enough:
                    if lowered != zero:
                        at = element(p_b, u, v, lowered)
                        place = at.z
                    if wp.dot(n, place) - plane < least:
                        near = of_place(p_a, wp.quat_rotate_inv(q, place - x), search.beside, least)
                        search.beside = near.normal
                        search.looks += 1
                        if near.gap < least:
                            least = near.gap
                            first = vec2d(u, v)
                            nearest_of_all = near
                            n = wp.quat_rotate(q, near.normal)
                            plane = beyond(p_a, x, q, n)
        search.steps = search.looks
        search.looks = 0
        search = started(p_a, p_b, x, q, first, nearest_of_all, lowered, search)
        for i in range(cells_u):
            corner = position(p_b, u_0 + real(i) * step_u, v_0)
            for j in range(cells_v):
                place = position(p_b, u_0 + (real(i) + half) * step_u, v_0 + (real(j) + half) * step_v)
                other = position(p_b, u_0 + real(i) * step_u, v_0 + real(j + 1) * step_v)
                here = place - corner
                there = place - other
                corner = other
                reach = wp.max(wp.length(here), wp.length(there))
                left = wp.bool(True)
                if wp.static(bounded):
                    left = wp.length(place - x) - radius - lowered - MARGIN * reach < search.best.near.gap
                m = search.best.near.normal
                across = wp.max(wp.abs(wp.dot(m, here)), wp.abs(wp.dot(m, there)))
                left = (
                    left
                    and wp.dot(m, place) - search.plane - lowered - across - SPARE * reach < search.best.near.gap
                )
                if left:
                    search = divided(p_a, p_b, x, q, radius, i, j, lowered, search)
        if search.starts > STARTS and search.rest < search.best.near.gap:
            now, steps = polish(p_a, p_b, x, q, search.rest_u, lowered)
            search.steps += steps
            search.best = now
        return search.best, search.looks + search.steps

    return deepest
