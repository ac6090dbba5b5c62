"""Where a patch and a closed shape meet: the place of the patch that is deepest in the shape, or nearest to it.

The signed distance D(u, v) of the patch from the shape is looked at all over the patch, every time, until no other
place can be nearer (``covering.py``). Newton's method goes on from there to where the normals face each other. The
result depends on the pose alone, and on nothing that came before.

The least D is the contact as long as the shape is less deep than its own middle. Deeper, the nearest way out of
the shape is not the one back through the patch. The patch is then lowered along its normals by about the depth:
parallel surfaces have the same normals, so the contact is that with the lowered patch, its gap less by what it was
lowered.

Beyond an edge of the patch there is no contact: as at the boundary of a mesh, the place nearest to the shape
decides. Nor is there of a shape that lies wholly behind the tangent plane where it would touch.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.smooth.base import Meeting, Shape, half, one, real, two, vec3d, zero
from warpcontact.kernels.smooth.covering import FAR, Sight, covering
from warpcontact.kernels.smooth.curvature import curvature
from warpcontact.kernels.smooth.nearest import UP, nearest_within
from warpcontact.kernels.smooth.patch import ParametricSurface, jet_of_patch
from warpcontact.kernels.smooth.plane import Plane
from warpcontact.kernels.types import MET, NOT_CONVERGED, OUTSIDE

vec2d = wp.vec2d
mat22d = wp.mat22d

# How often a patch is lowered.
LOWERINGS = wp.constant(wp.int32(8))
# By how much more than it is deep, in terms of the shape's size.
MARGIN = wp.constant(real(0.02))
# 4 to 6 are usual; where a contact lies on the end of a rounded edge, it takes hundreds.
STEPS = wp.constant(wp.int32(1000))
# Within a shape, of a search that ends where two ways out are as short: that is no contact.
STEPS_INSIDE = wp.constant(wp.int32(100))
HALVINGS = wp.constant(wp.int32(40))
# Cosine between the normal of the shape and the tangents of the patch, at a contact.
ALLOWED = wp.constant(real(1.0e-9))
# Part of the descent that a slope promises.
ENOUGH = wp.constant(real(0.25))
# What is no curvature, in terms of the other principal value.
FLAT = wp.constant(real(1.0e-6))
GOAL = wp.constant(real(1.0e-14))


@functools.cache
def meet(A: type[Shape], B: type[ParametricSurface]) -> wp.Function:
    """Returns the device function of a closed shape and a patch; arguments as in ``meet.py``."""
    of_place, bent = nearest_within(A), curvature(A)
    jet_of = jet_of_patch(B)
    bounded = A is not Plane
    closed_u, closed_v = B.u_periodic, B.v_periodic
    u_0, u_1, v_0, v_1 = (wp.constant(real(value)) for value in (*B.u_range, *B.v_range))

    @wp.func
    def look(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, u: vec2d, lowered: real, start: vec3d, enough: real):
        at = Sight()
        at.u = u
        at.jet = jet_of(p_b, 0, u[0], u[1])
        at.normal = wp.normalize(wp.cross(at.jet.u, at.jet.v))
        at.place = at.jet.x - lowered * at.normal
        at.near = of_place(p_a, wp.quat_rotate_inv(q, at.place - x), wp.quat_rotate_inv(q, start), enough)
        at.near.normal = wp.quat_rotate(q, at.near.normal)
        at.near.point = x + wp.quat_rotate(q, at.near.point)
        at.tilt = vec2d(
            wp.dot(at.near.normal, at.jet.u) / wp.length(at.jet.u),
            wp.dot(at.near.normal, at.jet.v) / wp.length(at.jet.v),
        )
        at.lean = wp.length(at.tilt)
        return at

    @wp.func
    def inside(u: vec2d):
        """The nearest parameters of the domain."""
        first = u[0]
        second = u[1]
        if not wp.static(closed_u):
            first = wp.clamp(first, u_0, u_1)
        if not wp.static(closed_v):
            second = wp.clamp(second, v_0, v_1)
        return vec2d(first, second)

    @wp.func
    def at_edge(u: vec2d):
        edge_u = (u[0] <= u_0 or u[0] >= u_1) and wp.static(not closed_u)
        edge_v = (u[1] <= v_0 or u[1] >= v_1) and wp.static(not closed_v)
        return edge_u or edge_v

    @wp.func
    def leads_out(u: vec2d, step: vec2d, axis: int):
        """Whether a step from an edge of the patch is one across it."""
        if axis == 0 and wp.static(not closed_u):
            return (u[0] <= u_0 and step[0] < zero) or (u[0] >= u_1 and step[0] > zero)
        if axis == 1 and wp.static(not closed_v):
            return (u[1] <= v_0 and step[1] < zero) or (u[1] >= v_1 and step[1] > zero)
        return wp.bool(False)

    @wp.func
    def turn_of(p_a: Any, x: vec3d, q: wp.quatd, at: Sight, step: vec3d):
        """How the normal of the nearest point turns when the place moves by ``step``."""
        n = at.near.normal
        flat = step - wp.dot(step, n) * n
        n_A = wp.quat_rotate_inv(q, n)
        place = wp.quat_rotate_inv(q, at.near.point - x)
        k = bent(p_a, place, n_A, zero, zero)
        first = wp.quat_rotate(q, k.direction)
        second = wp.cross(n, first)
        return (
            stiff(k.k_1, at.near.gap) * wp.dot(flat, first) * first
            + stiff(k.k_2, at.near.gap) * wp.dot(flat, second) * second
        )

    @wp.func
    def stiff(k: real, gap: real):
        """Curvature of the parallel surface at a distance."""
        if k == zero:
            return zero
        radius = one / k + gap
        if radius == zero:
            return zero
        return one / radius

    @wp.func
    def over_saddle(J: mat22d, values: vec2d, E: real, F: real, G: real):
        """Newton's step with the principal values of the symmetric part of J taken as positive."""
        # On unit vectors along x_u and across.
        length = wp.sqrt(E)
        along = F / E
        wide = wp.sqrt(G - F * along)
        cross = half * (J[0, 1] + J[1, 0])
        uu = J[0, 0] / E
        uv = (cross - along * J[0, 0]) / (length * wide)
        vv = (J[1, 1] - real(2.0) * along * cross + along * along * J[0, 0]) / (wide * wide)
        by_u = values[0] / length
        by_v = (values[1] - along * values[0]) / wide
        mean = half * (uu + vv)
        apart = half * (uu - vv)
        size = wp.sqrt(apart * apart + uv * uv)
        angle = half * wp.atan2(uv, apart)
        c = wp.cos(angle)
        s = wp.sin(angle)
        first = mean + size
        second = mean - size
        least = FLAT * wp.max(wp.abs(first), wp.abs(second))
        if least == zero:
            return vec2d()
        first_step = -(c * by_u + s * by_v) / wp.max(wp.abs(first), least)
        second_step = -(c * by_v - s * by_u) / wp.max(wp.abs(second), least)
        on_u = c * first_step - s * second_step
        on_v = s * first_step + c * second_step
        return vec2d(on_u / length - along * on_v / wide, on_v / wide)

    @wp.func
    def newton(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, at: Sight, lowered: real):
        """Newton's step for the tangential parts of the normal, one off a saddle, the way down, and the slope."""
        jet = at.jet
        n = at.normal
        m = at.near.normal
        E = wp.dot(jet.u, jet.u)
        F = wp.dot(jet.u, jet.v)
        G = wp.dot(jet.v, jet.v)
        form = wp.inverse(mat22d(E, F, F, G))
        uu = wp.dot(n, jet.uu)
        uv = wp.dot(n, jet.uv)
        vv = wp.dot(n, jet.vv)
        # n changes by −b g⁻¹ x, the lowered patch along with it.
        by_u = form * vec2d(uu, uv)
        by_v = form * vec2d(uv, vv)
        z_u = jet.u + lowered * (by_u[0] * jet.u + by_u[1] * jet.v)
        z_v = jet.v + lowered * (by_v[0] * jet.u + by_v[1] * jet.v)
        m_u = turn_of(p_a, x, q, at, z_u)
        m_v = turn_of(p_a, x, q, at, z_v)
        values = vec2d(wp.dot(m, jet.u), wp.dot(m, jet.v))
        J = mat22d(
            wp.dot(m, jet.uu) + wp.dot(m_u, jet.u), wp.dot(m, jet.uv) + wp.dot(m_v, jet.u),
            wp.dot(m, jet.uv) + wp.dot(m_u, jet.v), wp.dot(m, jet.vv) + wp.dot(m_v, jet.v),
        )  # fmt: skip
        # The way down, if the patch were flat and the shape far.
        down = -(form * values)
        determinant = wp.determinant(J)
        step = down
        if determinant != zero:
            step = -(wp.inverse(J) * values)
        slope = vec2d(wp.dot(m, z_u), wp.dot(m, z_v))
        bent = wp.where(determinant > zero and J[0, 0] > zero, step, over_saddle(J, values, E, F, G))
        # Along an edge of the patch beyond which the distance falls on.
        if leads_out(at.u, -slope, 0):
            step = vec2d(zero, wp.where(J[1, 1] != zero, -values[1] / J[1, 1], zero))
            bent = step
            down[0] = zero
        elif leads_out(at.u, -slope, 1):
            step = vec2d(wp.where(J[0, 0] != zero, -values[0] / J[0, 0], zero), zero)
            bent = step
            down[1] = zero
        return step, bent, down, slope

    @wp.func
    def polish(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec2d, lowered: real):
        """The minimum of the distance that Newton's method comes to, within the domain."""
        at = look(p_a, p_b, x, q, start, lowered, UP, FAR)
        beside = at.near.normal
        steps = wp.int32(0)
        going = wp.bool(True)
        while going and steps < wp.where(at.near.gap < zero, STEPS_INSIDE, STEPS) and at.lean > GOAL:
            steps += 1
            step, bent, down, slope = newton(p_a, p_b, x, q, at, lowered)
            going = wp.bool(False)
            # Newton's step if it leads down and nearer to a root; else, or if that fails, that with the curvatures
            # taken as positive: down along a valley, whichever way it is bent; else the way down.
            for attempt in range(3):
                trial = step
                if attempt == 1:
                    trial = bent
                elif attempt == 2:
                    trial = (wp.abs(at.near.gap) + wp.length(at.jet.u) * (u_1 - u_0)) * down
                if wp.dot(slope, trial) < zero:
                    for _i in range(HALVINGS):
                        to = inside(at.u + trial)
                        rise = wp.min(wp.dot(slope, to - at.u), zero)
                        slack = GOAL * (wp.abs(at.near.gap) + wp.length(at.place - x))
                        now = look(p_a, p_b, x, q, to, lowered, beside, at.near.gap + two * slack)
                        beside = now.near.normal
                        # By a good part of what the slope promises: less is a jump across a valley.
                        lower = now.near.gap < at.near.gap + wp.min(ENOUGH * rise, -slack)
                        settled = now.near.gap <= at.near.gap + slack and now.lean < half * at.lean
                        if lower or settled:
                            at = now
                            going = wp.bool(True)
                            break
                        trial = half * trial
                if going:
                    break
        return at, steps

    deepest = covering(A, B, of_place, polish)

    @wp.func
    def wrapped(u: vec2d):
        """Parameters of a closed surface within their range."""
        first = u[0]
        second = u[1]
        if wp.static(closed_u):
            first = first - (u_1 - u_0) * wp.floor((first - u_0) / (u_1 - u_0))
        if wp.static(closed_v):
            second = second - (v_1 - v_0) * wp.floor((second - v_0) / (v_1 - v_0))
        return vec2d(first, second)

    @wp.func
    def met_by(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, seed: Any):
        q = wp.normalize(rotation)
        lowered = zero
        at, steps = deepest(p_a, p_b, x, q, lowered)
        for attempt in range(LOWERINGS):
            facing = wp.dot(at.near.normal, at.normal) < zero and at.lean <= ALLOWED
            # At the edge of the patch, or apart from it, it is where it is.
            if facing or at.near.gap >= zero:
                break
            if wp.static(bounded):
                # As deep as the shape goes below the tangent plane, and a little more: outside, the distance from
                # sharp edges is smooth.
                lowest = x + wp.quat_rotate(q, A.support(p_a, wp.quat_rotate_inv(q, -at.normal)))
                depth = wp.dot(at.normal, at.jet.x - lowest)
                more_than = MARGIN * real(attempt + 1) * wp.length(A.extents(p_a))
                lowered = wp.max(depth, lowered - at.near.gap) + more_than
            else:
                break
            at, more = deepest(p_a, p_b, x, q, lowered)
            steps += more

        met = Meeting()
        met.gap = at.near.gap - lowered
        met.normal = at.normal
        met.point_b = at.jet.x
        met.point_a = at.near.point
        met.iterations = steps
        met.residual = at.lean
        u = wrapped(at.u)
        met.seed.normal = met.normal
        met.seed.u = wp.vec4d(u[0], u[1], zero, zero)
        met.seed.known = 1
        met.status = MET
        facing = wp.dot(at.near.normal, at.normal) < zero
        if at.lean > ALLOWED or not facing:
            met.status = NOT_CONVERGED
            # Nearest to the edge, or apart from the patch and behind it.
            if at_edge(at.u) or (at.lean <= ALLOWED and met.gap >= zero):
                met.status = OUTSIDE
        elif wp.static(bounded):
            top = x + wp.quat_rotate(q, A.support(p_a, wp.quat_rotate_inv(q, at.normal)))
            if wp.dot(at.normal, top - at.jet.x) < zero:
                met.status = OUTSIDE
        return met

    return met_by
