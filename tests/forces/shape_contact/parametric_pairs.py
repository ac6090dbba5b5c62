"""Random pairs of a shape and a parametric surface (patch), and conditions on their contacts."""

from typing import Any

import numpy as np
import warp as wp
from convex_pairs import directions, heights, random_rotations, random_shapes
from nonconvex_pairs import Quadric, inverse_rotation, rotated
from parametric_reference import GRID, Reference
from warpcontact.kernels import shapes as S
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.types import MET, NOT_CONVERGED, OUTSIDE

# A point counts as nearer if its distance is smaller by more than TIE. The solver returns one of several minima
# within two of the finest cells, 1/1000 of the patch, whose distances differ by 1e-8 at most.
TIE = 1e-7
# Slope of the distance along the patch that counts as zero. If two exits from the shape are equally near, the
# slope is arbitrary.
LEVEL = 1e-5
# Penetration relative to the radius of curvature of a convex patch above which its normals soon intersect.
DEEP = 0.5
# Distance from the edge of a patch, in its parameters, at which a search that leads there ends.
BESIDE = 1e-6


class Waves(ParametricSurface):
    """z = h sin(k x) sin(k y), without analytic derivatives."""

    high: float = parameter("m", "height h")
    wave: float = parameter("1/m", "wave number k")

    u_range = (-1.0, 1.0)
    v_range = (-1.0, 1.0)

    @wp.func
    def position(p: Any, u: Any, v: Any):
        return wp.vec3d(u, v, p.high * wp.sin(p.wave * u) * wp.sin(p.wave * v))


class Tube(ParametricSurface):
    """A round bar along z, periodic in u."""

    radius: float = parameter("m", "radius", above=0.0)

    u_range = (0.0, 2.0 * np.pi)
    v_range = (-1.0, 1.0)
    u_periodic = True

    @wp.func
    def position(p: Any, u: Any, v: Any):
        return wp.vec3d(p.radius * wp.cos(u), p.radius * wp.sin(u), v)


class Bore(ParametricSurface):
    """A round hole along z, periodic in u."""

    radius: float = parameter("m", "radius", above=0.0)

    u_range = (0.0, 2.0 * np.pi)
    v_range = (-1.0, 1.0)
    u_periodic = True

    @wp.func
    def position(p: Any, u: Any, v: Any):
        return wp.vec3d(p.radius * wp.cos(u), -p.radius * wp.sin(u), v)


PATCHES = (Quadric, Waves, Tube, Bore)


def random_patches(P, count, random):
    """Returns parameters of patches, and the largest curvature of each where it is convex [1/m]."""
    if P is Quadric:
        k_x, k_y = random.uniform(-1.2, 1.2, (2, count))
        return {"k_x": k_x, "k_y": k_y}, np.maximum(0.0, np.maximum(-k_x, -k_y))
    if P is Waves:
        high, wave = random.uniform(0.02, 0.1, count), random.uniform(2.0, 5.0, count)
        return {"high": high, "wave": wave}, high * wave**2
    radius = random.uniform(0.4, 1.5, count)
    return {"radius": radius}, 1.0 / radius if P is Tube else 0.0 * radius


def random_bodies(A, count, random, scale=0.3):
    """Returns parameters of shapes with a size of at most ``scale``, or 1.5 times that."""
    if A is Torus:
        major = scale * random.uniform(0.25, 1.0, count)
        return {"major_radius": major, "minor_radius": major * random.uniform(0.1, 0.9, count)}
    sizes = random_shapes(A, count, random)
    return {name: value if name == "exponents" else scale * value for name, value in sizes.items()}


def support(A, a, n):
    """Support functions along directions (count, d, 3) in the frame of the shape."""
    if A is Torus:
        return a["major_radius"][:, None] * np.hypot(n[..., 0], n[..., 1]) + a["minor_radius"][:, None]
    return heights(A, a, n)


def evaluate_surface(P, b, u, v):
    """Returns points of patches and their normals."""
    if P in (Tube, Bore):
        sign = 1.0 if P is Tube else -1.0
        round_ = np.stack([np.cos(u), sign * np.sin(u), 0.0 * u], axis=-1)
        return b["radius"][:, None] * round_ + np.outer(v, [0.0, 0.0, 1.0]), sign * round_
    if P is Quadric:
        z, z_u, z_v = 0.5 * (b["k_x"] * u * u + b["k_y"] * v * v), b["k_x"] * u, b["k_y"] * v
    else:
        h, k = b["high"], b["wave"]
        z = h * np.sin(k * u) * np.sin(k * v)
        z_u, z_v = h * k * np.cos(k * u) * np.sin(k * v), h * k * np.sin(k * u) * np.cos(k * v)
    n = np.stack([-z_u, -z_v, 1.0 + 0.0 * u], axis=-1)
    return np.stack([u, v, z], axis=-1), n / np.linalg.norm(n, axis=1, keepdims=True)


def random_pairs(A, P, count, seed):
    """Returns parameters of both, poses of the shape, and the largest curvature of the patch.

    Along the normal at a random point of the patch, the distance is −60 % to 200 % of the mean width of the shape,
    mostly near contact. The shape is also displaced sideways.
    """
    random = np.random.default_rng(seed)
    a, (b, bend) = random_bodies(A, count, random), random_patches(P, count, random)
    q = random_rotations(count, random)
    u = random.uniform(0.0, 2.0 * np.pi, count) if P.u_periodic else random.uniform(-0.8, 0.8, count)
    closest, n = evaluate_surface(P, b, u, random.uniform(-0.8, 0.8, count))
    if A is S.Plane:
        # Half-spaces that face the patch, tilted by up to about 30°.
        z = -n + 0.15 * random.normal(size=(count, 3))
        z /= np.linalg.norm(z, axis=1, keepdims=True)
        half = np.column_stack([-z[:, 1], z[:, 0], 0.0 * z[:, 0], 1.0 + z[:, 2]])
        q = half / np.linalg.norm(half, axis=1, keepdims=True)
        return a, b, closest + n * random.uniform(-0.3, 0.6, (count, 1)), q, bend
    size = 2.0 * support(A, a, np.broadcast_to(directions(64), (count, 64, 3))).mean(axis=1)
    gap = np.where(random.random(count) < 0.5, random.uniform(-0.6, 2.0, count), random.uniform(-0.6, 0.2, count))
    offset = random.normal(size=(count, 3)) * (0.2 * size * random.random(count))[:, None]
    offset -= np.sum(offset * n, axis=1, keepdims=True) * n
    out = gap * size + support(A, a, rotated(inverse_rotation(q), -n)[:, None])[:, 0]
    return a, b, closest + out[:, None] * n + offset, q, bend


def is_at_boundary(P, place):
    """Whether the points found are on the edge of a patch."""
    across = np.abs(place["v"]) > 1.0 - BESIDE
    return across if P.u_periodic else across | (np.abs(place["u"]) > 1.0 - BESIDE)


def facing(P, place):
    """Whether normals of shape and patch are opposite at the points found."""
    return (place["tilt"] < LEVEL) & (place["along"] < -0.999) & ~is_at_boundary(P, place)


def classify_contacts(A, P, pairs, contacts, device="cpu"):
    """Returns masks of contacts by kind, and of contacts that are wrong.

    The contact point is where the patch is deepest in the shape, or nearest to it, if the normals are opposite
    there. If not, the point is that of the patch lowered along its normals until it is outside of the shape.
    """
    a, b, x, q, bend = pairs
    gap, u = contacts["gap"], contacts["warm_start"]["u"][:, :2]
    good, outside = contacts["status"] == MET, contacts["status"] == OUTSIDE
    size = np.zeros(len(x)) if A is S.Plane else outer(A, a)
    ball = np.full(len(x), np.inf) if A is S.Plane else size
    reference = Reference(A, P, a, b, x, q, ball, device)
    unlowered = np.abs(reference.evaluate(u, 0.0)[1] - gap) < TIE
    lowered = np.where(unlowered, 0.0, 0.02 * size - gap)
    there = reference.evaluate(u, lowered)[1] - lowered
    # If the original patch decides, the lowered one is not searched.
    bound = np.where(unlowered & good, gap - TIE, np.inf)
    bound_below = np.where(unlowered, -np.inf, np.where(good, gap + lowered - TIE, np.inf))
    least, below = reference.least(0.0, bound), reference.least(lowered, bound_below)
    faces = facing(P, least)
    # If two exits are equally near along a curve, the distance has a narrow valley. Such minima are searched again
    # on a finer grid.
    doubt = np.flatnonzero(~unlowered & faces)
    if doubt.size:
        own = [{name: value[doubt] for name, value in sizes.items()} for sizes in (a, b)]
        close = Reference(A, P, *own, x[doubt], q[doubt], ball[doubt], device, grid=8 * GRID)
        least[doubt] = close.least(0.0, np.inf)
        faces = facing(P, least)
    nearer = np.where(unlowered, least["gap"] < bound, below["gap"] < bound_below)
    other = ~unlowered & (faces | (least["gap"] >= 0.0) | (np.abs(there - gap) > TIE))
    # A shape is outside if its nearest point is on the edge, or if it is entirely behind the patch.
    decides = unlowered | faces | (least["gap"] >= 0.0)
    place = np.where(decides, least, below)
    inside = outside & ~is_at_boundary(P, place) & ~((least["gap"] >= 0.0) & (least["along"] > 0.0))
    if A is not S.Plane:
        closest, n = evaluate_surface(P, b, place["u"], place["v"])
        inside &= (
            np.sum((x - closest) * n, axis=1) + support(A, a, rotated(inverse_rotation(q), n)[:, None])[:, 0]
            >= 0.0
        )
    sane = bend * np.maximum(0.0, -gap) <= DEEP
    return {
        "met": good & sane,
        "lowered": good & sane & ~unlowered,
        "deep": good & sane & (gap < 0.0),
        "wrong": good & sane & (nearer | other),
        "lost": inside & sane,
        "missed": (contacts["status"] == NOT_CONVERGED) & sane,
        "too deep": ~sane,
    }


def outer(A, a):
    """Returns radii of spheres about the origin that contain the shapes."""
    axes = np.eye(3)[None]
    return np.linalg.norm(np.maximum(support(A, a, axes), support(A, a, -axes)), axis=1)


def check_points(A, P, pairs, contacts):
    """Asserts that points lie on both, on a line along the normal of the patch, and the gap apart."""
    b = pairs[1]
    good = contacts["status"] == MET
    u, n, gap = contacts["warm_start"]["u"][good], contacts["normal"][good], contacts["gap"][good]
    closest, normal = evaluate_surface(P, {name: value[good] for name, value in b.items()}, u[:, 0], u[:, 1])
    np.testing.assert_allclose(contacts["point_b"][good], closest, atol=1e-13)
    # Normals from numerical derivatives are accurate to 1e-10.
    np.testing.assert_allclose(n, normal, atol=1e-13 if hasattr(P, "derivatives") else 1e-10)
    np.testing.assert_allclose(contacts["point_a"][good] - contacts["point_b"][good], gap[:, None] * n, atol=1e-11)
