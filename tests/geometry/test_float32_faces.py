"""Faces that a float32 search would miss are reported with their index in the mesh."""

import numpy as np
import pytest
from scenes import probe
from test_meshes import joined, moved

from warpcontact.meshes import Mesh, box
from warpcontact.meshes.topology import angles, directions


def far_apart():
    """Three boxes: 0.01 m, 1 m, and 0.01 m at a distance of 900 km."""
    return Mesh(*joined(box((1e-2, 1e-2, 1e-2)), moved(box(), 3.0), moved(box((1e-2, 1e-2, 1e-2)), 9e5)))


@pytest.mark.parametrize(("search", "first"), [("whole", 24), ("active", 30)])
def test_face_without_area_in_float32_is_named_by_its_index(search, first, device):
    message = rf"surface: face {first} is degenerate in float32, .* coordinates of up to 900000 m\."
    with pytest.raises(ValueError, match=message):
        probe(far_apart(), (0.0, 0.0, 1.0), active_faces=[12, 13, 30, 31], search=search, device=device)


def test_angles_of_a_face_match_the_triangle():
    corners = np.random.default_rng(0).normal(size=(50, 3, 3)) * 10.0 ** np.arange(-25, 25)[:, None, None]
    found = angles(corners)
    np.testing.assert_allclose(found.sum(axis=1), np.pi, rtol=1e-12)
    legs = [(corners[:, i - 2] - corners[:, i], corners[:, i - 1] - corners[:, i]) for i in range(3)]
    cosine = [(a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1) for a, b in legs]
    np.testing.assert_allclose(np.cos(found), np.column_stack(cosine), atol=1e-12)


def test_pseudonormal_of_opposite_faces_falls_back_to_the_face_normal():
    sums, instead = np.array([(0.0, 0.0, 3.0), (0.0, 1e-12, 0.0)]), np.array([(1.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    assert directions(sums, instead).tolist() == [[0, 0, 1], [1, 0, 0]]
