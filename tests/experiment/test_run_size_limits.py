"""Run folders with extreme array sizes, numbers of shards or depths of folders are rejected immediately."""

import json
import shutil
import time
from dataclasses import asdict

import pytest

from warpcontact.experiment.progress import run_status
from warpcontact.experiment.records import (
    AXES,
    ChunkGrid,
    Commit,
    ExpectedFiles,
    RunDataError,
    RunExtent,
    digest,
    is_chunk,
)
from warpcontact.experiment.run import Run
from warpcontact.experiment.store import Ledger, Shard, Shards
from warpcontact.files.run_folder import RunPath

MOST = 2**31 - 1
SUMMARY = {
    "program": "warpcontact 1.0",
    "schema": 2,
    "state": "finished",
    "name": "study",
    "device": "cpu",
    "fingerprint": "",
    "envs": 4,
    "shard": 4,
    "shards": 1,
    "block": 2,
    "steps": 10,
    "dt": 1e-3,
    "duration": 1e-2,
}


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def stored(folder, shape, chunks=None, dims=None):
    """Makes a run with one variable and the digests of its metadata; returns its expected files."""
    data = {
        "zarr.json": {"attributes": {"groups": ["params"]}},
        "params/zarr.json": {"attributes": {"variables": ["mass"]}},
        "params/mass/zarr.json": {
            "attributes": {},
            "shape": shape,
            "chunk_grid": {"configuration": {"chunk_shape": [1] * len(shape) if chunks is None else chunks}},
            "dimension_names": [f"axis_{k}" for k in range(len(shape))] if dims is None else dims,
        },
    }
    made = {}
    for name, content in data.items():
        write(folder / "data.zarr" / name, content)
        path = RunPath(folder) / "data.zarr" / name
        made[name] = (path.size(), digest(path))
    write(folder / "commit/store.json", {"files": made})
    return ExpectedFiles(RunPath(folder), made, RunExtent(4, 4, 10))


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ([2**70], {}),
        ([2**31], {}),
        ([True], {}),
        ([-1], {}),
        ([4], {"chunks": [True]}),
        ([4], {"chunks": [2**31]}),
        ([1] * (AXES + 1), {}),
        ([1] * 5000, {}),
        ([4, 4], {"dims": ["env", "env"]}),
        ([4], {"dims": [["env"]]}),
    ],
    ids=lambda value: str(value)[:20],
)
def test_extreme_grid_of_an_array_is_refused(shape, words, tmp_path):
    with pytest.raises(RunDataError, match=r"mass/zarr\.json: must have a shape of at most 8 axes"):
        stored(tmp_path, shape, **words)


def test_more_frames_than_steps_are_refused(tmp_path):
    stored(tmp_path, [11, 4], dims=["time", "env"])
    with pytest.raises(RunDataError, match=r"must have at most 11 frames, as run\.json has 10 steps, got 12"):
        stored(tmp_path, [12, 4], dims=["time", "env"])


def test_array_with_an_empty_axis_has_no_chunks_and_is_checked_quickly(tmp_path):
    expected = stored(tmp_path, [2**24, 4, 0], dims=["x", "env", "y"])
    begin = time.process_time()
    assert expected.problem(Commit(0, steps=10, finished=True)) is None
    assert list(ChunkGrid(("x", "y"), (2**24, 0), (1, 1)).names()) == []
    assert list(ChunkGrid((), (), ()).names()) == ["c"]
    assert time.process_time() - begin < 1.0


def test_chunk_grid_handles_ranges_beyond_index_size():
    grid = ChunkGrid(("x",), (2**70,), (2**69,))
    assert grid.chunk_ranges() == [range(2)]


def test_chunk_names_have_bounded_depth_and_length():
    assert is_chunk("params/mass/c" + "/0" * AXES)
    assert not is_chunk("params/mass/c" + "/0" * (AXES + 1))
    assert not is_chunk("params/mass/c/" + "1" * 5000)


def test_shards_are_computed_from_their_numbers():
    shards = Shards(10, 4)
    assert list(shards) == [Shard(0, 0, 4), Shard(1, 4, 8), Shard(2, 8, 10)]
    assert next(reversed(shards)) == shards[-1] == shards[1:][1] == Shard(2, 8, 10)
    with pytest.raises(IndexError):
        shards[3]
    many = Shards(MOST, 1)
    assert len(many) == MOST
    assert many[MOST - 1] == Shard(MOST - 1, MOST - 1, MOST)


def test_status_of_billions_of_shards_is_fast(tmp_path):
    write(tmp_path / "run.json", SUMMARY | {"envs": MOST, "shard": 1, "shards": MOST, "state": "failed"})
    write(
        tmp_path / "commit/shard_000007.json",
        {
            **{"shard": 7, "steps": 10, "frames": 0, "finished": True, "checkpoint": None, "wall_time": 1.0},
            **{"files": {}, "frozen": 0},
        },
    )
    begin = time.process_time()
    found = run_status(tmp_path)
    assert (found.shards, found.finished_shards, found.finished_envs, found.env_steps) == (MOST, 1, 1, 10)
    assert not Run(tmp_path, dict(found.summary)).finished
    assert time.process_time() - begin < 1.0


def finished(folder, empty=range(4)):
    """Makes a finished run of one shard; chunks are empty or have a file. Returns its ledger."""
    stored(folder, [4], dims=["env"])
    names = [f"params/mass/c/{k}" for k in range(4)]
    files = {}
    for name in (name for k, name in enumerate(names) if k not in empty):
        write(folder / "data.zarr" / name, 0)
        path = RunPath(folder) / "data.zarr" / name
        files[name] = (path.size(), digest(path))
    commit = Commit(0, 10, 0, True, files=files, empty=[name for name in names if name not in files])
    write(folder / "commit/shard_000000.json", asdict(commit))
    return Ledger(folder)


EXTENT = RunExtent(4, 4, 10)


@pytest.mark.parametrize("name", ["x", "0"])
def test_folders_without_chunks_are_not_entered(name, tmp_path, monkeypatch):
    """Folders that contain no chunks are reported as unknown."""
    ledger = finished(tmp_path)
    top = tmp_path / "data.zarr/params/mass/c"
    top.joinpath(*[name] * 20).mkdir(parents=True)
    entered, names = [], RunPath.names

    def noted(path):
        entered.append(len(path.parts))
        return names(path)

    monkeypatch.setattr(RunPath, "names", noted)
    if name == "x":
        with pytest.raises(RunDataError, match=r"mass/c/x: is not of this run; remove it"):
            ledger.check(EXTENT, contents=True)
    else:
        ledger.check(EXTENT, contents=True)
    assert max(entered) <= len(("data.zarr", "params", "mass", "c")) + AXES - 1


def test_folders_nested_too_deep_to_be_removed_raise_with_their_name(tmp_path, monkeypatch):
    def deep(*_, **__):
        raise RecursionError

    (tmp_path / "staging").mkdir()
    monkeypatch.setattr(shutil, "rmtree", deep)
    with pytest.raises(OSError, match="has folders that are nested too deeply to be removed") as error:
        (RunPath(tmp_path) / "staging").remove()
    assert error.value.filename == str(tmp_path / "staging")


def test_each_chunk_is_accessed_once_and_staging_once_per_shard(tmp_path, monkeypatch):
    ledger = finished(tmp_path, empty=())
    queried, status = [], RunPath.status

    def noted(path):
        queried.append("/".join(path.parts))
        return status(path)

    monkeypatch.setattr(RunPath, "status", noted)
    ledger.check(EXTENT)
    chunks = [name for name in queried if "/c/" in name]
    assert sorted(chunks) == [f"data.zarr/params/mass/c/{k}" for k in range(4)]
    assert [name for name in queried if name.startswith("staging")] == ["staging/shard_000000"]


def test_staged_chunk_is_found(tmp_path):
    ledger = finished(tmp_path, empty=())
    staged = tmp_path / "staging/shard_000000/params/mass/c/2"
    staged.parent.mkdir(parents=True)
    (tmp_path / "data.zarr/params/mass/c/2").rename(staged)
    ledger.check(EXTENT, contents=True)
    staged.unlink()
    with pytest.raises(RunDataError, match="c/2: is missing, and was committed"):
        ledger.check(EXTENT)
