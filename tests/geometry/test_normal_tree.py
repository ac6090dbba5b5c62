"""Trees of normals: their bounds hold for all planes, and for all normals between the faces of convex edges."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from warpcontact.geometry.normal_tree import NormalTree


def hull_features(vertices):
    """Returns normals and offsets of the planes of a hull, and a point and both normals of each edge."""
    hull = ConvexHull(vertices)
    edges = {}
    for face, corners in enumerate(hull.simplices):
        for i in range(3):
            edges.setdefault(tuple(sorted((corners[i], corners[i - 1]))), []).append(face)
    normals = hull.equations[:, :3]
    positions = np.asarray(vertices)[[pair[0] for pair in edges]]
    beside = np.array(list(edges.values()))
    return normals, -hull.equations[:, 3], positions, normals[beside[:, 0]], normals[beside[:, 1]]


def bounds(tree, points):
    """Upper bounds of heights of points above the items of each node, (nodes, points)."""
    products = np.stack([tree.lower[:, None, :3] * points, tree.upper[:, None, :3] * points])
    return products.max(axis=0).sum(axis=2) - tree.lower[:, None, 3]


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (1e3, 1e3, 1.0), (1e-3, 1e-6, 1e-3)])
def test_bounds_of_nodes_hold_for_all_normals(scale):
    """Of ordinary hulls, and of thin ones whose edges have nearly opposite normals."""
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(60, 3)) * scale
    normals, offsets, positions, first, second = hull_features(vertices)
    points = rng.normal(size=(50, 3)) * scale
    # Great circle arcs from the first to the second normal.
    cosine = np.clip(np.einsum("ij,ij->i", first, second), -1.0, 1.0)
    angle = np.arccos(cosine)[:, None]
    fractions = np.linspace(0.0, 1.0, 21)[:, None, None]
    arcs = (np.sin((1.0 - fractions) * angle) * first + np.sin(fractions * angle) * second) / np.sin(angle)
    heights_of_edges = np.einsum("tij,ikj->tik", arcs, points - positions[:, None]).max(axis=0)
    for tree, heights in (
        (NormalTree.of_planes(normals, offsets, single=False), normals @ points.T - offsets[:, None]),
        (NormalTree.of_edges(positions, first, second, single=False), heights_of_edges),
    ):
        np.testing.assert_array_equal(np.sort(tree.order), np.arange(len(heights)))
        assert len(tree.nodes) > len(heights) / 8
        upper = bounds(tree, points)
        tolerance = 1e-9 * max(scale)
        for (child, start, end), bound in zip(tree.nodes, upper, strict=True):
            own = heights[tree.order[start:end]]
            assert (own <= bound + tolerance).all()
            if child < 0:
                assert end - start <= 4
            else:
                assert tree.nodes[child, 1] == start
                assert tree.nodes[child + 1, 2] == end
        # The bounds of leaves exclude most points from most leaves.
        leaves = upper[tree.nodes[:, 0] < 0]
        assert (leaves < heights.max(axis=0)).mean() > 0.3


def test_single_tree_is_one_leaf():
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    tree = NormalTree.of_planes(normals, np.ones(6), single=True)
    np.testing.assert_array_equal(tree.nodes, [[-1, 0, 6]])
