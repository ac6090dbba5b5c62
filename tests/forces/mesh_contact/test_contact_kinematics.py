"""Closest point, orientation, active faces, boundaries: the sensor table and hand values of SPEC 1."""

import json

import numpy as np
import pytest
from scenes import oracle_law, probe, square

import warpcontact as wc
from warpcontact import ContactStatus

# One float32 epsilon is 1.2e-7; positions of order one pass a rotation, a query and the inverse rotation.
LENGTH = 1.0e-6


def tetrahedron():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    return wc.Mesh(vertices, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], name="tetrahedron")


# Hand values of SPEC 1


BODY_1 = {"position": (0.1, 0, 0.3), "linear_velocity": (0.4, -0.1, -0.5), "angular_velocity": (0, 1, 0.5)}
BODY_2 = {"position": (0, 0, -0.2), "linear_velocity": (0.05, 0, 0.02), "angular_velocity": (0, 0, 0.3)}


def oracle_model(mesh, point, precision, device, **contact):
    """Two moving bodies. The surface is fixed to the second, with its frame given in the world."""
    scene = wc.Scene(gravity=(0, 0, 0))
    one = scene.add_body(1.0, (1, 1, 1), name="one", **BODY_1)
    two = scene.add_body(1.0, (1, 1, 1), name="two", **BODY_2)
    surface = scene.add_surface(mesh, two, position=(0, 0, 0.2), name="surface")
    offset = np.subtract(point, BODY_1["position"])
    scene.add_contact(scene.add_point(one, offset), surface, oracle_law(), name="touch", **contact)
    return scene.build(device=device, precision=precision)


PLANE_CASES = {
    "point_plane": ((0.2, 0.1, -0.003), {"kappa": 0.5}),
    "point_plane_K_at_S": ((0.2, 0.1, -0.003), {"kappa": 0.0}),
    "point_plane_K_at_P": ((0.2, 0.1, -0.003), {"kappa": 1.0}),
    "sphere_plane": ((0.2, 0.1, 0.047), {"radius": 0.05}),
    "sphere_plane_deep": ((0.2, 0.1, -0.01), {"radius": 0.05}),
    "open": ((0.2, 0.1, 0.02), {}),
    "on_surface": ((0.2, 0.1, 0.0), {}),
}


# In float32, δ = 3e-3 is a difference of numbers of order 0.3, with a relative error of 3e-8/3e-3 = 1e-5. Every
# force is proportional to it.
@pytest.mark.parametrize(("precision", "rtol"), [("float32", 4e-5), ("float64", 1e-9)])
@pytest.mark.parametrize("case", PLANE_CASES)
def test_point_on_plane_matches_reference(case, precision, rtol, shared, device):
    oracle = json.loads((shared / "spec" / "oracle_contactps2.json").read_text())[case]
    point, options = PLANE_CASES[case]
    model = oracle_model(square(), point, precision, device, **options)
    assert_like_oracle(model, oracle, rtol)


def assert_like_oracle(model, oracle, rtol):
    def close(name, expected, scale=1.0):
        np.testing.assert_allclose(model.sensor(name)[0], expected, rtol=rtol, atol=rtol * scale, err_msg=name)

    assert ContactStatus(model.sensor("touch.status")[0]).name == oracle["status"]
    close("touch.gap", oracle["gap"], 0.01)
    close("touch.penetration", oracle["delta"], 0.01)
    close("one.force", oracle["F1"], np.linalg.norm(oracle["F1"]))
    if oracle["K"] is None:
        return
    close("touch.point", oracle["K"])
    close("touch.approach_speed", oracle["v_n"])
    close("touch.slip_speed", np.linalg.norm(oracle["v_t"]))
    close("touch.normal_force", oracle["N"])
    close("touch.friction_force", oracle["Ft"], np.linalg.norm(oracle["F1"]))
    close("two.force", oracle["F2"], np.linalg.norm(oracle["F1"]))
    close("one.torque", oracle["tau1"], np.linalg.norm(oracle["tau1"]))
    close("two.torque", oracle["tau2"], np.linalg.norm(oracle["tau1"]))
    power = power_of_pair(model)
    np.testing.assert_allclose(power, oracle["power"], rtol=10 * rtol)


def power_of_pair(model):
    """Power of the contact force on both bodies, from wrenches and velocities."""
    total = 0.0
    for body in ("one", "two"):
        total += model.sensor(f"{body}.force")[0] @ model.sensor(f"{body}.linear_velocity")[0]
        total += model.sensor(f"{body}.torque")[0] @ model.sensor(f"{body}.angular_velocity")[0]
    return total


def test_point_on_meshed_sphere_converges_to_reference(shared, device):
    oracle = json.loads((shared / "spec" / "oracle_contactps2.json").read_text())["point_sphere"]
    # A facet of the fine icosphere (edge 0.02) is up to h²/8 = 5e-5 inside. With δ = 4e-3 that is 1.5 % of the
    # force.
    direction = np.array([1.0, 2.0, 2.0]) / 3.0
    model = oracle_model(wc.meshes.icosphere(1.0, 6), 0.996 * direction, "float32", device)
    assert ContactStatus(model.sensor("touch.status")[0]) == ContactStatus.CONTACT
    np.testing.assert_allclose(model.sensor("touch.penetration")[0], oracle["delta"], rtol=0.015)
    np.testing.assert_allclose(model.sensor("touch.point")[0], oracle["K"], atol=5e-5)
    np.testing.assert_allclose(model.sensor("one.force")[0], oracle["F1"], rtol=0.03)


def test_contact_wrenches_cancel_about_any_point(device):
    model = oracle_model(square(), (0.2, 0.1, -0.003), "float32", device)
    f1, f2 = model.sensor("one.force")[0], model.sensor("two.force")[0]
    np.testing.assert_array_equal(f1, -f2)
    r1, r2 = np.array(BODY_1["position"]), np.array(BODY_2["position"])
    moments = [
        model.sensor("one.torque")[0] + np.cross(r1, f1),
        model.sensor("two.torque")[0] + np.cross(r2, f2),
    ]
    # The moments are of order 100 N·m; the bound is a few float32 roundings.
    assert np.abs(sum(moments)).max() < 1e-4


# The sensor table, row by row


def test_open_contact_has_no_force_and_zero_gap_is_open(device):
    sensors = probe(square(), [(0.1, 0.2, 0.3), (0.1, 0.2, 0.05)], radius=0.05, device=device)
    np.testing.assert_allclose(sensors["gap"], [0.25, 0.0], atol=LENGTH)
    assert sensors["penetration"].tolist() == [0.0, 0.0]
    assert sensors["normal_force"].tolist() == [0.0, 0.0]
    assert sensors["status"][0] == ContactStatus.OPEN


def test_point_exactly_on_the_surface_is_open(device):
    sensors = probe(square(), [(0.1, 0.2, 0.0)], device=device)
    assert sensors["gap"][0] == 0.0
    assert sensors["penetration"][0] == 0.0
    assert sensors["status"][0] == ContactStatus.OPEN
    np.testing.assert_allclose(sensors["normal"][0], (0, 0, 1))


def test_penetrating_point_has_expected_gap_and_normal(device):
    sensors = probe(square(), [(0.1, 0.2, -0.01)], device=device)
    assert sensors["status"][0] == ContactStatus.CONTACT
    np.testing.assert_allclose(sensors["gap"], -0.01, atol=LENGTH)
    np.testing.assert_allclose(sensors["penetration"], 0.01, atol=LENGTH)
    np.testing.assert_allclose(sensors["normal"][0], (0, 0, 1), atol=LENGTH)


def test_inactive_faces_have_distance_but_no_force(device):
    # The upper left triangle is inactive. The search covers all faces, so the point above it gets status INACTIVE.
    positions = [(-0.5, 0.5, -0.01), (-0.5, 0.5, 0.3), (0.5, -0.5, -0.01)]
    sensors = probe(square(), positions, active_faces=[0], device=device)
    assert sensors["status"].tolist() == [ContactStatus.INACTIVE, ContactStatus.INACTIVE, ContactStatus.CONTACT]
    np.testing.assert_allclose(sensors["gap"], [0.01, 0.3, -0.01], atol=LENGTH)
    assert sensors["normal_force"][:2].tolist() == [0.0, 0.0]
    sphere = probe(square(), positions[:2], active_faces=[0], radius=0.1, device=device)
    np.testing.assert_allclose(sphere["gap"], [0.0, 0.2], atol=LENGTH)
    assert sphere["normal_force"].tolist() == [0.0, 0.0]


def test_edge_shared_with_an_active_face_is_active(device):
    # The diagonal belongs to both triangles.
    sensors = probe(square(), [(0.25, 0.25, -0.01)], active_faces=[0], device=device)
    assert sensors["status"][0] == ContactStatus.CONTACT


def test_search_active_returns_nearest_point_of_the_active_part(device):
    # Over the inactive triangle, 0.1 from the diagonal: the nearest active point is on the diagonal, which is a
    # boundary.
    beside = (-0.1 / np.sqrt(2), 0.1 / np.sqrt(2), 0.05)
    for boundary, status in (("off", ContactStatus.OPEN), ("outer", ContactStatus.CONTACT)):
        sensors = probe(
            square(), [beside], active_faces=[0], search="active", radius=0.2, boundary=boundary, device=device
        )
        assert sensors["status"][0] == status
        expected = np.hypot(0.1, 0.05) - 0.2
        gap = expected if boundary == "outer" else 0.0
        np.testing.assert_allclose(sensors["gap"], gap, atol=LENGTH)
    point = probe(square(), [(*beside[:2], -0.05)], active_faces=[0], search="active", device=device)
    assert point["status"][0] == ContactStatus.OPEN
    np.testing.assert_allclose(point["gap"], np.hypot(0.1, 0.05), atol=LENGTH)


def test_surface_beyond_search_radius_has_status_far(device):
    sensors = probe(square(), [(0, 0, 0.5), (0, 0, 0.2)], radius=0.05, search_radius=0.3, device=device)
    assert sensors["status"].tolist() == [ContactStatus.FAR, ContactStatus.OPEN]
    np.testing.assert_allclose(sensors["gap"], [0.25, 0.15], atol=LENGTH)


def test_point_deeper_than_max_depth_has_status_wrong_side(device):
    sensors = probe(square(), [(0, 0, -0.01), (0, 0, -0.2)], max_depth=0.05, device=device)
    assert sensors["status"].tolist() == [ContactStatus.CONTACT, ContactStatus.WRONG_SIDE]
    np.testing.assert_allclose(sensors["gap"], [-0.01, -0.2], atol=LENGTH)
    assert sensors["penetration"][1] == 0.0
    assert sensors["normal_force"][1] == 0.0


def test_disabled_contact_has_no_gap_and_no_force(device):
    sensors = probe(square(), [(0, 0, -0.01)], enabled=False, device=device)
    assert sensors["status"][0] == ContactStatus.DISABLED
    assert np.isnan(sensors["gap"][0])
    assert sensors["normal_force"][0] == 0.0


# Edges, vertices, boundaries, far field


def test_contact_normals_at_cube_edges_and_vertices_match_directions(device):
    cube = wc.meshes.box((1.0, 1.0, 1.0))
    h = np.sqrt(0.5)
    positions = [(0.7, 0.0, 0.7), (0.7, 0.7, 0.7), (0.7, 0.0, 0.0)]
    sensors = probe(cube, positions, radius=0.5, device=device)
    distance = np.array([np.sqrt(2) * 0.2, np.sqrt(3) * 0.2, 0.2])
    np.testing.assert_allclose(sensors["gap"], distance - 0.5, atol=LENGTH)
    directions = [(h, 0, h), np.full(3, 1 / np.sqrt(3)), (1, 0, 0)]
    np.testing.assert_allclose(sensors["normal"], directions, atol=4 * LENGTH)


def test_gap_sign_is_correct_inside_and_outside_a_cube(device):
    cube = wc.meshes.box((1.0, 1.0, 1.0))
    rng = np.random.default_rng(1)
    positions = rng.uniform(-1.0, 1.0, (4000, 3))
    q = np.abs(positions) - 0.5
    exact = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    sensors = probe(cube, positions, device=device)
    np.testing.assert_allclose(sensors["gap"], exact, atol=2 * LENGTH)


def test_gap_sign_is_correct_far_from_a_tetrahedron(device):
    """Positions for which Warp's ``sign_normal`` is wrong."""
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sensors = probe(tetrahedron(), 50.0 * directions, device=device)
    assert (sensors["gap"] > 48.0).all()
    assert (sensors["status"] == ContactStatus.OPEN).all()


def test_gap_is_negative_inside_a_tetrahedron(device):
    rng = np.random.default_rng(3)
    inside = rng.dirichlet(np.ones(4), 2000)[:, 1:]
    sensors = probe(tetrahedron(), inside, device=device)
    exact = -np.minimum(inside.min(axis=1), (1 - inside.sum(axis=1)) / np.sqrt(3))
    np.testing.assert_allclose(sensors["gap"], exact, atol=LENGTH)


def test_normal_at_concave_edge_points_out_of_the_material(device):
    # A ridge seen from below is a valley: the nearest feature of a point under it is the concave edge.
    roof = wc.Mesh(
        [[-1, -1, 1], [0, -1, 0], [0, 1, 0], [-1, 1, 1], [1, -1, 1], [1, 1, 1]],
        [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]],
    )
    sensors = probe(roof, [(0.02, 0.0, -0.1)], device=device)
    expected = np.array([-0.02, 0, 0.1]) / np.hypot(0.02, 0.1)
    np.testing.assert_allclose(sensors["normal"][0], expected, atol=4 * LENGTH)
    np.testing.assert_allclose(sensors["gap"][0], -np.hypot(0.02, 0.1), atol=LENGTH)


def test_point_beyond_the_boundary_is_open(device):
    positions = [(1.1, 0.0, -0.01), (1.0 + 1e-5, 0.0, -0.01), (0.999, 0.0, -0.01), (1.1, 1.1, -0.01)]
    sensors = probe(square(), positions, device=device)
    # 1e-5 outside a boundary of length 2 is within the tolerance of 1e-4 of the edge.
    assert sensors["status"].tolist() == [
        ContactStatus.OPEN,
        ContactStatus.CONTACT,
        ContactStatus.CONTACT,
        ContactStatus.OPEN,
    ]
    np.testing.assert_allclose(sensors["gap"][0], np.hypot(0.1, 0.01), atol=LENGTH)
    np.testing.assert_allclose(sensors["gap"][1], -0.01, atol=LENGTH)


@pytest.mark.parametrize(("boundary", "touching"), [("off", ContactStatus.OPEN), ("outer", ContactStatus.CONTACT)])
def test_sphere_contacts_boundary_only_with_boundary_outer(boundary, touching, device):
    positions = [(1.06, 0.0, 0.08), (1.06, 0.0, -0.08)]
    sensors = probe(square(), positions, radius=0.2, boundary=boundary, device=device)
    assert sensors["status"].tolist() == [touching, ContactStatus.OPEN]
    if boundary == "outer":
        np.testing.assert_allclose(sensors["gap"][0], 0.1 - 0.2, atol=LENGTH)
        np.testing.assert_allclose(sensors["normal"][0], (0.6, 0, 0.8), atol=4 * LENGTH)


def test_nearest_face_of_plate_changes_at_half_its_thickness(device):
    plate = wc.meshes.box((1.0, 1.0, 0.02))
    sensors = probe(plate, [(0.1, 0.2, 0.0001), (0.1, 0.2, -0.0001)], device=device)
    np.testing.assert_allclose(sensors["normal"][:, 2], [1, -1], atol=LENGTH)
    np.testing.assert_allclose(sensors["gap"], -0.0099, atol=LENGTH)


def test_tie_is_broken_by_the_lowest_face_index(device):
    cube = wc.meshes.box((1.0, 1.0, 1.0))
    for order in (np.arange(12), np.arange(12)[::-1]):
        mesh = wc.Mesh(cube.vertices, cube.faces[order])
        first = mesh.vertices[mesh.faces[0]]
        normal = np.cross(first[1] - first[0], first[2] - first[0])
        sensors = probe(mesh, [(0.0, 0.0, 0.0)], device=device)
        np.testing.assert_allclose(sensors["normal"][0], normal / np.linalg.norm(normal), atol=LENGTH)


def test_flip_reverses_the_outer_side(device):
    sensors = probe(square(), [(0.1, 0.0, 0.01)], flip=True, device=device)
    assert sensors["status"][0] == ContactStatus.CONTACT
    np.testing.assert_allclose(sensors["normal"][0], (0, 0, -1), atol=LENGTH)


def test_contact_normal_is_continuous_while_sphere_rolls_over_an_edge(device):
    cube = wc.meshes.box((1.0, 1.0, 1.0))
    angle = np.linspace(-0.3, np.pi / 2 + 0.3, 400)
    # The offset surface of the cube at 0.05: along the top, around the edge, down the side.
    along = np.minimum(angle, 0.0) + np.maximum(angle - np.pi / 2, 0.0)
    turn = np.clip(angle, 0.0, np.pi / 2)
    x = 0.5 + 0.05 * np.sin(turn) + np.where(angle < 0, along, 0.0)
    z = 0.5 + 0.05 * np.cos(turn) - np.where(angle > np.pi / 2, along, 0.0)
    sensors = probe(cube, np.stack([x, 0 * x, z], axis=1), radius=0.06, device=device)
    assert (sensors["status"] == ContactStatus.CONTACT).all()
    # The gap is constant, and the normal never turns by more than the path.
    np.testing.assert_allclose(sensors["gap"], -0.01, atol=LENGTH)
    steps = np.linalg.norm(np.diff(sensors["normal"], axis=0), axis=1)
    # At an edge, the direction over a distance of 0.05 m has a rounding error of 1e-7/0.05.
    assert steps.max() <= np.diff(angle).max() + 1e-5


# Surfaces on bodies


def test_surface_moves_with_its_body(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    turned = np.sin(np.pi / 4)
    plate = scene.add_body(1.0, (1, 1, 1), position=(5, 0, 0), orientation=(0, turned, 0, turned), name="plate")
    # The body is rotated by 90° about y: its z axis is the x axis of the world.
    surface = scene.add_surface(square(), plate, position=(0, 0, 0.5), name="surface")
    point = scene.add_point(None, (5.49, 0.1, 0.2))
    scene.add_contact(point, surface, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), name="touch")
    model = scene.build(device=device)
    np.testing.assert_allclose(model.sensor("touch.gap"), -0.01, atol=2 * LENGTH)
    np.testing.assert_allclose(model.sensor("touch.normal")[0], (1, 0, 0), atol=LENGTH)
    # The reaction acts on the plate only, because the point is fixed to the world.
    np.testing.assert_allclose(model.sensor("plate.force")[0], (-100, 0, 0), atol=0.05)


def test_surface_pose_can_differ_between_environments(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    surface = scene.add_surface(square(), name="surface")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 1.0), name="body")
    point = scene.add_point(body, (0, 0, 0))
    scene.add_contact(point, surface, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0)), name="touch")
    model = scene.build(envs=3, device=device)
    model["surface.position"] = [(0, 0, 0), (0, 0, 0.5), (0, 0, -1)]
    np.testing.assert_allclose(model.sensor("touch.gap"), [1.0, 0.5, 2.0], atol=LENGTH)


# Contacts that begin on the inner side


def latched(entry, z0, velocity, device, steps=200, **options):
    scene = wc.Scene(gravity=(0, 0, 0))
    surface = scene.add_surface(square(), name="surface")
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, z0), linear_velocity=velocity, name="body")
    law = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0e4))
    scene.add_contact(scene.add_point(body, (0, 0, 0)), surface, law, name="touch", entry=entry, **options)
    sim = wc.Simulation(scene.build(device=device), dt=1e-3)
    sim.step(steps)
    return sim


def test_literal_entry_pushes_point_from_the_inner_side_through(device):
    sim = latched("literal", -0.1, (0, 0, 0), device)
    # D √(k/m): the undamped speed of SPEC 1.3, at first order in dt.
    np.testing.assert_allclose(sim.model.sensor("body.linear_velocity")[0, 2], 0.1 * 100.0, rtol=0.01)


def test_latched_entry_lets_point_from_the_inner_side_pass(device):
    sim = latched("latched", -0.1, (0, 0, 1.0), device, steps=50)
    assert sim.model.sensor("touch.status")[0] == ContactStatus.WRONG_SIDE
    np.testing.assert_allclose(sim.model.sensor("touch.gap")[0], -0.05, atol=1e-5)
    sim.step(150)
    np.testing.assert_allclose(sim.model.sensor("body.linear_velocity")[0], (0, 0, 1.0))


def test_latched_entry_stops_point_from_the_outer_side(device):
    sim = latched("latched", 0.05, (0, 0, -1.0), device)
    # The rebound speed equals the impact speed, up to the phase of the step at which contact ends: (ω dt)²/8 =
    # 1.3e-3.
    np.testing.assert_allclose(sim.model.sensor("body.linear_velocity")[0, 2], 1.0, rtol=2e-3)


def test_latch_opens_below_max_depth_and_closes_outside(device):
    # Too fast to stop within 20 mm: it passes through, without a force towards the other side.
    sim = latched("latched", 0.05, (0, 0, -5.0), device, max_depth=0.02, steps=100)
    assert sim.model.sensor("touch.status")[0] == ContactStatus.WRONG_SIDE
    speed = sim.model.sensor("body.linear_velocity")[0, 2]
    assert speed < -4.0
    sim.step(100)
    assert sim.model.sensor("body.linear_velocity")[0, 2] == speed


def test_reset_disarms_the_latch_of_its_environment(device):
    sim = latched("latched", -0.01, (0, 0, 1.0), device, steps=100)
    assert sim.model.sensor("touch.gap")[0] > 0
    sim.reset()
    assert sim.model.sensor("touch.status")[0] == ContactStatus.WRONG_SIDE
