"""Parametric surfaces: open, user-defined surfaces of two parameters."""

import functools
import inspect
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.shapes.base import Shape, real, vec3d, zero

# Step of the difference formulas, relative to the parameter range: of sixth order, with truncation and rounding
# errors of about 1e-11 of the second derivatives each.
STEP = 5.0e-3


@wp.struct
class Jet:
    """A point of a surface and its derivatives with respect to u and v."""

    x: vec3d  # [m]
    u: vec3d
    v: vec3d
    uu: vec3d
    uv: vec3d
    vv: vec3d


class ParametricSurface(Shape):
    """A user-defined surface x(u, v) with the material below it. The outward normal is x_u × x_v.

    A subclass declares its parameters, the ranges of u and v, and the surface::

        class Bowl(wc.ParametricSurface):
            \"\"\"z = (x² + y²)/(2 R), a bowl that is open to the top.\"\"\"

            radius: float = wc.parameter("m", "radius R of curvature at the bottom", above=0.0)

            u_range = (-0.5, 0.5)
            v_range = (-0.5, 0.5)

            @wp.func
            def position(p: Any, u: Any, v: Any):
                return wp.vec3d(u, v, (u * u + v * v) / (wp.float64(2.0) * p.radius))

            @wp.func
            def derivatives(p: Any, u: Any, v: Any):
                zero, one = wp.float64(0.0), wp.float64(1.0)
                x_u = wp.vec3d(one, zero, u / p.radius)
                x_v = wp.vec3d(zero, one, v / p.radius)
                bend = wp.vec3d(zero, zero, one / p.radius)
                return x_u, x_v, bend, wp.vec3d(), bend

    All values are float64. ``derivatives`` returns x_u, x_v, x_uu, x_uv and x_vv. If it is not defined,
    differences of sixth order are used, with a relative error of 1e-11; ``position`` must then be defined 1.5 % of
    the range beyond its ends. The surface must be smooth, with x_u and x_v nowhere parallel.

    The surface is open: there is no contact beyond its edges, nor with a body entirely behind its tangent plane.
    If ``u_periodic`` (or ``v_periodic``) is true, the surface closes in that direction and the range is one
    period.
    """

    convex: ClassVar[bool] = False
    functions: ClassVar = {"position": "the point, a wp.vec3d"}

    #: Ranges of the parameters.
    u_range: ClassVar[tuple[float, float]]
    v_range: ClassVar[tuple[float, float]]
    #: Whether the surface is periodic in u or v.
    u_periodic: ClassVar[bool] = False
    v_periodic: ClassVar[bool] = False
    #: Numbers of grid cells for the contact search. Bulges of the surface must be wider than a cell; the other
    #: shape may be smaller, because cells are divided while they can contain a nearer point.
    scan: ClassVar[tuple[int, int]] = (48, 48)
    position: ClassVar[wp.Function]

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        for name in ("u_range", "v_range"):
            if hasattr(cls, name):
                _check_range(f"{cls.__name__}.{name}", getattr(cls, name))
        scan = cls.scan
        whole = isinstance(scan, Sequence) and len(scan) == 2 and all(isinstance(n, int) and n >= 4 for n in scan)
        if not whole:
            raise TypeError(f"{cls.__name__}.scan must be two whole numbers of at least 4, got {scan!r}")
        given = vars(cls).get("derivatives")
        if given is not None:
            if not isinstance(given, wp.Function):
                raise TypeError(f"{cls.__name__}.derivatives must be a wp.func of (p, u, v), got {given!r}")
            if len(inspect.signature(given.func).parameters) != 3:
                raise TypeError(f"{cls.__name__}.derivatives must take 3 arguments, (p, u, v)")

    @classmethod
    def arguments(cls) -> tuple[str, ...]:
        """Returns the argument names of its device functions."""
        return ("p", "u", "v")

    def __post_init__(self) -> None:
        super().__post_init__()
        cls = type(self)
        for name in ("u_range", "v_range"):
            if not hasattr(cls, name):
                raise TypeError(f"{cls.__name__}.{name} must be given: {name} = (first, last)")


def _check_range(name: str, values: Any) -> None:
    """Raises ``TypeError`` unless ``values`` are two increasing finite numbers."""
    try:
        ends = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        ends = np.empty(0)
    if ends.shape != (2,) or not np.all(np.isfinite(ends)) or ends[0] >= ends[1]:
        raise TypeError(f"{name} must be two increasing numbers, got {values!r}")


@functools.cache
def parametric_jet(A: type[ParametricSurface]) -> wp.Function:
    """Returns the device function ``(p, u, v)``: the ``Jet`` of a parametric surface."""
    position = A.position
    given = getattr(A, "derivatives", None)
    if given is not None:

        @wp.func
        def jet_of_derivatives(p: Any, u: real, v: real):
            jet = Jet()
            jet.x = position(p, u, v)
            x_u, x_v, x_uu, x_uv, x_vv = given(p, u, v)
            jet.u = x_u
            jet.v = x_v
            jet.uu = x_uu
            jet.uv = x_uv
            jet.vv = x_vv
            return jet

        return jet_of_derivatives

    du = wp.constant(real(STEP * (A.u_range[1] - A.u_range[0])))
    dv = wp.constant(real(STEP * (A.v_range[1] - A.v_range[0])))

    @wp.func
    def difference_along(p: Any, x: vec3d, u: real, v: real, step_u: real, step_v: real):
        """Returns the first and second difference of sixth order along a step."""
        first = vec3d()
        second = real(wp.static(-49.0 / 18.0)) * x
        for i in range(1, 4):
            k = real(i)
            after = position(p, u + k * step_u, v + k * step_v)
            before = position(p, u - k * step_u, v - k * step_v)
            w_1 = real(wp.static(3.0 / 4.0))
            w_2 = real(wp.static(3.0 / 2.0))
            if i == 2:
                w_1 = real(wp.static(-3.0 / 20.0))
                w_2 = real(wp.static(-3.0 / 20.0))
            elif i == 3:
                w_1 = real(wp.static(1.0 / 60.0))
                w_2 = real(wp.static(1.0 / 90.0))
            first += w_1 * (after - before)
            second += w_2 * (after + before)
        return first, second

    @wp.func
    def jet_of_differences(p: Any, u: real, v: real):
        jet = Jet()
        jet.x = position(p, u, v)
        x_u, x_uu = difference_along(p, jet.x, u, v, du, zero)
        x_v, x_vv = difference_along(p, jet.x, u, v, zero, dv)
        _x_1, x_11 = difference_along(p, jet.x, u, v, du, dv)
        _x_2, x_22 = difference_along(p, jet.x, u, v, du, -dv)
        jet.u = x_u / du
        jet.v = x_v / dv
        jet.uu = x_uu / (du * du)
        jet.vv = x_vv / (dv * dv)
        jet.uv = (x_11 - x_22) / (real(4.0) * du * dv)
        return jet

    return jet_of_differences
