"""The folder of results: what a run leaves there, what it never touches, and what it says about itself."""

import json
import os
import warnings

import numpy as np
import pytest
from test_experiment import content

import warpcontact as wc


def test_folder_of_something_else_is_left_alone(tmp_path):
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
    with pytest.raises(wc.ExperimentError, match="device"):  # found before anything is removed
        wc.Experiment(content()).run(tmp_path, device="cuda:99", overwrite=True)
    assert (tmp_path / "recording.zarr").exists()
    run = wc.Experiment(content(output={"usd_envs": 0})).run(tmp_path, device="cpu", overwrite=True)
    assert not (tmp_path / "animation.usdc").exists()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert run.summary["state"] == "finished"


def test_folder_of_an_unfinished_run_may_be_used_again(tmp_path):
    def interrupt(stage):
        if stage == "writing":
            raise KeyboardInterrupt

    summary = tmp_path / "run.json"
    with pytest.raises(KeyboardInterrupt):
        wc.Experiment(content()).run(tmp_path, device="cpu", on_stage=interrupt)
    assert json.loads(summary.read_text())["state"] == "interrupted"
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]
    assert wc.Experiment(content()).run(tmp_path, device="cpu").health.good
    written = json.loads(summary.read_text())
    gone = written | {"state": "unfinished", "process": 2**22 + 1}  # above the largest number of a process
    summary.write_text(json.dumps(gone))
    assert wc.Experiment(content()).run(tmp_path, device="cpu").health.good


@pytest.mark.skipif(os.name != "posix", reason="other systems do not tell")
def test_folder_of_a_run_in_progress_is_left_alone(tmp_path):
    run = wc.Experiment(content()).run(tmp_path, device="cpu")
    going_on = json.loads(run.files["summary"].read_text()) | {"state": "unfinished", "process": os.getppid()}
    run.files["summary"].write_text(json.dumps(going_on))
    with pytest.raises(wc.ExperimentError, match="is running and writes there"):
        wc.Experiment(content()).run(tmp_path, device="cpu", overwrite=True)


def test_warnings_of_python_are_kept_and_take_their_way(tmp_path):
    def warn(stage):
        warnings.warn("a bad omen", UserWarning, stacklevel=1)

    with pytest.warns(UserWarning, match="a bad omen"):
        run = wc.Experiment(content()).run(tmp_path, device="cpu", on_stage=warn)
    assert run.summary["warnings"].count("a bad omen") == 1
    told = []
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        wc.Experiment(content()).run(tmp_path, device="cpu", overwrite=True, on_stage=warn, on_warning=told.append)
    assert "a bad omen" in told
    assert not shown


def test_frozen_environments_are_reported(tmp_path):
    # A force beyond float32 in the last environment only.
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
        {"contact": [], "surface": [], "record": {"readings": ["ball.linear_velocity"]}},
        {"record": {"readings": ["touch.normal_force"]}, "variation": {"ball.mass": {"loguniform": [0.01, 10]}}},
        {"surface": [{"name": "ground", "mesh": {"shape": "box"}, "position": [0, 0, -0.5]}]},
    ],
    ids=["one", "nothing to touch", "logarithmic colours", "closed mesh"],
)
def test_picture_is_made_of_whatever_there_is(changes, tmp_path):
    run = wc.Experiment(content(**changes)).run(tmp_path, device="cpu")
    assert run.files["picture"].stat().st_size > 10_000


def test_picture_shows_what_differs_from_the_side_that_tells(tmp_path):
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
    assert picture._plane([recording["ball.position"].values]) == [0, 2]
    recording["touch.law.stiffness"][0, 1] = 7.0  # items that differ are no colour
    assert picture._color_values(recording, list(varied))[1] == "environment"


@pytest.mark.parametrize("shape", ["grid", "sinusoidal_terrain", "icosphere"])
def test_section_lies_on_the_surface(shape):
    from matplotlib.figure import Figure

    from warpcontact.experiment import picture

    scene = wc.Experiment(content(surface=[{"name": "ground", "mesh": {"shape": shape}}])).scene()
    axes = Figure().add_subplot()
    picture._draw_section(axes, scene.surfaces[0], 0.0)
    points = np.concatenate(axes.collections[0].get_segments())
    if shape == "icosphere":
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=0.01)
    else:
        np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-4)
