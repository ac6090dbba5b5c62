"""The results folder of a run: files, protection of existing files, and run.json."""

import json
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest
import xarray as xr
from test_experiment import content

import warpcontact as wc
from warpcontact.drawing.reduction import evenly
from warpcontact.experiment.progress import run_status

pytestmark = pytest.mark.installed


def test_unrelated_folder_is_not_overwritten(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    for overwrite in (False, True):
        with pytest.raises(wc.ExperimentError, match="not empty"):
            wc.Experiment(content()).run(tmp_path, overwrite=overwrite)
    (tmp_path / "run.json").write_text('{"program": "another"}')
    with pytest.raises(wc.ExperimentError, match="not empty"):
        wc.Experiment(content()).run(tmp_path, overwrite=True)
    with pytest.raises(wc.ExperimentError, match="not a folder"):
        wc.Experiment(content()).run(tmp_path / "thesis.tex")
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_earlier_run_is_replaced_on_request_only(tmp_path):
    wc.Experiment(content()).run(tmp_path, device="cpu")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(wc.ExperimentError, match="holds an earlier run"):
        wc.Experiment(content()).run(tmp_path, device="cpu")
    with pytest.raises(wc.ExperimentError, match="device"):  # detected before anything is removed
        wc.Experiment(content()).run(tmp_path, device="cuda:99", overwrite=True)
    assert (tmp_path / "data.zarr").exists()
    run = wc.Experiment(content(output={"usd_envs": 0})).run(tmp_path, device="cpu", overwrite=True)
    assert not (tmp_path / "animation.usdc").exists()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert run.summary["state"] == "finished"


def test_partial_summary_of_killed_run_does_not_block_a_new_run(tmp_path):
    (tmp_path / "run.json.partial").write_text('{"program": "warpc')
    assert wc.Experiment(content()).run(tmp_path, device="cpu").finished
    assert not (tmp_path / "run.json.partial").exists()


def test_folder_of_unfinished_run_can_be_reused(tmp_path):
    def interrupt(stage):
        if stage == "running":
            raise KeyboardInterrupt

    summary = tmp_path / "run.json"
    with pytest.raises(KeyboardInterrupt):
        wc.Experiment(content()).run(tmp_path, device="cpu", on_stage=interrupt)
    assert json.loads(summary.read_text())["state"] == "interrupted"
    assert wc.Experiment(content()).run(tmp_path, device="cpu").health.good
    written = json.loads(summary.read_text())
    summary.write_text(json.dumps(written | {"state": "unfinished"}))  # as for a killed run
    with pytest.raises(wc.ExperimentError, match=r"a run that did not finish; .*\(--resume\)"):
        wc.Experiment(content()).run(tmp_path, device="cpu")
    for path in (tmp_path / "commit").iterdir():
        path.unlink()  # no data is lost in that case
    assert wc.Experiment(content()).run(tmp_path, device="cpu").health.good


WRITER = """
import sys, pathlib
from warpcontact.experiment.folder import write_lock
with write_lock(pathlib.Path(sys.argv[1])):
    print("writing", flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(os.name != "posix", reason="other systems have no locks on folders")
@pytest.mark.parametrize("options", [{"overwrite": True}, {"resume": True}], ids=str)
def test_folder_of_run_in_progress_is_refused(tmp_path, options):
    experiment = wc.Experiment(content())
    before = experiment.run(tmp_path, device="cpu").digest()
    summary = tmp_path / "run.json"
    summary.write_text(json.dumps(json.loads(summary.read_text()) | {"state": "unfinished"}))
    with subprocess.Popen([sys.executable, "-c", WRITER, tmp_path], stdin=-1, stdout=-1) as writer:
        assert writer.stdout.readline() == b"writing\n"
        assert run_status(tmp_path).state == "running"
        with pytest.raises(wc.ExperimentError, match="is running and writes there"):
            experiment.run(tmp_path, device="cpu", **options)
        writer.kill()  # for any end of the process
        writer.wait()
    assert run_status(tmp_path).state == "stopped"
    assert experiment.run(tmp_path, device="cpu", **options).digest() == before


def test_python_warnings_are_stored_and_issued(tmp_path):
    def warn(stage):
        warnings.warn("a bad omen", UserWarning, stacklevel=1)

    with pytest.warns(UserWarning, match="a bad omen"):
        run = wc.Experiment(content()).run(tmp_path, device="cpu", on_stage=warn)
    assert run.summary["warnings"].count("caution: a bad omen") == 1
    messages = []
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        wc.Experiment(content()).run(
            tmp_path, device="cpu", overwrite=True, on_stage=warn, on_warning=messages.append
        )
    assert "caution: a bad omen" in messages
    assert not shown


def test_frozen_environments_are_reported_in_summary(tmp_path):
    # A force that overflows float32 in the last environment only.
    stiffness = {"values": [1e4, 1e4, 1e4, 1e38]}
    body = content()["body"][0] | {"position": [0, 0, 0.05]}
    experiment = wc.Experiment(content(body=[body], variation={"touch.law.stiffness": stiffness}))
    with pytest.warns(RuntimeWarning, match="1 of 4 environments turned non-finite"):
        run = experiment.run(tmp_path, device="cpu")
    assert run.health.frozen.tolist() == [3]
    assert json.loads(run.files["summary"].read_text())["frozen_environments"] == [3]
    assert "1 of 4 environments turned non-finite" in str(run)


@pytest.mark.parametrize(
    "changes",
    [
        {"envs": 1},
        {"contact": [], "surface": [], "record": {"sensors": ["ball.linear_velocity"]}},
        {"record": {"sensors": ["touch.normal_force"]}, "variation": {"ball.mass": {"loguniform": [0.01, 10]}}},
        {"surface": [{"name": "ground", "mesh": {"shape": "box"}, "position": [0, 0, -0.5]}]},
    ],
    ids=["one", "no_surface", "logarithmic colors", "closed mesh"],
)
def test_picture_is_drawn_for_any_recorded_content(changes, tmp_path):
    run = wc.Experiment(content(**changes)).run(tmp_path, device="cpu")
    assert run.files["picture"].stat().st_size > 10_000


def tracks_of(recording):
    """The tracks in a picture."""
    from warpcontact.experiment import picture

    chosen = evenly(recording.sizes["env"], picture.TRACKS)
    return [picture._tracks(recording, body, chosen) for body in recording.scene.bodies]


def test_picture_colors_by_varied_parameter_and_selects_view_plane(tmp_path):
    from warpcontact.experiment import picture

    body = content()["body"][0] | {"position": [0.0, 0.0, 0.3], "linear_velocity": [1.0, 0.0, 0.0]}
    points = [{"name": "centre", "body": "ball", "positions": [[0, 0, 0], [0, 0, 0.01]]}]
    varied = {
        "ball.position": {"linspace": [[0, 0, 0.2], [1, 0, 0.5]]},
        "touch.law.stiffness": {"linspace": [1, 4]},
    }
    raw = content(body=[body], point=[], points=points, variation=varied)
    recording = wc.Experiment(raw).run(tmp_path, device="cpu").recording
    values, label = picture._color_values(recording, list(varied))
    np.testing.assert_allclose(values, [1, 2, 3, 4])
    assert label.startswith("touch.law.stiffness [N/m")
    assert picture._extent(tracks_of(recording))[0] == [0, 2]
    recording["touch.law.stiffness"][0, 1] = 7.0  # items with different values give no color
    assert picture._color_values(recording, list(varied))[1] == "environment"


def test_picture_crops_long_catenary_of_fixed_body(tmp_path):
    from warpcontact.experiment import picture

    buoy = content()["body"][0] | {"motion": {"type": "Fixed"}}
    ends = [
        {"name": "anchor", "position": [-80, 0, -50]},
        {"name": "fairlead", "body": "ball", "position": [0, 0, 0]},
    ]
    line = {"name": "line", "point_a": "anchor", "point_b": "fairlead", "length": 100}
    line |= {"mass_per_length": 20, "axial_stiffness": 1e6}
    changes = {"surface": [], "contact": [], "body": [buoy], "point": ends, "catenary": [line], "dt": 0.01}
    changes["record"] = {"sensors": ["line.force_b", "line.tension_b"]}
    recording = wc.Experiment(content(**changes)).run(tmp_path, device="cpu").recording
    plane, lower, upper = picture._extent(tracks_of(recording))
    assert plane == [0, 2]
    shapes = picture._coupling_shapes(recording)
    low, high = picture._window(recording.scene, [], shapes, lower, upper, plane)
    np.testing.assert_allclose(high - low, 0.25 * 80.0)
    np.testing.assert_allclose(0.5 * (low + high), [0.0, 0.105], atol=1e-6)


@pytest.mark.parametrize("shape", ["grid", "sinusoidal_terrain", "icosphere"])
def test_ground_section_lies_on_the_surface(shape):
    from matplotlib.figure import Figure

    from warpcontact.experiment.ground import GroundSurface, draw_section

    scene = wc.Experiment(content(surface=[{"name": "ground", "mesh": {"shape": shape}}])).scene()
    axes = Figure().add_subplot()
    draw_section(axes, GroundSurface.of(xr.Dataset(), scene.surfaces[0]), 0.0)
    points = np.concatenate(axes.collections[0].get_segments())
    if shape == "icosphere":
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=0.01)
    else:
        np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-4)


LEFT = {"shape": "grid", "size": [4.0, 4.0], "cells": [2, 1]}  # faces 0 and 1 have x < 0
STEP = {"shape": "box", "size": [4.0, 4.0, 0.2]}


def drawn(folder, monkeypatch, body=(), **changes):
    """Runs a small experiment; returns its recording and the figure of its picture."""
    from matplotlib.figure import Figure

    figures = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *to, **how: (figures.append(self), save(self, *to, **how)))
    ball = content()["body"][0] | dict(body)
    run = wc.Experiment(content(body=[ball], **changes)).run(folder, device="cpu")
    return run.recording, figures[0]


def figure_texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_picture_distinguishes_inactive_faces(tmp_path, monkeypatch):
    surface = {"name": "ground", "mesh": LEFT, "active_faces": [2, 3]}
    varied = {"ball.position": {"linspace": [[-1, -1, 0.2], [1, 1, 0.2]]}}
    _, figure = drawn(tmp_path, monkeypatch, surface=[surface], variation=varied)
    faces = figure.axes[0].collections[0]
    colors = faces.get_facecolor()[:, :3]
    x = np.array([path.vertices[:3, 0].mean() for path in faces.get_paths()])
    assert len(x) == 4
    assert (np.ptp(colors[x > 0], axis=1) == 0).all()
    # No track has the hue of the ground: red is the smallest component.
    assert (colors[x < 0, 1:].min(axis=1) > colors[x < 0, 0] + 0.1).all()
    assert figure_texts(figure) == ["active faces", "inactive faces, which cannot touch"]
    patches = [handle.get_facecolor()[:3] for handle in figure.legends[0].get_patches()]
    ratio = colors[x < 0] / colors[x > 0][0]
    np.testing.assert_allclose(ratio, np.broadcast_to(np.divide(patches[1], patches[0]), (2, 3)), rtol=1e-6)


def test_ground_section_distinguishes_inactive_faces(tmp_path, monkeypatch):
    surface = {"name": "ground", "mesh": LEFT, "active_faces": [2, 3]}
    moving = {"position": [0, 0, 0.5], "linear_velocity": [3, 0, 0]}
    _, figure = drawn(tmp_path, monkeypatch, moving, surface=[surface])
    lines = figure.axes[0].collections[0]
    x = np.array([segment[:, 0].mean() for segment in lines.get_segments()])
    colors = lines.get_color()[:, :3]
    assert (np.ptp(colors[x > 0], axis=1) == 0).all()
    assert (np.ptp(colors[x < 0], axis=1) > 0.3).all()
    handles = [handle.get_color() for handle in figure.legends[0].get_lines()]
    np.testing.assert_array_equal(colors[x > 0], np.broadcast_to(handles[0], (2, 3)))
    np.testing.assert_array_equal(colors[x < 0], np.broadcast_to(handles[1], (2, 3)))


def test_picture_has_no_face_legend_if_all_faces_are_active(tmp_path, monkeypatch):
    hidden = {"name": "roof", "mesh": LEFT, "active_faces": [0], "visible": False}
    surfaces = [content()["surface"][0] | {"active_faces": [0, 1]}, hidden]
    _, figure = drawn(tmp_path, monkeypatch, surface=surfaces)
    assert figure_texts(figure) == []
    assert "surfaces as in" not in figure.axes[0].get_title("left")


@pytest.mark.parametrize(
    ("variation", "differ"), [({"values": [1, 0, 0, 1]}, True), ({"value": 1}, False)], ids=["each", "one"]
)
def test_picture_shows_the_mesh_of_the_first_environment(variation, differ, tmp_path, monkeypatch):
    from warpcontact.experiment import picture
    from warpcontact.experiment.ground import GroundSurface

    surface = {"name": "ground", "mesh": [LEFT, STEP], "active_faces": [[0], True]}
    varied = {
        "ground.mesh": variation,
        "ground.scale": {"value": 2},
        "ball.mass": {"linspace": [1, 2]},
        "ball.position": {"linspace": [[-1, -1, 0.5], [1, 1, 0.5]]},
    }
    recording, figure = drawn(tmp_path, monkeypatch, surface=[surface], variation=varied)
    ground = GroundSurface.of(recording, recording.scene.surfaces[0])
    assert ground.shared is not differ
    np.testing.assert_allclose(ground.corners.max(axis=(0, 1)), [4, 4, 0.2])
    assert ground.active.all()
    # Faces of the box are as wide as the box, those of the grid half of its width.
    assert all(np.ptp(path.vertices[:, 0]) == 8.0 for path in figure.axes[0].collections[0].get_paths())
    assert figure_texts(figure) == []
    assert ("surfaces as in environment 0" in figure.axes[0].get_title("left")) is differ
    # Parameters that are equal everywhere do not color tracks.
    expected = (
        "ground.mesh\none of 3 varied parameters" if differ else "ball.mass [kg]\none of 2 varied parameters"
    )
    assert picture._color_values(recording, list(varied))[1] == expected
