"""Random pairs of convex shapes, and brute-force gaps from support functions in NumPy."""

import functools

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes.base import ShapeContactPoint, WarmStart
from warpcontact.kernels.shapes.pair_dispatch import pair_function

# The solver without a scene


@functools.cache
def _kernel(A, B):
    solve = pair_function(A, B)
    Of_a, Of_b = coefficient_struct(A, wp.float64), coefficient_struct(B, wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def solve_pairs(
        p_a: wp.array(dtype=Of_a),
        p_b: wp.array(dtype=Of_b),
        x: wp.array(dtype=wp.vec3d),
        q: wp.array(dtype=wp.quatd),
        seeds: wp.array(dtype=WarmStart),
        found: wp.array(dtype=ShapeContactPoint),
    ):
        i = wp.tid()
        found[i] = solve(p_a[i], p_b[i], x[i], q[i], seeds[i])

    return solve_pairs


def packed(shape, values, count, device="cpu"):
    """Returns the device coefficients of ``count`` shapes."""
    struct = coefficient_struct(shape, wp.float64)
    rows = np.zeros(count, dtype=struct.numpy_dtype())
    for name, value in values.items():
        rows[name] = value
    return wp.array(rows, dtype=struct, device=device)


def solved(A, B, a, b, x, q, seeds=None, device="cpu"):
    """Solves pairs; returns a structured array of shape contacts.

    Args:
        A: Class of the first shape.
        B: Class of the second shape, in whose frame the result is given.
        a: Parameters of A, by name.
        b: Parameters of B.
        x: Origins of A, (n, 3).
        q: Rotations of A, (n, 4).
        seeds: Warm starts of an earlier result.
        device: Warp device.
    """
    x = np.atleast_2d(np.asarray(x, dtype=float))
    count = len(x)
    q = np.broadcast_to(np.asarray(q, dtype=float), (count, 4))
    if seeds is None:
        seeds = np.zeros(count, dtype=WarmStart.numpy_dtype())
    found = wp.zeros(count, dtype=ShapeContactPoint, device=device)
    inputs = [
        packed(A, a, count, device),
        packed(B, b, count, device),
        wp.array(x, dtype=wp.vec3d, device=device),
        wp.array(q, dtype=wp.quatd, device=device),
        wp.array(seeds, dtype=WarmStart, device=device),
    ]
    wp.launch(_kernel(A, B), dim=count, inputs=inputs, outputs=[found], device=device)
    return found.numpy()


# Random pairs


def random_shapes(shape, count, rng, shortest=0.25, exponents=(0.1, 1.9)):
    """Returns parameters of ``count`` shapes with lengths between ``shortest`` and 1."""

    def sizes(*shape):
        return rng.uniform(shortest, 1.0, (count, *shape))

    match shape.__name__:
        case "Sphere":
            return {"radius": sizes()}
        case "Ellipsoid":
            return {"semi_axes": sizes(3)}
        case "Superellipsoid":
            return {"semi_axes": sizes(3), "exponents": rng.uniform(*exponents, (count, 2))}
        case "Cylinder" | "Capsule":
            return {"radius": sizes(), "half_length": sizes()}
        case "Cone":
            return {"radius": sizes(), "height": 1.5 * sizes()}
        case "RoundedBox":
            extents = sizes(3)
            rounded = np.where(rng.random(count) < 0.3, 0.0, rng.uniform(0.0, 0.9, count))
            return {"half_extents": extents, "radius": extents.min(axis=1) * rounded}
    return {}


def random_rotations(count, rng):
    """Returns unit quaternions (count, 4)."""
    return Rotation.random(count, random_state=rng).as_quat()


def random_pairs(A, B, count, seed=0, **options):
    """Returns parameters of both, and poses of A, for gaps from deep overlap to twice the size.

    The support planes of a random direction are −60 % to 200 % of the smaller mean width apart, most of them near
    contact. The shapes are also displaced along the planes, so the gap is that distance or more.
    """
    rng = np.random.default_rng(seed)
    a, b = random_shapes(A, count, rng, **options), random_shapes(B, count, rng, **options)
    q = random_rotations(count, rng)
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rotation = Rotation.from_quat(q).as_matrix()
    sum_of_supports = heights(B, b, n[:, None])[:, 0] + heights(A, a, to_a(rotation, -n[:, None]))[:, 0]
    size = np.minimum(_mean_width(A, a), _mean_width(B, b))
    gap = np.where(rng.random(count) < 0.5, rng.uniform(-0.6, 2.0, count), rng.uniform(-0.6, 0.2, count)) * size
    sideways = rng.normal(size=(count, 3)) * (0.2 * size * rng.random(count))[:, None]
    sideways -= np.sum(sideways * n, axis=1, keepdims=True) * n
    return a, b, (sum_of_supports + gap)[:, None] * n + sideways, q


def _mean_width(shape, values):
    n = directions(64)[None]
    return 2.0 * heights(shape, values, n).mean(axis=1)


# Brute force


def directions(count):
    """Returns ``count`` unit vectors spread over the sphere."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def to_a(rotation, n):
    """Rotates directions (n, d, 3) from the frame of b to that of a."""
    return np.einsum("nij,ndi->ndj", rotation, n)


def heights(shape, values, n):
    """Support functions of shapes along directions (n, d, 3) or (1, d, 3): (n, d)."""
    v = {name: np.asarray(value)[:, None] for name, value in values.items()}
    across = np.hypot(n[..., 0], n[..., 1])
    along = n[..., 2]
    match shape.__name__:
        case "Sphere":
            return v["radius"] * np.ones(n.shape[:2])
        case "Ellipsoid":
            return np.linalg.norm(v["semi_axes"] * n, axis=-1)
        case "Superellipsoid":
            # The maximum of n·y on a surface |y/a|^(2/e) … = 1 is the dual norm.
            p, r = 2.0 / (2.0 - v["exponents"][..., 0]), 2.0 / (2.0 - v["exponents"][..., 1])
            with np.errstate(under="ignore"):
                x, y, z = np.moveaxis(np.abs(v["semi_axes"] * n), -1, 0)
                flat = (x**r + y**r) ** (1.0 / r)
                return (flat**p + z**p) ** (1.0 / p)
        case "Cylinder":
            return v["radius"] * across + v["half_length"] * np.abs(along)
        case "Capsule":
            return v["radius"] + v["half_length"] * np.abs(along)
        case "Cone":
            return np.maximum(v["radius"] * across, v["height"] * along)
        case "RoundedBox":
            return np.sum((v["half_extents"] - v["radius"][..., None]) * np.abs(n), axis=-1) + v["radius"]
    raise ValueError(shape)


def widths(A, B, a, b, x, rotation, n):
    """g along directions (n, d, 3) or (1, d, 3): (n, d)."""
    n = np.broadcast_to(n, (len(x), *n.shape[1:]))
    return np.einsum("ndi,ni->nd", n, x) - heights(B, b, n) - heights(A, a, to_a(rotation, -n))


def chosen(values, rows):
    """Returns the selected rows of the parameters."""
    return {name: value[rows] for name, value in values.items()}


def brute_force(A, B, a, b, x, q, count=2000, best=6, rounds=30, block=500):
    """Returns the largest g found: over many directions, then refined around the best few."""
    rotation = Rotation.from_quat(q).as_matrix()
    around = directions(count)[None]
    found = np.empty(len(x))
    angle = 2.0 * np.pi * np.arange(10) / 10
    for first in range(0, len(x), block):
        rows = slice(first, first + block)
        pair = (A, B, chosen(a, rows), chosen(b, rows), x[rows], rotation[rows])
        g = widths(*pair, around)
        top = np.argpartition(-g, best, axis=1)[:, :best]
        n = around[0][top]
        value = np.take_along_axis(g, top, axis=1)
        radius = 3.0 / np.sqrt(count)
        for round_ in range(rounds):
            e_1 = np.cross(n, np.where(np.abs(n[..., :1]) < 0.6, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
            e_1 /= np.linalg.norm(e_1, axis=-1, keepdims=True)
            e_2 = np.cross(n, e_1)
            turned = angle + 0.37 * round_
            step = radius * np.concatenate([np.ones(5), 0.4 * np.ones(5)])[:, None]
            ring = step * (
                np.cos(turned)[:, None] * e_1[..., None, :] + np.sin(turned)[:, None] * e_2[..., None, :]
            )
            trial = n[..., None, :] + ring
            trial /= np.linalg.norm(trial, axis=-1, keepdims=True)
            shape = trial.shape
            values = widths(*pair, trial.reshape(shape[0], -1, 3)).reshape(shape[:3])
            pick = values.argmax(axis=-1)[..., None]
            better = np.take_along_axis(values, pick, axis=-1)[..., 0] > value
            value = np.maximum(value, np.take_along_axis(values, pick, axis=-1)[..., 0])
            n = np.where(better[..., None], np.take_along_axis(trial, pick[..., None], axis=-2)[..., 0, :], n)
            radius *= 0.7
        found[rows] = value.max(axis=1)
    return found


def outside(shape, values, y):
    """Level function of points (n, 3): 0 on the surface, negative inside, about a distance [m]."""
    across = np.hypot(y[:, 0], y[:, 1])
    match shape.__name__:
        case "Sphere":
            return np.linalg.norm(y, axis=1) - values["radius"]
        case "Ellipsoid":
            return np.linalg.norm(y / values["semi_axes"], axis=1) - 1.0
        case "Superellipsoid":
            p, r = 2.0 / values["exponents"].T
            a, b, c = np.abs(y / values["semi_axes"]).T
            with np.errstate(under="ignore"):
                return ((a**r + b**r) ** (p / r) + c**p) ** (1.0 / p) - 1.0
        case "Cylinder":
            return np.maximum(across - values["radius"], np.abs(y[:, 2]) - values["half_length"])
        case "Capsule":
            above = np.maximum(np.abs(y[:, 2]) - values["half_length"], 0.0)
            return np.hypot(across, above) - values["radius"]
        case "Cone":
            return np.maximum(across - values["radius"] * (1.0 - y[:, 2] / values["height"]), -y[:, 2])
        case "RoundedBox":
            core = values["half_extents"] - values["radius"][:, None]
            return np.linalg.norm(np.maximum(np.abs(y) - core, 0.0), axis=1) - values["radius"]
    raise ValueError(shape)


def check(A, B, pair, found, **effort):
    """Asserts that all pairs are solved with consistent gaps, points and residuals.

    The gap must be that of the support planes along the normal, and the vector between the points, which must lie
    in the shapes. If the gap is not negative, this proves that it is exact. In overlap, ``brute_force`` with this
    ``effort`` must not find a larger gap.
    """
    a, b, x, q = pair
    steep = "Superellipsoid" in (A.__name__, B.__name__)
    # Rounding of the normal by 1e-16 changes points of superellipsoids by a power of it, down to 1/19.
    allowed = 1e-5 if steep else 1e-11
    assert (found["status"] == 0).all()
    assert (found["residual"] <= (1e-6 if steep else 1e-9)).all()
    rotation = Rotation.from_quat(q).as_matrix()
    along = widths(A, B, a, b, x, rotation, found["normal"][:, None])[:, 0]
    np.testing.assert_allclose(np.linalg.norm(found["normal"], axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(found["gap"], along, atol=1e-11 if steep else 2e-13)
    between = found["point_a"] - found["point_b"] - found["gap"][:, None] * found["normal"]
    assert np.abs(between).max() < allowed
    in_a = np.einsum("nij,ni->nj", rotation, found["point_a"] - x)
    assert outside(A, a, in_a).max() < allowed
    assert outside(B, b, found["point_b"]).max() < allowed
    deep = found["gap"] < 0.0
    assert 0.2 < deep.mean() < 0.8
    best = brute_force(A, B, chosen(a, deep), chosen(b, deep), x[deep], q[deep], **effort)
    assert (found["gap"][deep] >= best - 1e-9).all()
