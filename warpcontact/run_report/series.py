"""Readings over time: quantile bands over the environments, and the curve of one environment in them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.analysis.fan import quantile_fan
from warpcontact.flags import words_of
from warpcontact.health import Health
from warpcontact.run_report import chart
from warpcontact.run_report.markup import Markup, element, joined, name
from warpcontact.run_report.words import count, several

# Charts, and points of a curve.
CHARTS = 12
POINTS = 200
# Quantiles of more environments than this look the same and take longer; of sets of many items fewer are taken.
SAMPLE = 4096
SAMPLED_BYTES = 128 * 2**20
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
# Steps of its precision by which rounding alone moves a number in a simulation, and no law does.
ROUNDING = 16.0

# What is drawn of the items of a set, by the last word of the name of the reading; of others their mean.
_SMALLEST = ("gap", "distance", "minimum_distance")
_SUMS = ("normal_force", "impulse", "kinetic_energy", "tension_a", "tension_b")
_LARGEST = ("penetration",)
# What nobody reads from a curve.
_LEFT_OUT = ("orientation", "point", "normal")


@dataclass(frozen=True, eq=False)
class Sampled:
    """What a fan takes from a run, of some environments and times; see ``analysis.results.Figures``."""

    outcome: xr.Dataset
    series: xr.Dataset


@dataclass(frozen=True, eq=False)
class Curves:
    """A chart of a reading, and what a script draws into it.

    Attributes:
        picture: The chart.
        lines: Of each chosen environment by its number, tenths of units of the chart at each time; ``None``: not
            finite there.
        places: Tenths of units along the time axis.
    """

    picture: Markup
    lines: dict[str, list[int | None]]
    places: list[int]


@dataclass(frozen=True, eq=False)
class _Measured:
    """What a chart shows of a reading.

    Attributes:
        label: Its name, with the component.
        meaning: What it is.
        unit: Its unit.
        precision: Relative distance of its numbers.
        seconds: Time of each record [s].
        fan: Quantiles over the environments, (level, time).
        lines: Of the chosen environments, (time, env).
        chosen: Their numbers.
        single: Whether there is no other.
    """

    label: str
    meaning: str
    unit: str
    precision: float
    seconds: NDArray[np.float64]
    fan: NDArray[np.float64]
    lines: NDArray[np.float64]
    chosen: list[int]
    single: bool

    @property
    def magnitude(self) -> float:
        """The largest quantile."""
        return float(np.abs(self.fan).max(initial=0.0, where=np.isfinite(self.fan)))


def thinned(size: int, most: int) -> NDArray[np.int64]:
    """Returns at most so many of ``size`` places, evenly spread, with both ends."""
    return np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(np.int64))


def readings_of(series: xr.Dataset) -> list[tuple[str, str | None]]:
    """Returns what there can be charts of, as readings and components, those first that were asked for.

    Poses are recorded last.
    """
    found: list[tuple[str, str | None]] = []
    for key, array in series.data_vars.items():
        reading = str(key)
        last = reading.rpartition(".")[2]
        if (
            array.dims[:2] != ("time", "env")
            or last in _LEFT_OUT
            or words_of(array)
            or array.dtype.kind not in "iuf"
        ):
            continue
        if {"row", "component"} & set(array.dims):
            continue
        found += [(reading, axis) for axis in ("xyz" if "axis" in array.dims else (None,))]
    return found


def curves_of(outcome: xr.Dataset, series: xr.Dataset, chosen: list[int]) -> tuple[list[Curves], int]:
    """Returns the first charts, and how many more there could be.

    Args:
        outcome: Outcomes of the environments, which say what is frozen.
        series: Readings (time, env, …).
        chosen: Numbers of the environments that have a curve of their own.
    """
    every = readings_of(series)
    numbers = series["env"].values
    there = [env for env in chosen if env in numbers]
    times = thinned(series.sizes["time"], POINTS)
    measured = [_measured(outcome, series, reading, axis, there, times) for reading, axis in every[:CHARTS]]
    scales: dict[str, float] = {}
    for one in measured:
        scales[one.unit] = max(scales.get(one.unit, 0.0), one.magnitude)
    return [_curves(one, scales[one.unit]) for one in measured], len(every) - len(measured)


def section(curves: list[Curves], more: int, envs: int, records: int, health: Health) -> Markup:
    """Returns the section of the page.

    Args:
        curves: The charts.
        more: How many more there could be.
        envs: Number of environments.
        records: Number of times.
        health: Which of the environments are frozen, and in no quantile, and which stopped, and in all.
    """
    if not curves:
        return element("p", "No reading that is one number was recorded over time.", class_="note")
    left_out = f", without {several(len(health.frozen), 'frozen one')}" if len(health.frozen) else ""
    told = [f"{several(records, 'record')} of {several(envs, 'environment')}{left_out}."]
    if envs > 1:
        told.append("Bands: 5 % to 95 % and 25 % to 75 % of the environments; line: median.")
        if len(health.stopped):
            told.append(f"{several(len(health.stopped), 'stopped one')} stay in them as they were.")
        told.append("Orange: the environment that the replay shows.")
    if records > POINTS:
        told.append(f"Each curve has {POINTS} of the records.")
    if envs > SAMPLE:
        told.append(f"Quantiles are those of at most {count(SAMPLE)} environments, evenly spread over all.")
    if more:
        told.append(f"{several(more, 'further reading')} left out; all are in data.zarr.")
    return joined(
        [
            element("p", " ".join(told), class_="note"),
            element("div", joined(one.picture for one in curves), class_="charts"),
        ]
    )


def data(curves: list[Curves]) -> list[dict[str, Any]]:
    """Returns what the script of the page needs of them, in their order."""
    return [{"x": one.places, "lines": one.lines} for one in curves]


def _measured(
    outcome: xr.Dataset,
    series: xr.Dataset,
    reading: str,
    axis: str | None,
    chosen: list[int],
    times: NDArray[np.int64],
) -> _Measured:
    whole = series[reading] if axis is None else series[reading].sel(axis=axis, drop=True)
    whole = whole.isel(time=times)
    per_env = whole.dtype.itemsize * max(1, whole.size // whole.sizes["env"])
    most = int(np.clip(SAMPLED_BYTES // per_env, 1, SAMPLE))
    sample, word = _of_items(whole.isel(env=thinned(whole.sizes["env"], most)).load(), reading)
    chosen = chosen[: max(1, SAMPLED_BYTES // per_env)]
    own, _ = _of_items(whole.sel(env=chosen).load(), reading)
    sampled = Sampled(outcome, sample.to_dataset(name=reading))
    return _Measured(
        label=reading if axis is None else f"{reading}.{axis}",
        meaning=f"{word} {whole.attrs.get('long_name', '')}".strip(),
        unit=str(whole.attrs.get("units", "-")),
        precision=float(np.finfo(whole.dtype).eps) if whole.dtype.kind == "f" else 0.0,
        seconds=whole["time"].values.astype(np.float64),
        fan=quantile_fan(sampled, reading, LEVELS, missing="drop").values,
        lines=own.values.astype(np.float64),
        chosen=chosen,
        single=whole.sizes["env"] == 1,
    )


def _curves(one: _Measured, scale: float) -> Curves:
    """Draws a reading; ``scale``: the largest value of all readings of its unit."""
    seconds, lines = one.seconds, one.lines
    low, high = visible(*_range(one.fan, lines), one.precision, scale)
    x = chart.horizontal(float(seconds[0]), float(seconds[-1]), "s")
    y = chart.vertical(low, high, one.unit)
    across, levels = x.place(seconds), y.place(one.fan)
    marks = [chart.polyline(across, levels[2], "curve" if one.single else "median")]
    if not one.single:
        marks = [
            chart.band(across, levels[0], levels[4], "band"),
            chart.band(across, levels[1], levels[3], "band inner"),
            *marks,
        ]
    about = f"{one.label} over time: median and quantiles over the environments"
    drawing = chart.chart(x, y, marks, about, "time", data_t0=seconds[0], data_t1=seconds[-1], data_series=True)
    unit_told = element("span", f"[{y.label}]" if y.label else "", class_="unit")
    heading = element("strong", name(one.label, 40), " ", unit_told)
    caption = element("figcaption", heading, element("span", one.meaning))
    places = (
        {}
        if one.single
        else {str(env): _tenths(y.place(lines[:, i])) for i, env in enumerate(one.chosen) if i < lines.shape[1]}
    )
    return Curves(element("figure", caption, drawing, class_="chart"), places, _whole(across))


def visible(low: float, high: float, precision: float, scale: float) -> tuple[float, float]:
    """Returns the ends of an axis on which what is only rounding looks flat.

    Args:
        low: The smallest value.
        high: The largest.
        precision: Relative distance of numbers.
        scale: The largest value of any quantity of this unit.
    """
    size = max(abs(low), abs(high))
    # Sums of larger numbers leave their rounding, in double precision at the best.
    nothing = ROUNDING * float(np.finfo(np.float64).eps) * scale
    if high - low > max(nothing, ROUNDING * precision * size):
        return low, high
    room = 0.05 * (size if size > nothing else scale)
    return low - room, high + room


def _of_items(array: xr.DataArray, reading: str) -> tuple[xr.DataArray, str]:
    """Returns one number (time, env) of the items of a set, and which it is."""
    items = [dim for dim in array.dims if dim not in ("time", "env")]
    if not items:
        return array, ""
    last = reading.rpartition(".")[2]
    values = array.astype(np.float64)
    if last in _SMALLEST:
        return values.min(items, keep_attrs=True), "smallest"
    if last in _LARGEST:
        return values.max(items, keep_attrs=True), "largest"
    if last in _SUMS:
        return values.sum(items, skipna=False, keep_attrs=True), "sum of"
    return values.mean(items, skipna=False, keep_attrs=True), "mean"


def _range(fan: NDArray[np.float64], lines: NDArray[np.float64]) -> tuple[float, float]:
    """Returns what the vertical axis shows: the quantiles with some room; single curves may leave it."""
    shown = fan[np.isfinite(fan)]
    shown = shown if len(shown) else lines[np.isfinite(lines)]
    if not len(shown):
        return 0.0, 1.0
    low, high = float(shown.min()), float(shown.max())
    room = 0.06 * (high - low)
    own = lines[np.isfinite(lines)]
    if len(own):
        # Those of chosen environments, up to as much again.
        reach = high - low
        low = max(low - reach, min(low, float(own.min())))
        high = min(high + reach, max(high, float(own.max())))
    return low - room, high + room


def _tenths(places: NDArray[np.float64]) -> list[int | None]:
    return [round(10.0 * place) if np.isfinite(place) and abs(place) < 1.0e4 else None for place in places]


def _whole(places: NDArray[np.float64]) -> list[int]:
    return [round(10.0 * place) for place in places]
