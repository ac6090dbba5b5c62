"""Replacements of SciPy functions that a first step uses, against SciPy, whose import takes longer than a build."""

import numpy as np
import pytest
from scipy.optimize import elementwise
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree
from scipy.special import gamma
from warpcontact.kernels.laws.formulas import contact_time, greatest_penetration, root_between
from warpcontact.kernels.types import SIDE_KNOWN_INSIDE_WALLS

from warpcontact.geometry.query_mesh import make_query_mesh
from warpcontact.meshes import Mesh
from warpcontact.meshes.topology import components, has_near_neighbor


def test_bracketed_roots_are_bitwise_identical_to_scipy():
    power = np.linspace(0.3, 9.0, 1001)
    for lower, upper in ((0.0, 4.0), (0.0, power + 2.0), (1.0 / (power + 1.0), 100.0)):

        def excess(x, power=power):
            return np.expm1(power * np.log1p(x)) - power

        expected = elementwise.find_root(excess, (lower, upper), args=(power,))
        assert expected.success.all()
        np.testing.assert_array_equal(root_between("root", excess, lower, upper), expected.x)
    assert root_between("root", lambda x: x - 0.25, 0.0, 1.0) == 0.25
    assert root_between("root", lambda x: x - 1.0, 0.0, 1.0) == 1.0  # at an end


def test_bracketed_root_requires_a_change_of_sign():
    with pytest.raises(
        RuntimeError, match="no depth found between 0 and 1: the values there are -2 and -1, and must"
    ):
        root_between("depth", lambda x: x - np.array([0.5, 2.0]), np.zeros(2), np.ones(2))
    with pytest.raises(RuntimeError, match="the values there are nan and nan"):
        root_between("depth", lambda x: np.full_like(x, np.nan), 0.0, 1.0)


def test_contact_times_match_gamma_function_of_scipy():
    n = np.random.default_rng(0).uniform(1.0, 4.0, (7, 5))
    factor = 2.0 * np.sqrt(np.pi) * gamma(1.0 + 1.0 / (n + 1.0)) / gamma(0.5 + 1.0 / (n + 1.0))
    expected = factor * greatest_penetration(1e5, n, 0.3, 2.0) / 2.0
    np.testing.assert_allclose(contact_time(1e5, n, 0.3, 2.0), expected, rtol=1e-14)
    with np.errstate(all="ignore"):
        assert np.isnan(contact_time(1e5, [-1.0, -1.5], 0.3, 2.0)).all()


@pytest.mark.parametrize("count", [1, 2, 50, 3000])
@pytest.mark.parametrize("share", [0.0, 0.4, 0.6, 2.0])
def test_connected_components_match_scipy_in_order_of_first_items(count, share):
    rng = np.random.default_rng(count)
    chain = rng.permutation(count)
    star = np.column_stack([np.full(count, count - 1), np.arange(count)])  # with its last item as the center
    some = rng.integers(0, count, (round(share * count), 2))
    for links in (some, np.stack([chain[:-1], chain[1:]], axis=1), star):
        graph = coo_array((np.ones(len(links), dtype=bool), links.T), shape=(count, count))
        expected, part = connected_components(graph, directed=False)
        found = components(links, count)
        assert found[0] == expected
        np.testing.assert_array_equal(found[1], part)


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize("seed", range(10))
def test_close_points_match_kd_tree(seed, offset):
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(40 * seed + 2, 3)).round(2)  # many of them at equal height
    near = points[:: rng.integers(1, 9)]
    points = np.concatenate([points, near + rng.normal(scale=1e-6, size=near.shape)]) + offset
    distances, _ = KDTree(points).query(points, k=2, distance_upper_bound=2e-6)
    expected = np.isfinite(distances[:, 1])
    assert 0 < expected.sum() < len(expected)
    np.testing.assert_array_equal(has_near_neighbor(points, 2e-6), expected)
    assert not has_near_neighbor(points[:0], 1.0).any()


@pytest.mark.parametrize("corners", [3, 4, 100])
def test_walls_over_a_polygonal_boundary_are_its_hull(corners):
    # A bowl over a polygon, in any position; the sides of the polygon have more vertices than its ends.
    angle = 2.0 * np.pi * np.arange(corners) / corners
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    boundary_points = np.concatenate([a + t * (b - a) for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)
                          for t in ((0.0,), (0.3,), (0.8,))]).reshape(-1, 2)  # fmt: skip
    turned = np.linalg.qr(np.random.default_rng(corners).normal(size=(3, 3)))[0]
    turned *= np.sign(np.linalg.det(turned))
    vertices = np.column_stack(
        [np.vstack([boundary_points, np.zeros(2)]), np.append(np.zeros(len(boundary_points)), -0.3)]
    )
    vertices = vertices @ turned.T + (3.0, -2.0, 5.0)
    start = np.arange(len(boundary_points))
    bowl = Mesh(
        vertices, np.column_stack([start, np.roll(start, -1), np.full(len(boundary_points), len(boundary_points))])
    )
    sides = make_query_mesh(
        bowl, np.ones(len(boundary_points), dtype=bool), np.zeros(3), only_active=False
    ).side_region
    assert sides.kind == SIDE_KNOWN_INSIDE_WALLS
    assert len(sides.normal) == corners

    flat = (vertices[:-1] - (3.0, -2.0, 5.0)) @ turned[:, :2]
    hull = ConvexHull(flat)
    expected = -hull.equations[:, :2] @ turned[:, :2].T
    order = [np.argmin(np.linalg.norm(sides.normal - normal, axis=1)) for normal in expected]
    assert sorted(order) == list(range(corners))
    np.testing.assert_allclose(sides.normal[order], expected, atol=1e-12)
    heights = vertices @ sides.normal[order].T - sides.offset[order]
    np.testing.assert_allclose(heights[:-1], -(flat @ hull.equations[:, :2].T + hull.equations[:, 2]), atol=1e-12)


def terrain(size, noise, turns):
    """A wavy terrain with four sides that are straight up to rounding and ``noise`` [m], rotated about z [rad]."""
    x, y = (own.ravel() for own in np.meshgrid(np.linspace(0.0, 1.0, size), np.linspace(0.0, 1.0, size)))
    inside = (x > 0.0) & (x < 1.0) & (y > 0.0) & (y < 1.0)
    vertices = np.column_stack([x, y, np.where(inside, 0.1 * np.sin(9.0 * x) * np.cos(7.0 * y), 0.0)])
    vertices[:, :2] += np.random.default_rng(size).normal(scale=noise, size=(len(x), 2))
    for angle in turns:
        c, s = np.cos(angle), np.sin(angle)
        vertices = vertices @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    low = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    return Mesh(vertices, np.concatenate([np.stack([low, low + 1, low + size + 1], axis=1),
                                          np.stack([low, low + size + 1, low + size], axis=1)]))  # fmt: skip


@pytest.mark.parametrize("noise", [0.0, 1e-17, 1e-16, 1e-15, 1e-14])
@pytest.mark.parametrize("turns", [(), (0.25 * np.pi,) * 2, (np.pi / 6, -np.pi / 6), (0.3,)])
@pytest.mark.parametrize("size", [3, 8, 21])
def test_nearly_straight_boundary_has_four_sides(size, turns, noise):
    """Also along the axes, where rounding determines the first vertex."""
    mesh = terrain(size, noise, turns)
    sides = make_query_mesh(mesh, np.ones(len(mesh.faces), dtype=bool), np.zeros(3), only_active=False).side_region
    assert sides.kind == SIDE_KNOWN_INSIDE_WALLS
    assert len(sides.normal) == 4
