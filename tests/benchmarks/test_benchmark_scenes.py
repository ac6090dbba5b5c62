"""Benchmark scenes have the documented properties, and the table reports the measured figures."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import warpcontact as wc
from warpcontact.benchmark.simulation import simulation

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="benchmarks are in a checkout, not in an installed package"
)


def load(name):
    spec = importlib.util.spec_from_file_location(f"benchmarks_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # required by dataclasses
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def scenes():
    return load("benchmark_scenes").SCENES


def test_benchmark_terrain_equals_library_terrain(scenes):
    terrain = wc.meshes.sinusoidal_terrain((10, 10), (100, 100), amplitude=0.2, wavelength=2.5)
    assert len(terrain.faces) == 20_000
    for name in ("W1", "W2p8", "W2p64"):
        np.testing.assert_allclose(scenes[name].surface.vertices, terrain.vertices, atol=1e-15)
        np.testing.assert_array_equal(scenes[name].surface.faces, terrain.faces)


def test_benchmark_bowl_has_1280_upward_facing_triangles(scenes):
    surface = scenes["W3"].surface
    assert len(surface.faces) == 1280
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    assert np.all(np.cross(b - a, c - a)[:, 2] > 0.0)
    np.testing.assert_allclose(surface.vertices[:, 2], np.sum(surface.vertices[:, :2] ** 2, axis=1) / 3.2)


def test_benchmark_surface_height_matches_triangles(scenes):
    surface = scenes["W1"].surface
    weights = np.random.default_rng(0).dirichlet((1, 1, 1), len(surface.faces))
    points = np.einsum("fk,fki->fi", weights, surface.vertices[surface.faces])
    np.testing.assert_allclose(surface.height(points), points[:, 2], atol=1e-12)


def test_benchmark_bodies_have_density_of_water(scenes):
    assert scenes["W1"].mass == pytest.approx(4.18879, rel=1e-6)
    assert scenes["W1"].inertia == pytest.approx(0.4 * 4.18879 * 0.01, rel=1e-6)
    assert scenes["W2p8"].mass == scenes["W2p64"].mass == pytest.approx(8.0)
    assert scenes["W2p64"].inertia == pytest.approx(8.0 * 0.2**2 / 6)


@pytest.mark.parametrize(("name", "count", "on_a_face"), [("W2p8", 8, {4}), ("W2p64", 64, {16, 20})])
def test_benchmark_box_points_are_spaced_apart_on_its_surface(scenes, name, count, on_a_face):
    points = scenes[name].points
    assert points.shape == (count, 3)
    np.testing.assert_allclose(np.max(np.abs(points), axis=1), 0.1)
    apart = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(count)
    assert apart.min() > 0.04
    assert {
        int(np.sum(np.isclose(side * points[:, axis], 0.1))) for axis in range(3) for side in (-1, 1)
    } == on_a_face


def test_benchmark_point_spheres_touch_the_box_faces(scenes):
    for name in ("W2p8", "W2p64"):
        for (centre, radius), point in zip(scenes[name].spheres(), scenes[name].points, strict=True):
            assert np.max(np.abs(centre)) + radius == pytest.approx(0.1)
            assert np.linalg.norm(centre - point) <= radius * 3**0.5 + 1e-12


def test_benchmark_bodies_start_above_the_surface_and_apart(scenes):
    for scene in scenes.values():
        start = scene.start(500)
        assert start.shape == (500, scene.bodies, 3)
        np.testing.assert_allclose(start[..., 2] - scene.surface.height(start), 0.5)
        np.testing.assert_array_equal(start, scene.start(500))
    spheres = scenes["W3"].start(500)
    apart = np.linalg.norm(spheres[:, :, None] - spheres[:, None], axis=3) + np.eye(10)
    assert apart.min() > 0.2


def test_benchmark_spheres_come_to_rest_in_the_bowl(scenes, device):
    scene = scenes["W3"]
    sim = simulation(scene, 4, device)
    sim.step(1500)
    positions = sim.model.sensor("body.position")
    figures = load("benchmark_scenes").sanity(scene, positions)
    assert figures["below"] == figures["not_finite"] == 0.0
    # On the bowl or on each other; no penetration exceeds what dashpots and weight explain.
    assert figures["highest_body"] < 0.5
    assert (sim.model.sensor("pile.contacts") >= 5).all()
    assert sim.model.sensor("pile.max_penetration").max() < 2e-3


def test_table_row_has_best_environment_count_and_ratio_to_best_peer():
    table = load("table")

    def entry(engine, envs, *rates, **sanity):
        figures = {"mean_height": 0.1, "highest_body": 0.2, "below": 0.0, "not_finite": 0.0} | sanity
        return {
            "scene": "W1",
            "engine": engine,
            "envs": envs,
            "env_steps_per_s": list(rates),
            "cores_busy": [2.0] * len(rates),
            "start_s": {"process": 1.0},
            "sanity": figures,
        }

    rows = table.summarise(
        [
            entry("warpcontact", 8, 50.0, 70.0, 60.0),
            entry("warpcontact", 16, 90.0, 80.0, 300.0),
            entry("one", 8, 30.0, 20.0, 10.0),
            entry("two", 8, 15.0, 15.0, 15.0, below=0.25, highest_body=3.0),
            {"scene": "W1", "engine": "three", "envs": 8, "why": "not available"},
        ]
    )
    own, one, two, three = rows
    assert (own["envs"], own["median"], own["lowest"], own["highest"]) == (16, 90.0, 80.0, 300.0)
    assert own["of_best_peer"] == pytest.approx(4.5)
    assert one["of_best_peer"] == 1.0
    assert two["doubt"] == "25.00% below the surface, a body 3 m above the surface"
    assert three["why"] == "not available"
    assert len(table.lines(rows)) == 5


def test_nonsmooth_residual_is_zero_for_stick_slip_and_separation():
    residual = load("nonsmooth_benchmark_scenes").residual
    resting = np.zeros(3)
    sliding = np.array([0.0, 0.3, -0.4])
    leaving = np.array([0.2, 0.0, 0.0])
    impulses = np.array([[2.0, 0.1, 0.7], [2.0, -0.48, 0.64], [0.0, 0.0, 0.0]])
    W = np.eye(9)
    velocities = np.stack([resting, sliding, leaving])
    assert residual(W, velocities, impulses, 0.4) < 1e-12
    assert residual(W, -velocities, impulses, 0.4) > 1e-2


@pytest.mark.slow
def test_nonsmooth_comparison_reports_a_small_residual(device, tmp_path):
    out = tmp_path / "figures.json"
    words = ["nonsmooth", "--engines", "warpcontact", "--here", "--scenes", "table4", "--envs", "3"]
    words += ["--rounds", "1", "--at-least", "1e-6", "--device", device, "--out", str(out)]
    done = subprocess.run(
        [sys.executable, FOLDER / "compare.py", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (entry,) = json.loads(out.read_text())["measured"]
    assert entry["sanity"]["residual_worst"] < 2e-5
    assert entry["sanity"]["not_converged"] == 0.0
    assert entry["sanity"]["penetration_m"] < 1e-4
