"""Folders of runs in which something is missing, cut off or changed: it is named, and what is good is read."""

import json
import os
import shutil

import numpy as np
import pytest
import runs
import xarray as xr

import warpcontact as wc
from warpcontact import checkpoint
from warpcontact.experiment.committed import CommittedStore

MOST = 2**63 - 1


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


def chunk_of(folder, name, shard=0):
    files = runs.records(folder)[shard]["files"]
    return folder / "data.zarr" / next(file for file in sorted(files) if file.startswith(name))


def test_missing_parts_are_named(whole_run, copied_run):
    folder = copied_run(whole_run)
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


def test_experiment_that_is_cut_off_is_named(whole_run, copied_run):
    folder = copied_run(whole_run)
    path = folder / "experiment.toml"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(wc.ExperimentError, match=r"experiment\.toml: cannot be read|envs must be None"):
        wc.open_run(folder)


def test_chunks_that_are_missing_or_cut_off_are_named(whole_run, copied_run):
    folder = copied_run(whole_run)
    path = chunk_of(folder, "series/touch.gap")
    content = path.read_bytes()
    path.write_bytes(content[:-1])
    message = f"has {len(content) - 1} bytes, and {len(content)} were committed"
    with pytest.raises(wc.StoreError, match=rf"series/touch\.gap/c/\S+: {message}"):
        wc.open_run(folder)
    path.unlink()
    with pytest.raises(wc.StoreError, match=r"series/touch\.gap/c/\S+: is missing, and was committed"):
        wc.open_run(folder)


def test_a_shard_whose_record_was_removed_is_run_again(whole_run, copied_run):
    folder = copied_run(whole_run)
    flip(chunk_of(folder, "series/touch.gap", shard=1))
    (folder / "commit" / "shard_000001.json").unlink()
    wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole_run)
    wc.open_run(folder, verify=True)


@pytest.mark.parametrize("name", ["params/ball.mass", "outcome/status", "series/touch.gap"])
def test_a_changed_bit_is_found_when_it_is_read_and_when_all_is_verified(name, whole_run, copied_run):
    folder = copied_run(whole_run)
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
    with pytest.raises((RuntimeError, ValueError), match=r"checksum|decompression"):
        xr.open_zarr(folder / "data.zarr", group=group, consolidated=False)[variable].load()


def test_chunks_that_vanish_after_opening_are_no_empty_values(whole_run, copied_run):
    folder = copied_run(whole_run)
    run = wc.open_run(folder)
    chunk_of(folder, "series/touch.gap").unlink()
    with pytest.raises(wc.StoreError, match=r"touch\.gap/c/\S+: is missing, and was committed"):
        run.series["touch.gap"].load()


def test_a_digest_reads_each_file_once_and_is_the_same_in_smaller_pieces(whole_run, monkeypatch):
    read = []
    content = CommittedStore._content

    def counted(store, key):
        if store.folder.root == whole_run:  # a read of another folder that failed may still be in progress
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


def test_a_missing_checkpoint_is_named_and_its_shard_begins_anew(whole_run, part_run, copied_run):
    folder = copied_run(part_run)
    name = runs.records(folder)[1]["checkpoint"]
    (folder / "checkpoint" / name).unlink()
    with pytest.raises(wc.StoreError, match=rf"{name}: is missing, and was committed; --resume lets"):
        wc.open_run(folder)
    experiment = wc.Experiment.from_toml(folder / "experiment.toml")
    with pytest.warns(RuntimeWarning, match="shard_000001 begins anew: .*No such file"):
        run = experiment.run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole_run)
    assert any("shard_000001 begins anew" in line for line in run.summary["warnings"])


@pytest.mark.parametrize(
    "damage",
    [
        "cut off",
        "huge",
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("no arrays", "objects", "of another time")),
    ],
)
def test_a_damaged_checkpoint_lets_its_shard_begin_anew(damage, whole_run, part_run, copied_run):
    """Also where the record is of an earlier version, which told nothing of its content."""
    folder = copied_run(part_run)
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
        runs.change(folder / "commit" / "shard_000001.json", steps=MOST, frames=MOST)
    with pytest.warns(
        RuntimeWarning, match=rf"shard_000001 begins anew: {path}: (is no whole|does not go on|is of )"
    ):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole_run)
    assert runs.leftovers(folder) == []


def test_a_checkpoint_of_another_content_is_named_and_its_shard_begins_anew(whole_run, part_run, copied_run):
    folder = copied_run(part_run)
    path = folder / "checkpoint" / runs.records(folder)[1]["checkpoint"]
    arrays, header = checkpoint.read(path)
    name = next(name for name, values in arrays.items() if values.dtype.kind == "f" and values.size)
    checkpoint.write(path, arrays | {name: arrays[name] + 1.0}, header)
    wc.open_run(folder)
    with pytest.raises(wc.StoreError, match=rf"{path}: was changed since it was committed; --resume lets"):
        wc.open_run(folder, verify=True)
    with pytest.warns(RuntimeWarning, match=rf"shard_000001 begins anew: {path}: was changed since it was commit"):
        wc.Experiment.from_toml(folder / "experiment.toml").run(folder, device="cpu", resume=True)
    assert runs.hashes(folder) == runs.hashes(whole_run)
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
