"""Tori and superellipsoids: no point of the core circle is nearer than reported, by bounds on distances."""

import numpy as np
import pytest
import warp as wp
from convex_pairs import directions, heights, random_rotations, random_shapes, solved
from nonconvex_pairs import inverse_rotation, rotated
from parametric_pairs import support
from superellipsoid_distance import distance_lower_bound, separation
from warpcontact.kernels import shapes as S
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.types import MET, NOT_CONVERGED

# Tolerance of the signed distance: larger than rounding of the support function, whose powers go up to 20.
TIE = 1e-9
UP = wp.constant(wp.vec3d(0.0, 0.0, 1.0))
ANGLES = wp.constant(wp.int32(300))


@wp.kernel(module="unique", enable_backward=False)
def search_neighborhood(
    axes: wp.array(dtype=wp.vec3d),
    exponents: wp.array(dtype=wp.vec2d),
    radius: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.vec3d),
    q: wp.array(dtype=wp.quatd),
    normal: wp.array(dtype=wp.vec3d),
    center: wp.array(dtype=wp.vec3d),
    reported: wp.array(dtype=wp.float64),
    shortfall: wp.array(dtype=wp.float64),
    there: wp.array(dtype=wp.float64),
):
    """Computes how much nearer than ``reported`` the core circle is at most, and the distance of ``center``."""
    i = wp.tid()
    n = normal[i]
    for k in range(ANGLES):
        angle = wp.float64(2.0 * wp.pi) * wp.float64(k) / wp.float64(ANGLES)
        y = x[i] + wp.quat_rotate(q[i], radius[i] * wp.vec3d(wp.cos(angle), wp.sin(angle), wp.float64(0.0)))
        if separation(axes[i], exponents[i], normal[i], y) < reported[i]:
            value, m = distance_lower_bound(axes[i], exponents[i], n, y, reported[i])
            n = m
            shortfall[i] = wp.max(shortfall[i], reported[i] - value)
    value, m = distance_lower_bound(axes[i], exponents[i], normal[i], center[i], wp.float64(wp.inf))
    there[i] = value


@wp.kernel(module="unique", enable_backward=False)
def measure(
    axes: wp.vec3d, exponents: wp.vec2d, y: wp.array(dtype=wp.vec3d), distance: wp.array(dtype=wp.float64)
):
    """Signed distances of points."""
    i = wp.tid()
    value, _n = distance_lower_bound(axes, exponents, UP, y[i], wp.float64(wp.inf))
    distance[i] = value


def random_poses(count, seed):
    """Returns sizes and poses: three in four from separated to overlapping hulls, else with nearby centers."""
    random = np.random.default_rng(seed)
    major = random.uniform(0.25, 1.0, count)
    a = {"major_radius": major, "minor_radius": major * random.uniform(0.1, 0.9, count)}
    b = random_shapes(S.Superellipsoid, count, random)
    q = random_rotations(count, random)
    n = random.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    reach = (
        support(Torus, a, rotated(inverse_rotation(q), -n)[:, None])[:, 0]
        + heights(S.Superellipsoid, b, n[:, None])[:, 0]
    )
    own = directions(64)[None]
    size = 2.0 * np.minimum(support(Torus, a, own).mean(axis=1), heights(S.Superellipsoid, b, own).mean(axis=1))
    gap = np.where(random.random(count) < 0.5, random.uniform(-0.6, 2.0, count), random.uniform(-0.6, 0.2, count))
    out = np.where(np.arange(count) % 4 > 0, reach + gap * size, random.uniform(0.0, 0.5, count) * reach)
    return a, b, out[:, None] * n, q


def check(count, seed, device):
    a, b, x, q = random_poses(count, seed)
    contact = solved(Torus, S.Superellipsoid, a, b, x, q, device=device)
    pierced = contact["status"] == NOT_CONVERGED
    assert (contact["status"][~pierced] == MET).all()
    assert 0.05 < pierced.mean() < 0.3
    # The core circle is in the body, with two exits at its deepest point; one may be nearly across the circle.
    assert (contact["gap"][pierced] < -a["minor_radius"][pierced]).all()
    slopes = []
    for i in np.flatnonzero(pierced)[:10]:
        ring = Torus(a["major_radius"][i], a["minor_radius"][i])
        body = S.Superellipsoid(tuple(b["semi_axes"][i]), tuple(b["exponents"][i]))
        slopes.append(min(slopes_near_the_minimum(ring, body, x[i], q[i], device)))
    assert np.median(slopes) > 0.01
    assert min(slopes) > 1e-5

    a, b = ({name: values[~pierced] for name, values in shape.items()} for shape in (a, b))
    contact, x, q = contact[~pierced], x[~pierced], q[~pierced]
    n, gap = contact["normal"], contact["gap"]
    # The points lie on both: on the support plane of the body across n, and at r from the core circle,
    # perpendicular to it.
    along = np.sum(n * contact["point_b"], axis=1) - heights(S.Superellipsoid, b, n[:, None])[:, 0]
    np.testing.assert_allclose(along, 0.0, atol=TIE)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.sum(n * (contact["point_a"] - contact["point_b"]), axis=1), gap, atol=TIE)
    center = contact["point_a"] + a["minor_radius"][:, None] * n
    local, m = rotated(inverse_rotation(q), center - x), rotated(inverse_rotation(q), n)
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), a["major_radius"], atol=TIE)
    np.testing.assert_allclose(local[:, 2], 0.0, atol=TIE)
    np.testing.assert_allclose(local[:, 0] * m[:, 1], local[:, 1] * m[:, 0], atol=TIE)
    # Rounding of the normal changes points by a power of it, down to 1/19.
    beside = contact["point_a"] - contact["point_b"] - gap[:, None] * n
    assert np.abs(beside).max() < 1e-5

    count = len(gap)
    shortfall, there = (wp.zeros(count, dtype=wp.float64, device=device) for _ in range(2))
    reported = gap + a["minor_radius"]
    numbers = [wp.array(values, dtype=wp.float64, device=device) for values in (a["major_radius"], reported - TIE)]
    vectors = [wp.array(values, dtype=wp.vec3d, device=device) for values in (x, n, center)]
    inputs = [
        wp.array(b["semi_axes"], dtype=wp.vec3d, device=device),
        wp.array(b["exponents"], dtype=wp.vec2d, device=device),
        numbers[0], vectors[0], wp.array(q, dtype=wp.quatd, device=device), *vectors[1:], numbers[1],
        shortfall, there,
    ]  # fmt: skip
    wp.launch(search_neighborhood, count, inputs=inputs, device=device)
    # No point of the circle is nearer, and the reported one is at the reported distance.
    assert (shortfall.numpy() <= 0.0).all()
    assert (there.numpy() <= reported + TIE).all()


def slopes_near_the_minimum(ring, body, x, q, device):
    """Returns the slopes of the distance of the core circle on both sides of its minimum, per length."""
    middle, width = 0.0, np.pi
    for count in (300, 60, 60):
        angle = middle + width * np.linspace(-1.0, 1.0, count + 1)
        circle = ring.major_radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
        y = wp.array(x + rotated(q, circle), dtype=wp.vec3d, device=device)
        distance = wp.zeros(count + 1, dtype=wp.float64, device=device)
        sizes = [wp.vec3d(*body.semi_axes), wp.vec2d(*body.exponents)]
        wp.launch(measure, count + 1, inputs=[*sizes, y, distance], device=device)
        value = distance.numpy()
        k = np.clip(value.argmin(), 1, count - 1)
        step = angle[1] - angle[0]
        middle, width = angle[k], step
    return (value[[k - 1, k + 1]] - value[k]) / (step * ring.major_radius)


@pytest.mark.slow
def test_torus_and_superellipsoid_contact_is_at_the_deepest_core_point(device):
    check(500, 1, device)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(10, 14))
def test_many_random_torus_and_superellipsoid_pairs_match_reference(first, times, device):
    """20 000 in all, or 100 000 with --thorough."""
    for seed in range(first, first + 4 * times, 4):
        check(5000, seed, device)
