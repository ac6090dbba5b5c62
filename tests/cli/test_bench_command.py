"""The command ``bench``: scenes, reported figures, and output."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc
from warpcontact.benchmark import limits, measurement
from warpcontact.benchmark.scenes import SCENES, STEPS
from warpcontact.benchmark.simulation import run_seconds, simulation
from warpcontact.cli import main

pytestmark = pytest.mark.installed

BRIEF = {"envs": 3, "seconds": 1e-6}
FIGURES = ("env_steps_per_s", "steps_per_s_alone", "first_step_s", "queries_per_s", "copies_per_s")


@pytest.fixture(scope="module")
def report(device):
    return wc.bench(device, **BRIEF)


@pytest.mark.slow
def test_bench_report_has_figures_of_every_benchmark_scene(report, device):
    assert [figures.work for figures in report.works] == list(SCENES)
    assert report.envs == 3
    assert report.facts["cores"] >= 1
    assert report.versions["warpcontact"] == wc.__version__
    for figures in report.works:
        assert figures.runs == 1  # at least one, for any duration
        assert figures.triangles == 20_000
        assert figures.frozen == 0
        assert figures.lowest <= figures.env_steps_per_s <= figures.highest
        for name in FIGURES:
            assert 0.0 < getattr(figures, name) < np.inf


def test_bench_report_prints_a_table_and_round_trips_through_json(report):
    again = json.loads(json.dumps(report.to_dict()))
    assert again["works"][2]["work"] == "box of 64 points"
    text = str(report)
    assert "3 environments in float32 on 20000 triangles, 1000 steps of 0.001 s" in text
    for figures in report.works:
        (line,) = (line for line in text.splitlines() if line.startswith(figures.work + " "))
        assert f"{figures.env_steps_per_s:.2e}" in line
        assert f"{figures.env_steps_per_s / figures.queries_per_s:.2f}" in line
    assert "non-finite" not in text


def test_bench_alternates_scenes_until_each_used_its_time():
    entries = [measurement._Entry(name, None, None, 0.0) for name in "ab"]
    order = []
    for entry in measurement._round_robin(entries, seconds=2.0):
        order.append(entry.title)
        entry.times.append({"a": 1.0, "b": 0.5}[entry.title])
    assert "".join(order) == "ababbb"


@pytest.mark.parametrize("title", SCENES)
def test_benchmark_bodies_come_to_rest_on_the_terrain(title, device):
    scene = SCENES[title]
    with measurement._without_step_warnings():
        sim = simulation(scene, 16, device)
        assert run_seconds(sim, STEPS) > 0.0
    assert sim.steps == STEPS
    position = sim.state.body_position.numpy()[:, 0]
    height = position[:, 2] - scene.surface.height(position)
    assert np.all((height > 0.09) & (height < 0.25))
    assert (sim.model.sensor("touch.status") == wc.ContactStatus.CONTACT).any()


def test_lower_bounds_query_the_current_point_positions(device):
    scene = SCENES["box of 8 points"]
    with measurement._without_step_warnings():
        sim = simulation(scene, 5, device)
        sim.step(800)
    turned = Rotation.from_quat(sim.model.sensor("body.orientation")).as_matrix() @ scene.points.T
    assert np.ptp(turned, axis=0).max() > 0.01  # they are on different slopes
    places = limits.query_points(sim.model, scene) - sim.model.sensor("body.position")[:, None]
    np.testing.assert_allclose(places, turned.swapaxes(1, 2), atol=1e-6)
    for threads in (1, 2, 64):
        assert min(limits.limits(sim.model, scene, threads)) > 0.0


def test_bench_command_prints_table_and_writes_json(device, tmp_path, capsys):
    file = tmp_path / "figures.json"
    words = ["bench", "--device", device, "--envs", "2", "--seconds", "1e-6", "--precision", "float64"]
    assert main([*words, "--json", str(file)]) == 0
    out, err = capsys.readouterr()
    assert "2 environments in float64" in out
    assert out.endswith(f"figures: {file}\n")
    assert "Warning" not in err
    assert json.loads(file.read_text())["precision"] == "float64"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--envs", "0"], "--envs must be a whole number of at least 1, got 0"),
        (["--seconds", "0"], "--seconds must be greater than 0, got 0 s"),
        (["--seconds", "nan"], "--seconds must be greater than 0, got nan s"),
        (["--device", "cuda:99"], "--device must be 'auto' or one of "),
        (["--precision", "float16"], "--precision must be one of 'float32', 'float64', got 'float16'"),
        (["--json", "missing/figures.json"], "missing/figures.json"),
        (["--json", "."], "is a folder"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bench_command_with_invalid_option_prints_one_message_and_exits_with_2(
    words, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("warpcontact: ")
    assert message in err
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_bench_command_exits_with_130_on_interrupt():
    process = subprocess.Popen(
        [sys.executable, "-m", "warpcontact", "bench", "--device", "cpu", "--seconds", "600"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(4.0)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert out == ""
    assert err.endswith("warpcontact: interrupted\n")
    assert "Traceback" not in err
