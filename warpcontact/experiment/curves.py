"""Recorded sensors as one curve for each environment, with their extremes, as pictures and reports draw them.

Items of a set are reduced to one number: the smallest gap, the largest penetration, the sum of forces, otherwise
the mean. Series are read in blocks of time, so that memory is bounded by the number of values that are returned.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.flags import words_of

# Quantiles of more environments than this look the same and take longer.
SAMPLE = 4096
# Values of one sensor that are returned, unless these are fewer environments, and that are read for them.
VALUES = 2**22
FEWEST = 64
READ = 2**29
# Values that are read in one block.
BLOCK = 2**22
# In larger series, extremes are those of the environments that are returned [bytes].
SEARCHED = 256 * 2**20

#: Further components of a vector: its length, and the length of its change since the first record.
MAGNITUDE = "magnitude"
DISTANCE = "distance"

# Reduction of the items of a set, by the last word of the name of the sensor.
_SMALLEST = ("gap", "distance", "minimum_distance")
_SUMS = ("normal_force", "impulse", "kinetic_energy", "tension_a", "tension_b")
_LARGEST = ("penetration", "max_penetration")
# Sensors without a readable curve.
_LEFT_OUT = ("orientation", "point", "normal")


@dataclass(frozen=True)
class Extreme:
    """An extreme value of a sensor.

    Attributes:
        value: The value.
        time: Time of its first record [s].
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
        reduction: Reduction of the items of a set, such as ``"sum of"``; empty: there is one value.
        items: Number of the items.
        unit: Unit of the values.
        seconds: Time of each record [s].
        envs: Numbers of the environments.
        values: (time, env).
        smallest: The smallest finite value over all records; ``None``: there is none.
        largest: Likewise the largest.
        searched: Number of environments whose records were searched for them.
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


def can_be_drawn(name: str, array: xr.DataArray) -> bool:
    """Whether a series has numbers over time that can be drawn as curves; vectors by their components."""
    return (
        array.dims[:2] == ("time", "env")
        and name.rpartition(".")[2] not in _LEFT_OUT
        and not words_of(array)
        and array.dtype.kind in "iuf"
        and not {"row", "component"} & set(array.dims)
    )


def sample_size(array: xr.DataArray) -> int:
    """Returns the number of environments of a series (time, env, …) of which curves are read."""
    records, each = array.sizes["time"], array.size // max(1, array.sizes["env"])
    return max(1, min(SAMPLE, max(FEWEST, VALUES // max(1, records)), READ // max(1, each)))


def read_curves(
    array: xr.DataArray,
    rows: NDArray[np.intp],
    without: NDArray[np.bool_] | None = None,
    component: str | None = None,
) -> SensorCurves:
    """Reads curves of some environments, and searches all environments for extremes if the series is small enough.

    Args:
        array: The series (time, env, …), named after its sensor.
        rows: Indices of the environments, in ascending order.
        without: Environments that are not searched for extremes, (env,).
        component: Component of a vector: ``"x"``, ``"y"``, ``"z"``, ``MAGNITUDE`` or ``DISTANCE``.
    """
    if component in ("x", "y", "z"):
        array = array.sel(axis=component, drop=True)
    axes = ["axis"] if "axis" in array.dims else []
    items = [str(dim) for dim in array.dims if dim not in ("time", "env", *axes)]
    seconds, envs = array["time"].values.astype(np.float64), np.asarray(array["env"].values)
    ignored = np.zeros(len(envs), dtype=bool) if without is None else without
    whole = array.nbytes <= SEARCHED
    read = (array if whole else array.isel(env=rows)).transpose("time", "env", *items, *axes)
    numbers = envs if whole else envs[rows]
    extremes = _Extremes(seconds, numbers, ignored if whole else ignored[rows])
    places = rows if whole else np.arange(len(rows))
    values = np.empty((len(seconds), len(rows)))
    reduction, (step, width) = "", _steps(read)
    for own in _blocks(len(numbers), width):
        origin: Array | None = None
        first, last = np.searchsorted(places, (own.start, own.stop))
        for times in _blocks(len(seconds), step):
            block = read.isel(time=times, env=own).values.astype(np.float64)
            with np.errstate(invalid="ignore"):
                if axes:
                    origin = block[:1] if origin is None and component == DISTANCE else origin
                    block = np.linalg.norm(block if origin is None else block - origin, axis=-1)
                if items:
                    block, reduction = _of_items(block.reshape(*block.shape[:2], -1), str(array.name))
            extremes.search(block, times.start, own.start)
            values[times, first:last] = block[:, places[first:last] - own.start]
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
    """Search for extremes, block by block."""

    seconds: Array
    envs: NDArray[np.int64]
    ignored: NDArray[np.bool_]
    smallest: Extreme | None = field(default=None, init=False)
    largest: Extreme | None = field(default=None, init=False)

    def search(self, values: Array, record: int, row: int) -> None:
        """Searches values (time, env) from record number ``record`` and environment number ``row`` on."""
        own = slice(row, row + values.shape[1])
        if self.ignored[own].any() or not (np.isfinite(values.min()) and np.isfinite(values.max())):
            good = np.isfinite(values) & ~self.ignored[own]
            if not good.any():
                return
            low, high = np.where(good, values, np.inf), np.where(good, values, -np.inf)
        else:
            low = high = values
        lowest = self._at(low, int(low.argmin()), record, row)
        highest = self._at(high, int(high.argmax()), record, row)
        self.smallest = min(self.smallest or lowest, lowest, key=lambda one: (one.value, one.time, one.env))
        self.largest = min(self.largest or highest, highest, key=lambda one: (-one.value, one.time, one.env))

    def _at(self, values: Array, place: int, record: int, row: int) -> Extreme:
        time, env = divmod(place, values.shape[1])
        return Extreme(float(values[time, env]), float(self.seconds[record + time]), int(self.envs[row + env]))


def _blocks(size: int, step: int) -> Iterator[slice]:
    return (slice(first, min(first + step, size)) for first in range(0, size, step))


def _steps(array: xr.DataArray) -> tuple[int, int]:
    """Returns the numbers of records and of environments of one block, of whole chunks of a store if these fit."""
    chunks = array.encoding.get("preferred_chunks", {})
    records, envs = array.sizes["time"], array.sizes["env"]
    each = max(1, array.size // max(1, records * envs))

    def whole(step: int, dim: str) -> int:
        chunk = int(chunks.get(dim, 1))
        return max(1, step // chunk * chunk or step)

    if BLOCK // (each * max(1, envs)) >= chunks.get("time", 1):
        return whole(BLOCK // (each * max(1, envs)), "time"), max(1, envs)
    time = min(int(chunks.get("time", 1)), max(1, records), max(1, BLOCK // each))
    return time, whole(BLOCK // (each * time), "env")


def _of_items(values: Array, name: str) -> tuple[Array, str]:
    """Returns one number (time, env) of the items of a set (time, env, item), and the reduction."""
    last = name.rpartition(".")[2]
    if last in _SMALLEST:
        return np.fmin.reduce(values, axis=2), "smallest"
    if last in _LARGEST:
        return np.fmax.reduce(values, axis=2), "largest"
    if last in _SUMS:
        return values.sum(axis=2), "sum of"
    return values.mean(axis=2), "mean"
