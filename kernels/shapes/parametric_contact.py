"""Contact of a closed shape and a parametric surface: the surface point that is deepest in the shape or nearest.

The signed distance D(u, v) of the surface from the shape is minimized globally in every step
(``parametric_branch_and_bound.py``). Newton's method then solves for facing normals. The result depends on the
pose only.

The minimum of D is the contact while the penetration is less than about half the shape. In deeper overlap the
shortest separation would not be back through the surface. The surface is then offset along −normal by about the
penetration. Parallel surfaces have the same normals, so the contact equals that of the offset surface, with the
offset subtracted from its gap.

Beyond an edge of the surface there is no contact, as at the boundary of a mesh. Neither is there if the shape is
entirely behind the tangent plane at the contact point.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import Plane, Shape, ShapeContactPoint, half, one, real, two, vec3d, zero
from warpcontact.kernels.shapes.curvature import curvature
from warpcontact.kernels.shapes.parametric_branch_and_bound import INFINITE, SurfaceSample, global_search
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface, parametric_jet
from warpcontact.kernels.shapes.signed_distance import UP, signed_distance_within
from warpcontact.kernels.types import MET, NOT_CONVERGED, OUTSIDE

vec2d = wp.vec2d
mat22d = wp.mat22d

# Maximum number of surface offsets.
MAX_OFFSETS = wp.constant(wp.int32(8))
# Extra offset beyond the depth, relative to the size of the shape.
OFFSET_MARGIN = wp.constant(real(0.02))
# Usually 4 to 6; a contact at the end of a rounded edge takes hundreds.
MAX_STEPS = wp.constant(wp.int32(1000))
# Limit inside a shape, where a search can end between two equally short separations: no contact.
STEPS_INSIDE = wp.constant(wp.int32(100))
MAX_HALVINGS = wp.constant(wp.int32(40))
# Largest cosine between the normal of the shape and the tangents of the surface at a contact.
MAX_MISALIGNMENT = wp.constant(real(1.0e-9))
# Required fraction of the descent predicted by the slope.
MIN_DESCENT = wp.constant(real(0.25))
# Smallest principal value, relative to the other one.
MIN_CURVATURE_RATIO = wp.constant(real(1.0e-6))
TARGET_MISALIGNMENT = wp.constant(real(1.0e-14))


@functools.cache
def pair_function(A: type[Shape], B: type[ParametricSurface]) -> wp.Function:
    """Returns the device function for a closed shape and a parametric surface; see ``pair_dispatch.py``."""
    distance_at, curvature_at = signed_distance_within(A), curvature(A)
    jet_of = parametric_jet(B)
    bounded = A is not Plane
    closed_u, closed_v = B.u_periodic, B.v_periodic
    u_0, u_1, v_0, v_1 = (wp.constant(real(value)) for value in (*B.u_range, *B.v_range))

    @wp.func
    def evaluate(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, u: vec2d, offset: real, start: vec3d, threshold: real):
        at = SurfaceSample()
        at.u = u
        at.jet = jet_of(p_b, u[0], u[1])
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
        """Returns the nearest parameters in the domain."""
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
        """Returns whether a step from an edge of the surface leaves the domain."""
        if axis == 0 and wp.static(not closed_u):
            return (u[0] <= u_0 and step[0] < zero) or (u[0] >= u_1 and step[0] > zero)
        if axis == 1 and wp.static(not closed_v):
            return (u[1] <= v_0 and step[1] < zero) or (u[1] >= v_1 and step[1] > zero)
        return wp.bool(False)

    @wp.func
    def normal_change(p_a: Any, x: vec3d, q: wp.quatd, at: SurfaceSample, step: vec3d):
        """Returns the change of the shape normal at the closest point when the query point moves by ``step``."""
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
        """Returns the curvature of the parallel surface at a distance."""
        if k == zero:
            return zero
        radius = one / k + gap
        if radius == zero:
            return zero
        return one / radius

    @wp.func
    def saddle_step(J: mat22d, values: vec2d, E: real, F: real, G: real):
        """Returns Newton's step with absolute principal values of the symmetric part of J."""
        # On unit vectors along x_u and normal to it.
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
        min_curvature = MIN_CURVATURE_RATIO * wp.max(wp.abs(first), wp.abs(second))
        if min_curvature == zero:
            return vec2d()
        first_step = -(c * by_u + s * by_v) / wp.max(wp.abs(first), min_curvature)
        second_step = -(c * by_v - s * by_u) / wp.max(wp.abs(second), min_curvature)
        on_u = c * first_step - s * second_step
        on_v = s * first_step + c * second_step
        return vec2d(on_u / length - along * on_v / wide, on_v / wide)

    @wp.func
    def newton_steps(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, at: SurfaceSample, offset: real):
        """Returns Newton's step, the step with absolute curvatures, the descent direction and the slope of D."""
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
        # n changes by −b g⁻¹ x; the offset surface follows.
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
        # Descent direction for a flat surface and a distant shape.
        descent = -(form * values)
        determinant = wp.determinant(J)
        step = descent
        if determinant != zero:
            step = -(wp.inverse(J) * values)
        slope = vec2d(wp.dot(m, z_u), wp.dot(m, z_v))
        modified_step = wp.where(determinant > zero and J[0, 0] > zero, step, saddle_step(J, values, E, F, G))
        # Along an edge of the surface beyond which the distance decreases.
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
        """Returns the minimum of the distance that Newton's method reaches within the domain, and the steps."""
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
            # Newton's step if it descends and approaches a root. If it fails, the step with absolute curvatures,
            # which descends along valleys. If both fail, the descent direction.
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
                        # Require a fraction of the predicted descent: less would be a jump across a valley.
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
        """Returns the parameters of a closed surface within their range."""
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
            # At an edge of the surface, or apart from it, the minimum of D is final.
            if normals_face or at.closest.gap >= zero:
                break
            if wp.static(bounded):
                # Offset by the depth of the shape below the tangent plane plus a margin: outside, the distance
                # from sharp edges is smooth.
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
            # Nearest to the edge, or behind the surface without contact.
            if at_edge(at.u) or (at.misalignment <= MAX_MISALIGNMENT and contact.gap >= zero):
                contact.status = OUTSIDE
        elif wp.static(bounded):
            top = x + wp.quat_rotate(q, A.support(p_a, wp.quat_rotate_inv(q, at.normal)))
            if wp.dot(at.normal, top - at.jet.x) < zero:
                contact.status = OUTSIDE
        return contact

    return find_contact
