"""Chunks that a shard writes: as many at once as its threads, each with one writer, and nothing beside its own."""

import contextlib
import hashlib
import threading
import time

import numpy as np
import pytest
import xarray as xr
import zarr

from warpcontact.experiment import store

ENVS, FRAMES = 96, 5


@pytest.fixture
def made(tmp_path, monkeypatch):
    """The folder of a run of three shards of 32 environments, whose chunks have 4 of these; and their values."""
    monkeypatch.setattr(store, "CHUNK", 4 * 8 * FRAMES)
    values = np.random.default_rng(3).normal(size=(FRAMES, ENVS))
    env = xr.DataArray(np.arange(32), dims="env")
    template = xr.Dataset({"gap": (("time", "env"), values[:, :32])}, coords={"env": env})
    (tmp_path / store.COMMITS).mkdir()
    store.create(tmp_path / store.DATA, {"series": template}, ENVS, np.arange(FRAMES) * 0.1, FRAMES, {})
    return tmp_path, values


def write(folder, values, shard, threads=None):
    own = values[:, shard.first : shard.stop]
    # A last shard is smaller than what runs.
    own = np.pad(own, ((0, 0), (0, 32 - shard.envs)), constant_values=7.0)
    with store.Ledger(folder).staging(shard, threads) as staging:
        staging.write("series", xr.Dataset({"gap": (("time", "env"), own)}))
        staging.wait()
    return staging


def series(values):
    return xr.Dataset({"gap": (("time", "env"), values[:, :32])})


@pytest.mark.parametrize(("threads", "most"), [(1, 1), (2, 2), (64, store.WRITERS), (None, store.WRITERS)])
def test_no_more_chunks_are_in_memory_than_the_plan_counts(threads, most, made, monkeypatch):
    folder, values = made
    lock, busy = threading.Lock(), []
    count = 0
    put = store._put

    def counted(piece):
        nonlocal count
        with lock:
            count += 1
            busy.append(count)
        # Long enough for others to begin, if they can.
        time.sleep(0.05)
        put(piece)
        with lock:
            count -= 1

    monkeypatch.setattr(store, "_put", counted)
    monkeypatch.setattr(store, "available_threads", lambda: 64)
    write(folder, values, store.Shard(0, 0, 32), threads)
    assert len(busy) == 8  # 32 environments in chunks of 4
    assert max(busy) == most


@pytest.mark.parametrize("shard", [store.Shard(1, 32, 64), store.Shard(2, 64, 91)], ids=str)
def test_a_shard_writes_its_environments_and_no_others(shard, made):
    folder, values = made
    staging = write(folder, values, shard)
    assert len(staging.written) == -(-shard.envs // 4)
    path = folder / store.STAGING / shard.name / "series" / "gap"
    found = zarr.open_array(path, mode="r")[:]
    np.testing.assert_array_equal(found[:, shard.first : shard.stop], values[:, shard.first : shard.stop])
    assert np.isnan(np.delete(found, np.s_[shard.first : shard.stop], axis=1)).all()


def test_chunks_that_shards_share_have_one_writer_in_each(made, monkeypatch):
    """A shard that begins within a chunk cuts at its ends all the same."""
    folder, values = made
    regions = []
    put = store._put
    monkeypatch.setattr(store, "_put", lambda piece: (regions.append(piece[1][1]), put(piece)))
    write(folder, values, store.Shard(1, 38, 49), 1)
    assert [(own.start, own.stop) for own in regions] == [(38, 40), (40, 44), (44, 48), (48, 49)]


def test_a_block_is_written_while_its_writer_goes_on(made, monkeypatch):
    folder, values = made
    begun, go_on = threading.Event(), threading.Event()
    put = store._put

    def held(piece):
        begun.set()
        assert go_on.wait(60)
        put(piece)

    monkeypatch.setattr(store, "_put", held)
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


@pytest.mark.parametrize("asks", ["write", "wait"])
def test_who_comes_next_hears_that_a_block_could_not_be_written(asks, made, monkeypatch):
    folder, values = made

    def full(piece):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "_put", full)
    with store.Ledger(folder).staging(store.Shard(0, 0, 32)) as staging:
        staging.write("series", series(values), 0)
        with pytest.raises(OSError, match="No space left"):
            staging.wait() if asks == "wait" else staging.write("series", series(values), FRAMES)
        assert staging.written == {}
        # Said once.
        staging.wait()


def test_nobody_writes_any_more_when_a_shard_is_left(made, monkeypatch):
    folder, values = made
    put, ended = store._put, []

    def slow(piece):
        time.sleep(0.05)
        put(piece)
        ended.append(piece)

    monkeypatch.setattr(store, "_put", slow)
    with (
        contextlib.suppress(KeyboardInterrupt),
        store.Ledger(folder).staging(store.Shard(0, 0, 32), 1) as staging,
    ):
        staging.write("series", series(values), 0)
        raise KeyboardInterrupt
    assert len(ended) == 8


def test_an_error_beside_another_is_told_with_it(made, monkeypatch):
    folder, values = made

    def full(piece):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "_put", full)
    other = KeyboardInterrupt()
    with contextlib.suppress(KeyboardInterrupt), store.Ledger(folder).staging(store.Shard(0, 0, 32)) as staging:
        staging.write("series", series(values), 0)
        raise other
    (note,) = other.__notes__
    assert "No space left" in note
