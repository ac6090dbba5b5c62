"""Folders of runs: what is damaged, changed or hostile gives one clear error, and the rest can be read."""

import csv
import json
import os
import shutil
import signal

import numpy as np
import pytest
import runs
import xarray as xr

import warpcontact as wc
from warpcontact import checkpoint
from warpcontact.cli import main
from warpcontact.experiment.committed import CommittedStore
from warpcontact.experiment.records import Commit

WORDS = ("--shard", 4, "--device", "cpu", "--checkpoint", 0)
SHA = "0" * 64
MOST = 2**63 - 1


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run of three shards, with chunks of 19 frames."""
    folder = tmp_path_factory.mktemp("whole")
    code, _, err = runs.run(runs.study(folder), "--out", folder / "out", *WORDS)
    assert code == 0, err
    return folder / "out"


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """The same, killed when one shard was finished and another on its way."""
    folder = tmp_path_factory.mktemp("part")
    study, out = runs.study(folder), folder / "out"
    process = runs.begin(study, "--out", out, *WORDS, first=runs.EAGER)

    def halfway():
        shards = runs.records(out)
        return 1 in shards and shards[1]["frames"] > 0 and not shards[1]["finished"]

    try:
        assert runs.wait_until(halfway, process)
    finally:
        runs.kill(process)
    return out


@pytest.fixture
def copied(tmp_path):
    """Copies the folder of a run, to be damaged."""

    def copy(folder):
        return shutil.copytree(folder, tmp_path / "copy")

    return copy


def change(path, **entries):
    content = json.loads(path.read_text())
    for key, value in entries.items():
        content[key] = value
    path.write_text(json.dumps(content))


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


def chunk_of(folder, name, shard=0):
    files = runs.records(folder)[shard]["files"]
    return folder / "data.zarr" / next(file for file in sorted(files) if file.startswith(name))


# What is no run


def test_what_holds_no_run_is_refused(tmp_path):
    with pytest.raises(wc.ExperimentError, match="none: is not a folder"):
        wc.open_run(tmp_path / "none")
    (tmp_path / "file").write_text("text")
    with pytest.raises(wc.ExperimentError, match="file: is not a folder"):
        wc.open_run(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "run.json").write_text('{"program": "another 1.0", "schema": 1}')
    for name in ("empty", "other"):
        with pytest.raises(wc.ExperimentError, match=rf"{name}: holds no run: there is no whole run\.json"):
            wc.open_run(tmp_path / name)
        with pytest.raises(wc.ExperimentError, match=f"{name}: holds no run that could go on"):
            wc.Experiment.from_toml(runs.study(tmp_path)).run(tmp_path / name, device="cpu", resume=True)


@pytest.mark.parametrize("content", ["", "{", '{"program": "warpc', "[]", "null", "\x00\xff", "[" * 100_000])
def test_run_json_that_is_cut_off_is_no_run(content, whole, copied):
    folder = copied(whole)
    (folder / "run.json").write_text(content)
    with pytest.raises(wc.ExperimentError, match=r"holds no run: there is no whole run\.json"):
        wc.open_run(folder)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"schema": 2}, "schema must be 1, got 2, written by warpcontact"),
        ({"schema": "1"}, "schema must be 1, got '1'"),
        ({"schema": None}, "schema must be 1, got None"),
        ({"envs": 0}, "envs must be a whole number from 1 to 2147483647, got 0"),
        ({"envs": 10**30}, "envs must be a whole number from 1 to 2147483647, got 10{30}"),
        ({"envs": 11}, r"envs must be 10, as in experiment\.toml, got 11"),
        ({"shard": "4"}, "shard must be a whole number from 1 to 2147483647, got '4'"),
        ({"shard": 5}, "shards must be 2, as envs and shard say, got 3"),
        ({"block": -1}, "block must be a whole number from 1 to 2147483647, got -1"),
        ({"steps": True}, "steps must be a whole number from 1 to 2147483647, got True"),
        ({"dt": 0}, "dt must be a time above 0 s, got 0"),
        ({"duration": [1]}, r"duration must be a time above 0 s, got \[1\]"),
        ({"state": "done"}, "state must be one of finished, unfinished, interrupted, failed, got 'done'"),
        ({"state": ["x"]}, r"state must be a text, got \['x'\]"),
        ({"failed": "all"}, "failed must be a table, got 'all'"),
        ({"law_files": 1}, "law_files must be a table, got 1"),
    ],
)
def test_run_json_with_wrong_entries_names_them(entries, message, whole, copied):
    folder = copied(whole)
    change(folder / "run.json", **entries)
    with pytest.raises(wc.ExperimentError, match=f"run\\.json.*{message}"):
        wc.open_run(folder)


def test_run_json_names_all_that_is_missing(whole, copied):
    folder = copied(whole)
    kept = {key: json.loads((folder / "run.json").read_text())[key] for key in ("program", "schema", "envs")}
    (folder / "run.json").write_text(json.dumps(kept))
    with pytest.raises(wc.ExperimentError, match="has 10 problems") as error:
        wc.open_run(folder)
    assert "  - shard is missing" in str(error.value)


def test_names_in_run_json_lead_nowhere_else(whole, copied):
    folder = copied(whole)
    (folder.parent / "secret.py").write_text("secret = 1")
    change(folder / "run.json", law_files={"../secret.py": SHA, "/etc/passwd": SHA})
    assert set(wc.open_run(folder).files) == {"commits", "data", "experiment", "picture", "summary"}


# What is missing, cut off or changed


def test_whole_folder_passes(whole):
    run = wc.open_run(whole, verify=True)
    assert run.finished
    run.check()
    assert runs.leftovers(whole) == []
    assert str(whole / "data.zarr") in str(run)


def test_missing_parts_are_named(whole, copied):
    folder = copied(whole)
    for name, message in (
        ("experiment.toml", r"experiment\.toml: cannot be read"),
        ("commit/store.json", r"store\.json: is missing, which says what counts"),
        ("commit/shard_000001.json", r"shard_000001\.json: the run is finished, and there is no record"),
        ("data.zarr/series/touch.gap/zarr.json", r"touch\.gap/zarr\.json: is missing, and was committed"),
        ("data.zarr/series/env/c/0", "env/c/0: is missing, and was committed"),
    ):
        content = (folder / name).read_bytes()
        (folder / name).unlink()
        with pytest.raises((wc.ExperimentError, wc.StoreError), match=message):
            wc.open_run(folder)
        (folder / name).write_bytes(content)
    wc.open_run(folder)
    shutil.rmtree(folder / "commit")
    with pytest.raises(wc.ExperimentError, match="folder commit is missing, which says what counts"):
        wc.open_run(folder)
    shutil.rmtree(folder / "data.zarr")
    with pytest.raises(wc.ExperimentError, match="the run was ended before anything was kept"):
        wc.open_run(folder)


def test_experiment_that_is_cut_off_is_named(whole, copied):
    folder = copied(whole)
    path = folder / "experiment.toml"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(wc.ExperimentError, match=r"experiment\.toml: cannot be read|envs must be None"):
        wc.open_run(folder)


def test_chunks_that_are_missing_or_cut_off_are_named(whole, copied):
    folder = copied(whole)
    path = chunk_of(folder, "series/touch.gap")
    content = path.read_bytes()
    path.write_bytes(content[:-1])
    message = f"has {len(content) - 1} bytes, and {len(content)} were committed"
    with pytest.raises(wc.StoreError, match=rf"series/touch\.gap/c/\S+: {message}"):
        wc.open_run(folder)
    path.unlink()
    with pytest.raises(wc.StoreError, match=r"series/touch\.gap/c/\S+: is missing, and was committed"):
        wc.open_run(folder)


def test_a_shard_whose_record_was_removed_is_run_again(whole, copied):
    folder = copied(whole)
    flip(chunk_of(folder, "series/touch.gap", shard=1))
    (folder / "commit" / "shard_000001.json").unlink()
    wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole)
    wc.open_run(folder, verify=True)


@pytest.mark.parametrize("name", ["params/ball.mass", "outcome/status", "series/touch.gap"])
def test_a_changed_bit_is_found_when_it_is_read_and_when_all_is_verified(name, whole, copied):
    folder = copied(whole)
    path = chunk_of(folder, name, shard=1)
    flip(path)
    message = rf"{name}/c/\S+: was changed since it was committed"
    with pytest.raises(wc.StoreError, match=message):
        wc.open_run(folder, verify=True)
    run = wc.open_run(folder)  # looks at sizes only
    with pytest.raises(wc.StoreError, match=message):
        run.check()
    with pytest.raises(wc.StoreError, match=message):
        run.digest()
    group, variable = name.split("/")
    values = getattr(run, group)[variable]
    values.sel(env=slice(0, 3)).load()  # that of another shard is good
    with pytest.raises(wc.StoreError, match=message):
        values.sel(env=[5]).load()
    # Who reads the arrays without this library is told by the check sum of the chunk.
    with pytest.raises(RuntimeError, match=r"checksum|decompression"):
        xr.open_zarr(folder / "data.zarr", group=group, consolidated=False)[variable].load()


def test_chunks_that_vanish_after_opening_are_no_empty_values(whole, copied):
    folder = copied(whole)
    run = wc.open_run(folder)
    chunk_of(folder, "series/touch.gap").unlink()
    with pytest.raises(wc.StoreError, match=r"touch\.gap/c/\S+: is missing, and was committed"):
        run.series["touch.gap"].load()


def test_a_digest_reads_each_file_once_and_is_the_same_in_smaller_pieces(whole, monkeypatch):
    read = []
    content = CommittedStore._content

    def counted(store, key):
        if store.root.parent == whole:  # a read of another folder that failed may still go on
            read.append(key)
        return content(store, key)

    monkeypatch.setattr(CommittedStore, "_content", counted)
    run = wc.open_run(whole)
    digest = run.digest()
    chunks = [
        key for key in read if "/c/" in key and key.split("/")[1] not in ("env", "time", "axis", "component")
    ]
    assert len(chunks) > 10
    assert len(chunks) == len(set(chunks))
    for size in (1, 100, 1000, 4000):
        monkeypatch.setattr("warpcontact.experiment.run.READ_AT_ONCE", size)
        assert run.digest() == digest


def test_a_missing_checkpoint_is_named_and_its_shard_begins_anew(whole, part, copied):
    folder = copied(part)
    name = runs.records(folder)[1]["checkpoint"]
    (folder / "checkpoint" / name).unlink()
    with pytest.raises(wc.StoreError, match=rf"{name}: is missing, and was committed; --resume lets"):
        wc.open_run(folder)
    experiment = wc.Experiment.from_toml(folder / "experiment.toml")
    with pytest.warns(RuntimeWarning, match="shard_000001 begins anew: .*No such file"):
        run = experiment.run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole)
    assert any("shard_000001 begins anew" in line for line in run.summary["warnings"])


@pytest.mark.parametrize(
    "damage",
    [
        "cut off",
        "huge",
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("no arrays", "objects", "of another time")),
    ],
)
def test_a_damaged_checkpoint_lets_its_shard_begin_anew(damage, whole, part, copied):
    """Also where the record is of an earlier version, which told nothing of its content."""
    folder = copied(part)
    record = folder / "commit" / "shard_000001.json"
    content = json.loads(record.read_text())
    del content["checkpoint_sha256"]
    record.write_text(json.dumps(content))
    path = folder / "checkpoint" / runs.records(folder)[1]["checkpoint"]
    arrays, header = checkpoint.read(path)
    if damage == "cut off":
        path.write_bytes(path.read_bytes()[:-200])
    elif damage == "no arrays":
        path.write_text("nothing")
    elif damage == "objects":
        objects = np.array([print], dtype=object)  # would have to be unpickled
        np.savez(path, header=np.zeros(1, np.uint8), times=objects)
    elif damage == "of another time":
        checkpoint.write(path, arrays | {"times": np.zeros(3)}, header)
    else:
        change(folder / "commit" / "shard_000001.json", steps=MOST, frames=MOST)
    with pytest.warns(
        RuntimeWarning, match=rf"shard_000001 begins anew: {path}: (is no whole|does not go on|is of )"
    ):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole)
    assert runs.leftovers(folder) == []


def test_a_checkpoint_of_another_content_is_named_and_its_shard_begins_anew(whole, part, copied):
    folder = copied(part)
    path = folder / "checkpoint" / runs.records(folder)[1]["checkpoint"]
    arrays, header = checkpoint.read(path)
    name = next(name for name, values in arrays.items() if values.dtype.kind == "f" and values.size)
    checkpoint.write(path, arrays | {name: arrays[name] + 1.0}, header)
    wc.open_run(folder)
    with pytest.raises(wc.StoreError, match=rf"{path}: was changed since it was committed; --resume lets"):
        wc.open_run(folder, verify=True)
    with pytest.warns(RuntimeWarning, match=rf"shard_000001 begins anew: {path}: was changed since it was commit"):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole)
    wc.open_run(folder, verify=True)


def test_a_checkpoint_of_objects_runs_no_code(tmp_path):
    class Code:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    np.savez(tmp_path / "state.npz", header=np.array([Code()], dtype=object))
    with pytest.raises(wc.CheckpointError, match="is no whole checkpoint: Object arrays cannot be loaded"):
        checkpoint.read(tmp_path / "state.npz")
    assert not (tmp_path / "ran").exists()


def test_a_checkpoint_with_any_bit_changed_is_refused_or_the_same(tmp_path):
    path = tmp_path / "state.npz"
    arrays = {"a": np.arange(9, dtype=np.uint8), "b": np.zeros((2, 3))}
    checkpoint.write(path, arrays, {"shard": 1})
    content = path.read_bytes()
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x08]) + content[place + 1 :])
        try:
            found, _ = checkpoint.read(path)
        except wc.CheckpointError as error:
            assert str(path) in str(error)  # noqa: PT017
            continue
        # Times of files, names and the like: the values carry check sums.
        for name in found.keys() & arrays.keys():
            np.testing.assert_array_equal(found[name], arrays[name])


# Records that somebody else wrote


@pytest.mark.parametrize("content", ["", "{", "[]", "null", "\x00", "[" * 100_000, '{"shard": 0}', "1" * 5000])
def test_a_damaged_record_is_named(content, whole, copied):
    folder = copied(whole)
    (folder / "commit" / "shard_000001.json").write_text(content)
    with pytest.raises(
        wc.StoreError, match=r"commit/shard_000001\.json: (is no whole record|must have the entries)"
    ):
        wc.open_run(folder)
    with pytest.raises(wc.StoreError, match=r"commit/shard_000001\.json: "):
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
def test_a_record_with_wrong_entries_names_them(entries, message, whole, copied):
    folder = copied(whole)
    path = folder / "commit" / "shard_000001.json"
    change(path, **entries)
    with pytest.raises(wc.StoreError, match=rf"shard_000001\.json: {message}"):
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
def test_a_record_that_names_files_elsewhere_is_refused_and_nothing_is_moved(name, record, part, copied):
    folder = copied(part)
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
        with pytest.raises(wc.StoreError, match=r"files must name files that a run writes into data\.zarr, got"):
            act()
    assert sorted(folder.parent.rglob("*")) == before
    assert victim.read_text() == "mine"


@pytest.mark.parametrize(
    "entry", [None, [1], [1, 2], ["1", SHA], [-1, SHA], [10**30, SHA], [1, "x"], [1, SHA, 0], [True, SHA], {}]
)
def test_a_record_with_wrong_sizes_or_sums_is_refused(entry, whole, copied):
    folder = copied(whole)
    path = folder / "commit" / "shard_000001.json"
    change(path, files={"outcome/status/c/0": entry})
    with pytest.raises(wc.StoreError, match=r"files\.outcome/status/c/0 must be a size in bytes and a SHA-256"):
        wc.open_run(folder)


def test_no_record_of_a_run_is_refused(whole, part):
    for folder in (whole, part):
        for path in (folder / "commit").glob("shard_*.json"):
            assert Commit.read(path).shard in range(3)


def test_other_files_do_no_harm(whole, copied):
    folder = copied(whole)
    (folder / "checkpoint").mkdir()
    for name in ("notes.txt", "commit/shard_000001 (copy).json", "commit/shard_1.json", "checkpoint/mine.npz"):
        (folder / name).write_text("mine")
    (folder / "data.zarr" / "series" / "touch.gap" / "c" / "99").mkdir()
    (folder / "data.zarr" / ".DS_Store").write_text("mine")
    run = wc.open_run(folder, verify=True)
    assert run.digest() == wc.open_run(whole).digest()
    assert run.series.identical(wc.open_run(whole).series)


# Who may go on


def test_the_run_of_another_experiment_is_told_by_keys_and_values(part, copied):
    folder = copied(part)
    path = runs.study(folder.parent, mass="1.5", every="2e-3", seed="4")
    before = sorted(folder.rglob("*"))
    with pytest.raises(wc.ExperimentError) as error:
        wc.Experiment.from_toml(path).run(folder, device="cpu", resume=True)
    text = str(error.value)
    assert text.startswith(f"{folder}: holds the run of another experiment: ")
    for difference in ("seed is 3 there, 4 here", "body[0].mass is 1.0 there, 1.5 here", "record.every is 0.001"):
        assert difference in text
    assert sorted(folder.rglob("*")) == before


def test_a_mesh_file_with_another_content_is_another_experiment(tmp_path):
    ground = tmp_path / "ground.obj"
    ground.write_text("v -2 -2 0\nv 2 -2 0\nv 2 2 0\nv -2 2 0\nf 1 2 3\nf 1 3 4\n")
    path = runs.study(tmp_path, mesh='{ file = "ground.obj" }', duration="2e-3")
    wc.Experiment.from_toml(path).run(tmp_path / "out", device="cpu")
    ground.write_text(ground.read_text().replace("v 2 2 0", "v 2 2 0.1"))
    with pytest.raises(wc.ExperimentError, match="another experiment: files that it names have changed since"):
        wc.Experiment.from_toml(path).run(tmp_path / "out", device="cpu", resume=True)


@pytest.mark.skipif(os.name != "posix", reason="other systems have no locks on folders")
def test_a_run_in_progress_can_be_read_and_not_continued(whole, tmp_path):
    folder = tmp_path / "out"
    reference = wc.open_run(whole)
    seen = set()

    def read():
        values = wc.open_run(folder).series["touch.gap"]
        there = ~np.isnan(values.values)
        expected = reference.series["touch.gap"].sel(env=values["env"]).values
        np.testing.assert_array_equal(values.values[there], expected[there])
        seen.add(int(there.sum()))

    process = runs.begin(runs.study(tmp_path), "--out", folder, *WORDS, first=runs.EAGER)
    try:
        assert runs.wait_until(lambda: runs.records(folder), process)
        os.kill(process.pid, signal.SIGSTOP)
        experiment = wc.Experiment.from_toml(folder / "experiment.toml")
        for options in ({"resume": True}, {"overwrite": True}):
            with pytest.raises(wc.ExperimentError, match="a process is running and writes there"):
                experiment.run(folder, device="cpu", **options)
        read()
        os.kill(process.pid, signal.SIGCONT)
        while process.poll() is None and len(seen) < 6:
            read()  # whatever is committed, moved and removed meanwhile
    finally:
        process.send_signal(signal.SIGCONT)
        code, _, err = runs.ended(process)
    assert code == 0, err
    read()
    assert len(seen) > 1
    assert runs.hashes(folder) == runs.hashes(whole)


# What can be read


def test_an_unfinished_run_shows_what_is_committed(whole, part):
    committed = runs.check_what_readers_see(part, wc.open_run(whole))
    run = wc.open_run(part)
    assert not run.finished
    assert committed[0]["finished"]
    assert not committed[1]["finished"]
    assert run.to_dataframe().index.tolist() == [0, 1, 2, 3]
    assert run.health.good
    assert "unfinished: 4 of 10 environments are finished in 3 shards" in str(run)
    assert run.digest() != wc.open_run(whole).digest()


@pytest.mark.parametrize("begun", [True, False])
def test_a_run_without_anything_committed_says_so(begun, part, copied, tmp_path, capsys):
    folder = copied(part)
    for path in (folder / "commit").glob("shard_*.json"):
        path.unlink()
    if begun:  # a checkpoint of the beginning, and no records yet
        shutil.copy(part / "commit" / "shard_000001.json", folder / "commit")
        change(folder / "commit" / "shard_000001.json", frames=0, steps=0, files={})
    goes_on = f"warpcontact run --resume --out {folder} goes on with"
    for words in (["export", folder, "--usd", tmp_path / "a.usda"], ["render", folder, "-o", tmp_path / "a.png"]):
        assert main([str(word) for word in words]) == 2
        told = capsys.readouterr().err
        assert f"{folder}: nothing over time is committed yet in this run; {goes_on} it" in told
    assert main(["export", str(folder), "--csv", str(tmp_path / "a.csv")]) == 0
    assert f"is finished yet: the table has no rows; {goes_on} the run" in capsys.readouterr().err


def test_records_that_wait_in_a_checkpoint_are_said_to_be_kept(part, copied, tmp_path, capsys):
    """Half of a shard is done, and not a whole block of it."""
    folder = copied(part)
    for number in (0, 1):
        change(folder / "commit" / f"shard_{number:06d}.json", frames=0)
    goes_on = f"warpcontact run --resume --out {folder} goes on with it"
    kept = (
        "records are written in blocks of 19, those since the last block are kept in checkpoints and appear as the"
    )
    for words in (["export", folder, "--usd", tmp_path / "a.usda"], ["render", folder, "-o", tmp_path / "a.png"]):
        assert main([str(word) for word in words]) == 2
        told = capsys.readouterr().err
        assert f"{folder}: no record over time can be read yet: {kept} run goes on; {goes_on}\n" in told
    assert f"\n4 environments begun, with 0 records over time or more: {kept} run goes on\n" in str(
        wc.open_run(folder)
    )


def test_what_is_shown_of_an_unfinished_run_says_of_how_many(part, whole):
    assert "\nof the 4 of 10 that are finished: all 4 environments are active\n" in str(wc.open_run(part))
    assert "\nall 10 environments are active\n" in str(wc.open_run(whole))
    assert " begun, " not in str(wc.open_run(whole))


def test_an_animation_of_an_unfinished_run_goes_to_the_last_record(part, tmp_path, capsys):
    frames = runs.records(part)[1]["frames"]
    out = tmp_path / "a.usda"
    assert main(["export", str(part), "--usd", str(out), "--envs", "0", "5"]) == 0
    printed, told = capsys.readouterr()
    assert printed == f"{out}\n"
    end = f"{(frames - 1) * 1e-3:g}"
    assert (
        f"warning: {part} is not finished: the animation goes to {end} s, and has 8 of 10 environments\n" in told
    )
    assert f"endTimeCode = {frames - 1}\n" in out.read_text()
    assert main(["export", str(part), "--usd", str(out), "--envs", "0"]) == 0
    assert "the animation goes to 0.2 s, and has 4 of 10 environments" in capsys.readouterr().err
    assert main(["export", str(part), "--usd", str(out), "--envs", "9"]) == 2
    assert "environment 9 has no record yet in this run: it has not begun; " in capsys.readouterr().err


def test_results_are_read_without_a_model(whole, tmp_path, monkeypatch):
    settings = wc.open_run(whole).experiment.settings

    def build(*_, **__):
        raise AssertionError("a model is built, which compiles kernels")

    monkeypatch.setattr(wc.Scene, "build", build)
    run = wc.open_run(whole)
    assert run.settings == settings
    assert [contact.name for contact in run.recording.scene.contacts] == ["touch"]
    assert wc.convergence(run, "end_time")["estimate"].sizes["n"] > 1
    assert wc.quantile_fan(run, "touch.gap").sizes["quantile"] == 5
    assert run.table().sizes["env"] == run.settings.envs
    assert "touch" in wc.report(run, tmp_path / "report.html").read_text(encoding="utf-8")


def test_tables_go_to_files_and_come_back(whole, tmp_path):
    pd = pytest.importorskip("pandas")
    run = wc.open_run(whole)
    frame = run.to_dataframe()
    assert frame.index.tolist() == list(range(10))
    assert frame["ball.mass"].tolist() == run.params["ball.mass"].values.tolist()
    sideways = run.params["ball.linear_velocity.initial"].sel(axis="y")
    np.testing.assert_array_equal(frame["ball.linear_velocity.initial.y"], sideways)
    run.to_csv(tmp_path / "table.csv")
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for name, column in frame.reset_index().items():
        read = str if column.dtype == "category" else float
        assert [read(row[name]) for row in rows] == column.tolist()
    pytest.importorskip("pyarrow")
    run.to_parquet(tmp_path / "table.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "table.parquet"), frame)


def test_the_digest_is_that_of_the_results_alone(whole, copied):
    folder = copied(whole)
    digest = wc.open_run(whole).digest()
    change(folder / "run.json", name="another", wall_time=1.0)
    assert wc.open_run(folder).digest() == digest
    run = wc.Experiment.from_toml(folder / "experiment.toml").run(folder.parent / "again", device="cpu", shard=3)
    assert run.digest() == digest
    other = wc.Experiment.from_toml(runs.study(folder.parent, seed="4"))
    assert other.run(folder.parent / "other", device="cpu").digest() != digest
