"""Run folders with missing, truncated or changed files: the damage is named, and intact data can be read."""

import hashlib
import json
import os
import shutil

import numpy as np
import pytest
import sharded_runs
import xarray as xr

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.experiment.committed import CommittedStore
from warpcontact.stepping import checkpoint

MOST = 2**63 - 1


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


def chunk_of(folder, name, shard=0):
    files = sharded_runs.records(folder)[shard]["files"]
    return folder / "data.zarr" / next(file for file in sorted(files) if file.startswith(name))


def test_missing_run_parts_are_reported(whole_run, copied_run):
    folder = copied_run(whole_run)
    for name, message in (
        ("experiment.toml", r"experiment\.toml: cannot be read"),
        ("commit/store.json", r"store\.json: is missing; it lists the committed files"),
        ("commit/shard_000001.json", r"shard_000001\.json: the run is finished, but this shard has no record"),
        ("data.zarr/series/touch.gap/zarr.json", r"touch\.gap/zarr\.json: is missing, and was committed"),
        ("data.zarr/series/env/c/0", "env/c/0: is missing, and was committed"),
    ):
        content = (folder / name).read_bytes()
        (folder / name).unlink()
        with pytest.raises((wc.ExperimentError, wc.RunDataError), match=message):
            wc.open_run(folder)
        (folder / name).write_bytes(content)
    wc.open_run(folder)
    shutil.rmtree(folder / "commit")
    with pytest.raises(wc.ExperimentError, match="folder commit is missing; it lists the committed files"):
        wc.open_run(folder)
    shutil.rmtree(folder / "data.zarr")
    with pytest.raises(wc.ExperimentError, match="the run ended before anything was saved"):
        wc.open_run(folder)


def test_truncated_experiment_file_is_reported(whole_run, copied_run):
    folder = copied_run(whole_run)
    path = folder / "experiment.toml"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(wc.ExperimentError, match=r"experiment\.toml: cannot be read|envs must be None"):
        wc.open_run(folder)


def test_missing_or_truncated_chunks_are_reported(whole_run, copied_run):
    folder = copied_run(whole_run)
    path = chunk_of(folder, "series/touch.gap")
    content = path.read_bytes()
    path.write_bytes(content[:-1])
    message = f"has {len(content) - 1} bytes, and {len(content)} were committed"
    with pytest.raises(wc.RunDataError, match=rf"series/touch\.gap/c/\S+: {message}"):
        wc.open_run(folder)
    path.unlink()
    with pytest.raises(wc.RunDataError, match=r"series/touch\.gap/c/\S+: is missing, and was committed"):
        wc.open_run(folder)


def drop_entry(folder, name):
    """Removes a chunk from its record."""
    for record in (folder / "commit").glob("*.json"):
        content = json.loads(record.read_text())
        if content["files"].pop(name, None) is not None:
            record.write_text(json.dumps(content))
            return
    raise KeyError(name)


@pytest.mark.parametrize(
    "array", ["params/ball.mass", "params/env", "params/axis", "outcome/status", "series/touch.gap", "series/time"]
)
def test_chunk_missing_with_its_entry_is_reported(array, whole_run, copied_run, capsys):
    folder = copied_run(whole_run)
    chunk = sorted((folder / "data.zarr" / array / "c").rglob("*"))[-1]
    name = chunk.relative_to(folder / "data.zarr").as_posix()
    chunk.unlink()
    drop_entry(folder, name)
    with pytest.raises(wc.RunDataError, match=rf"{name}: is missing"):
        wc.open_run(folder)
    assert main(["status", str(folder), "--verify"]) == 1
    assert f"{name}: is missing" in capsys.readouterr().err


def test_array_missing_with_its_entries_is_reported(whole_run, copied_run):
    folder = copied_run(whole_run)
    shutil.rmtree(folder / "data.zarr/series/touch.gap")
    for path in (folder / "commit").glob("*.json"):
        content = json.loads(path.read_text())
        kept = {name: one for name, one in content["files"].items() if "/touch.gap/" not in name}
        path.write_text(json.dumps(content | {"files": kept}))
    with pytest.raises(wc.RunDataError, match=r"series/touch\.gap/zarr\.json: is missing in \S+store\.json"):
        wc.open_run(folder)


def test_block_of_unfinished_shard_missing_with_its_entry_is_reported(whole_run, part_run, copied_run):
    folder = copied_run(part_run)
    name = chunk_of(folder, "series/touch.gap", shard=1).relative_to(folder / "data.zarr").as_posix()
    for root in ("data.zarr", "staging/shard_000001"):  # it may not have been moved yet
        (folder / root / name).unlink(missing_ok=True)
    drop_entry(folder, name)
    with pytest.raises(wc.RunDataError, match=rf"{name}: is missing"):
        wc.open_run(folder)
    with pytest.warns(RuntimeWarning, match=rf"shard_000001 starts again: \S+{name}: is missing"):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert sharded_runs.hashes(folder) == sharded_runs.hashes(whole_run)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 199}, "steps must be 200, got 199"),
        ({"frames": 38}, "frames must be 201, got 38"),
        (
            {"add": "series/touch.gap/c/99/0"},
            r"files must be those of this shard .*, got 'series/touch\.gap/c/99/0'",
        ),
        (
            {"add": "series/touch.gap/c/0/1"},
            r"files must be those of this shard .*, got 'series/touch\.gap/c/0/1'",
        ),
        ({"add": "series/other/c/0"}, r"files must be those .*, got 'series/other/c/0'"),
        ({"empty": ["series/touch.gap/c/0/0"]}, "empty must name chunks that are not in files"),
        ({"empty": None}, "empty is missing"),
    ],
    ids=str,
)
def test_invalid_commit_record_is_not_verified(changes, message, whole_run, copied_run):
    folder = copied_run(whole_run)
    record = folder / "commit" / "shard_000000.json"
    if "add" in changes:
        files = json.loads(record.read_text())["files"]
        sharded_runs.change(record, files=files | {changes["add"]: next(iter(files.values()))})
    else:
        sharded_runs.change(record, **changes)
    with pytest.raises(wc.RunDataError, match=rf"shard_000000\.json: {message}"):
        wc.open_run(folder, verify=True)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("commit/shard_000007.json", "shard must be 7, as in its name, got 0"),
        ("data.zarr/series/other/zarr.json", "is not of this run"),
        ("data.zarr/notes.txt", "is not of this run"),
    ],
)
def test_unknown_files_are_not_verified(name, message, whole_run, copied_run):
    folder = copied_run(whole_run)
    (folder / name).parent.mkdir(exist_ok=True)
    shutil.copy(folder / "commit" / "shard_000000.json", folder / name)
    with pytest.raises(wc.RunDataError, match=message):
        wc.open_run(folder, verify=True)


def test_chunks_lost_with_their_entries_are_not_verified_in_a_run_of_an_earlier_version(
    whole_run, copied_run, capsys
):
    folder = copied_run(whole_run)
    made = json.loads((folder / "commit/store.json").read_text())["files"]
    for path in (folder / "data.zarr").rglob("zarr.json"):
        content = json.loads(path.read_text())
        for key in ("groups", "labels"):
            content["attributes"].pop(key, None)
        path.write_text(json.dumps(content))
        own = path.read_bytes()
        made[path.relative_to(folder / "data.zarr").as_posix()] = (len(own), hashlib.sha256(own).hexdigest())
    (folder / "commit/store.json").write_text(json.dumps({"files": made}))
    assert main(["status", str(folder), "--verify"]) == 0
    assert "earlier version" not in capsys.readouterr().out
    for path in (folder / "commit").glob("shard_*.json"):
        content = json.loads(path.read_text())
        del content["empty"]
        path.write_text(json.dumps(content))
    assert main(["status", str(folder), "--verify"]) == 0
    assert "an earlier version" in capsys.readouterr().out
    assert wc.open_run(folder).digest() == wc.open_run(whole_run).digest()


def test_shard_without_record_is_run_again(whole_run, copied_run):
    folder = copied_run(whole_run)
    flip(chunk_of(folder, "series/touch.gap", shard=1))
    (folder / "commit" / "shard_000001.json").unlink()
    wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert sharded_runs.hashes(folder) == sharded_runs.hashes(whole_run)
    wc.open_run(folder, verify=True)


@pytest.mark.parametrize("name", ["params/ball.mass", "outcome/status", "series/touch.gap"])
def test_changed_bit_is_detected_on_read_and_on_verification(name, whole_run, copied_run):
    folder = copied_run(whole_run)
    path = chunk_of(folder, name, shard=1)
    flip(path)
    message = rf"{name}/c/\S+: was changed since it was committed"
    with pytest.raises(wc.RunDataError, match=message):
        wc.open_run(folder, verify=True)
    run = wc.open_run(folder)  # checks sizes only
    with pytest.raises(wc.RunDataError, match=message):
        run.check()
    with pytest.raises(wc.RunDataError, match=message):
        run.digest()
    group, variable = name.split("/")
    values = getattr(run, group)[variable]
    values.sel(env=slice(0, 3)).load()  # the chunk of another shard is intact
    with pytest.raises(wc.RunDataError, match=message):
        values.sel(env=[5]).load()
    # Other readers of the arrays get an error from the checksum of the chunk.
    with pytest.raises((RuntimeError, ValueError), match=r"checksum|decompression"):
        xr.open_zarr(folder / "data.zarr", group=group, consolidated=False)[variable].load()


def test_chunks_missing_after_opening_raise_instead_of_empty_values(whole_run, copied_run):
    folder = copied_run(whole_run)
    run = wc.open_run(folder)
    chunk_of(folder, "series/touch.gap").unlink()
    with pytest.raises(wc.RunDataError, match=r"touch\.gap/c/\S+: is missing, and was committed"):
        run.series["touch.gap"].load()


def test_digest_reads_each_file_once_and_does_not_depend_on_piece_size(whole_run, monkeypatch):
    read = []
    content = CommittedStore._content

    def counted(store, key):
        if store.folder.root == whole_run:  # a failed read of another folder may still be in progress
            read.append(key)
        return content(store, key)

    monkeypatch.setattr(CommittedStore, "_content", counted)
    run = wc.open_run(whole_run)
    digest = run.digest()
    chunks = [
        key for key in read if "/c/" in key and key.split("/")[1] not in ("env", "time", "axis", "component")
    ]
    assert len(chunks) > 10
    assert len(chunks) == len(set(chunks))
    for size in (1, 100, 1000, 4000):
        monkeypatch.setattr("warpcontact.experiment.run.READ_AT_ONCE", size)
        assert run.digest() == digest


def test_missing_checkpoint_is_reported_and_its_shard_restarts(whole_run, part_run, copied_run):
    folder = copied_run(part_run)
    name = sharded_runs.records(folder)[1]["checkpoint"]
    (folder / "checkpoint" / name).unlink()
    with pytest.raises(wc.RunDataError, match=rf"{name}: is missing, and was committed; --resume starts"):
        wc.open_run(folder)
    experiment = wc.Experiment.from_toml(folder / "experiment.toml")
    with pytest.warns(RuntimeWarning, match="shard_000001 starts again: .*No such file"):
        run = experiment.run(folder, device="cpu", resume=True)
    assert sharded_runs.hashes(folder) == sharded_runs.hashes(whole_run)
    assert any("shard_000001 starts again" in line for line in run.summary["warnings"])


@pytest.mark.parametrize(
    "damage",
    [
        "cut off",
        "huge",
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("no arrays", "objects", "of another time")),
    ],
)
def test_damaged_checkpoint_restarts_its_shard(damage, whole_run, part_run, copied_run):
    """Also if the record is of an earlier version without a digest of its content."""
    folder = copied_run(part_run)
    record = folder / "commit" / "shard_000001.json"
    content = json.loads(record.read_text())
    del content["checkpoint_sha256"]
    record.write_text(json.dumps(content))
    path = folder / "checkpoint" / sharded_runs.records(folder)[1]["checkpoint"]
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
        sharded_runs.change(folder / "commit" / "shard_000001.json", steps=MOST, frames=MOST)
    with pytest.warns(
        RuntimeWarning, match=rf"shard_000001 starts again: {path}: (is no complete|does not continue|must be of )"
    ):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert sharded_runs.hashes(folder) == sharded_runs.hashes(whole_run)
    assert sharded_runs.leftovers(folder) == []


def test_changed_checkpoint_is_reported_and_its_shard_restarts(whole_run, part_run, copied_run):
    folder = copied_run(part_run)
    path = folder / "checkpoint" / sharded_runs.records(folder)[1]["checkpoint"]
    arrays, header = checkpoint.read(path)
    name = next(name for name, values in arrays.items() if values.dtype.kind == "f" and values.size)
    checkpoint.write(path, arrays | {name: arrays[name] + 1.0}, header)
    wc.open_run(folder)
    with pytest.raises(wc.RunDataError, match=rf"{path}: was changed since it was committed; --resume starts"):
        wc.open_run(folder, verify=True)
    with pytest.warns(
        RuntimeWarning, match=rf"shard_000001 starts again: {path}: was changed since it was commit"
    ):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert sharded_runs.hashes(folder) == sharded_runs.hashes(whole_run)
    wc.open_run(folder, verify=True)


def test_checkpoint_with_pickled_objects_runs_no_code(tmp_path):
    class Code:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    np.savez(tmp_path / "state.npz", header=np.array([Code()], dtype=object))
    with pytest.raises(wc.CheckpointError, match="is no complete checkpoint: Object arrays cannot be loaded"):
        checkpoint.read(tmp_path / "state.npz")
    assert not (tmp_path / "ran").exists()


def test_checkpoint_with_any_changed_bit_is_refused_or_equal(tmp_path):
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
        # Times and names of files, for example; the values have checksums.
        for name in found.keys() & arrays.keys():
            np.testing.assert_array_equal(found[name], arrays[name])
