"""Drawings of a recording have the poses of the elements, in every record of every environment."""

import numpy as np
import pytest
from recorded_usd_scene import CORNERS, RADII, simulate
from scipy.spatial.transform import Rotation

import warpcontact as wc
from warpcontact.drawing.drawing import drawing_of

TURNED = (0.0, 0.0, np.sin(0.3), np.cos(0.3))


@pytest.fixture(scope="module")
def recording(device):
    return simulate(device)


@pytest.fixture(scope="module")
def drawing(recording):
    return drawing_of(recording)


def figures(drawing, name):
    found = [figure for figure in drawing.figures if figure.name == name]
    assert found
    return found


def corners(figure, frame, row, item=0):
    """Returns the vertices of a figure in the world, (V, 3)."""
    time = min(frame, len(figure.positions) - 1)
    turn = Rotation.from_quat(figure.orientations[min(frame, len(figure.orientations) - 1), row, item])
    return turn.apply(figure.scales[row, item] * figure.shape.vertices) + figure.positions[time, row, item]


def test_drawn_spheres_follow_their_bodies(recording, drawing):
    (ball,) = figures(drawing, "touch")
    assert ball.kind == "sphere"
    np.testing.assert_allclose(ball.scales[:, 0], np.repeat(np.array(RADII)[:, None], 3, axis=1))
    for row in range(len(RADII)):
        body = recording["ball.position"].values[7, row]
        turn = Rotation.from_quat(recording["ball.orientation"].values[7, row])
        found = corners(ball, 7, row)
        np.testing.assert_allclose(found.mean(axis=0), body + turn.apply([0, 0, 0.01]), atol=1e-6)
        distance = np.linalg.norm(found - ball.positions[7, row, 0], axis=1)
        np.testing.assert_allclose(distance, RADII[row], rtol=1e-6)


def test_drawn_points_of_a_set_are_small_spheres_on_their_body(recording, drawing):
    (points,) = figures(drawing, "cube-floor")
    assert (points.kind, points.positions.shape[2]) == ("point", len(CORNERS))
    body = recording["cube.position"].values[11, 2]
    turn = Rotation.from_quat(recording["cube.orientation"].values[11, 2])
    np.testing.assert_allclose(points.positions[11, 2], body + turn.apply(CORNERS), atol=1e-6)
    assert 0.0 < points.scales.max() < 0.1 * np.ptp(CORNERS, axis=0).max()


def test_fixed_surface_is_drawn_once_with_inactive_faces_dimmed(recording, drawing):
    (floor,) = figures(drawing, "floor")
    assert (floor.kind, floor.positions.shape[0]) == ("surface", 1)
    expected = np.array([0.1, 0.2, -0.02]) + recording.scene.surfaces[0].mesh.vertices
    np.testing.assert_allclose(corners(floor, 5, 1), expected)
    np.testing.assert_allclose(floor.shape.colors, [[0.8, 0.6, 0.4], [0.32, 0.24, 0.16]])


def test_drawn_forces_act_at_recorded_points(recording, drawing):
    (touch,) = (one for one in drawing.contact_forces if one.name == "touch")
    normal = recording["touch.normal_force"].values[..., None] * recording["touch.normal"].values
    expected = normal + recording["touch.friction_force"].values if "touch.friction_force" in recording else normal
    np.testing.assert_allclose(touch.forces[:, :, 0], expected, rtol=1e-6)
    peak = max(np.linalg.norm(one.forces, axis=-1).max() for one in drawing.contact_forces)
    assert peak * drawing.force_scale == pytest.approx(1.5 * drawing.size)


def test_invisible_elements_are_not_drawn(device):
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((2, 2)), name="ground", visible=False)
    ball = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(0, 0, 1), name="ball")
    centre = scene.add_point(ball, (0, 0, 0), name="centre")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(centre, ground, material, radius=0.1, name="touch", visible=False)
    scene.add_spring_damper(centre, scene.add_point(None, (0, 0, 2)), stiffness=1.0, name="spring")
    scene.add_shape(ball, wc.shapes.Sphere(0.1), name="hidden", visible=False)
    recording = wc.Simulation(scene.build(device=device), dt=1e-3).run(0.003, poses=True)
    drawing = drawing_of(recording)
    assert (drawing.figures, drawing.contact_forces, [curve.name for curve in drawing.curves]) == (
        [],
        [],
        ["spring"],
    )


@pytest.mark.parametrize(
    "form",
    [
        wc.shapes.Sphere(0.3),
        wc.shapes.Ellipsoid((0.3, 0.2, 0.1)),
        wc.shapes.Cylinder(0.2, 0.3),
        wc.shapes.Capsule(0.1, 0.3),
        wc.shapes.Cone(0.2, 0.4),
        wc.shapes.RoundedBox((0.3, 0.2, 0.1)),
        wc.shapes.Torus(0.3, 0.1),
        wc.shapes.Superellipsoid((0.3, 0.2, 0.1), (0.5, 0.7)),
    ],
    ids=lambda form: type(form).__name__,
)
@pytest.mark.parametrize("count", [None, 3])
def test_drawn_shapes_have_outward_normals(form, count, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    if count is None:
        body = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(1, 2, 3), orientation=TURNED, name="body")
    else:
        body = scene.add_bodies(np.array([[i, 2, 3] for i in range(1, count + 1)]), 1.0, (1, 1, 1), name="body")
    scene.add_shape(body, form, name="form", color=(1, 0, 0))
    recording = wc.Simulation(scene.build(envs=2, device=device), dt=1e-3).run(0.002, poses=True)
    (figure,) = figures(drawing_of(recording), "form")
    assert figure.present.shape == (2, count or 1)
    assert figure.present.all()
    np.testing.assert_allclose(figure.positions[2, 1, -1], [count or 1, 2, 3])
    if count is None:
        np.testing.assert_allclose(figure.orientations[2, 1, 0], TURNED, atol=1e-7)
    shape = figure.shape
    a, b, c = (shape.vertices[shape.faces[:, i]] for i in range(3))
    outward = np.cross(b - a, c - a)
    area = np.linalg.norm(outward, axis=1)
    assert (area > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1.0, rtol=1e-6)
    # Vertex normals are outward and within the smoothing angle of the faces. Slivers, whose normals are rounding,
    # count by their area.
    leaning = np.einsum("fi,fi->f", outward, shape.normals[shape.faces[:, 0]])
    assert (leaning < 0.9 * area).sum(where=area > 1e-4 * area.mean()) == 0
    assert leaning.sum() > 0.99 * area.sum()


def test_shapes_of_several_sizes_are_drawn_once_each(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    rods = scene.add_bodies(np.array([[0, 0, 1], [1, 0, 1], [2, 0, 1.0]]), 1.0, (1, 1, 1), name="rods")
    scene.add_shape(rods, wc.shapes.Capsule(0.1, 0.2), name="hulls")
    model = scene.build(envs=2, device=device)
    model["hulls.half_length"] = [[0.2, 0.3, 0.2]] * 2
    recording = wc.Simulation(model, dt=1e-3).run(0.002, poses=True)
    short, long = sorted(figures(drawing_of(recording), "hulls"), key=lambda one: np.ptp(one.shape.vertices))
    assert np.ptp(long.shape.vertices) == pytest.approx(0.8, rel=1e-3)
    np.testing.assert_array_equal(short.present, [[True, False, True]] * 2)
    np.testing.assert_array_equal(long.present, ~short.present)


def test_body_without_elements_is_drawn_and_shape_set_is_drawn_once(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(1, 2, 3), linear_velocity=(1, 0, 0), name="bare")
    grains = scene.add_bodies(np.array([[0, 0, 1], [1, 0, 1.0]]), 1.0, (1, 1, 1), name="grains")
    scene.add_shape(grains, wc.shapes.Sphere(0.2), name="hulls")
    scene.add_bodies(np.array([[0, 0, 2], [1, 0, 2.0]]), 1.0, (1, 1, 1), name="dust")
    drawing = drawing_of(wc.Simulation(scene.build(device=device), dt=1e-3).run(0.002, poses=True))
    assert [figure.name for figure in drawing.figures] == ["centres", "bare", "hulls"]
    (bare,) = figures(drawing, "bare")
    np.testing.assert_allclose(bare.positions[2, 0, 0], [1.002, 2, 3])
    assert 0.0 < bare.scales.max() < drawing.size
