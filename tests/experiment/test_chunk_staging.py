"""Staging of chunks of a shard: as many in parallel as threads, one writer each, only chunks of that shard."""

import contextlib
import hashlib
import os
import shutil
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

from warpcontact.experiment import store
from warpcontact.experiment.chunks import Chunk, ChunkEncoder, compressors
from warpcontact.experiment.records import RunDataError, RunExtent
from warpcontact.files.run_folder import RunPath

ENVS, FRAMES = 96, 5


@pytest.fixture
def staged_run(tmp_path, monkeypatch):
    """The folder of a run of three shards of 32 environments, with chunks of 4 environments, and the values."""
    monkeypatch.setattr(store, "CHUNK", 4 * 8 * FRAMES)
    values = np.random.default_rng(3).normal(size=(FRAMES, ENVS))
    env = xr.DataArray(np.arange(32), dims="env")
    material = xr.Dataset({"gap": (("time", "env"), values[:, :32])}, coords={"env": env})
    (tmp_path / store.COMMITS).mkdir()
    store.create(tmp_path, {"series": material}, ENVS, np.arange(FRAMES) * 0.1, FRAMES, {})
    return tmp_path, values


def write(folder, values, shard, threads=None):
    own = values[:, shard.first : shard.stop]
    # The last shard can be smaller than the arrays.
    own = np.pad(own, ((0, 0), (0, 32 - shard.envs)), constant_values=7.0)
    with store.Ledger(folder).staging(shard, threads) as staging:
        staging.write("series", {"gap": own})
        staging.wait()
    return staging


def series(values):
    return {"gap": values[:, :32]}


@pytest.mark.parametrize(("threads", "most"), [(1, 1), (2, 2), (64, store.WRITERS), (None, store.WRITERS)])
def test_chunks_in_memory_do_not_exceed_the_plan(threads, most, staged_run, monkeypatch):
    folder, values = staged_run
    lock, busy = threading.Lock(), []
    count = 0
    write_chunk = Chunk.write

    def counted(chunk, path):
        nonlocal count
        with lock:
            count += 1
            busy.append(count)
        # Long enough for other writers to start, if they can.
        time.sleep(0.05)
        entry = write_chunk(chunk, path)
        with lock:
            count -= 1
        return entry

    monkeypatch.setattr(Chunk, "write", counted)
    monkeypatch.setattr(store, "available_threads", lambda: 64)
    write(folder, values, store.Shard(0, 0, 32), threads)
    assert len(busy) == 8  # 32 environments in chunks of 4
    assert max(busy) == most


@pytest.mark.parametrize("shard", [store.Shard(1, 32, 64), store.Shard(2, 64, 91)], ids=str)
def test_shard_writes_its_own_environments_only(shard, staged_run):
    folder, values = staged_run
    staging = write(folder, values, shard)
    assert len(staging.written) == -(-shard.envs // 4)
    path = folder / store.STAGING / shard.name / "series" / "gap"
    shutil.copyfile(folder / store.DATA / "series" / "gap" / "zarr.json", path / "zarr.json")
    found = zarr.open_array(path, mode="r")[:]
    np.testing.assert_array_equal(found[:, shard.first : shard.stop], values[:, shard.first : shard.stop])
    assert np.isnan(np.delete(found, np.s_[shard.first : shard.stop], axis=1)).all()


@pytest.mark.parametrize(
    ("dims", "dtype"),
    [
        (("time", "env"), "f4"),
        (("time", "env", "axis"), "f8"),
        (("time", "env", "item"), "f4"),
        (("env",), "f8"),
        (("env", "item", "axis"), "f8"),
        (("time", "env"), "i4"),
        (("env", "event"), "i8"),
        (("env",), "?"),
    ],
    ids=str,
)
def test_chunks_are_bitwise_identical_to_those_of_zarr(dims, dtype, tmp_path):
    """Includes incomplete chunks at the end; empty chunks are not written."""
    sizes = {"time": 10, "env": 22, "axis": 3, "item": 5, "event": 2}
    pieces = {**sizes, "time": 4, "env": 8}
    values = (100 * np.random.default_rng(4).normal(size=[sizes[dim] for dim in dims])).round(1).astype(dtype)
    values[(slice(0, 4),) * (dims[0] == "time") + (slice(8, 16),)] = store.empty_value(values.dtype)
    material = xr.DataArray(values, dims=dims)
    group = zarr.open_group(tmp_path, mode="w", zarr_format=3)
    array = group.create_array(
        "x",
        shape=values.shape,
        chunks=tuple(pieces[dim] for dim in dims),
        dtype=values.dtype,
        fill_value=store.empty_value(values.dtype),
        dimension_names=dims,
        compressors=compressors(material),
    )
    chunks = ChunkEncoder(array)
    frames = range(0, 10, 4) if "time" in dims else [0]
    own = [
        chunk
        for first in frames
        for chunk in chunks.split(values[first : first + 4] if "time" in dims else values, 0, 22, first)
    ]
    array[:] = values
    files = {path.relative_to(tmp_path / "x").as_posix(): path for path in (tmp_path / "x" / "c").rglob("*")}
    assert [chunk.name for chunk in own] == sorted(name for name, path in files.items() if path.is_file())
    for chunk in own:
        size, sha = chunk.write(RunPath(tmp_path) / "own")
        content = (tmp_path / "own").read_bytes()
        assert content == files[chunk.name].read_bytes()
        assert (size, sha) == (len(content), hashlib.sha256(content).hexdigest())


def test_chunks_without_values_have_no_file_and_are_listed(staged_run):
    folder, values = staged_run
    values = values.copy()
    values[:, 4:8] = np.nan
    staging = write(folder, values, store.Shard(0, 0, 32))
    assert staging.empty == {"series/gap/c/0/1"}
    assert staging.written.keys() == {f"series/gap/c/0/{k}" for k in (0, 2, 3, 4, 5, 6, 7)}


def test_labels_of_a_single_environment_have_a_file(tmp_path):
    material = xr.Dataset({"x": ("env", [1.0])}, coords={"env": [0]})
    (tmp_path / store.COMMITS).mkdir()
    store.create(tmp_path, {"params": material}, 1, np.zeros(0), 1, {})
    assert (tmp_path / store.DATA / "params" / "env" / "c" / "0").is_file()
    store.Ledger(tmp_path).check(RunExtent(envs=1, shard=1, steps=1), contents=True)


def test_arrays_with_another_compressor_are_refused(tmp_path):
    group = zarr.open_group(tmp_path, mode="w", zarr_format=3)
    array = group.create_array("x", shape=(4,), chunks=(4,), dtype="f4", compressors=zarr.codecs.GzipCodec())
    with pytest.raises(RunDataError, match="gzip"):
        ChunkEncoder(array)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="this system does not tell what is waited for")
def test_files_to_commit_are_synchronized_to_disk(staged_run, monkeypatch):
    folder, values = staged_run
    synced = set()
    usual = os.fsync

    def noted(descriptor):
        usual(descriptor)
        synced.add(Path(os.readlink(f"/proc/self/fd/{descriptor}")))

    monkeypatch.setattr(os, "fsync", noted)
    with store.Ledger(folder).staging(store.Shard(0, 0, 32)) as staging:
        staging.write("series", series(values))
        staging.wait()
        root = (folder / store.STAGING / "shard_000000").resolve()
        files = {root / name for name in staging.written}
        folders = {one for file in files for one in file.parents if one.is_relative_to(root.parent)}
        assert len(files) == 8
        assert files | folders <= synced


def test_block_is_written_concurrently_with_the_next(staged_run, monkeypatch):
    folder, values = staged_run
    begun, go_on = threading.Event(), threading.Event()
    write_chunk = Chunk.write

    def held(chunk, path):
        begun.set()
        assert go_on.wait(60)
        return write_chunk(chunk, path)

    monkeypatch.setattr(Chunk, "write", held)
    with store.Ledger(folder).staging(store.Shard(0, 0, 32)) as staging:
        staging.write("series", series(values), 0)
        assert begun.wait(60)
        assert staging.written == {}
        go_on.set()
        staging.wait()
        assert len(staging.written) == 8
    for name, (size, sha) in staging.written.items():
        content = (folder / store.STAGING / "shard_000000" / name).read_bytes()
        assert (len(content), hashlib.sha256(content).hexdigest()) == (size, sha)


@pytest.mark.parametrize("call", ["write", "wait"])
def test_failed_block_write_raises_at_the_next_call(call, staged_run, monkeypatch):
    folder, values = staged_run

    def full(chunk, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Chunk, "write", full)
    with store.Ledger(folder).staging(store.Shard(0, 0, 32)) as staging:
        staging.write("series", series(values), 0)
        with pytest.raises(OSError, match="No space left"):
            staging.wait() if call == "wait" else staging.write("series", series(values), FRAMES)
        assert staging.written == {}
        # The error is raised once.
        staging.wait()


def test_no_write_is_running_after_a_shard_is_closed(staged_run, monkeypatch):
    folder, values = staged_run
    write_chunk, ended = Chunk.write, []

    def slow(chunk, path):
        time.sleep(0.05)
        entry = write_chunk(chunk, path)
        ended.append(chunk)
        return entry

    monkeypatch.setattr(Chunk, "write", slow)
    with (
        contextlib.suppress(KeyboardInterrupt),
        store.Ledger(folder).staging(store.Shard(0, 0, 32), 1) as staging,
    ):
        staging.write("series", series(values), 0)
        raise KeyboardInterrupt
    assert len(ended) == 8


def test_write_error_is_added_to_another_exception(staged_run, monkeypatch):
    folder, values = staged_run

    def full(chunk, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Chunk, "write", full)
    other = KeyboardInterrupt()
    with contextlib.suppress(KeyboardInterrupt), store.Ledger(folder).staging(store.Shard(0, 0, 32)) as staging:
        staging.write("series", series(values), 0)
        raise other
    (note,) = other.__notes__
    assert "No space left" in note
