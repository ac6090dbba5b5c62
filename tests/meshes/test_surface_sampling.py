"""Sample points of a surface: evenly spread, on the surface, with areas that sum to its area."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import warpcontact as wc
from warpcontact import sample_surface

METHODS = [("blue_noise", 400), ("vertices", None), ("centroids", None)]


def hexagonal(area, count):
    """Distance between neighbors of the densest packing of ``count`` points on ``area``."""
    return np.sqrt(2.0 * area / (np.sqrt(3.0) * count))


def distances(points):
    return cKDTree(points).query(points, k=2)[0][:, 1]


def uneven():
    """A square of which one half has two triangles and the other 20 000."""
    fine = wc.meshes.grid((1, 1), (100, 100))
    coarse = wc.meshes.grid((1, 1))
    vertices = np.concatenate([fine.vertices, coarse.vertices + np.array([1, 0, 0])])
    return wc.Mesh(vertices, np.concatenate([fine.faces, coarse.faces + len(fine.vertices)]))


@pytest.mark.parametrize(("method", "count"), METHODS)
@pytest.mark.parametrize("mesh", [wc.meshes.icosphere(0.05, 3), wc.meshes.box((1, 2, 3)), uneven()])
def test_sample_areas_sum_to_the_surface_area_and_normals_are_unit(mesh, method, count):
    samples = sample_surface(mesh, count, method)
    assert (samples.areas > 0).all()
    assert samples.areas.sum() == pytest.approx(mesh.report.area, rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(samples.normals, axis=1), 1.0, rtol=1e-12)
    assert len(samples) == len(samples.areas) == len(samples.faces) == len(samples.normals)
    # Each lies on its face: the barycentric coordinates are positive and reproduce it.
    a, b, c = mesh.vertices[mesh.faces[samples.faces]].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    parts = [
        np.einsum("ij,ij->i", np.cross(v - u, samples.positions - u), normal)
        / np.einsum("ij,ij->i", normal, normal)
        for u, v in ((b, c), (c, a), (a, b))
    ]
    assert np.min(parts) > -1e-9
    np.testing.assert_allclose(
        sum(p[:, None] * x for p, x in zip(parts, (a, b, c), strict=True)), samples.positions, atol=1e-12
    )


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("count", [50, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("mesh", [wc.meshes.icosphere(1.0, 5), uneven()])
def test_blue_noise_samples_are_as_even_as_sample_elimination(mesh, count, seed):
    samples = sample_surface(mesh, count, seed=seed)
    assert len(samples) == count
    unit = hexagonal(mesh.report.area, count)
    # Yuksel's paper has 0.7 to 0.8 of the hexagonal distance in the plane; random points have 0.01.
    assert distances(samples.positions).min() > 0.65 * unit
    # A hole of radius r has space for another point if r exceeds the minimum distance.
    dense = sample_surface(mesh, 200 * count // 10, seed=seed + 1).positions
    assert cKDTree(samples.positions).query(dense)[0].max() < 1.15 * unit


def test_random_points_fail_the_evenness_test():
    points = np.random.default_rng(0).random((1000, 2))
    assert distances(points).min() < 0.1 * hexagonal(1.0, 1000)


def test_sample_density_does_not_depend_on_triangles():
    samples = sample_surface(uneven(), 1000)
    fine = samples.positions[:, 0] < 0.5
    assert abs(fine.sum() - 500) < 15
    assert samples.areas[fine].sum() == pytest.approx(1.0, abs=0.02)


def test_both_sides_of_a_thin_plate_are_sampled_separately():
    plate = wc.meshes.box((1.0, 1.0, 1e-3))
    samples = sample_surface(plate, 600)
    for sign in (-1, 1):
        side = samples.normals[:, 2] * sign > 0.5
        assert abs(side.sum() - 300) < 12
        assert samples.areas[side].sum() == pytest.approx(1.0, abs=0.02)
        assert distances(samples.positions[side]).min() > 0.6 * hexagonal(1.0, 300)


def test_blue_noise_areas_match_nearest_point_areas():
    samples = sample_surface(wc.meshes.grid((1.0, 1.0)), 200)
    probes = np.random.default_rng(3).random((400_000, 2)) - 0.5
    owner = cKDTree(samples.positions[:, :2]).query(probes)[1]
    expected = np.bincount(owner, minlength=200) / len(probes)
    # 2000 random probes per point leave 2 %, and the 128 even ones that measure an area about 2 %.
    np.testing.assert_allclose(samples.areas, expected, rtol=0.12)
    assert np.sqrt(np.mean((samples.areas / expected - 1.0) ** 2)) < 0.04
    # Equal areas would have larger errors, because cells differ.
    assert np.std(expected) * 200 > 0.1


def test_samples_are_repeatable_with_equal_seed():
    mesh = wc.meshes.icosphere(1.0, 3)
    one, same, other = (sample_surface(mesh, 300, seed=seed) for seed in (4, 4, 5))
    for key in ("positions", "areas", "normals", "faces"):
        np.testing.assert_array_equal(getattr(one, key), getattr(same, key))
    assert not np.array_equal(one.positions, other.positions)


def test_vertex_sample_normals_of_a_box_are_diagonal_for_any_triangulation():
    box = wc.meshes.box((2, 2, 2))
    samples = sample_surface(box, method="vertices")
    np.testing.assert_allclose(samples.normals, np.sign(samples.positions) / np.sqrt(3.0), rtol=1e-12)
    # Every side has two triangles of 2 m²; each gives a third to each of its vertices.
    touching = [(box.faces == i).sum() for i in range(8)]
    np.testing.assert_allclose(samples.areas, 2.0 / 3.0 * np.array(touching), rtol=1e-12)


def test_coincident_vertices_are_one_sample():
    box = wc.meshes.box()
    soup = wc.Mesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    samples = sample_surface(soup, method="vertices")
    assert len(samples) == 8
    assert samples.areas.sum() == pytest.approx(6.0)


def test_centroid_samples_are_at_face_centroids():
    mesh = wc.meshes.sinusoidal_terrain(cells=(5, 4))
    samples = sample_surface(mesh, method="centroids")
    np.testing.assert_allclose(samples.positions, mesh.vertices[mesh.faces].mean(axis=1))
    np.testing.assert_array_equal(samples.faces, np.arange(len(mesh.faces)))


@pytest.mark.parametrize(("method", "count"), METHODS)
def test_subset_of_faces_can_be_sampled(method, count):
    mesh = wc.meshes.icosphere(1.0, 3)
    top = mesh.vertices[mesh.faces].mean(axis=1)[:, 2] > 0.5
    samples = sample_surface(mesh, count, method, faces=top)
    assert top[samples.faces].all()
    corners = mesh.vertices[mesh.faces[top]]
    area = (
        0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )
    assert samples.areas.sum() == pytest.approx(area, rel=1e-12)
    numbers = sample_surface(mesh, count, method, faces=np.flatnonzero(top))
    np.testing.assert_array_equal(numbers.positions, samples.positions)


def test_sample_surface_raises_for_invalid_arguments():
    mesh = wc.meshes.box()
    cases = [
        ({"count": 0}, "count must be a whole number of at least 1, got 0"),
        ({}, "count must be a whole number of at least 1, got None"),
        ({"count": 2.0}, "count must be a whole number of at least 1, got 2.0"),
        ({"count": 5, "method": "vertices"}, "count must be None with method='vertices'"),
        ({"count": 5, "method": "random"}, "method must be one of 'blue_noise', 'vertices', 'centroids'"),
        ({"count": 5, "seed": -1}, "seed must be a whole number of at least 0, got -1"),
        ({"count": 5, "faces": [12]}, "faces must be face numbers from 0 to 11, got 12"),
        ({"count": 5, "faces": []}, "faces must name at least one face"),
        ({"count": 5, "faces": [True, False]}, "faces must be a mask of 12 booleans or face numbers"),
    ]
    for options, message in cases:
        with pytest.raises(ValueError, match=message.replace("(", r"\(")):
            sample_surface(mesh, **options)
    with pytest.raises(TypeError, match=r"mesh must be a wc\.Mesh"):
        sample_surface(None, 5)
