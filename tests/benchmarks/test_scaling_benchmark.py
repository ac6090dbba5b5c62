"""Benchmarks of scaling and startup: fits, parameter ranges, and complete runs."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import warpcontact as wc

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="benchmarks are in a checkout, not in an installed package"
)
# As small as possible; the times have no meaning.
TINY = ["--steps", "4", "--rounds", "2", "--at-least", "1e-6", "--threads", "2"]
TINY += ["--most-envs", "4", "--most-points", "16", "--most-triangles", "3100"]


@pytest.fixture(scope="module")
def load():
    """Imports a file of the benchmarks, which import each other by module name."""
    known = set(sys.modules)
    sys.path.insert(0, str(FOLDER))
    yield importlib.import_module
    sys.path.remove(str(FOLDER))
    for name in set(sys.modules) - known:
        if getattr(sys.modules[name], "__file__", None) and Path(sys.modules[name].__file__).parent == FOLDER:
            del sys.modules[name]


def run(script, *words, **variables):
    """Runs a script of the benchmarks."""
    words = [sys.executable, str(FOLDER / script), *map(str, words)]
    return subprocess.run(words, env={**os.environ, **variables}, capture_output=True, text=True, check=False)


@pytest.fixture
def bare(tmp_path):
    """Environment in which plotting, storage and progress-bar packages cannot be imported."""
    folder = tmp_path / "hidden"
    folder.mkdir()
    for name in ("matplotlib", "tqdm", "zarr"):
        (folder / f"{name}.py").write_text(f"raise ModuleNotFoundError('hidden', name={name!r})\n")
    beside = filter(None, [os.environ.get("PYTHONPATH")])
    return {"PYTHONPATH": os.pathsep.join([str(folder), *beside])}


@pytest.mark.parametrize("k", [0.0, 0.5, 1.0, 2.0])
def test_power_law_exponent_is_fitted(load, k):
    fits = load("fits")
    values = np.geomspace(1, 1e6, 9)
    noise = np.array([1.0, 1.01, 0.99, 1.0, 1.01, 0.99, 1.0, 1.01, 0.99])
    assert fits.exponent(values, 3e-4 * values**k * noise) == pytest.approx(k, abs=2e-3)
    # An overhead hides growth among small values, but not in the upper half.
    costs = 1e3 + 5.0 * values**k
    assert fits.upper_exponent(values, costs) >= fits.exponent(values, costs) - 1e-12
    assert fits.upper_exponent(np.array([1, 10]), [2.0, 2.0 * 10**k]) == pytest.approx(k)
    assert fits.upper_exponent(np.array([1, 2, 1000]), [7.0, 1.0, 500**k]) == pytest.approx(k)


def test_growth_per_decade_is_fitted(load):
    fits = load("fits")
    values = np.geomspace(1e3, 1e6, 7)
    slope, explained = fits.per_decade(values, 40.0 + 12.5 * np.log10(values))
    assert slope == pytest.approx(12.5)
    assert explained == pytest.approx(1.0)
    assert fits.per_decade(values, np.full(7, 3.0)) == (pytest.approx(0.0, abs=1e-12), pytest.approx(1.0, abs=1))
    assert fits.per_decade(values, values)[1] < 0.7  # linear growth is not logarithmic


def test_fit_requires_two_positive_values(load):
    for values, costs in (([1, 1], [1, 2]), ([1], [1]), ([1, 2], [1, 2, 3]), ([0, 1], [1, 2]), ([1, 2], [0, 1])):
        with pytest.raises(ValueError, match="two or more positive values"):
            load("fits").exponent(values, costs)


def test_growth_is_fitted_for_every_series(load):
    def entry(series, line, value, envs, cost):
        return {
            "series": series,
            "line": line,
            "value": value,
            "envs": envs,
            "ns_per_env_step": cost,
            "ns_bare_query": 2.0 * cost,
        }

    measured = [entry("environments", "W1", n, n, 5.0 + 10.0 / n) for n in (1, 4, 16, 64, 256, 1024, 4096)]
    measured += [entry("points", "box", n, 8, 3.0 * n**0.8) for n in (8, 64, 512)]
    measured += [entry("triangles", "W1", n, 8, 10.0 * np.log10(n)) for n in (1e3, 1e4, 1e5, 1e6)]
    measured += [entry("threads", "W1", n, 8, 60.0 / n) for n in (1, 2, 3)]
    measured[-1]["ns_in_processes"] = 24.0
    measured += [entry("threads", "W2p8", 1, 8, 60.0)]
    scaling = load("scaling")
    found = {fit["series"]: fit for fit in scaling.fits(measured)}
    assert found["environments"]["upper_exponent"] == pytest.approx(0.99, abs=0.01)
    assert found["points"]["exponent"] == pytest.approx(0.8)
    assert found["triangles"]["ns_per_decade"] == pytest.approx(10.0)
    assert found["triangles"]["ns_per_decade_of_bare_query"] == pytest.approx(20.0)
    assert found["triangles"]["explained_by_logarithm"] == pytest.approx(1.0)
    assert found["threads"]["times_one_thread"] == {"1": 1.0, "2": 2.0, "3": pytest.approx(3.0)}
    assert found["threads"]["times_one_thread_in_processes"] == pytest.approx(2.5)
    assert "same number of processes: 2.50" in scaling.lines([found["threads"]])[0]
    assert len(scaling.lines(list(found.values()))) == len(found) == 4


def test_scaling_series_vary_one_quantity(load):
    series = load("scaling_cases")
    sizes = series.Sizes("cpu", 256, 512, 10**6, 6)
    found = {name: series.cases(name, sizes) for name in series.SERIES}
    assert {case.value for case in found["environments"]} == {1, 4, 16, 64, 256}
    assert all(case.envs == case.value for case in found["environments"])
    assert {case.value for case in found["threads"]} == {1, 2, 4, 6}
    assert all(case.threads == case.value for case in found["threads"])
    for case in found["points"]:
        assert case.value == (1 if case.scene.points is None else len(case.scene.points))
    triangles = sorted({case.value for case in found["triangles"]})
    assert triangles[0] < 1e3 < triangles[-1] < 1e6
    for case in found["triangles"]:
        assert len(case.scene.surface.faces) == case.value
    for name in ("points", "triangles", "threads"):
        assert len({case.envs for case in found[name]}) == 1
    gpu = series.Sizes("cuda:0", 4**10, 512, 10**6, 6)
    assert series.cases("threads", gpu) == []
    assert max(case.envs for case in series.cases("environments", gpu)) == 4**10


def test_scaling_points_are_added_to_the_box_corners(load):
    for count in (8, 9, 64):
        points = load("scaling_cases").spread_points(count)
        assert points.shape == (count, 3)
        np.testing.assert_allclose(np.max(np.abs(points), axis=1), 0.1)
        np.testing.assert_allclose(np.abs(points[:8]), 0.1)


@pytest.mark.slow
def test_scaling_benchmark_runs_and_plots(device, tmp_path):
    out, picture = tmp_path / "figures.json", tmp_path / "picture.svg"
    done = run("scaling.py", *TINY, "--device", device, "--out", out, "--plot", picture)
    assert done.returncode == 0, done.stderr
    assert f"picture: {picture}" in done.stdout
    report = json.loads(out.read_text())
    assert report["versions"]["warpcontact"] == wc.__version__
    series = {"environments", "points", "triangles"} | ({"threads"} if device == "cpu" else set())
    assert {entry["series"] for entry in report["measured"]} == series
    assert {fit["series"] for fit in report["fits"]} == series
    for entry in report["measured"]:
        assert 0.0 < entry["lowest"] <= entry["ns_per_env_step"] <= entry["highest"]
        assert min(entry["ns_bare_query"], entry["ns_copy_of_state"]) > 0.0
        assert entry["frozen"] == 0
        apart = entry["series"] == "threads" and entry["value"] == 2
        assert (entry.get("ns_in_processes", 0.0) > 0.0) == apart
    assert "<svg" in picture.read_text()


@pytest.mark.slow
def test_scaling_benchmark_runs_without_matplotlib_and_is_plotted_elsewhere(device, tmp_path, bare):
    out = tmp_path / "figures.json"
    words = [*TINY, "--device", device, "--series", "environments", "--out", out]
    done = run("scaling.py", *words, **bare)
    assert done.returncode == 0, done.stderr
    assert "no picture: matplotlib is not installed" in done.stdout
    drawn = run("scaling_picture.py", out, "--plot", tmp_path / "picture.png")
    assert drawn.returncode == 0, drawn.stderr
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_stage_benchmark_runs_with_minimal_dependencies(device, tmp_path, bare):
    out = tmp_path / "stages.json"
    words = ["--device", device, "--envs", "2", "--scenes", "W2p8", "--at", "3", "--repeats", "1", "--out", out]
    done = run("stages.py", *words, **bare)
    assert done.returncode == 0, done.stderr
    costs = json.loads(out.read_text())["stages"]["W2p8"]["2"]["ns_per_env_after_steps"]["3"]
    assert {"bare query", "copy of state"} < costs.keys()
    assert costs.keys() & {"update_sets", "fused_step", "closest_point"}


@pytest.mark.slow
def test_startup_benchmark_runs_with_minimal_dependencies(device, tmp_path, bare):
    out = tmp_path / "start.json"
    words = ["--device", device, "--rounds", "1", "--envs", "2", "--at-least", "1e-6", "--out", out]
    done = run("start.py", *words, **bare)
    assert done.returncode == 0, done.stderr
    report = json.loads(out.read_text())
    cold, warm = report["first_step_s"]["cold"], report["first_step_s"]["warm"]
    assert cold["modules"] == warm["modules"] > 3
    parts = sum(cold[name]["median"] for name in ("import", "read", "build", "step"))
    assert 0.0 < parts < cold["process"]["median"]
    assert report["import_s"]["package"]["median"] < report["import_s"]["to_simulate"]["median"]
    assert "every_name" not in report["import_s"]  # one of them plots
    assert set(report["steps_per_s_alone"]) == {"W1", "W2p8", "W2p64", "terrain example"}
    assert "terrain example, cold" in done.stdout
