"""Pairs with a nonconvex shape: contacts on the device, and independent references in NumPy."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels import shapes
from warpcontact.kernels.catalogue.device_model import coefficient_struct, parameter
from warpcontact.kernels.shapes import pair_dispatch
from warpcontact.kernels.shapes.base import ShapeContactPoint, WarmStart
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.revolution import Torus

S = shapes


def packed(made):
    """Returns the coefficients of a shape as a struct in float64."""
    p = coefficient_struct(type(made), wp.float64)()
    values = type(made).coefficients({name: np.asarray(value) for name, value in made.parameters().items()})
    for name, value in values.items():
        setattr(p, name, wp.types.vector(len(value), wp.float64)(*value) if np.ndim(value) else float(value))
    return p


def shape_contacts(a, b, x, q, device, of_pair=None):
    """Returns the contacts of shapes a and b, one for each position x (n, 3) and rotation q (n, 4), a → b."""
    of_pair = of_pair or pair_dispatch.nonconvex_pair_function(type(a), type(b))
    P_a, P_b = (coefficient_struct(type(s), wp.float64) for s in (a, b))

    @wp.kernel(module="unique", enable_backward=False)
    def each(
        p_a: P_a,
        p_b: P_b,
        x: wp.array(dtype=wp.vec3d),
        q: wp.array(dtype=wp.quatd),
        out: wp.array(dtype=ShapeContactPoint),
    ):
        i = wp.tid()
        out[i] = of_pair(p_a, p_b, x[i], q[i], WarmStart())

    out = wp.zeros(len(x), dtype=ShapeContactPoint, device=device)
    given = [wp.array(x, dtype=wp.vec3d, device=device), wp.array(q, dtype=wp.quatd, device=device)]
    wp.launch(each, len(x), inputs=[packed(a), packed(b), *given, out], device=device)
    return out.numpy()


def random_rotations(random, count):
    """Returns unit quaternions (n, 4), uniformly distributed."""
    q = random.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def rotated(q, v):
    """Returns v (…, 3) rotated by quaternions q (…, 4)."""
    axis, w = q[..., :3], q[..., 3:]
    turned = 2.0 * np.cross(axis, v)
    return v + w * turned + np.cross(axis, turned)


def inverse_rotation(q):
    """Returns the inverse rotations."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def _length(v):
    return np.sqrt((v * v).sum(-1))


def _box(p, half):
    d = np.abs(p) - half
    return _length(np.maximum(d, 0.0)) + np.minimum(d.max(-1), 0.0)


def _ellipsoid(p, axes):
    """Distance by bisection for the multiplier t of the nearest point a² x/(t + a²)."""
    axes, p = np.broadcast_arrays(np.asarray(axes, dtype=np.float64), np.abs(p))
    squares = axes**2
    low = -squares.min(-1)
    high = np.linalg.norm(axes * p, axis=-1) + 1.0
    for _ in range(60):
        t = 0.5 * (low + high)
        with np.errstate(divide="ignore"):
            beyond = (((axes * p) / (t[..., None] + squares)) ** 2).sum(-1) > 1.0
        low, high = np.where(beyond, t, low), np.where(beyond, high, t)
    foot = squares * p / (high[..., None] + squares)
    # Near the middle surface, the component along the shortest axis is below rounding; it follows from the
    # equation.
    short = np.argmin(squares, -1)[..., None]
    rest = 1.0 - ((foot / axes) ** 2).sum(-1) + (np.take_along_axis(foot / axes, short, -1)[..., 0]) ** 2
    along = np.take_along_axis(axes, short, -1)[..., 0] * np.sqrt(np.maximum(rest, 0.0))
    np.put_along_axis(foot, short, along[..., None], -1)
    return _length(p - foot) * np.where(((p / axes) ** 2).sum(-1) > 1.0, 1.0, -1.0)


def signed_distance(shape: Any, p):
    """Returns the signed distance of points p (…, 3) from the surface of a shape, in its frame, negative inside."""
    across = _length(p[..., :2])
    if isinstance(shape, S.Sphere):
        return _length(p) - shape.radius
    if isinstance(shape, S.Plane):
        return p[..., 2]
    if isinstance(shape, S.Ellipsoid):
        return _ellipsoid(p, shape.semi_axes)
    if isinstance(shape, S.Capsule):
        along = p[..., 2] - np.clip(p[..., 2], -shape.half_length, shape.half_length)
        return np.hypot(across, along) - shape.radius
    if isinstance(shape, S.Cylinder):
        return _box(np.stack([across, p[..., 2]], -1), [shape.radius, shape.half_length])
    if isinstance(shape, S.RoundedBox):
        return _box(p, np.array(shape.half_extents) - shape.radius) - shape.radius
    if isinstance(shape, S.Cone):
        # In the half-plane of the axis the cone is a triangle; the nearest of its edges counts.
        corners = np.array([[0.0, 0.0], [shape.radius, 0.0], [0.0, shape.height]])
        at = np.stack([across, p[..., 2]], -1)
        nearest = np.full(across.shape, np.inf)
        for a, b in ((corners[0], corners[1]), (corners[1], corners[2])):
            t = np.clip(((at - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
            nearest = np.minimum(nearest, _length(at - (a + t[..., None] * (b - a))))
        inside = (at[..., 1] > 0.0) & (at[..., 0] / shape.radius + at[..., 1] / shape.height < 1.0)
        return np.where(inside, -nearest, nearest)
    if isinstance(shape, Torus):
        return np.hypot(across - shape.major_radius, p[..., 2]) - shape.minor_radius
    raise TypeError(shape)


class Quadric(ParametricSurface):
    """z = ½ (k_x x² + k_y y²): a bowl, a dome or a saddle, depending on the signs."""

    k_x: float = parameter("1/m", "curvature along x")
    k_y: float = parameter("1/m", "curvature along y")

    u_range = (-1.0, 1.0)
    v_range = (-1.0, 1.0)

    @wp.func
    def position(p: Any, u: Any, v: Any):
        return wp.vec3d(u, v, wp.float64(0.5) * (p.k_x * u * u + p.k_y * v * v))

    @wp.func
    def derivatives(p: Any, u: Any, v: Any):
        zero, one = wp.float64(0.0), wp.float64(1.0)
        x_u, x_v = wp.vec3d(one, zero, p.k_x * u), wp.vec3d(zero, one, p.k_y * v)
        return x_u, x_v, wp.vec3d(zero, zero, p.k_x), wp.vec3d(), wp.vec3d(zero, zero, p.k_y)
