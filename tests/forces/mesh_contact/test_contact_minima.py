"""Forces of spheres at all local minima of the distance: grooves, corners, troughs, convex bodies, limits."""

import json
import math

import numpy as np
import pytest
from creases import RADIUS, ball_in, corner, depth_in_groove, forces_at, groove, prism, similarity, trough

import warpcontact as wc

# Relative rounding of the penetration: coordinates over a depth of 1 mm, times some operations.
PRECISIONS = {"float32": 1e-4, "float64": 1e-12}


@pytest.mark.parametrize(("precision", "tolerance"), PRECISIONS.items())
def test_force_in_a_groove_and_in_corners_is_that_of_all_walls(precision, tolerance, device):
    k, d = 1e4, 1e-3
    center = [(0, 0.02, depth_in_groove(math.pi / 2, d))]
    in_groove = forces_at(groove(math.pi / 2), center, device=device, precision=precision)
    np.testing.assert_allclose(in_groove, [[0, 0, math.sqrt(2) * k * d]], rtol=tolerance, atol=10 * tolerance)
    depths = np.array([(d, d, d), (d, 0.2 * d, 0.5 * d), (d, -d, 0.1 * d)])
    in_corner = forces_at(corner(), RADIUS - depths, device=device, precision=precision)
    np.testing.assert_allclose(in_corner, k * np.maximum(depths, 0), rtol=tolerance, atol=10 * tolerance)


def test_reference_cases_of_spheres_in_creases(shared, device):
    oracle = json.loads((shared / "spec" / "oracle_patches.json").read_text(encoding="utf-8"))
    cases = [case for case in oracle["cases"] if "all minima" in case["kind"]]
    assert len(cases) == 3
    for case in cases:
        wall = groove(math.pi / 2) if case["body_b"]["shape"] == "groove" else corner()
        model = ball_in(wall, device=device)
        assert case["body_a"]["radius"] == RADIUS
        assert case["law"] == {"type": "Hooke", "stiffness": 1e4}
        model["ball.position"] = case["body_a"]["position"]
        tolerance = case["rel_tol"] * np.linalg.norm(case["force"])
        np.testing.assert_allclose(model.sensor("touch.force")[0], case["force"], rtol=0, atol=tolerance)
        assert model.sensor("touch.minimum_count")[0] == case["points"]


def test_two_walls_share_a_force_according_to_their_angle(device):
    degrees = np.array([0, 5, 10, 20, 30, 45, 90, 120])
    angles = np.radians(degrees)
    model = ball_in([groove(angle) for angle in angles], envs=2 * len(angles), device=device)
    model["wall.mesh"] = np.tile(np.arange(len(angles)), 2)
    heights = [depth_in_groove(angle, 1e-3) for angle in angles]
    model["ball.position"] = [(0, 0, z) for z in [*heights, *heights]]
    default = (math.radians(10), math.radians(40))
    model["touch.group_angle"] = [default] * len(angles) + [(0.0, 0.0)] * len(angles)
    grouped, plain = model.sensor("touch.force")[:, 2].reshape(2, -1)
    both = 2 * 10.0 * np.cos(angles / 2)
    both[0] = 10.0  # a plane has one minimum
    np.testing.assert_allclose(plain, both, rtol=1e-12)
    expected = np.where(degrees > 0, both / (1 + similarity(np.cos(angles))), 10.0)
    np.testing.assert_allclose(grouped, expected, rtol=1e-12)
    # Rounded, as published with the method.
    np.testing.assert_allclose(grouped, [10.0, 9.99, 9.96, 10.42, 13.46, 18.48, 14.14, 10.0], atol=5e-3)


def test_force_in_a_trough_of_facets_converges_with_their_number(device):
    facets = np.array([12, 24, 48, 96])
    model = ball_in([trough(n) for n in facets], envs=8, device=device, max_minima=64)
    model["wall.mesh"] = np.tile(np.arange(4), 2)
    down = 1.5e-3
    model["ball.position"] = (0, 0.01, -down)
    model["touch.group_angle"] = [(math.radians(10), math.radians(40))] * 4 + [(0.0, 0.0)] * 4
    grouped, plain = model.sensor("touch.force")[:, 2].reshape(2, -1)
    for i, n in enumerate(facets):
        turn = (np.arange(n) + 0.5) * 2 * np.pi / n
        depth = RADIUS - 0.0505 * math.cos(math.pi / n) + down * np.cos(turn)
        turn, depth = turn[depth > 0], depth[depth > 0]
        pairs = similarity(np.cos(turn[:, None] - turn)) * np.minimum(1, depth / depth[:, None])
        np.testing.assert_allclose(plain[i], (1e4 * depth * np.cos(turn)).sum(), rtol=1e-12)
        np.testing.assert_allclose(grouped[i], (1e4 * depth * np.cos(turn) / pairs.sum(axis=1)).sum(), rtol=1e-12)
    np.testing.assert_allclose(grouped, [47.6, 24.9, 18.7, 17.0], atol=0.06)
    # Of second order in the width of a facet, and the plain sum grows with the number of facets.
    changes = -np.diff(grouped)
    assert (changes > 0).all()
    assert (changes[1:] < changes[:-1] / 3).all()
    assert plain[-1] > 1.7 * plain[-2]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_contact_with_convex_bodies_is_bitwise_that_of_the_closest_point(precision, device):
    rng = np.random.default_rng(5)
    places = rng.uniform(-1, 1, (2, 1500, 3)) * 0.148
    places[1] *= 0.149 / np.linalg.norm(places[1], axis=1, keepdims=True)
    meshes = [wc.meshes.box((0.2, 0.2, 0.2)), wc.meshes.icosphere(0.1, 3)]
    results = []
    for minima in ("nearest", "all"):
        model = ball_in(meshes, envs=3000, device=device, precision=precision, minima=minima)
        model["wall.mesh"] = np.repeat([0, 1], 1500)
        model["ball.position"] = places.reshape(-1, 3)
        wc.Simulation(model, dt=1e-3).step()
        keys = ("touch.normal_force", "touch.normal", "touch.point", "touch.penetration", "ball.linear_velocity")
        results.append([model.sensor(key) for key in keys])
    assert (results[0][0] > 0).sum() > 1000
    for nearest, every in zip(*results, strict=True):
        assert np.array_equal(nearest, every)


# Paths over creases, edges and facets: mesh, start, end, further options.
STAIRS = prism([(-1, -1), (1, -1), (1, 0.1), (0.2, 0.1), (0.2, 0), (-1, 0)])
PATHS = {
    "into a groove": (groove(math.pi / 2), (-0.03, 0.01, 0.09), (0.03, 0.01, 0.075), {}),
    "into a corner": (corner(), (0.08, 0.06, 0.049), (0.045, 0.047, 0.0485), {}),
    "up a stair": (STAIRS, (0.1, 0, 0.0488), (0.2, 0, 0.149), {}),
    "over an edge": (STAIRS, (0.25, 0, 0.148), (0.145, 0, 0.11), {}),
    "along a trough": (trough(24), (0, 0, -0.0016), (0.0011, 0, -0.0012), {"max_minima": 64}),
    "over the end of a wall": (
        groove(math.pi / 2),
        (0, 0.15, 0.0695),
        (0.002, 0.36, 0.0695),
        {"boundary": "outer"},
    ),
}


@pytest.mark.parametrize("path", PATHS)
def test_force_is_continuous(path, device):
    mesh, start, end, options = PATHS[path]
    fractions = np.linspace(0, 1, 801)[:, None]
    force = forces_at(
        mesh, np.array(start) * (1 - fractions) + np.array(end) * fractions, device=device, **options
    )
    coarse, fine = (np.linalg.norm(np.diff(force[::stride], axis=0), axis=1).max() for stride in (2, 1))
    assert np.linalg.norm(force, axis=1).max() > 5.0
    # The largest jump is that of a slope: it halves with the step.
    assert fine < 0.6 * coarse


def test_wall_next_to_a_boundary_carries_although_the_boundary_is_closer(device):
    # The left wall ends at y = 0, and a sphere at y = 0.01 is closer to its end than to the right wall.
    whole = groove(math.pi / 2)
    vertices = np.array(whole.vertices)
    vertices[5, 1] = 0.0
    ends = wc.Mesh(np.vstack([vertices, [(0, 0, 0)]]), [(0, 2, 6), (6, 2, 3), (6, 3, 1), (0, 6, 5), (0, 5, 4)])
    height = depth_in_groove(math.pi / 2, 2e-3)
    positions = [(-0.002, 0.01, height), (-0.03, 0.3, height)]
    force = {}
    for boundary in ("off", "outer"):
        model = ball_in(ends, envs=2, device=device, boundary=boundary)
        model["ball.position"] = positions
        force[boundary] = model.sensor("touch.force")
        assert model.sensor("touch.status").tolist() == [wc.ContactStatus.CONTACT, wc.ContactStatus.OPEN]
    wall = RADIUS - (height + 0.002) / math.sqrt(2)
    np.testing.assert_allclose(force["off"][0], 1e4 * wall * np.array([-1, 0, 1]) / math.sqrt(2), atol=1e-9)
    assert (force["outer"][0] != force["off"][0]).any()
    assert (force["off"][1] == 0).all()


def test_deepest_minima_act_if_there_are_more_than_room(device):
    position = [(0.0491, 0.0494, 0.0497)]
    for room, carried in ((2, (9, 6, 0)), (4, (9, 6, 3))):
        model = ball_in(corner(), device=device, max_minima=room)
        model["ball.position"] = position[0]
        np.testing.assert_allclose(model.sensor("touch.force"), [carried], atol=1e-9)
        assert model.sensor("touch.minimum_count")[0] == 3
        wc.Simulation(model, dt=1e-6).step(2)
        assert model.sensor("touch.minimum_overflow")[0] == (2 if room < 3 else 0)
        model.reset()
        assert model.sensor("touch.minimum_overflow")[0] == 0


def test_back_of_a_thin_plate_does_not_act(device):
    plate = wc.meshes.box((1.0, 1.0, 0.002))
    positions = [(0.1, 0.1, RADIUS - 0.001 - z) for z in (0.0, 0.002, 0.01, 0.04)]
    force = forces_at(plate, positions, device=device)
    np.testing.assert_allclose(force[:, 2], 1e4 * np.array([0.002, 0.004, 0.012, 0.042]), rtol=1e-12)


def test_latched_contact_that_passed_a_plate_is_held_by_its_front(device):
    model = ball_in(wc.meshes.box((1.0, 1.0, 0.002)), device=device, entry="latched")
    model["ball.position"] = (0.1, 0.1, 0.06)
    sim = wc.Simulation(model, dt=1e-4)
    sim.step()
    for height in (0.04, 0.01, -0.01):
        model.state.body_position.assign(np.array([[(0.1, 0.1, height)]]))
        sim.step()
        np.testing.assert_allclose(model.sensor("touch.force")[0, 2], 1e4 * (0.051 - height), rtol=1e-3)


def test_sensors_of_minima_describe_each_wall(device):
    model = ball_in(corner(), device=device)
    model["ball.position"] = (0.049, 0.0495, 0.06)
    depth, load = model.sensor("touch.minimum_penetration")[0], model.sensor("touch.minimum_normal_force")[0]
    normal = model.sensor("touch.minimum_normal")[0]
    assert depth.shape == load.shape == (8,)
    np.testing.assert_allclose(np.sort(depth)[-3:], [0, 5e-4, 1e-3], atol=1e-12)
    np.testing.assert_allclose(load, 1e4 * depth, atol=1e-12)
    np.testing.assert_allclose(normal.sum(axis=0), [1, 1, 0], atol=1e-12)
    np.testing.assert_allclose(load @ normal, model.sensor("touch.force")[0], atol=1e-12)
    assert model.sensor("touch.normal_force")[0] == pytest.approx(15.0)
    points = np.array([0.049, 0.0495, 0.06]) - (RADIUS - depth / 2)[:, None] * normal
    np.testing.assert_allclose(model.sensor("touch.center")[0], load @ points / 15.0, atol=1e-12)
    model["ball.position"] = (0.3, 0.3, 0.3)
    for name in (
        "minimum_penetration",
        "minimum_normal_force",
        "minimum_normal",
        "force",
        "center",
        "minimum_count",
    ):
        model.reset()
        assert not model.sensor(f"touch.{name}").any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"minima": "both"}, "touch.minima must be"),
        ({"group_angle": (0.5, 0.2)}, r"touch.group_angle: the second angle must be larger"),
        ({"group_angle": (0.1, 0.0)}, r"or both must be 0, got \(0.1, 0\) rad"),
        ({"group_angle": (-0.1, 0.2)}, "touch.group_angle"),
        ({"group_angle": 0.2}, "touch.group_angle must be 2 numbers"),
        ({"max_minima": 0}, "touch.max_minima must be a whole number of at least 1"),
        ({"max_minima": 65}, "touch.max_minima must be at most 64, got 65"),
    ],
)
def test_invalid_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        ball_in(corner(), **options)


def test_inactive_faces_need_a_search_among_active_ones(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    walls = scene.add_surface(corner(), active_faces=[0, 1, 2, 3])
    ball = scene.add_body(1.0, (1, 1, 1), (0.0492, 0.0495, 0.049), name="ball")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    options = {"radius": RADIUS, "minima": "all", "name": "touch"}
    with pytest.raises(ValueError, match="minima='all' needs search='active', because 'surface' has faces"):
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), walls, material, **options)
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), walls, material, search="active", **options)
    model = scene.build(envs=1, device=device, precision="float64")
    # Walls z = 0 and y = 0; the boundary at the edge of x = 0 does not act.
    np.testing.assert_allclose(model.sensor("touch.force"), [[0, 5, 10]], atol=1e-9)


def test_invalid_angles_of_a_parameter_are_refused(device):
    model = ball_in(corner(), envs=2, device=device)
    with pytest.raises(
        ValueError, match=r"touch.group_angle: the second angle must be larger .* got \(0.5, 0.2\) rad"
    ):
        model["touch.group_angle"] = [(0.1, 0.2), (0.5, 0.2)]
    np.testing.assert_allclose(model["touch.group_angle"], [(math.radians(10), math.radians(40))] * 2)


@pytest.mark.parametrize("count", [2, 8])
def test_all_sensors_of_a_set_of_spheres_are_recorded_together(count, device):
    """Also of as many spheres as one sphere has slots for minima; histories belong to slots."""
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(1.0, (1, 1, 1), (0, 0, depth_in_groove(math.pi / 2, 1e-3)), name="body")
    balls = scene.add_points(body, [(0, 0.03 * i, 0) for i in range(count)], name="balls")
    single = scene.add_point(body, (0, -0.1, 0), name="centre")
    friction = wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1e4)
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4), friction=friction)
    wall = scene.add_surface(groove(math.pi / 2), name="wall")
    for points, name in ((balls, "touch"), (single, "other")):
        scene.add_contact(points, wall, material, radius=RADIUS, minima="all", name=name)
    model = scene.build(envs=2, device=device, precision="float64")
    recording = wc.Simulation(model, dt=1e-4).run(2e-4, model.sensor_names)
    for name in model.sensor_names:
        np.testing.assert_array_equal(recording[name].values[-1], model.sensor(name), err_msg=name)
    assert recording["touch.force"].dims == ("time", "env", "item", "axis")
    assert recording["other.force"].dims == ("time", "env", "axis")
    for key in ("minimum_normal", "friction.spring"):
        assert recording[f"touch.{key}"].dims == ("time", "env", "touch.minimum.item", "axis")
        assert recording[f"other.{key}"].dims == ("time", "env", "other.minimum.item", "axis")
    assert recording.sizes["touch.minimum.item"] == 8 * count
    np.testing.assert_allclose(recording["touch.minimum_penetration"][0].sum("touch.minimum.item"), 2e-3 * count)
