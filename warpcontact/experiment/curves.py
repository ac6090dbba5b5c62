"""Data of pictures and reports: recorded sensors as one curve per environment, with extremes, and bins of histograms."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.model.flags import words_of
from warpcontact.validation.checks import Array

BINS = 60
# Largest span of integer values with one bin each.
MAX_INTEGER_BINS = 40

# Largest number of environments for quantiles: more would not change them visibly.
SAMPLE_SIZE = 4096
# Largest number of returned values of a sensor, unless that is fewer than MIN_SAMPLES environments, and of values
# read for them.
VALUES = 2**22
MIN_SAMPLES = 64
MAX_READ = 2**29
# Number of values in one block.
BLOCK = 2**22
# For larger series, extreme values are those of the returned environments only [bytes].
MAX_SEARCHED = 256 * 2**20

#: Additional components of a vector: its length, and the length of its change since the first frame.
MAGNITUDE = "magnitude"
DISTANCE = "distance"

# Reduction of the items of a set, by the last part of the name of the sensor.
_SMALLEST = ("gap", "distance", "minimum_distance")
_SUMS = ("normal_force", "impulse", "kinetic_energy", "tension_a", "tension_b")
_LARGEST = ("penetration", "max_penetration")
# Sensors that are not drawn.
_NOT_DRAWN = ("orientation", "point", "normal")


def has_integer_bins(values: NDArray[np.float64]) -> bool:
    """Whether finite values are integers that span few enough numbers for one bin each."""
    # Beyond 2⁵¹, bin edges between integers cannot be represented.
    small = np.abs(values).max() < 2.0**51
    return bool(small and (values == np.round(values)).all() and np.ptp(values) <= MAX_INTEGER_BINS)


def bin_edges(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the bin edges of a histogram of finite values."""
    low, high = float(values.min()), float(values.max())
    if has_integer_bins(values):
        return np.arange(low, high + 2.0) - 0.5
    count = int(np.clip(np.sqrt(len(values)), 10, BINS))
    # Values that differ only by rounding errors are in one bin.
    margin = 1.0e-6 * max(abs(low), abs(high))
    if high - low <= margin:
        low, high, count = low - margin, high + margin, 1
    return np.linspace(low, high, count + 1)


@dataclass(frozen=True)
class Extreme:
    """An extreme value of a sensor.

    Attributes:
        value: The value.
        time: Time of the first frame with this value [s].
        env: Number of the environment.
    """

    value: float
    time: float
    env: int


@dataclass(frozen=True, eq=False)
class SensorCurves:
    """Curves of a sensor.

    Attributes:
        name: Name of the sensor.
        reduction: Reduction of the items of a set, such as ``"sum of"``; empty: no reduction.
        items: Number of the items.
        unit: Unit of the values.
        seconds: Times of the frames [s].
        envs: Numbers of the environments.
        values: Values (time, env).
        smallest: Smallest finite value over all frames; ``None``: no value is finite.
        largest: Largest finite value over all frames; ``None``: no value is finite.
        searched: Number of environments that were searched for extreme values.
    """

    name: str
    reduction: str
    items: int
    unit: str
    seconds: Array
    envs: NDArray[np.int64]
    values: Array
    smallest: Extreme | None
    largest: Extreme | None
    searched: int


def is_drawable(name: str, array: xr.DataArray) -> bool:
    """Whether a series has numbers over time that can be drawn as curves, for vectors by component."""
    return (
        array.dims[:2] == ("time", "env")
        and name.rpartition(".")[2] not in _NOT_DRAWN
        and not words_of(array)
        and array.dtype.kind in "iuf"
        and not {"row", "component"} & set(array.dims)
    )


def sample_size(array: xr.DataArray) -> int:
    """Returns the number of environments of a series (time, env, …) whose curves are read."""
    records, values_per_record = array.sizes["time"], array.size // max(1, array.sizes["env"])
    return max(
        1, min(SAMPLE_SIZE, max(MIN_SAMPLES, VALUES // max(1, records)), MAX_READ // max(1, values_per_record))
    )


def read_curves(
    array: xr.DataArray,
    rows: NDArray[np.intp],
    without: NDArray[np.bool_] | None = None,
    component: str | None = None,
) -> SensorCurves:
    """Reads curves of some environments, and extreme values of all environments if the series is small enough.

    Args:
        array: The series (time, env, …), named after its sensor.
        rows: Indices of the environments, in ascending order.
        without: Environments that are excluded from extreme values (env,).
        component: Component of a vector: ``"x"``, ``"y"``, ``"z"``, ``MAGNITUDE`` or ``DISTANCE``.
    """
    if component in ("x", "y", "z"):
        array = array.sel(axis=component, drop=True)
    axes = ["axis"] if "axis" in array.dims else []
    items = [str(dim) for dim in array.dims if dim not in ("time", "env", *axes)]
    seconds, envs = array["time"].values.astype(np.float64), np.asarray(array["env"].values)
    ignored = np.zeros(len(envs), dtype=bool) if without is None else without
    read_all = array.nbytes <= MAX_SEARCHED
    read = (array if read_all else array.isel(env=rows)).transpose("time", "env", *items, *axes)
    numbers = envs if read_all else envs[rows]
    extremes = _Extremes(seconds, numbers, ignored if read_all else ignored[rows])
    sample_rows = rows if read_all else np.arange(len(rows))
    values = np.empty((len(seconds), len(rows)))
    reduction, (step, width) = "", _block_shape(read)
    for block_envs in _blocks(len(numbers), width):
        origin: Array | None = None
        first, last = np.searchsorted(sample_rows, (block_envs.start, block_envs.stop))
        for times in _blocks(len(seconds), step):
            block = read.isel(time=times, env=block_envs).values.astype(np.float64)
            with np.errstate(invalid="ignore"):
                if axes:
                    origin = block[:1] if origin is None and component == DISTANCE else origin
                    block = np.linalg.norm(block if origin is None else block - origin, axis=-1)
                if items:
                    block, reduction = _reduce_items(block.reshape(*block.shape[:2], -1), str(array.name))
            extremes.search(block, times.start, block_envs.start)
            values[times, first:last] = block[:, sample_rows[first:last] - block_envs.start]
    return SensorCurves(
        name=str(array.name),
        reduction=reduction,
        items=int(np.prod([array.sizes[dim] for dim in items], initial=1)),
        unit=str(array.attrs.get("units", "-")),
        seconds=seconds,
        envs=envs[rows],
        values=values,
        smallest=extremes.smallest,
        largest=extremes.largest,
        searched=int((~extremes.ignored).sum()),
    )


@dataclass(eq=False)
class _Extremes:
    """Block-wise search for extreme values."""

    seconds: Array
    envs: NDArray[np.int64]
    ignored: NDArray[np.bool_]
    smallest: Extreme | None = field(default=None, init=False)
    largest: Extreme | None = field(default=None, init=False)

    def search(self, values: Array, record: int, row: int) -> None:
        """Searches values (time, env) that start at frame ``record`` and environment index ``row``."""
        block_envs = slice(row, row + values.shape[1])
        if self.ignored[block_envs].any() or not (np.isfinite(values.min()) and np.isfinite(values.max())):
            good = np.isfinite(values) & ~self.ignored[block_envs]
            if not good.any():
                return
            low, high = np.where(good, values, np.inf), np.where(good, values, -np.inf)
        else:
            low = high = values
        lowest = self._extreme_at(low, int(low.argmin()), record, row)
        highest = self._extreme_at(high, int(high.argmax()), record, row)
        self.smallest = min(self.smallest or lowest, lowest, key=lambda one: (one.value, one.time, one.env))
        self.largest = min(self.largest or highest, highest, key=lambda one: (-one.value, one.time, one.env))

    def _extreme_at(self, values: Array, index: int, record: int, row: int) -> Extreme:
        time, env = divmod(index, values.shape[1])
        return Extreme(float(values[time, env]), float(self.seconds[record + time]), int(self.envs[row + env]))


def _blocks(size: int, step: int) -> Iterator[slice]:
    return (slice(first, min(first + step, size)) for first in range(0, size, step))


def _block_shape(array: xr.DataArray) -> tuple[int, int]:
    """Returns the number of frames and environments of a block, of whole chunks of a store if these fit."""
    chunks = array.encoding.get("preferred_chunks", {})
    records, envs = array.sizes["time"], array.sizes["env"]
    values_per_record = max(1, array.size // max(1, records * envs))

    def read_all(step: int, dim: str) -> int:
        chunk = int(chunks.get(dim, 1))
        return max(1, step // chunk * chunk or step)

    if BLOCK // (values_per_record * max(1, envs)) >= chunks.get("time", 1):
        return read_all(BLOCK // (values_per_record * max(1, envs)), "time"), max(1, envs)
    time = min(int(chunks.get("time", 1)), max(1, records), max(1, BLOCK // values_per_record))
    return time, read_all(BLOCK // (values_per_record * time), "env")


def _reduce_items(values: Array, name: str) -> tuple[Array, str]:
    """Returns one number (time, env) for the items of a set (time, env, item), and the name of the reduction."""
    last = name.rpartition(".")[2]
    if last in _SMALLEST:
        return np.fmin.reduce(values, axis=2), "smallest"
    if last in _LARGEST:
        return np.fmax.reduce(values, axis=2), "largest"
    if last in _SUMS:
        return values.sum(axis=2), "sum of"
    return values.mean(axis=2), "mean"
