"""Slice size: a slice fits into the cache of a core, including the faces that it reads of large meshes."""

import numpy as np
import pytest
from test_step_schedules import MATERIAL

import warpcontact as wc
from warpcontact.geometry import query_mesh
from warpcontact.stepping.requirements import MAX_SLICE, MIN_SLICE_FOR_FACES, cut_slices, slice_sizes

# Area of a face of a square of 4 m [m²].
CELLS = 40
FACE = 16.0 / (2 * CELLS**2)


@pytest.fixture(autouse=True)
def many_faces(monkeypatch):
    monkeypatch.setattr(query_mesh, "LARGE_MESH_FACES", 2 * CELLS**2 - 1)


def square(cells=CELLS, size=4.0):
    return wc.meshes.grid((size, size), (cells, cells))


def model_of(mesh=None, *, radius=0.5, points=None, scale=1.0, carrier=None, bodies=1):
    scene = wc.Scene()
    ground = scene.add_surface(square() if mesh is None else mesh, name="ground", scale=scale)
    if bodies > 1:
        body = scene.add_bodies([(0, 0, 1.0 + z) for z in range(bodies)], 1.0, (1, 1, 1), name="body")
    else:
        body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 1), name="body")
    if carrier is not None:
        body = scene.add_surface(wc.meshes.box((1, 1, 1)), body, scale=carrier, name="carrier")
    places = scene.add_point(body, (0, 0, 0)) if points is None else scene.add_points(body, points)
    scene.add_contact(places, ground, MATERIAL, radius=radius)
    return scene.build(envs=2, device="cpu", precision="float64")


def read(*arguments, **options):
    return model_of(*arguments, **options).arrays.faces_read


def test_faces_read_by_a_sphere_are_counted_within_its_reach():
    assert read(radius=0.5) == round(np.pi * 0.5**2 / FACE)
    assert read(radius=0.5, bodies=3) == pytest.approx(3 * read(radius=0.5), abs=2)
    # A point reads at least one face, and at most all faces are read.
    assert read(radius=0.0) == 1
    assert read(radius=1e160) == 2 * CELLS**2


def test_faces_are_counted_in_units_of_their_mesh_and_carrier():
    assert read(radius=0.5, scale=0.1) == read(radius=5.0)
    assert read(radius=0.5, scale=1e-160) == 2 * CELLS**2
    points = [(-0.4, 0, 0), (0.4, 0, 0)]
    assert read(radius=0.0, points=points) == round(np.pi * 0.4**2 / FACE)
    small = read(radius=0.0, points=points, carrier=0.5)
    assert small == round(np.pi * 0.2**2 / FACE)


def test_one_large_mesh_of_a_surface_is_counted():
    meshes = [square(), square(size=3.9), square(CELLS // 2)]
    assert read(meshes, radius=0.5) == round(np.pi * 0.5**2 * 2 * CELLS**2 / 3.9**2)
    assert read(square(CELLS // 2), radius=0.5) == 0


def test_slices_are_smaller_if_many_faces_are_read():
    few, many = model_of(square(CELLS // 2)), model_of(square(200), radius=0.3)
    envs = 10**6
    assert slice_sizes([(few, envs)], 2) == [MAX_SLICE]
    (size,) = slice_sizes([(many, envs)], 2)
    assert MIN_SLICE_FOR_FACES <= size < MAX_SLICE
    assert slice_sizes([(model_of(square(200), radius=2.0), envs)], 2) == [MIN_SLICE_FOR_FACES]
    # As many slices as threads at least.
    assert slice_sizes([(many, 8)], 4) == [2]


def test_slices_are_contiguous():
    assert cut_slices(5, 2) == [slice(0, 2), slice(2, 4), slice(4, 5)]
    assert cut_slices(4, 4) == [slice(0, 4)]
