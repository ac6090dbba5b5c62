"""Contact of two charts: Newton's method for four equations in four parameters.

With tangents s₁, s₂ of b and t₁, t₂ of a, N_a = t₁ × t₂, and d from the point of b to that of a,

    d·s₁ = d·s₂ = 0,  N_a·s₁ = N_a·s₂ = 0

state that d is normal to both surfaces. They imply n_a × n_b = 0 and d × n_b = 0 except at chart singularities, so
these are checked at the end. A pair has several roots: near and far sides, normals facing or parallel.
``Root.kind`` reports which one was found. Newton's method finds roots with a gap of either sign. A minimization of
the distance would not: in overlap the distance has no minimum at the contact.
"""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.shapes.base import Shape, half, real, vec3d, zero
from warpcontact.kernels.shapes.charts import POLE_COSINE, chart
from warpcontact.kernels.shapes.parametric_surface import Jet
from warpcontact.kernels.types import ROOT_FACING, ROOT_FALSE, ROOT_NONE, ROOT_PARALLEL

# Tolerance of the equations, relative to the size of the tangents.
TOLERANCE = wp.constant(real(1.0e-12))
# Tolerance of the cross products of unit vectors; false roots at chart singularities exceed it by far.
ALIGNED = wp.constant(real(1.0e-6))
MAX_HALVINGS = wp.constant(wp.int32(30))


@wp.struct
class Equations:
    """The four equations at given parameters."""

    values: wp.vec4d
    jacobian: wp.mat44d
    b: Jet  # frame of b
    a: Jet


@wp.struct
class Root:
    """End of the iteration."""

    kind: wp.int32  # ROOT_FACING, ROOT_PARALLEL, ROOT_FALSE or ROOT_NONE
    gap: real  # n·(point_a − point_b), n out of b [m]
    normal: vec3d  # out of b, frame of b
    point_a: vec3d  # frame of b [m]
    point_b: vec3d
    u: wp.vec4d  # parameters of b, then of a
    pole_b: wp.int32
    pole_a: wp.int32
    normal_cosine: real  # n_a·n_b; −1: facing
    residual: real  # of the equations, relative to the size of the tangents
    iterations: wp.int32


@wp.func
def transform_jet(jet: Jet, x: vec3d, q: wp.quatd):
    """Transforms a jet to the frame of b."""
    jet.x = x + wp.quat_rotate(q, jet.x)
    jet.u = wp.quat_rotate(q, jet.u)
    jet.v = wp.quat_rotate(q, jet.v)
    jet.uu = wp.quat_rotate(q, jet.uu)
    jet.uv = wp.quat_rotate(q, jet.uv)
    jet.vv = wp.quat_rotate(q, jet.vv)
    return jet


@wp.func
def equations_of(b: Jet, a: Jet):
    """Returns the equations and their derivatives with respect to u and v of b, then of a."""
    at = Equations()
    at.b = b
    at.a = a
    d = a.x - b.x
    N = wp.cross(a.u, a.v)
    N_u = wp.cross(a.uu, a.v) + wp.cross(a.u, a.uv)
    N_v = wp.cross(a.uv, a.v) + wp.cross(a.u, a.vv)
    at.values = wp.vec4d(wp.dot(d, b.u), wp.dot(d, b.v), wp.dot(N, b.u), wp.dot(N, b.v))
    at.jacobian = wp.mat44d(
        wp.dot(d, b.uu) - wp.dot(b.u, b.u), wp.dot(d, b.uv) - wp.dot(b.v, b.u), wp.dot(a.u, b.u), wp.dot(a.v, b.u),
        wp.dot(d, b.uv) - wp.dot(b.u, b.v), wp.dot(d, b.vv) - wp.dot(b.v, b.v), wp.dot(a.u, b.v), wp.dot(a.v, b.v),
        wp.dot(N, b.uu), wp.dot(N, b.uv), wp.dot(N_u, b.u), wp.dot(N_v, b.u),
        wp.dot(N, b.uv), wp.dot(N, b.vv), wp.dot(N_u, b.v), wp.dot(N_v, b.v),
    )  # fmt: skip
    return at


@wp.func
def equation_error(values: wp.vec4d, size_b: real, size_a: real):
    """Returns the norm of the equations, made dimensionless."""
    length_scale = size_b * (size_a + size_b)
    normal = size_b * size_a * size_a
    return wp.length(
        wp.vec4d(values[0] / length_scale, values[1] / length_scale, values[2] / normal, values[3] / normal)
    )


@functools.cache
def solver(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns ``(p_a, p_b, x, q, u, pole_a, pole_b, max_iterations)``: the ``Root`` of Newton's method from u.

    ``u`` are the initial parameters of b, then of a. A step is halved until the residual decreases. Near the pole
    of a chart, the solver changes to another pole.

    Raises:
        NoChartError: If a shape has no chart.
    """
    chart_a, chart_b = chart(A), chart(B)
    jet_a, parameters_a, poles_a, jet_b, parameters_b, poles_b = *chart_a[:3], *chart_b[:3]
    latitude_a, latitude_b = chart_a.latitude, chart_b.latitude

    @wp.func
    def equations(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, u: wp.vec4d, pole_a: wp.int32, pole_b: wp.int32):
        return equations_of(jet_b(p_b, pole_b, u[0], u[1]), transform_jet(jet_a(p_a, pole_a, u[2], u[3]), x, q))

    @wp.func
    def solve(
        p_a: Any,
        p_b: Any,
        x: vec3d,
        rotation: wp.quatd,
        start: wp.vec4d,
        start_pole_a: wp.int32,
        start_pole_b: wp.int32,
        max_iterations: wp.int32,
    ):
        q = wp.normalize(rotation)
        u = start
        pole_a = start_pole_a
        pole_b = start_pole_b
        at = equations(p_a, p_b, x, q, u, pole_a, pole_b)
        size_b = half * (wp.length(at.b.u) + wp.length(at.b.v))
        size_a = half * (wp.length(at.a.u) + wp.length(at.a.v))
        error = equation_error(at.values, size_b, size_a)
        iterations = wp.int32(0)
        progressing = wp.bool(True)
        while progressing and iterations < max_iterations and error > zero:
            if wp.static(poles_a):
                if wp.abs(wp.cos(u[3])) < POLE_COSINE:
                    u_a, v_a, new_a = parameters_a(p_a, wp.quat_rotate_inv(q, at.a.x - x))
                    u = wp.vec4d(u[0], u[1], u_a, v_a)
                    pole_a = new_a
                    at = equations(p_a, p_b, x, q, u, pole_a, pole_b)
                    error = equation_error(at.values, size_b, size_a)
            if wp.static(poles_b):
                if wp.abs(wp.cos(u[1])) < POLE_COSINE:
                    u_b, v_b, new_b = parameters_b(p_b, at.b.x)
                    u = wp.vec4d(u_b, v_b, u[2], u[3])
                    pole_b = new_b
                    at = equations(p_a, p_b, x, q, u, pole_a, pole_b)
                    error = equation_error(at.values, size_b, size_a)
            iterations += 1
            step = -(wp.inverse(at.jacobian) * at.values)
            progressing = wp.bool(False)
            for _i in range(MAX_HALVINGS):
                trial = equations(p_a, p_b, x, q, u + step, pole_a, pole_b)
                trial_error = equation_error(trial.values, size_b, size_a)
                if trial_error < error:
                    u = u + step
                    at = trial
                    error = trial_error
                    progressing = wp.bool(True)
                    break
                step = half * step

        root = Root()
        root.u = u
        root.pole_a = pole_a
        root.pole_b = pole_b
        root.iterations = iterations
        root.residual = error
        n_b = wp.normalize(wp.cross(at.b.u, at.b.v))
        n_a = wp.normalize(wp.cross(at.a.u, at.a.v))
        if wp.static(latitude_b):
            n_b = wp.sign(wp.cos(u[1])) * n_b
        if wp.static(latitude_a):
            n_a = wp.sign(wp.cos(u[3])) * n_a
        d = at.a.x - at.b.x
        root.normal = n_b
        root.gap = wp.dot(n_b, d)
        root.point_a = at.a.x
        root.point_b = at.b.x
        root.normal_cosine = wp.dot(n_a, n_b)
        root.kind = ROOT_NONE
        if error <= TOLERANCE:
            root.kind = ROOT_FALSE
            across = wp.length(wp.cross(d, n_b))
            if wp.length(wp.cross(n_a, n_b)) <= ALIGNED and across <= ALIGNED * (size_a + size_b):
                root.kind = wp.where(root.normal_cosine < zero, ROOT_FACING, ROOT_PARALLEL)
        return root

    return solve
