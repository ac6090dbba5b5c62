"""Pipes, devices and oversized files instead of files of a user or a run are rejected without blocking."""

import os
import shutil
import signal
import time

import numpy as np
import pytest
import sharded_runs
from test_experiment import content

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment import quantities
from warpcontact.experiment.quantities import read_rows
from warpcontact.stepping import checkpoint
from warpcontact.system.resources import AvailableMemory

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and devices of POSIX")


@pytest.fixture(autouse=True)
def no_waiting():
    """Ends a test that blocks on a pipe or reads forever."""

    def late(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(120)  # the machine may be busy
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def with_law(path):
    material = {"name": "rubber", "law": {"type": f"{path.name}:Law"}}
    return wc.Experiment.from_dict(content(material=[material]), path.parent)


def with_rows(path):
    bodies = [{"name": "grains", "positions": path.name, "mass": 1, "inertia": [1, 1, 1]}]
    return wc.Experiment.from_dict(content(bodies=bodies), path.parent)


def with_mesh(path):
    surface = [{"name": "ground", "mesh": {"file": path.name}}]
    return wc.Experiment.from_dict(content(surface=surface), path.parent)


# Functions that read a file of the user, by file name.
READERS = {
    "study.toml": wc.Experiment.from_toml,
    "laws.py": with_law,
    "rows.npy": with_rows,
    "rows.csv": with_rows,
    "mesh.stl": with_mesh,
    "mesh.obj": wc.load_mesh,
    "state.npz": checkpoint.read,
    "problem.npz": wc.unilateral.Problem.load,
    "stage.usda": wc.Scene.from_usd,
}


@pytest.mark.parametrize("kind", ["a named pipe", "a device"])
@pytest.mark.parametrize("name", READERS)
def test_special_file_of_the_user_is_refused(name, kind, tmp_path):
    path = tmp_path / name
    if kind == "a device":
        path.symlink_to("/dev/zero")
    else:
        os.mkfifo(path)
    begin = time.monotonic()
    with pytest.raises((ValueError, OSError), match=r"not a regular file|must name a file inside of") as error:
        READERS[name](path)
    assert time.monotonic() - begin < 5.0  # fraction of a second; the machine may be busy
    assert name in str(error.value)


@pytest.mark.parametrize("command", ["run", "plan", "view", "build-kernels"])
def test_named_pipe_on_the_command_line_is_refused(command, tmp_path, capsys):
    if command == "view":
        pytest.importorskip("viser")
    os.mkfifo(tmp_path / "study.toml")
    assert main([command, str(tmp_path / "study.toml")]) == 2
    assert "is not a regular file" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["study.toml", "laws.py"])
def test_too_large_text_file_is_refused(name, tmp_path):
    with (tmp_path / name).open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(wc.ExperimentError, match="must have at most 512 MiB, has 1 GiB"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", ["rows.npy", "rows.csv"])
def test_rows_that_do_not_fit_into_memory_are_refused(name, tmp_path, monkeypatch):
    monkeypatch.setattr(quantities, "available_memory", lambda place: AvailableMemory(place, 100))
    with (tmp_path / name).open("wb") as file:
        file.truncate(101)
    with pytest.raises(ValueError, match=f"{name}' cannot be read: must have at most 100 B, has 101 B"):
        read_rows(tmp_path / name)


def test_rows_are_read_if_the_memory_size_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(quantities, "available_memory", lambda place: None)
    np.save(tmp_path / "rows.npy", np.ones((2, 3)))
    np.testing.assert_array_equal(read_rows(tmp_path / "rows.npy"), np.ones((2, 3)))


@pytest.mark.parametrize(
    "name",
    ["run.json", "experiment.toml", "commit/store.json", "commit/shard_000001.json", "progress/shard_000001.json"],
)
def test_too_large_commit_record_is_refused(name, part_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(part_run, folder)
    (folder / name).parent.mkdir(exist_ok=True)
    with (folder / name).open("wb") as file:
        file.truncate(2**30)
    begin = time.monotonic()
    if name.startswith("progress"):
        acts = [lambda: main(["status", str(folder)])]
    else:
        acts = [lambda: main(["status", str(folder), "--verify"]), lambda: wc.open_run(folder)]
    if name.endswith(".json") and not name.startswith("progress"):  # a resumed run uses the settings of its study
        study = sharded_runs.study(tmp_path)
        acts.append(lambda: wc.Experiment.from_toml(study).run(folder, resume=True))
    for act in acts:
        try:
            assert act() in (1, 2)  # 1: results differ from those that were committed
        except (ValueError, OSError) as error:
            assert f"{folder / name}" in str(error)  # noqa: PT017
            assert "has 1 GiB" in str(error)  # noqa: PT017
    assert time.monotonic() - begin < 15.0
