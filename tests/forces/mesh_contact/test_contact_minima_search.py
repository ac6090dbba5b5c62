"""The local minima of the distance of spheres to random surfaces are those of a search by definition."""

import numpy as np
import pytest

import warpcontact as wc

STIFFNESS, RADIUS = 1e3, 0.3


def closest_points(place, triangles):
    """Returns the closest points (n, 3) of triangles (n, 3, 3), by the regions of Ericson's book."""
    a, b, c = (triangles[:, i] for i in range(3))
    ab, ac = b - a, c - a
    d1, d2 = ((edge * (place - a)).sum(axis=1) for edge in (ab, ac))
    d3, d4 = ((edge * (place - b)).sum(axis=1) for edge in (ab, ac))
    d5, d6 = ((edge * (place - c)).sum(axis=1) for edge in (ab, ac))
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    with np.errstate(invalid="ignore", divide="ignore"):
        on_ab, on_ac, on_bc = d1 / (d1 - d3), d2 / (d2 - d6), (d4 - d3) / ((d4 - d3) + (d5 - d6))
        inside = a + ab * (vb / (va + vb + vc))[:, None] + ac * (vc / (va + vb + vc))[:, None]
    regions = [
        ((d1 <= 0) & (d2 <= 0), a),
        ((d3 >= 0) & (d4 <= d3), b),
        ((d6 >= 0) & (d5 <= d6), c),
        ((vc <= 0) & (d1 >= 0) & (d3 <= 0), a + on_ab[:, None] * ab),
        ((vb <= 0) & (d2 >= 0) & (d6 <= 0), a + on_ac[:, None] * ac),
        ((va <= 0) & (d4 >= d3) & (d5 >= d6), b + on_bc[:, None] * (c - b)),
    ]
    return np.select([region[:, None] for region, _ in regions], [point for _, point in regions], inside)


def minima(mesh, center):
    """Returns the local minima of the distance within the sphere whose outer side has the center, (n, 3)."""
    triangles = mesh.vertices[mesh.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    closest = closest_points(center, triangles)
    found = []
    for point in closest[np.linalg.norm(closest - center, axis=1) < RADIUS]:
        containing = np.linalg.norm(closest_points(point, triangles) - point, axis=1) < 1e-9
        is_minimum = (np.linalg.norm(closest[containing] - point, axis=1) < 1e-9).all()
        is_outside = (center - point) @ normals[containing].mean(axis=0) > 0
        is_new = all(np.linalg.norm(point - other) > 1e-9 for other in found)
        if is_minimum and is_outside and is_new:
            found.append(point)
    return np.array(found).reshape(-1, 3)


def rough_ground(rng):
    """A triangulated square with random heights and diagonals."""
    n, line = 12, np.linspace(-1, 1, 12)
    vertices = [(x, y, rng.uniform(-0.15, 0.15)) for x in line for y in line]
    faces = []
    for i in range(n - 1):
        for j in range(n - 1):
            a, b, c, d = i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1
            faces += [(a, b, c), (a, c, d)] if rng.random() < 0.5 else [(a, b, d), (b, c, d)]
    return wc.Mesh(vertices, faces)


def rough_ball(rng):
    """A sphere with random distances of the vertices."""
    sphere = wc.meshes.icosphere(0.5, 2)
    return wc.Mesh(sphere.vertices * rng.uniform(0.7, 1.3, (len(sphere.vertices), 1)), sphere.faces)


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-5), ("float64", 1e-11)])
def test_minima_on_random_surfaces_are_those_of_a_search_by_definition(precision, tolerance, device):
    rng, count = np.random.default_rng(8), 80
    meshes = [rough_ground(rng), rough_ball(rng)]
    above = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), rng.uniform(0.0, 0.4, count)])
    around = rng.normal(size=(count, 3))
    around *= rng.uniform(0.4, 0.9, (count, 1)) / np.linalg.norm(around, axis=1, keepdims=True)
    scene = wc.Scene(gravity=(0, 0, 0))
    surface = scene.add_surface(meshes, name="surface")
    ball = scene.add_body(1.0, (1, 1, 1), name="ball")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=STIFFNESS))
    options = {"radius": RADIUS, "minima": "all", "max_minima": 64, "group_angle": (0, 0), "name": "touch"}
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), surface, material, **options)
    model = scene.build(envs=2 * count, device=device, precision=precision)
    model["surface.mesh"] = np.repeat([0, 1], count)
    model["ball.position"] = centers = np.concatenate([above, around])
    force, found = model.sensor("touch.force"), model.sensor("touch.minimum_count")
    # Centers inside have at most the closest point in addition, which is not on their outer side.
    outside = model.sensor("touch.gap") > -RADIUS
    numbers = np.zeros(10, dtype=int)
    for i in np.flatnonzero(outside):
        offset = centers[i] - minima(meshes[i // count], centers[i])
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        expected = (STIFFNESS * (RADIUS - distance) * offset / distance).sum(axis=0)
        assert found[i] == len(offset)
        np.testing.assert_allclose(force[i], expected, rtol=0, atol=tolerance * STIFFNESS * RADIUS)
        numbers[len(offset)] += 1
    assert (numbers[:5] > 2).all()
