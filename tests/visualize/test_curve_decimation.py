"""Decimated curves keep their extremes, ends and gaps, also for stored sensors."""

import itertools

import numpy as np
import pytest
import xarray as xr

from warpcontact.drawing.reduction import evenly, kept_samples
from warpcontact.experiment import curves
from warpcontact.experiment.curves import DISTANCE, MAGNITUDE, read_curves, sample_size


def noisy(size, seed, gaps=0.0):
    """Noise on a slow wave, with one narrow peak, and gaps."""
    random = np.random.default_rng(seed)
    values = np.sin(np.linspace(0.0, 9.0, size)) + 0.01 * random.normal(size=size)
    values[random.integers(size)] = 40.0
    values[random.random(size) < gaps] = random.choice([np.nan, np.inf])
    return values


@pytest.mark.parametrize("size", [5, 200, 201, 1000, 4999])
@pytest.mark.parametrize("gaps", [0.0, 0.02, 0.5])
def test_decimation_keeps_bucket_extremes_ends_and_gaps(size, gaps):
    for seed in range(20):
        values = noisy(size, seed, gaps)
        kept = kept_samples(values, 200)
        assert (np.diff(kept) > 0).all()
        good = np.flatnonzero(np.isfinite(values))
        drawn = kept[np.isfinite(values[kept])]
        assert len(drawn) <= 200
        if size <= 200:
            np.testing.assert_array_equal(kept, np.arange(size))
            continue
        assert {good[0], good[-1]} <= set(drawn)
        for bucket in np.split(np.arange(size), np.linspace(0, size, 99, endpoint=False).astype(int)[1:]):
            own = bucket[np.isfinite(values[bucket])]
            if len(own):
                found = values[drawn[np.isin(drawn, own)]]
                assert (found.min(), found.max()) == (values[own].min(), values[own].max())
        # Two neighbors are joined by a line only if all samples between them are finite.
        whole = np.isfinite(values)
        pairs = [(a, b) for a, b in itertools.pairwise(kept) if whole[a] and whole[b]]
        assert all(whole[a : b + 1].all() for a, b in pairs)


def test_decimation_of_loops_keeps_extremes_of_both_coordinates():
    angle = np.linspace(0.0, 40.0 * np.pi, 10_001)
    loop = np.stack([np.cos(angle), np.sin(angle + 0.3) * np.exp(-0.01 * angle)], axis=1)
    loop[5000] = 7.0, -9.0
    kept = kept_samples(loop, 402)
    assert len(kept) <= 402
    np.testing.assert_array_equal(loop[kept].max(axis=0), loop.max(axis=0))
    np.testing.assert_array_equal(loop[kept].min(axis=0), loop.min(axis=0))
    assert 5000 in kept


def test_decimation_buckets_can_have_equal_length_in_another_coordinate():
    values, along = np.zeros(1000), np.append(np.arange(100.0), np.full(900, 99.0))
    values[:100] = np.random.default_rng(0).normal(size=100)
    values[950] = 5.0
    kept = kept_samples(values, 42, along)
    assert {0, 950, 999} <= set(kept)
    assert len(kept) <= 42
    starts = np.append(np.linspace(0.0, 99.0, 20, endpoint=False), 1e9)
    for first, stop in itertools.pairwise(starts):
        own = np.flatnonzero((along >= first) & (along < stop))
        assert {own[values[own].argmin()], own[values[own].argmax()]} <= set(kept)
    assert kept_samples(values, 42, np.zeros(1000)).tolist() == sorted({0, values.argmin(), 950, 999})


def test_decimation_of_curve_without_finite_samples_is_empty():
    assert not np.isfinite(np.full(500, np.nan)[kept_samples(np.full(500, np.nan), 100)]).any()
    assert kept_samples(np.zeros(0), 100).size == 0


def test_evenly_spaced_indices_include_both_ends():
    assert evenly(3, 10).tolist() == [0, 1, 2]
    assert evenly(1000, 4).tolist() == [0, 333, 666, 999]


@pytest.fixture
def stored():
    """A force at three points in five environments, of which environment 12 is frozen."""
    random = np.random.default_rng(1)
    values = random.random((50, 5, 3))
    values[20, 3] = 100.0
    values[31, 2] = 1e9
    coords = {"time": 0.1 * np.arange(50), "env": np.arange(10, 15)}
    return xr.DataArray(values, coords, ("time", "env", "item"), "feet.normal_force", {"units": "N"})


@pytest.mark.parametrize("searched", [curves.MAX_SEARCHED, 0])
def test_curves_of_sets_are_read_in_blocks_with_extremes(stored, searched, monkeypatch):
    monkeypatch.setattr(curves, "BLOCK", 100)
    monkeypatch.setattr(curves, "MAX_SEARCHED", searched)
    rows = np.array([1, 3])
    found = read_curves(stored, rows, stored["env"].values == 12)
    np.testing.assert_allclose(found.values, stored.values[:, rows].sum(axis=2))
    assert (found.reduction, found.items, found.envs.tolist()) == ("sum of", 3, [11, 13])
    assert (found.largest.value, found.largest.time, found.largest.env) == (300.0, pytest.approx(2.0), 13)
    counted = stored.values.sum(axis=2)[:, [0, 1, 3, 4] if searched else rows]
    assert found.smallest.value == pytest.approx(counted.min())
    assert found.searched == counted.shape[1]


def test_gap_curve_of_a_set_is_the_smallest_finite_item(stored):
    gap = stored.copy(data=np.where(stored == 100.0, np.nan, -stored)).rename("feet.gap")
    found = read_curves(gap, np.arange(5))
    assert np.isnan(found.values[20, 3])
    gap[20, 3, 1] = -0.5
    assert read_curves(gap, np.arange(5)).values[20, 3] == -0.5


def test_vector_curves_reduce_to_component_magnitude_or_distance(stored, monkeypatch):
    monkeypatch.setattr(curves, "BLOCK", 100)
    position = xr.DataArray(
        stored.values, {**stored.coords, "axis": ["x", "y", "z"]}, ("time", "env", "axis"), "ball.position"
    )
    rows = np.array([0, 4])
    own = stored.values[:, rows]
    np.testing.assert_array_equal(read_curves(position, rows, component="z").values, own[..., 2])
    lengths = np.linalg.norm(own, axis=2)
    np.testing.assert_allclose(read_curves(position, rows, component=MAGNITUDE).values, lengths)
    way = np.linalg.norm(own - own[0], axis=2)
    np.testing.assert_allclose(read_curves(position, rows, component=DISTANCE).values, way)


@pytest.mark.parametrize(
    ("records", "envs", "items", "size"),
    [
        (100, 50, 1, 50),
        (100, 10**6, 1, 4096),
        (10_000, 10**6, 1, 419),
        (10**6, 10**6, 1, 64),
        (10**6, 100, 10**4, 1),
    ],
)
def test_number_of_curves_decreases_with_number_of_records(records, envs, items, size):
    array = xr.DataArray(np.broadcast_to(np.zeros(()), (records, envs, items)), dims=("time", "env", "item"))
    assert min(sample_size(array), envs) == size
