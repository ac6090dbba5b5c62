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
from warpcontact.kernels.shapes.base import Shape, ShapeContactPoint, half, one, real, two, vec3d, zero
from warpcontact.kernels.shapes.curvature import curvature
from warpcontact.kernels.shapes.parametric_branch_and_bound import INFINITE, SurfaceSample, global_search
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface, parametric_jet
from warpcontact.kernels.shapes.plane import Plane
from warpcontact.kernels.shapes.signed_distance import UP, signed_distance_within
from warpcontact.kernels.types import MET, NOT_CONVERGED, OUTSIDE

vec2d = wp.vec2d
mat22d = wp.mat22d

# How often a patch is lowered.
MAX_OFFSETS = wp.constant(wp.int32(8))
# By how much more than it is deep, in terms of the shape's size.
OFFSET_MARGIN = wp.constant(real(0.02))
# 4 to 6 are usual; where a contact lies on the end of a rounded edge, it takes hundreds.
MAX_STEPS = wp.constant(wp.int32(1000))
# Within a shape, of a search that ends where two ways out are as short: that is no contact.
STEPS_INSIDE = wp.constant(wp.int32(100))
MAX_HALVINGS = wp.constant(wp.int32(40))
# Cosine between the normal of the shape and the tangents of the patch, at a contact.
MAX_MISALIGNMENT = wp.constant(real(1.0e-9))
# Part of the descent that a slope promises.
MIN_DESCENT = wp.constant(real(0.25))
# What is no curvature, in terms of the other principal value.
MIN_CURVATURE_RATIO = wp.constant(real(1.0e-6))
TARGET_MISALIGNMENT = wp.constant(real(1.0e-14))


@functools.cache
def pair_function(A: type[Shape], B: type[ParametricSurface]) -> wp.Function:
    """Returns the device function of a closed shape and a patch; arguments as in ``meet.py``."""
    distance_at, curvature_at = signed_distance_within(A), curvature(A)
    jet_of = parametric_jet(B)
    bounded = A is not Plane
    closed_u, closed_v = B.u_periodic, B.v_periodic
    u_0, u_1, v_0, v_1 = (wp.constant(real(value)) for value in (*B.u_range, *B.v_range))

    @wp.func
    def evaluate(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, u: vec2d, offset: real, start: vec3d, threshold: real):
        at = SurfaceSample()
        at.u = u
        at.jet = jet_of(p_b, 0, u[0], u[1])
        at.normal = wp.normalize(wp.cross(at.jet.u, at.jet.v))
        at.offset_point = at.jet.x - offset * at.normal
        at.closest = distance_at(
            p_a, wp.quat_rotate_inv(q, at.offset_point - x), wp.quat_rotate_inv(q, start), threshold
        )
        at.closest.normal = wp.quat_rotate(q, at.closest.normal)
        at.closest.point = x + wp.quat_rotate(q, at.closest.point)
        at.tangent_cosines = vec2d(
            wp.dot(at.closest.normal, at.jet.u) / wp.length(at.jet.u),
            wp.dot(at.closest.normal, at.jet.v) / wp.length(at.jet.v),
        )
        at.misalignment = wp.length(at.tangent_cosines)
        return at

    @wp.func
    def clamp_to_domain(u: vec2d):
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
    def leaves_domain(u: vec2d, step: vec2d, axis: int):
        """Whether a step from an edge of the patch is one across it."""
        if axis == 0 and wp.static(not closed_u):
            return (u[0] <= u_0 and step[0] < zero) or (u[0] >= u_1 and step[0] > zero)
        if axis == 1 and wp.static(not closed_v):
            return (u[1] <= v_0 and step[1] < zero) or (u[1] >= v_1 and step[1] > zero)
        return wp.bool(False)

    @wp.func
    def normal_change(p_a: Any, x: vec3d, q: wp.quatd, at: SurfaceSample, step: vec3d):
        """How the normal of the nearest point turns when the place moves by ``step``."""
        n = at.closest.normal
        flat = step - wp.dot(step, n) * n
        n_A = wp.quat_rotate_inv(q, n)
        point = wp.quat_rotate_inv(q, at.closest.point - x)
        k = curvature_at(p_a, point, n_A, zero, zero)
        first = wp.quat_rotate(q, k.direction)
        second = wp.cross(n, first)
        return (
            parallel_curvature(k.k_1, at.closest.gap) * wp.dot(flat, first) * first
            + parallel_curvature(k.k_2, at.closest.gap) * wp.dot(flat, second) * second
        )

    @wp.func
    def parallel_curvature(k: real, gap: real):
        """Curvature of the parallel surface at a distance."""
        if k == zero:
            return zero
        radius = one / k + gap
        if radius == zero:
            return zero
        return one / radius

    @wp.func
    def saddle_step(J: mat22d, values: vec2d, E: real, F: real, G: real):
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
        half_difference = half * (uu - vv)
        size = wp.sqrt(half_difference * half_difference + uv * uv)
        angle = half * wp.atan2(uv, half_difference)
        c = wp.cos(angle)
        s = wp.sin(angle)
        first = mean + size
        second = mean - size
        least = MIN_CURVATURE_RATIO * wp.max(wp.abs(first), wp.abs(second))
        if least == zero:
            return vec2d()
        first_step = -(c * by_u + s * by_v) / wp.max(wp.abs(first), least)
        second_step = -(c * by_v - s * by_u) / wp.max(wp.abs(second), least)
        on_u = c * first_step - s * second_step
        on_v = s * first_step + c * second_step
        return vec2d(on_u / length - along * on_v / wide, on_v / wide)

    @wp.func
    def newton_steps(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, at: SurfaceSample, offset: real):
        """Newton's step for the tangential parts of the normal, one off a saddle, the way down, and the slope."""
        jet = at.jet
        n = at.normal
        m = at.closest.normal
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
        z_u = jet.u + offset * (by_u[0] * jet.u + by_u[1] * jet.v)
        z_v = jet.v + offset * (by_v[0] * jet.u + by_v[1] * jet.v)
        m_u = normal_change(p_a, x, q, at, z_u)
        m_v = normal_change(p_a, x, q, at, z_v)
        values = vec2d(wp.dot(m, jet.u), wp.dot(m, jet.v))
        J = mat22d(
            wp.dot(m, jet.uu) + wp.dot(m_u, jet.u), wp.dot(m, jet.uv) + wp.dot(m_v, jet.u),
            wp.dot(m, jet.uv) + wp.dot(m_u, jet.v), wp.dot(m, jet.vv) + wp.dot(m_v, jet.v),
        )  # fmt: skip
        # The way down, if the patch were flat and the shape far.
        descent = -(form * values)
        determinant = wp.determinant(J)
        step = descent
        if determinant != zero:
            step = -(wp.inverse(J) * values)
        slope = vec2d(wp.dot(m, z_u), wp.dot(m, z_v))
        modified_step = wp.where(determinant > zero and J[0, 0] > zero, step, saddle_step(J, values, E, F, G))
        # Along an edge of the patch beyond which the distance falls on.
        if leaves_domain(at.u, -slope, 0):
            step = vec2d(zero, wp.where(J[1, 1] != zero, -values[1] / J[1, 1], zero))
            modified_step = step
            descent[0] = zero
        elif leaves_domain(at.u, -slope, 1):
            step = vec2d(wp.where(J[0, 0] != zero, -values[0] / J[0, 0], zero), zero)
            modified_step = step
            descent[1] = zero
        return step, modified_step, descent, slope

    @wp.func
    def refine(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, start: vec2d, offset: real):
        """The minimum of the distance that Newton's method comes to, within the domain."""
        at = evaluate(p_a, p_b, x, q, start, offset, UP, INFINITE)
        start_normal = at.closest.normal
        steps = wp.int32(0)
        progressing = wp.bool(True)
        while (
            progressing
            and steps < wp.where(at.closest.gap < zero, STEPS_INSIDE, MAX_STEPS)
            and at.misalignment > TARGET_MISALIGNMENT
        ):
            steps += 1
            step, modified_step, descent, slope = newton_steps(p_a, p_b, x, q, at, offset)
            progressing = wp.bool(False)
            # Newton's step if it leads down and nearer to a root; else, or if that fails, that with the curvatures
            # taken as positive: down along a valley, whichever way it is modified_step; else the way down.
            for attempt in range(3):
                trial = step
                if attempt == 1:
                    trial = modified_step
                elif attempt == 2:
                    trial = (wp.abs(at.closest.gap) + wp.length(at.jet.u) * (u_1 - u_0)) * descent
                if wp.dot(slope, trial) < zero:
                    for _i in range(MAX_HALVINGS):
                        to = clamp_to_domain(at.u + trial)
                        rise = wp.min(wp.dot(slope, to - at.u), zero)
                        slack = TARGET_MISALIGNMENT * (wp.abs(at.closest.gap) + wp.length(at.offset_point - x))
                        now = evaluate(p_a, p_b, x, q, to, offset, start_normal, at.closest.gap + two * slack)
                        start_normal = now.closest.normal
                        # By a good part of what the slope promises: less is a jump across a valley.
                        lower = now.closest.gap < at.closest.gap + wp.min(MIN_DESCENT * rise, -slack)
                        converged = (
                            now.closest.gap <= at.closest.gap + slack and now.misalignment < half * at.misalignment
                        )
                        if lower or converged:
                            at = now
                            progressing = wp.bool(True)
                            break
                        trial = half * trial
                if progressing:
                    break
        return at, steps

    closest_sample = global_search(A, B, distance_at, refine)

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
    def find_contact(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, warm_start: Any):
        q = wp.normalize(rotation)
        offset = zero
        at, steps = closest_sample(p_a, p_b, x, q, offset)
        for attempt in range(MAX_OFFSETS):
            normals_face = wp.dot(at.closest.normal, at.normal) < zero and at.misalignment <= MAX_MISALIGNMENT
            # At the edge of the patch, or apart from it, it is where it is.
            if normals_face or at.closest.gap >= zero:
                break
            if wp.static(bounded):
                # As deep as the shape goes below the tangent plane, and a little more: outside, the distance from
                # sharp edges is smooth.
                lowest = x + wp.quat_rotate(q, A.support(p_a, wp.quat_rotate_inv(q, -at.normal)))
                depth = wp.dot(at.normal, at.jet.x - lowest)
                extra_offset = OFFSET_MARGIN * real(attempt + 1) * wp.length(A.extents(p_a))
                offset = wp.max(depth, offset - at.closest.gap) + extra_offset
            else:
                break
            at, extra_steps = closest_sample(p_a, p_b, x, q, offset)
            steps += extra_steps

        contact = ShapeContactPoint()
        contact.gap = at.closest.gap - offset
        contact.normal = at.normal
        contact.point_b = at.jet.x
        contact.point_a = at.closest.point
        contact.iterations = steps
        contact.residual = at.misalignment
        u = wrapped(at.u)
        contact.warm_start.normal = contact.normal
        contact.warm_start.u = wp.vec4d(u[0], u[1], zero, zero)
        contact.warm_start.valid = 1
        contact.status = MET
        normals_face = wp.dot(at.closest.normal, at.normal) < zero
        if at.misalignment > MAX_MISALIGNMENT or not normals_face:
            contact.status = NOT_CONVERGED
            # Nearest to the edge, or apart from the patch and behind it.
            if at_edge(at.u) or (at.misalignment <= MAX_MISALIGNMENT and contact.gap >= zero):
                contact.status = OUTSIDE
        elif wp.static(bounded):
            top = x + wp.quat_rotate(q, A.support(p_a, wp.quat_rotate_inv(q, at.normal)))
            if wp.dot(at.normal, top - at.jet.x) < zero:
                contact.status = OUTSIDE
        return contact

    return find_contact
