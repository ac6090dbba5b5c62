"""Gap, side, closest point and normal against brute force, on meshes that are difficult for the search."""

import difficult_meshes
import numpy as np
import pytest
from brute_force import Surface
from scenes import probe

import warpcontact as wc

# Errors are in units of the mesh size, or of the distance if that is larger. Each coordinate of the mesh and of
# the point carries half an epsilon, and a difference of two vectors collects a few of them. These bounds are those
# in the documentation. In float64, brute force rounds as well.
LENGTH = {"float32": 5e-7, "float64": 1.5e-15}
# Closest points whose distances differ by at most 3 roundings of the coordinates count as equally near.
# Coordinates are up to √3 times the size apart. Near a sharp vertex, one of them can be on the inner side. Within
# this distance of the surface the side is not checked.
SIDE = {"float32": 1e-6, "float64": 2e-15}
# Within 16 roundings of the differences (at most √3 times the size), the direction to the surface is not defined
# by the coordinates and the normal is that of the feature. P − S and gap n, both that short, can then differ.
ON_SURFACE = {"float32": 16 * 1.2e-7 * 1.8, "float64": 16 * 2.2e-16 * 1.8}
# A point counts as outside the boundary if its lateral distance is more than this fraction of the boundary edge.
BOUNDARY_DISTANCE = 1e-4

PRECISIONS = ("float32", "float64")


def placed(name):
    """Returns the mesh, the position of its surface, and the triangles in the scene."""
    mesh = {**difficult_meshes.CLOSED, **difficult_meshes.OPEN}[name]()
    position = -difficult_meshes.FAR_AWAY if "km" in name else np.zeros(3)
    return mesh, position, Surface(mesh.vertices[mesh.faces] + position)


def measured(mesh, position, surface, count, precision, device, seed=1):
    """Returns points rounded to the precision, their exact distance, and their sensors."""
    kinds = difficult_meshes.difficult_points(surface, count, seed)
    points = np.concatenate(list(kinds.values())).astype(precision).astype(np.float64)
    sensors = probe(mesh, points, position=position, kappa=0.0, precision=precision, device=device)
    return points, surface.nearest(points)[0], sensors


def assert_nearest(points, distance, sensors, surface, precision):
    """Asserts that the reported closest point is a nearest point of the surface; any of several is accepted.

    Returns the deviation of the normal from the direction to the point, up to sign, and with the sign of the gap.
    """
    scale = np.maximum(surface.size, distance)
    closest_point = sensors["point"].astype(np.float64)
    to_point = points - closest_point
    assert (np.abs(np.linalg.norm(to_point, axis=1) - distance) / scale).max() < LENGTH[precision]
    assert (surface.nearest(closest_point)[0] / scale).max() < LENGTH[precision]
    normal, gap = sensors["normal"].astype(np.float64), sensors["gap"].astype(np.float64)[:, None]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=LENGTH[precision])
    # Outside a boundary, the gap has no defined sign.
    away = [np.linalg.norm(to_point - sign * gap * normal, axis=1) / scale for sign in (1, -1)]
    return np.minimum(*away), away[0]


def assert_exact_on_closed(mesh, position, surface, count, precision, device, *, sides=True):
    points, distance, sensors = measured(mesh, position, surface, count, precision, device)
    scale = np.maximum(surface.size, distance)
    gap = sensors["gap"].astype(np.float64)
    assert (np.abs(np.abs(gap) - distance) / scale).max() < LENGTH[precision]
    _, away = assert_nearest(points, distance, sensors, surface, precision)
    clear = distance / scale > ON_SURFACE[precision]
    assert away[clear].max() < LENGTH[precision]
    assert away.max() < LENGTH[precision] + 2 * ON_SURFACE[precision]
    if sides:
        turns = surface.winding(points)
        clear = distance / scale > SIDE[precision]
        assert np.abs(turns - np.round(turns))[clear].max() < 1e-3
        np.testing.assert_array_equal(gap[clear] < 0, np.round(turns[clear]) == 1)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", difficult_meshes.CLOSED)
def test_closed_mesh_gap_is_exact_at_difficult_points(name, precision, device):
    assert_exact_on_closed(*placed(name), 1500, precision, device)


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", difficult_meshes.CLOSED)
def test_closed_mesh_gap_is_exact_at_very_many_points(name, precision, times, device):
    assert_exact_on_closed(*placed(name), 20_000 * times, precision, device)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", difficult_meshes.FILES)
def test_mesh_file_gap_is_exact_at_difficult_points(name, precision, shared_data, device):
    mesh = wc.load_mesh(shared_data / "meshes" / name)
    surface = Surface(mesh.vertices[mesh.faces])
    # A mesh with self-intersections has no defined inside near them.
    assert_exact_on_closed(
        mesh, np.zeros(3), surface, 1500, precision, device, sides=name not in difficult_meshes.CUTS_ITSELF
    )


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", difficult_meshes.OPEN)
def test_open_mesh_gap_is_exact_over_faces_and_beyond_the_boundary(name, precision, device):
    mesh, position, surface = placed(name)
    points, distance, sensors = measured(mesh, position, surface, 3000, precision, device)
    scale = np.maximum(surface.size, distance)
    away, _ = assert_nearest(points, distance, sensors, surface, precision)
    gap, closest_point = sensors["gap"].astype(np.float64), sensors["point"].astype(np.float64)
    edges = np.linalg.norm(np.diff(surface.corners, axis=1, append=surface.corners[:, :1]), axis=2)
    # If the nearest point is on the boundary of the rectangle, P may be slightly outside it and still count as
    # above it.
    inset = np.minimum(closest_point - surface.low, surface.high - closest_point)[:, :2].min(axis=1)
    boundary = inset < LENGTH[precision] * scale
    over = ~boundary
    assert over.sum() > 1000
    assert boundary.sum() > 300
    clear = distance / scale > ON_SURFACE[precision]
    assert away[over & clear].max() < LENGTH[precision]
    assert (np.abs(np.abs(gap) - distance) / scale)[over].max() < LENGTH[precision]
    sideways = np.sqrt(np.maximum(distance**2 - gap**2, 0))
    # The square root of a difference of squares amplifies the rounding of the gap.
    rounding = np.sqrt(2 * distance * LENGTH[precision] * scale)
    assert (sideways - rounding)[boundary].max() <= BOUNDARY_DISTANCE * edges.max()
    # For a height field, inside means below the surface.
    bottom = np.column_stack([points[:, :2], np.full(len(points), surface.low[2] - surface.size)])
    height = surface.first_hit(bottom, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    below = points[:, 2] - bottom[:, 2] < height
    decided = over & np.isfinite(height) & (distance > SIDE[precision] * scale)
    np.testing.assert_array_equal((gap < 0)[decided], below[decided])


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", difficult_meshes.CLOSED)
def test_normal_on_the_surface_is_that_of_a_feature_at_the_point(name, precision, device):
    mesh, position, surface = placed(name)
    corners = surface.corners[:: len(surface.corners) // 300 + 1]
    points = np.concatenate([corners[:, 0], 0.5 * (corners[:, 0] + corners[:, 1]), corners.mean(axis=1)])
    sensors = probe(mesh, points, position=position, precision=precision, device=device)
    assert np.abs(sensors["gap"]).max() < LENGTH[precision] * surface.size
    for point, normal in zip(points, sensors["normal"], strict=True):
        off = np.linalg.norm(surface.pseudonormals(point) - normal, axis=1)
        # The pseudonormal of the blade's edge is a small difference of the normals of its faces.
        assert off.min() < 10 * LENGTH[precision]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_gap_to_rotated_and_translated_surface_is_equally_exact(precision, device):
    mesh = difficult_meshes.angle_bracket()
    turn = np.array([0.3, -0.5, 0.2, 0.8])
    turn /= np.linalg.norm(turn)
    axis, w = turn[:3], turn[3]
    rotated = mesh.vertices + 2 * np.cross(axis, np.cross(axis, mesh.vertices) + w * mesh.vertices)
    position = np.array([0.25, -0.5, 0.125])
    surface = Surface((rotated + position)[mesh.faces])
    points = np.concatenate(list(difficult_meshes.difficult_points(surface, 1500).values()))
    points = points.astype(precision).astype(np.float64)
    sensors = probe(mesh, points, position=position, orientation=turn, precision=precision, device=device)
    distance, turns = surface.nearest(points)[0], surface.winding(points)
    expected = np.where(turns > 0.5, -distance, distance)
    scale = np.maximum(surface.size, distance)
    # The rotation of the surface is rounded as well.
    assert (np.abs(sensors["gap"] - expected) / scale).max() < LENGTH[precision]


@pytest.mark.parametrize("thickness", [1e-2, 1e-3])
def test_gap_to_thin_triangles_is_exact_in_float32(thickness, device):
    """If the float32 query may return a wrong face, the result is refined at any distance."""
    mesh = wc.meshes.box((1.0, 0.7, thickness))
    assert_exact_on_closed(mesh, np.zeros(3), Surface(mesh.vertices[mesh.faces]), 20_000, "float32", device)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_search_radius_excludes_no_point_within_it(precision, device):
    """Points next to the edges of a thin box. A float32 query overestimates the distance of its long triangles."""
    count, reach = 2000, 1e-4
    rng = np.random.default_rng(5)
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(wc.meshes.box((1, 1, 1e-3)), name="ground")
    body = scene.add_body(1.0, (1, 1, 1), name="body")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0))
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, material, search_radius=reach, name="touch")
    model = scene.build(envs=count, precision=precision, device=device)
    away = rng.uniform(0.05, 2.0, count) * reach
    beside, above = rng.uniform(-0.49, 0.49, count), rng.uniform(-4e-4, 4e-4, count)
    model["body.position"] = np.column_stack([0.5 + away, beside, above])
    seen = model.sensor("touch.status") != wc.ContactStatus.FAR
    # float32 rounds the position of a point by 6e-8 m.
    np.testing.assert_array_equal(seen[np.abs(away - reach) > 1e-7], (away < reach)[np.abs(away - reach) > 1e-7])
    np.testing.assert_allclose(model.sensor("touch.gap"), np.minimum(away, reach), rtol=0, atol=1e-7)
