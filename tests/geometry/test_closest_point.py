"""Gap, side, nearest point and normal against a search over all triangles, where they are easily wrong."""

import difficult_meshes
import numpy as np
import pytest
from brute_force import Surface
from scenes import probe

import warpcontact as wc

# Errors are in units of the size of the mesh, or of the distance where that is larger. A coordinate of the mesh
# or of the point carries half an epsilon, of which a difference of two vectors of them may collect a few. The
# figures of the documentation; in float64 the search over all triangles rounds as well.
LENGTH = {"float32": 5e-7, "float64": 1.5e-15}
# Feet whose distances differ by 3 roundings of the coordinates, which are up to √3 times the size apart, count as
# equally near. About a sharp corner one of them may be inner: nearer to the surface than this the side is open.
SIDE = {"float32": 1e-6, "float64": 2e-15}
# Within 16 roundings of the differences, √3 times the size at most, a direction means nothing and the normal is
# that of the feature: P − S and gap n, both that short, then need not agree.
ON_SURFACE = {"float32": 16 * 1.2e-7 * 1.8, "float64": 16 * 2.2e-16 * 1.8}
# Beside a boundary is what is farther sideways than this part of the boundary edge.
BOUNDARY_DISTANCE = 1e-4

PRECISIONS = ("float32", "float64")


def placed(name):
    """Returns the mesh, where its surface is put, and the triangles that this makes."""
    mesh = {**difficult_meshes.CLOSED, **difficult_meshes.OPEN}[name]()
    position = -difficult_meshes.FAR_AWAY if "km" in name else np.zeros(3)
    return mesh, position, Surface(mesh.vertices[mesh.faces] + position)


def measured(mesh, position, surface, count, precision, device, seed=1):
    """Returns points as the precision holds them, their true distance, and the sensors of them."""
    kinds = difficult_meshes.difficult_points(surface, count, seed)
    points = np.concatenate(list(kinds.values())).astype(precision).astype(np.float64)
    sensors = probe(mesh, points, position=position, kappa=0.0, precision=precision, device=device)
    return points, surface.nearest(points)[0], sensors


def assert_nearest(points, distance, sensors, surface, precision):
    """The reported point is a nearest one of the surface, whichever of several.

    Returns how far the normal is off the direction to the point, either way round and as the gap's sign has it.
    """
    scale = np.maximum(surface.size, distance)
    closest_point = sensors["point"].astype(np.float64)
    to_point = points - closest_point
    assert (np.abs(np.linalg.norm(to_point, axis=1) - distance) / scale).max() < LENGTH[precision]
    assert (surface.nearest(closest_point)[0] / scale).max() < LENGTH[precision]
    normal, gap = sensors["normal"].astype(np.float64), sensors["gap"].astype(np.float64)[:, None]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=LENGTH[precision])
    # Beside a boundary the gap has no sign.
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
    # A mesh that cuts itself has no inside where it does.
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
    # Where the nearest point is on the rectangle's boundary, P may be a little beside it and count as over it.
    inset = np.minimum(closest_point - surface.low, surface.high - closest_point)[:, :2].min(axis=1)
    boundary = inset < LENGTH[precision] * scale
    over = ~boundary
    assert over.sum() > 1000
    assert boundary.sum() > 300
    clear = distance / scale > ON_SURFACE[precision]
    assert away[over & clear].max() < LENGTH[precision]
    assert (np.abs(np.abs(gap) - distance) / scale)[over].max() < LENGTH[precision]
    sideways = np.sqrt(np.maximum(distance**2 - gap**2, 0))
    # To the gap's rounding the root of a difference of squares is far from exact.
    rounding = np.sqrt(2 * distance * LENGTH[precision] * scale)
    assert (sideways - rounding)[boundary].max() <= BOUNDARY_DISTANCE * edges.max()
    # A height field: inside is what lies below.
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
        # The direction of a blade's edge is a small difference of the normals of its faces.
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
    # The rotation is rounded as well.
    assert (np.abs(sensors["gap"] - expected) / scale).max() < LENGTH[precision]


@pytest.mark.parametrize("thickness", [1e-2, 1e-3])
def test_gap_to_thin_triangles_is_exact_in_float32(thickness, device):
    """Where the float32 query may name a wrong face, its choice is looked at again at any distance."""
    mesh = wc.meshes.box((1.0, 0.7, thickness))
    assert_exact_on_closed(mesh, np.zeros(3), Surface(mesh.vertices[mesh.faces]), 20_000, "float32", device)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_search_radius_excludes_no_point_within_it(precision, device):
    """Beside the rim of a thin box, whose long triangles a float32 query sees farther away than they are."""
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
    # float32 places a point to 6e-8 m.
    np.testing.assert_array_equal(seen[np.abs(away - reach) > 1e-7], (away < reach)[np.abs(away - reach) > 1e-7])
    np.testing.assert_allclose(model.sensor("touch.gap"), np.minimum(away, reach), rtol=0, atol=1e-7)
