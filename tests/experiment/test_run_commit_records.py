"""Untrusted commit records of runs: no path leads outside of the folder, and errors are named."""

import json

import pytest
import sharded_runs

import warpcontact as wc
from warpcontact.experiment.records import Commit
from warpcontact.files.run_folder import RunPath

SHA = "0" * 64
MOST = 2**63 - 1


@pytest.mark.parametrize("content", ["", "{", "[]", "null", "\x00", "[" * 100_000, '{"shard": 0}', "1" * 5000])
def test_damaged_commit_record_is_reported(content, whole_run, copied_run):
    folder = copied_run(whole_run)
    (folder / "commit" / "shard_000001.json").write_text(content)
    with pytest.raises(
        wc.RunDataError, match=r"commit/shard_000001\.json: (is not a complete record|must have the entries)"
    ):
        wc.open_run(folder)
    with pytest.raises(wc.RunDataError, match=r"commit/shard_000001\.json: "):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"shard": 2}, "shard must be 1, as in its name, got 2"),
        ({"shard": True}, "shard must be 1, as in its name, got True"),
        ({"steps": -1}, f"steps must be a whole number from 0 to {MOST}, got -1"),
        ({"steps": 1e300}, f"steps must be a whole number from 0 to {MOST}, got 1e\\+300"),
        ({"frames": 10**40}, f"frames must be a whole number from 0 to {MOST}, got 10{{40}}"),
        ({"frozen": None}, f"frozen must be a whole number from 0 to {MOST}, got None"),
        ({"finished": 1}, "finished must be true or false, got 1"),
        ({"wall_time": float("nan")}, "wall_time must be a time of at least 0 s, got nan"),
        ({"wall_time": float("inf")}, "wall_time must be a time of at least 0 s, got inf"),
        ({"checkpoint": "x.npz"}, r"checkpoint must be null in a finished shard, got 'x\.npz'"),
        (
            {"finished": False, "checkpoint": "../../secret.npz"},
            r"checkpoint must be the name of a file shard_000001-<steps>\.npz, got '\.\./\.\./secret\.npz'",
        ),
        ({"finished": False, "checkpoint": None}, "checkpoint must be the name of a file"),
        ({"checkpoint_sha256": "0" * 64}, "checkpoint_sha256 must be null in a finished shard, got '0+"),
        (
            {"finished": False, "checkpoint": "shard_000001-000000000050.npz", "checkpoint_sha256": "0"},
            "checkpoint_sha256 must be null, or a SHA-256 in 64 hexadecimal digits, got '0'",
        ),
        ({"files": []}, r"files must be a table, got \[\]"),
        ({"more": 1}, "must have the entries shard, steps"),
    ],
)
def test_invalid_commit_record_entries_are_reported(entries, message, whole_run, copied_run):
    folder = copied_run(whole_run)
    path = folder / "commit" / "shard_000001.json"
    sharded_runs.change(path, **entries)
    with pytest.raises(wc.RunDataError, match=rf"shard_000001\.json: {message}"):
        wc.open_run(folder)


HOSTILE = [
    "../victim",
    "../../victim",
    "/tmp/victim",
    "series/../../victim/c/0",
    "series/../c/0",
    "series/./c/0",
    "series/touch.gap/c/../../../../victim",
    "series/touch.gap/c/0/..",
    "series\\..\\victim/c/0",
    "series//c/0",
    "C:/victim/c/0",
    "other/touch.gap/c/0",
    "series/touch.gap/c/0/0\n",
    "series/touch\0gap/c/0",
    "",
]


@pytest.mark.parametrize("name", HOSTILE, ids=repr)
@pytest.mark.parametrize("record", ["shard_000001.json", "store.json"])
def test_commit_record_with_outside_file_names_is_refused_without_moving_files(name, record, part_run, copied_run):
    folder = copied_run(part_run)
    victim = folder.parent / "victim"
    victim.write_text("mine")
    (folder / "victim").write_text("mine")
    path = folder / "commit" / record
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"files": {name: [4, SHA]}}))
    before = sorted(folder.parent.rglob("*"))
    for act in (
        lambda: wc.open_run(folder),
        lambda: wc.open_run(folder, verify=True),
        lambda: wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True),
    ):
        with pytest.raises(wc.RunDataError, match=r"files must name files that a run writes into data\.zarr, got"):
            act()
    assert sorted(folder.parent.rglob("*")) == before
    assert victim.read_text() == "mine"


@pytest.mark.parametrize(
    "entry", [None, [1], [1, 2], ["1", SHA], [-1, SHA], [10**30, SHA], [1, "x"], [1, SHA, 0], [True, SHA], {}]
)
def test_commit_record_with_invalid_sizes_or_hashes_is_refused(entry, whole_run, copied_run):
    folder = copied_run(whole_run)
    path = folder / "commit" / "shard_000001.json"
    sharded_runs.change(path, files={"outcome/status/c/0": entry})
    with pytest.raises(wc.RunDataError, match=r"files\.outcome/status/c/0 must be a size in bytes and a SHA-256"):
        wc.open_run(folder)


def test_valid_commit_records_are_accepted(whole_run, part_run):
    for folder in (whole_run, part_run):
        for path in (folder / "commit").glob("shard_*.json"):
            assert Commit.read(RunPath(folder) / "commit" / path.name).shard in range(3)


def test_unknown_files_do_not_affect_a_run(whole_run, copied_run):
    folder = copied_run(whole_run)
    (folder / "checkpoint").mkdir()
    for name in ("notes.txt", "commit/shard_000001 (copy).json", "commit/shard_1.json", "checkpoint/mine.npz"):
        (folder / name).write_text("mine")
    (folder / "data.zarr" / "series" / "touch.gap" / "c" / "99").mkdir()
    (folder / "data.zarr" / ".DS_Store").write_text("mine")
    run = wc.open_run(folder, verify=True)
    assert run.digest() == wc.open_run(whole_run).digest()
    assert run.series.identical(wc.open_run(whole_run).series)
