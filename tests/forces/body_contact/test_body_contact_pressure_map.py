"""Pressure maps of body contacts: their area and the integral of their pressure are the sensors of the contact.

Pictures compute them on a CPU.
"""

import numpy as np
import pytest
from part_meshes import prism
from scipy.spatial.transform import Rotation

import warpcontact as wc
from warpcontact.forces.body_contact.map_triangles import MapTriangles, hide_layers, refine
from warpcontact.forces.body_contact.pressure_map import pressure_map

SIDE, K, DEPTH = 0.1, 2e7, 1e-3
RADIUS = 0.05
TILT = 0.02
# A U profile that opens downwards.
U_OUTLINE = [(-5, -3), (-3, -3), (-3, 3), (3, 3), (3, -3), (5, -3), (5, 5), (-5, 5)]
U_TRIANGLES = [(0, 1, 2), (0, 2, 7), (2, 6, 7), (2, 3, 6), (3, 4, 5), (3, 5, 6)]


def built(upper, lower, envs, law=None, **options):
    """Returns a model of a solid on ``body`` in contact with a solid on the world."""
    scene = wc.Scene()
    body = scene.add_body(mass=1.0, inertia=(1e-3,) * 3, name="body")
    solids = [
        scene.add_surface(one, body=on, name=name)
        if isinstance(one, wc.Mesh)
        else scene.add_shape(on, one, name=name)
        for one, on, name in ((upper, body, "upper"), (lower, None, "lower"))
    ]
    law = law or wc.laws.ElasticFoundation(stiffness=K)
    scene.add_body_contact(*solids, wc.ContactMaterial(law=law), name="press", **options)
    return scene.build(envs=envs, device="cpu", precision="float64")


def mapped(model):
    """Returns the pressure map of the current state, and its areas and forces (env,)."""
    found = pressure_map(model.force_elements[0], model)
    shape = (model.envs, 1)
    return found, found.area(shape)[:, 0], found.normal_force(shape)[:, 0]


def about_y(angles):
    return Rotation.from_rotvec(np.outer(angles, (0, 1, 0))).as_quat()


def cube(side=SIDE):
    return wc.shapes.RoundedBox((side / 2,) * 3)


def assert_sums_are_sensors(model, tolerance):
    _, area, force = mapped(model)
    np.testing.assert_allclose(area, model.sensor("press.area"), rtol=tolerance)
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=tolerance)


@pytest.fixture(scope="module")
def on_plane():
    """A cube on a plane: flat, tilted, on an edge, and above it."""
    model = built(cube(), wc.shapes.Plane(), 4)
    edge = SIDE / np.sqrt(2) - DEPTH
    model["body.position"] = [(0, 0, SIDE / 2 - DEPTH), (0, 0, SIDE / 2 - DEPTH), (0.3, 0, edge), (0, 0, 1)]
    model["body.orientation"] = about_y([0, TILT, np.pi / 4, 0])
    return model


def test_map_of_a_cube_on_a_plane_has_the_area_and_force_of_the_sensors(on_plane):
    assert_sums_are_sensors(on_plane, 1e-9)  # pressure is affine on each triangle


def test_flat_face_is_a_square_of_uniform_pressure(on_plane):
    found, area, _ = mapped(on_plane)
    own = found.env == 0
    assert area[0] == pytest.approx(SIDE**2, rel=1e-12)
    np.testing.assert_allclose(found.pressures[own], K * DEPTH, rtol=1e-9)
    assert np.abs(found.positions[own][..., :2]).max() == pytest.approx(SIDE / 2)
    np.testing.assert_allclose(found.positions[own][..., 2], 0.0, atol=1e-15)


def test_pressure_below_a_tilted_face_is_linear(on_plane):
    found, _, _ = mapped(on_plane)
    own = found.env == 1
    x = found.positions[own][..., 0]
    # Height of the lower face above the plane at x.
    height = SIDE / 2 - DEPTH - SIDE / 2 / np.cos(TILT) - x * np.tan(TILT)
    lower_face = np.abs(x + SIDE / 2 * np.sin(TILT)) <= SIDE / 2 * np.cos(TILT)
    # The others are below the side wall.
    assert found.areas[own][lower_face.all(axis=1)].sum() > 0.98 * found.areas[own].sum()
    np.testing.assert_allclose(
        found.pressures[own][lower_face], K * np.maximum(-height, 0.0)[lower_face], atol=1e-9 * K * DEPTH
    )


def test_edge_in_a_plane_is_a_strip(on_plane):
    found, area, force = mapped(on_plane)
    assert area[2] == pytest.approx(2 * DEPTH * SIDE, rel=1e-9)
    assert force[2] == pytest.approx(K * DEPTH**2 * SIDE, rel=1e-9)
    assert found.pressures[found.env == 2].max() == pytest.approx(K * DEPTH, rel=1e-9)


def test_open_contact_has_no_triangles(on_plane):
    found, area, _ = mapped(on_plane)
    assert not (found.env == 3).any()
    assert area[3] == 0.0


def test_common_area_of_turned_cubes_is_drawn_once():
    model = built(cube(), cube(), 3)
    model["body.position"] = [(0.02, 0.01, SIDE - DEPTH), (0, 0, SIDE - DEPTH), (0.01, 0, SIDE - DEPTH)]
    turned = Rotation.from_euler("z", [[0], [45], [0]], degrees=True).as_quat()
    turned[2] = about_y([1e-3])[0]
    model["body.orientation"] = turned
    found, area, force = mapped(model)
    octagon = 2 * (np.sqrt(2) - 1) * SIDE**2
    drawn = [found.areas[(found.env == env) & found.is_main].sum() for env in (0, 1)]
    np.testing.assert_allclose(area[:2], [0.08 * 0.09, octagon], rtol=1e-9)
    np.testing.assert_allclose(drawn, area[:2], rtol=1e-9)
    np.testing.assert_allclose(force[:2], K * DEPTH * area[:2], rtol=1e-9)
    # Columns of decreasing weight on the sides of a tilted cube are interpolated.
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=1e-4)
    np.testing.assert_allclose(area, model.sensor("press.area"), rtol=1e-4)


def test_force_of_a_law_per_contact_is_distributed_over_the_area():
    law = wc.laws.HuntCrossley(stiffness=1e5, exponent=1.5, damping=1.0)
    model = built(cube(), wc.shapes.Plane(), 2, law=law)
    model["body.position"] = [(0, 0, SIDE / 2 - DEPTH)] * 2
    model["press.force_scale"] = [1.0, 0.5]
    found, _, force = mapped(model)
    np.testing.assert_allclose(force, 1e5 * DEPTH**1.5 * np.array([1.0, 0.5]), rtol=1e-9)
    np.testing.assert_allclose(found.pressures[found.env == 0], force[0] / SIDE**2, rtol=1e-9)


def test_pressure_includes_the_damping_of_the_present_speed():
    model = built(cube(), wc.shapes.Plane(), 2, law=wc.laws.ElasticFoundation(stiffness=K, damping=2.0))
    model["body.position"] = [(0, 0, SIDE / 2 - DEPTH)] * 2
    model["body.linear_velocity"] = [(0, 0, -0.1), (0, 0, 0.1)]
    found, _, _ = mapped(model)
    for env, speed in enumerate((0.1, -0.1)):
        np.testing.assert_allclose(found.pressures[found.env == env], K * DEPTH * (1 + 2.0 * speed), rtol=1e-9)
    assert_sums_are_sensors(model, 1e-9)


def test_disabled_and_too_deep_contacts_have_no_triangles():
    model = built(cube(), wc.shapes.Plane(), 3)
    model["body.position"] = [(0, 0, SIDE / 2 - DEPTH)] * 3
    model["press.enabled"] = [1, 0, 1]
    model["press.max_depth"] = [1.0, 1.0, DEPTH / 2]
    found, _, _ = mapped(model)
    assert set(found.env) == {0}


def test_sphere_in_a_plane_has_the_pressure_of_its_shape():
    model = built(wc.shapes.Sphere(RADIUS), wc.shapes.Plane(), 2)
    model["body.position"] = [(0.1, 0, RADIUS - DEPTH), (0.1, 0, -0.02)]
    found, area, force = mapped(model)
    own = found.env == 0
    distance = np.linalg.norm(found.positions[own][..., :2] - (0.1, 0), axis=-1)
    depth = np.sqrt(np.maximum(RADIUS**2 - distance**2, 0.0)) - (RADIUS - DEPTH)
    # Triangles are divided once after the depths were computed at their vertices.
    np.testing.assert_allclose(found.pressures[own], K * np.maximum(depth, 0.0), atol=0.04 * K * DEPTH)
    # The outline has chords of 11°, and depths between vertices are interpolated.
    np.testing.assert_allclose(area, model.sensor("press.area"), rtol=0.01)
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=0.03)


@pytest.mark.parametrize("upper", [wc.shapes.Cylinder(RADIUS, RADIUS), wc.shapes.Capsule(RADIUS, RADIUS)])
@pytest.mark.parametrize("lower", [wc.shapes.Plane(), wc.shapes.RoundedBox((0.2, 0.2, 0.1))])
def test_lying_shapes_have_the_area_and_force_of_the_sensors(upper, lower):
    model = built(upper, lower, 2)
    top = 0.1 if isinstance(lower, wc.shapes.RoundedBox) else 0.0
    model["body.position"] = [(0, 0, top + RADIUS - DEPTH), (0.18, 0.02, top + RADIUS - DEPTH)]
    model["body.orientation"] = about_y([np.pi / 2, np.pi / 2])
    _, area, force = mapped(model)
    np.testing.assert_allclose(area, model.sensor("press.area"), rtol=0.01)
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=0.03)


def test_edge_on_a_cylinder_is_drawn_on_the_cylinder():
    model = built(cube(), wc.shapes.Cylinder(RADIUS, 2 * RADIUS), 1)
    model["lower.orientation"] = Rotation.from_euler("x", 90, degrees=True).as_quat()
    model["body.position"] = (0, 0, RADIUS + SIDE / np.sqrt(2) - DEPTH)
    model["body.orientation"] = about_y([np.pi / 4])
    found, _, force = mapped(model)
    drawn = found.positions[found.is_main]
    np.testing.assert_allclose(np.hypot(drawn[..., 0], drawn[..., 2]), RADIUS, rtol=1e-4)
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=0.01)


def test_spheres_have_a_common_disc():
    model = built(wc.shapes.Sphere(RADIUS), wc.shapes.Sphere(RADIUS), 1)
    model["body.position"] = (0, 0, 2 * RADIUS - DEPTH)
    found, area, force = mapped(model)
    np.testing.assert_allclose(found.positions[..., 2], RADIUS - DEPTH / 2, atol=1e-9)
    assert found.pressures.max() == pytest.approx(K * DEPTH, rel=1e-9)
    np.testing.assert_allclose(area, model.sensor("press.area"), rtol=0.01)
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=0.02)


def test_map_of_a_solid_that_is_not_convex_ends_at_the_first_exit():
    mesh = prism(0.01 * np.array(U_OUTLINE), U_TRIANGLES, 0.1)
    model = built(mesh, cube(), 2)
    upright = Rotation.from_euler("x", 90, degrees=True)
    model["body.position"] = [(0.02, 0.01, SIDE / 2 + 0.03 - DEPTH)] * 2
    model["body.orientation"] = (Rotation.from_quat(about_y([0, TILT / 10])) * upright).as_quat()
    found, area, force = mapped(model)
    np.testing.assert_allclose(area, model.sensor("press.area"), rtol=1e-3)
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=1e-3)
    # One leg on the cube, and not the bridge above it.
    assert found.pressures[found.env == 0].max() == pytest.approx(K * DEPTH, rel=1e-9)


def test_sunk_plate_has_the_pressure_of_its_thickness():
    thickness = 2 * DEPTH
    model = built(wc.shapes.RoundedBox((0.05, 0.05, thickness / 2)), wc.shapes.Plane(), 1)
    model["body.position"] = (0, 0, -3 * thickness)
    found, area, force = mapped(model)
    np.testing.assert_allclose(found.pressures, K * thickness, rtol=1e-9)
    assert area[0] == pytest.approx(0.01, rel=1e-9)
    np.testing.assert_allclose(force, model.sensor("press.normal_force"), rtol=1e-9)


def triangle(positions, depths, weight=1.0):
    """Returns one triangle of a face in the plane z = 0."""
    zeros, one = np.zeros(1, dtype=np.int32), np.ones((1, 3))
    normals = np.broadcast_to((0.0, 0.0, 1.0), (1, 3, 3))
    return MapTriangles(
        *(zeros,) * 4,
        np.array([weight]),
        np.array([positions], dtype=float),
        normals,
        np.array([depths], dtype=float),
        np.zeros((1, 3)),
        one,
    )


def area_of(triangles):
    edges = triangles.edges(triangles.positions)
    return 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()


def test_refined_triangles_cover_the_same_area_in_small_steps_of_depth():
    whole = triangle([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [0.0, 3.0, 1.0])
    found = refine(whole)
    assert area_of(found) == pytest.approx(0.5)
    assert np.ptp(found.depths, axis=1).max() <= 3.0 / 6.0
    x, y = found.positions[..., 0], found.positions[..., 1]
    np.testing.assert_allclose(found.depths, 3.0 * x + y, atol=1e-12)


@pytest.mark.parametrize(("depth", "area"), [(0.5, 0.25), (2.0, 0.5)])
def test_entry_hides_the_part_of_an_exit_below_it(depth, area):
    exits = triangle([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [1.0, 1.0, 1.0])
    entries = triangle([(0, 0, 0), (1, 0, 0), (0.5, 0.5, 0)], [depth] * 3, weight=-1.0)
    found = hide_layers(exits.joined(entries), np.array([False]))
    # Cells along the boundary are visible or hidden as a whole.
    assert area_of(found) == pytest.approx(area, abs=0.02)
