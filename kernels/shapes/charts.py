"""Charts: parametrizations of surfaces by two parameters, with first and second derivatives.

A chart of a sphere or ellipsoid has a pole axis, 0, 1 or 2 (x, y or z): where one is singular, another is not.
Tangents are right-handed, u × v points out of the surface.
"""

import functools
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.shapes.base import Shape, one, real, two, vec3d, zero
from warpcontact.kernels.shapes.ellipsoid import Ellipsoid
from warpcontact.kernels.shapes.parametric_surface import Jet, ParametricSurface, parametric_jet
from warpcontact.kernels.shapes.sphere import Sphere
from warpcontact.kernels.shapes.superellipsoid import Superellipsoid
from warpcontact.kernels.shapes.torus import Torus

# Cosine of the latitude below which the pole is changed. With the best of three poles it is at least √(2/3).
POLE_COSINE = wp.constant(real(0.5))


@wp.func
def rotate_axes(x: vec3d, pole: wp.int32):
    """Permutes the components x, y, z cyclically so that that of ``pole`` is the third."""
    if pole == 0:
        return vec3d(x[2], x[0], x[1])
    if pole == 1:
        return vec3d(x[1], x[2], x[0])
    return x


@wp.func
def rotate_axes_back(x: vec3d, pole: wp.int32):
    """Inverts ``rotate_axes``."""
    if pole == 0:
        return vec3d(x[1], x[2], x[0])
    if pole == 1:
        return vec3d(x[2], x[0], x[1])
    return x


@wp.func
def best_pole(direction: vec3d):
    """Returns the axis with the largest angle to a direction."""
    pole = wp.int32(2)
    for i in range(2):
        if wp.abs(direction[i]) < wp.abs(direction[pole]):
            pole = i
    return pole


@wp.func
def signed_power(cosine: real, sine: real, exponent: real):
    """Returns sgn(cos w) |cos w|^e and its first and second derivative with respect to w."""
    if exponent == one:
        return cosine, -sine, -cosine
    size = wp.abs(cosine)
    value = wp.sign(cosine) * wp.pow(size, exponent)
    slope = -exponent * sine * wp.pow(size, exponent - one)
    bend = exponent * ((exponent - one) * sine * sine * wp.pow(size, exponent - two) - wp.pow(size, exponent))
    return value, slope, wp.sign(cosine) * bend


@wp.func
def latitude_longitude_jet(
    axes: vec3d, latitude_exponent: real, longitude_exponent: real, pole: wp.int32, u: real, v: real
):
    """Returns the jet for longitude u and latitude v about ``pole``, with the exponents of a superellipsoid."""
    c, c_u, c_uu = signed_power(wp.cos(u), wp.sin(u), longitude_exponent)
    quarter = real(wp.half_pi)
    s, s_u, s_uu = signed_power(wp.cos(u - quarter), wp.sin(u - quarter), longitude_exponent)
    p, p_v, p_vv = signed_power(wp.cos(v), wp.sin(v), latitude_exponent)
    r, r_v, r_vv = signed_power(wp.cos(v - quarter), wp.sin(v - quarter), latitude_exponent)
    jet = Jet()
    jet.x = wp.cw_mul(axes, rotate_axes_back(vec3d(p * c, p * s, r), pole))
    jet.u = wp.cw_mul(axes, rotate_axes_back(vec3d(p * c_u, p * s_u, zero), pole))
    jet.v = wp.cw_mul(axes, rotate_axes_back(vec3d(p_v * c, p_v * s, r_v), pole))
    jet.uu = wp.cw_mul(axes, rotate_axes_back(vec3d(p * c_uu, p * s_uu, zero), pole))
    jet.uv = wp.cw_mul(axes, rotate_axes_back(vec3d(p_v * c_u, p_v * s_u, zero), pole))
    jet.vv = wp.cw_mul(axes, rotate_axes_back(vec3d(p_vv * c, p_vv * s, r_vv), pole))
    return jet


@wp.func
def longitude_and_latitude(direction: vec3d, pole: wp.int32):
    """Returns longitude and latitude of a direction of any length."""
    d = rotate_axes(direction, pole)
    return wp.atan2(d[1], d[0]), wp.atan2(d[2], wp.sqrt(d[0] * d[0] + d[1] * d[1]))


@wp.func
def ellipsoid_jet(p: Any, pole: wp.int32, u: real, v: real):
    """Returns the jet of an ellipsoid."""
    return latitude_longitude_jet(p.semi_axes, one, one, pole, u, v)


@wp.func
def ellipsoid_parameters(p: Any, x: vec3d):
    """Returns the parameters of a point of an ellipsoid, and the best pole."""
    direction = wp.cw_div(x, p.semi_axes)
    pole = best_pole(direction)
    u, v = longitude_and_latitude(direction, pole)
    return u, v, pole


@wp.func
def sphere_jet(p: Any, pole: wp.int32, u: real, v: real):
    """Returns the jet of a sphere."""
    return latitude_longitude_jet(vec3d(p.radius, p.radius, p.radius), one, one, pole, u, v)


@wp.func
def sphere_parameters(p: Any, x: vec3d):
    """Returns the parameters of a point of a sphere, and the best pole."""
    pole = best_pole(x)
    u, v = longitude_and_latitude(x, pole)
    return u, v, pole


@wp.func
def superellipsoid_jet(p: Any, pole: wp.int32, u: real, v: real):
    """Returns the jet of a superellipsoid, regular within each octant."""
    return latitude_longitude_jet(p.semi_axes, p.exponents[0], p.exponents[1], 2, u, v)


@wp.func
def superellipsoid_parameters(p: Any, x: vec3d):
    """Returns the parameters of a point of a superellipsoid."""
    d = wp.cw_div(x, p.semi_axes)
    cosine = wp.pow(wp.abs(d[0]), one / p.exponents[1])
    sine = wp.pow(wp.abs(d[1]), one / p.exponents[1])
    u = wp.atan2(wp.where(d[1] < zero, -sine, sine), wp.where(d[0] < zero, -cosine, cosine))
    # |x/a|^(2/e₂) + |y/b|^(2/e₂) is cos(v)^(2 e₁/e₂).
    across = wp.pow(cosine * cosine + sine * sine, real(0.5) * p.exponents[1] / p.exponents[0])
    height = wp.pow(wp.abs(d[2]), one / p.exponents[0])
    v = wp.atan2(wp.where(d[2] < zero, -height, height), across)
    return u, v, 2


@wp.func
def torus_jet(p: Any, pole: wp.int32, u: real, v: real):
    """Returns the jet of a torus: u around the axis, v around the tube."""
    c = wp.cos(u)
    s = wp.sin(u)
    out = p.minor_radius * wp.cos(v)
    up = p.minor_radius * wp.sin(v)
    ring = p.major_radius + out
    jet = Jet()
    jet.x = vec3d(ring * c, ring * s, up)
    jet.u = vec3d(-ring * s, ring * c, zero)
    jet.v = vec3d(-up * c, -up * s, out)
    jet.uu = vec3d(-ring * c, -ring * s, zero)
    jet.uv = vec3d(up * s, -up * c, zero)
    jet.vv = vec3d(-out * c, -out * s, -up)
    return jet


@wp.func
def torus_parameters(p: Any, x: vec3d):
    """Returns the parameters of a point of a torus."""
    across = wp.sqrt(x[0] * x[0] + x[1] * x[1])
    return wp.atan2(x[1], x[0]), wp.atan2(x[2], across - p.major_radius), 2


class NoChartError(TypeError):
    """Raised for a shape without a chart."""


class Chart(NamedTuple):
    """The chart of a shape, in its frame."""

    #: ``(p, pole, u, v)``: the ``Jet``.
    jet: wp.Function
    #: ``(p, x)``: u, v and the best pole of a point x on the surface; ``None`` for parametric surfaces.
    parameters: wp.Function | None
    #: Whether the pole can be changed.
    poles: bool
    #: Whether v is a latitude: beyond ±90° the tangents are left-handed.
    latitude: bool


@functools.cache
def chart(A: type[Shape]) -> Chart:
    """Returns the chart of ``A``.

    Raises:
        NoChartError: If ``A`` has no chart.
    """
    if issubclass(A, ParametricSurface):
        return Chart(parametric_jet(A), None, poles=False, latitude=False)
    charts = {
        Sphere: Chart(sphere_jet, sphere_parameters, poles=True, latitude=True),
        Ellipsoid: Chart(ellipsoid_jet, ellipsoid_parameters, poles=True, latitude=True),
        Superellipsoid: Chart(superellipsoid_jet, superellipsoid_parameters, poles=False, latitude=True),
        Torus: Chart(torus_jet, torus_parameters, poles=False, latitude=False),
    }
    if A not in charts:
        raise NoChartError(
            f"{A.__name__} has no chart; available: {', '.join(kind.__name__ for kind in charts)}, ParametricSurface"
        )
    return charts[A]
