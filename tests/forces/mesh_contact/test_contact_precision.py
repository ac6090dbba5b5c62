"""Gap, sign and normal in cases prone to rounding: edges, thin triangles, blades, wrong faces from the query."""

import numpy as np
import pytest
from scenes import probe

import warpcontact as wc
from warpcontact import ContactStatus


def box_distance(points, size):
    """Signed distance of points from a box about the origin."""
    q = np.abs(points) - 0.5 * np.asarray(size)
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


# Coordinates are of order one; the bounds are a few roundings in float32 and float64.
PRECISIONS = pytest.mark.parametrize(("precision", "exact"), [("float32", 5e-7), ("float64", 1e-15)])


@PRECISIONS
def test_contact_normal_is_face_normal_up_to_the_edge(precision, exact, device):
    cube = wc.meshes.box((1.0, 1.0, 1.0))
    # Points above the face that approach the edge. The edge is equally near to first order, but must not be
    # selected.
    x = 0.5 - np.geomspace(1e-6, 0.1, 200)
    for face_order in (np.arange(12), np.arange(12)[::-1]):
        mesh = wc.Mesh(cube.vertices, cube.faces[face_order])
        for height in (0.005, 0.05, 0.5):
            points = np.stack([x, 0.1234 + 0 * x, 0.5 + height + 0 * x], axis=1)
            sensors = probe(mesh, points, radius=1.2 * height, device=device, precision=precision)
            # If a difference of coordinates is below rounding, the edge may be selected. The normal is then off by
            # at most √(2 tie/height).
            sure = 0.5 - x > np.sqrt(20 * exact * height)
            np.testing.assert_allclose(sensors["normal"][sure], np.tile((0, 0, 1), (sure.sum(), 1)), atol=exact)
            np.testing.assert_allclose(sensors["gap"], -0.2 * height, atol=exact)


@PRECISIONS
def test_flat_floor_has_no_gap_error_at_its_diagonals(precision, exact, device):
    floor = wc.meshes.grid((1.0, 1.0), (1, 1))
    rng = np.random.default_rng(1)
    along = rng.uniform(-0.45, 0.45, 2000)
    side = rng.choice([-1, 1], 2000) * np.geomspace(1e-9, 1e-2, 2000)
    depth = np.geomspace(1e-5, 1e-2, 2000)[::-1]
    points = np.stack([along + side, along - side, -depth], axis=1)
    sensors = probe(floor, points, device=device, precision=precision)
    np.testing.assert_allclose(sensors["gap"], -depth, atol=exact)
    np.testing.assert_allclose(sensors["normal"], np.tile((0, 0, 1), (2000, 1)), atol=1e-3)


@PRECISIONS
@pytest.mark.parametrize("strips", [10, 100, 1000])
def test_thin_triangles_keep_gap_precision(strips, precision, exact, device):
    floor = wc.meshes.grid((1.0, 1.0), (1, strips))
    rng = np.random.default_rng(strips)
    depth = np.geomspace(1e-6, 1e-2, 3000)
    points = np.stack([*rng.uniform(-0.45, 0.45, (2, 3000)), -depth], axis=1)
    sensors = probe(floor, points, device=device, precision=precision)
    np.testing.assert_allclose(sensors["gap"], -depth, atol=exact)
    assert (sensors["status"] == ContactStatus.CONTACT).all()
    # Penetrations of 1e-6 at coordinates of 0.5 leave six digits less for a normal at an edge.
    deep = depth > 1e-4
    np.testing.assert_allclose(sensors["normal"][deep], np.tile((0, 0, 1), (deep.sum(), 1)), atol=2e-3)


@PRECISIONS
@pytest.mark.parametrize("thickness", [1e-2, 1e-3])
def test_thin_blade_distinguishes_both_sides(thickness, precision, exact, device):
    size = (1.0, 1.0, thickness)
    blade = wc.meshes.box(size)
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.7, 0.7, (4000, 3))
    points[:2000, 2] *= 3 * thickness  # near the blade
    points[2000:2500, 0] = 0.5 + rng.normal(size=500) * 1e-5  # near its edges
    expected = box_distance(points, size)
    for radius in (0.0, 0.3):
        sensors = probe(blade, points, radius=radius, device=device, precision=precision)
        # At the middle of the blade, rounding decides which side is nearer; the distance is the same. The result
        # is also exact without contact: if the float32 query may return a wrong face, it is refined.
        np.testing.assert_allclose(sensors["gap"] + radius, expected, atol=exact)


def test_gap_sign_is_correct_for_rounding_sensitive_points(device):
    tetrahedron = wc.Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    )
    above = probe(tetrahedron, [(6.30810109e-6, 1.35726877e-5, 1.00000286)], radius=0.05, device=device)
    np.testing.assert_allclose(above["gap"] + 0.05, 1.32e-5, atol=2e-6)
    blade = wc.meshes.box((1.0, 1.0, 1e-4))
    below = probe(blade, [(-0.49998909, -0.49109605, -0.14033279)], radius=0.3, device=device)
    np.testing.assert_allclose(below["gap"] + 0.3, 0.14033279 - 5e-5, atol=1e-6)
    far = probe(blade, [(456.47, -1075.77, 9931.48)], device=device)
    assert far["gap"][0] > 9000


def test_contact_is_detected_if_float32_query_returns_wrong_face(device):
    """A cylinder of 2000 sides: its facets are so thin that the float32 query returns wrong ones."""
    sides = 2000
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-0.5, 0.5)])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = np.concatenate([np.stack([i, j, sides + j], axis=1), np.stack([i, sides + j, sides + i], axis=1)])
    pipe = wc.Mesh(vertices, faces)
    rng = np.random.default_rng(6)
    turn = rng.uniform(0, 2 * np.pi, 3000)
    # The distance from a facet, along the normal at its center.
    middle = (np.floor(turn / (2 * np.pi) * sides) + 0.5) * 2 * np.pi / sides
    depth = np.geomspace(1e-9, 1e-4, 3000)
    reach = np.cos(np.pi / sides) / np.cos(turn - middle)
    inside = 1 - depth / reach / np.cos(turn - middle)
    points = np.column_stack(
        [*(reach * inside * np.array([np.cos(turn), np.sin(turn)])), rng.uniform(-0.4, 0.4, 3000)]
    )
    sensors = probe(pipe, points, device=device, precision="float64")
    assert (sensors["status"] == ContactStatus.CONTACT).all()
    # The penetration relative to the nearest facet is at most that relative to this one.
    assert (sensors["penetration"] <= depth + 1e-15).all()
    np.testing.assert_allclose(sensors["penetration"], depth, atol=1e-6)


def test_active_face_determines_status_on_shared_edge(device):
    square = wc.Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    rng = np.random.default_rng(7)
    along = rng.uniform(-0.9, 0.9, 500)
    points = np.stack([along, along, np.full(500, -1e-3)], axis=1)
    for active in ([0], [1]):
        sensors = probe(square, points, active_faces=active, device=device)
        assert (sensors["status"] == ContactStatus.CONTACT).all()
