"""Report section on sensors over time: quantile bands over the environments, and curves of single environments."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.analysis.fan import quantile_fan
from warpcontact.analysis.results import frozen
from warpcontact.drawing.reduction import evenly, kept_samples
from warpcontact.experiment.curves import (
    VALUES,
    Extreme,
    SensorCurves,
    is_drawable,
    read_curves,
    sample_size,
)
from warpcontact.model.health import Health
from warpcontact.validation.checks import Array
from warpcontact.validation.number_format import count, quantity, several
from warpcontact.visualize.report import chart
from warpcontact.visualize.report.markup import Markup, element, joined, name, short

# Largest numbers of charts, and of samples per curve.
CHARTS = 12
SAMPLES = 200
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
# Significant digits of extremes.
DIGITS = 5
# Multiple of the machine precision up to which variations are attributed to rounding.
ROUNDING = 16.0


@dataclass(frozen=True, eq=False)
class SampledResults:
    """Outcomes and series of some environments, as input of ``quantile_fan``; see ``analysis.results``."""

    outcome: xr.Dataset
    series: xr.Dataset


@dataclass(frozen=True, eq=False)
class Curves:
    """Chart of a sensor, and the curves that the script draws into it.

    Attributes:
        picture: The chart.
        about: Name of the sensor, its unit, and the values at the bottom and the top of the plot.
        lines: Curves of the selected environments by number: ``x`` and ``y`` of each sample in tenths of chart units,
            as differences from the previous sample, the first from 0; ``y`` is ``None`` in gaps.
        sampled: Number of environments in the quantiles.
    """

    picture: Markup
    about: dict[str, Any]
    lines: dict[str, dict[str, list[Any]]]
    sampled: int


@dataclass(frozen=True, eq=False)
class _ChartData:
    """Data of a chart.

    Attributes:
        label: Name of the sensor, with the component.
        meaning: Description.
        precision: Relative precision of its numbers.
        curves: Curves of the selected environments, and extremes.
        fan: Quantiles over the sampled environments, (level, time).
        failed: Which of the selected environments are frozen.
        sampled: Number of environments in the quantiles.
        total: Number of environments.
        active: Number of environments that are not frozen.
    """

    label: str
    meaning: str
    precision: float
    curves: SensorCurves
    fan: Array
    failed: NDArray[np.bool_]
    sampled: int
    total: int
    active: int

    @property
    def single(self) -> bool:
        """Whether there is only one environment."""
        return self.total == 1

    @property
    def magnitude(self) -> float:
        """Largest absolute quantile."""
        return float(np.abs(self.fan).max(initial=0.0, where=np.isfinite(self.fan)))


def sensors_of(series: xr.Dataset) -> list[tuple[str, str | None]]:
    """Returns the sensors that can be drawn, with their components, in recorded order: poses come last."""
    found: list[tuple[str, str | None]] = []
    for key, array in series.data_vars.items():
        if is_drawable(str(key), array):
            found += [(str(key), axis) for axis in ("xyz" if "axis" in array.dims else (None,))]
    return found


def make_curves(outcome: xr.Dataset, series: xr.Dataset, chosen: list[int]) -> tuple[list[Curves], int]:
    """Returns the first ``CHARTS`` charts, and the number of further sensors.

    Args:
        outcome: Outcomes of the environments, with their status.
        series: Sensors (time, env, …).
        chosen: Numbers of the environments that have individual curves.
    """
    sensors = sensors_of(series)
    charts = [_chart_data(outcome, series, sensor, axis, chosen) for sensor, axis in sensors[:CHARTS]]
    scales: dict[str, float] = {}
    for chart_data in charts:
        unit = chart_data.curves.unit
        scales[unit] = max(scales.get(unit, 0.0), chart_data.magnitude)
    return [_curves(chart_data, scales[chart_data.curves.unit]) for chart_data in charts], len(sensors) - len(
        charts
    )


def section(curves: list[Curves], more: int, envs: int, records: int, health: Health) -> Markup:
    """Returns the section of the page.

    Args:
        curves: The charts.
        more: Number of further sensors.
        envs: Number of environments.
        records: Number of records.
        health: Frozen environments, which are excluded from quantiles, and stopped ones, which are included.
    """
    if not curves:
        return element("p", "No scalar sensor was recorded.", class_="note")
    exclusion = f", without {several(len(health.frozen), 'frozen one')}" if len(health.frozen) else ""
    sentences = [f"{several(records, 'record')} of {several(envs, 'environment')}{exclusion}."]
    if envs > 1:
        sentences.append("Bands: 5 % to 95 % and 25 % to 75 % of the environments; line: median.")
        if len(health.stopped):
            sentences.append(f"{several(len(health.stopped), 'stopped one')} are included with their last values.")
        sentences.append("Orange: the environment shown in the replay.")
    if records > SAMPLES:
        sentences.append("Curves are decimated; peaks keep their times and heights.")
    sampled = min(chart_data.sampled for chart_data in curves)
    if sampled < envs:
        sentences.append(f"Quantiles are over at least {count(sampled)} evenly spaced environments.")
    if more:
        sentences.append(f"{several(more, 'further sensor')} omitted; all are in data.zarr.")
    return joined(
        [
            element("p", " ".join(sentences), class_="note"),
            element("div", joined(chart_data.picture for chart_data in curves), class_="charts"),
        ]
    )


def data(curves: list[Curves]) -> list[dict[str, Any]]:
    """Returns the data of the charts for the script of the page, in order."""
    return [chart_data.about | {"lines": chart_data.lines} for chart_data in curves]


def _chart_data(
    outcome: xr.Dataset, series: xr.Dataset, sensor: str, axis: str | None, chosen: list[int]
) -> _ChartData:
    array = series[sensor]
    envs = np.asarray(array["env"].values)
    halted = np.isin(envs, frozen(outcome))
    sample = evenly(len(envs), sample_size(array))
    shown_envs = [env for env in chosen if env in envs][: max(1, VALUES // array.sizes["time"])]
    env_rows = np.array([int(np.flatnonzero(envs == env)[0]) for env in shown_envs], dtype=np.intp)
    rows = np.union1d(sample, env_rows)
    curves = read_curves(array, rows, halted, axis)
    sampled = xr.DataArray(
        curves.values[:, np.searchsorted(rows, sample)],
        dims=("time", "env"),
        coords={"time": curves.seconds, "env": envs[sample]},
    )
    fan = quantile_fan(SampledResults(outcome, sampled.to_dataset(name=sensor)), sensor, LEVELS, missing="drop")
    # Copy only the selected curves, so that those of other environments are not kept in memory for all charts.
    lines = curves.values[:, np.searchsorted(rows, env_rows)]
    return _ChartData(
        label=sensor if axis is None else f"{sensor}.{axis}",
        meaning=f"{curves.reduction} {array.attrs.get('long_name', '')}".strip(),
        precision=float(np.finfo(array.dtype).eps) if array.dtype.kind == "f" else 0.0,
        curves=replace(curves, envs=envs[env_rows], values=lines),
        fan=fan.values,
        failed=halted[env_rows],
        sampled=len(sample),
        total=len(envs),
        active=int((~halted).sum()),
    )


def _curves(chart_data: _ChartData, scale: float) -> Curves:
    """Draws a sensor; ``scale``: largest value of all sensors with its unit."""
    seconds = chart_data.curves.seconds
    span = _range(chart_data.fan, chart_data.curves.values, chart_data.failed)
    low, high = visible_range(*span, chart_data.precision, scale)
    x = chart.horizontal(float(seconds[0]), float(seconds[-1]), "s")
    y = chart.vertical(low, high, chart_data.curves.unit)

    def line(values: Array) -> tuple[Array, Array]:
        kept = kept_samples(values, SAMPLES)
        return x.place(seconds[kept]), y.place(values[kept])

    def band(low: Array, high: Array, style: str) -> Markup:
        kept = np.union1d(kept_samples(low, SAMPLES), kept_samples(high, SAMPLES))
        return chart.band(x.place(seconds[kept]), y.place(low[kept]), y.place(high[kept]), style)

    marks = [chart.polyline(*line(chart_data.fan[2]), "curve" if chart_data.single else "median")]
    if not chart_data.single:
        marks = [
            band(chart_data.fan[0], chart_data.fan[4], "band"),
            band(chart_data.fan[1], chart_data.fan[3], "band inner"),
            *marks,
        ]
    about = f"{chart_data.label} over time: median and quantiles over the environments"
    drawing = chart.chart(x, y, marks, about, "time", data_t0=seconds[0], data_t1=seconds[-1], data_series=True)
    unit_label = element("span", f"[{y.label}]" if y.label else "", class_="unit")
    heading = element("strong", name(chart_data.label, 40), " ", unit_label)
    caption = element("figcaption", heading, element("span", chart_data.meaning))
    extremes = element("p", _extremes(chart_data, y), class_="note")
    drawn = (
        []
        if chart_data.single
        else zip(chart_data.curves.envs, map(line, chart_data.curves.values.T), strict=True)
    )
    return Curves(
        picture=element("figure", caption, drawing, extremes, class_="chart"),
        about={"name": short(chart_data.label, 200), "unit": chart_data.curves.unit, "low": y.low, "high": y.high},
        lines={str(env): _differences(*points) for env, points in drawn},
        sampled=chart_data.sampled,
    )


def _extremes(chart_data: _ChartData, axis: chart.Axis) -> str:
    """Returns the extremes of a sensor as text, with their times and environments."""

    def sentences(word: str, extreme: Extreme) -> str:
        value = quantity(axis.factor * extreme.value, axis.label, DIGITS)
        where = "" if chart_data.single else f" in environment {extreme.env}"
        return f"{word} {value} at {quantity(extreme.time, 's', DIGITS)}{where}"

    low, high, searched = chart_data.curves.smallest, chart_data.curves.largest, chart_data.curves.searched
    if low is None or high is None:
        return "no finite value"
    sampled = f", of {several(searched, 'sampled environment')}" if searched < chart_data.active else ""
    return f"{sentences('smallest', low)}; {sentences('largest', high)}{sampled}"


def visible_range(low: float, high: float, precision: float, scale: float) -> tuple[float, float]:
    """Returns the ends of an axis on which variations due to rounding look flat.

    Args:
        low: Smallest value.
        high: Largest value.
        precision: Relative precision of the numbers.
        scale: Largest value of any sensor with this unit.
    """
    size = max(abs(low), abs(high))
    # Sums of larger numbers keep the rounding errors of these, at least in double precision.
    rounding = ROUNDING * float(np.finfo(np.float64).eps) * scale
    if high - low > max(rounding, ROUNDING * precision * size):
        return low, high
    margin = 0.05 * (size if size > rounding else scale)
    return low - margin, high + margin


def _range(fan: Array, lines: Array, failed: NDArray[np.bool_]) -> tuple[float, float]:
    """Returns the ends of the vertical axis: the range of quantiles and selected curves, with a margin.

    Curves of frozen environments may exceed it.
    """
    values = np.concatenate([fan[np.isfinite(fan)], lines[:, ~failed][np.isfinite(lines[:, ~failed])]])
    env_rows = lines[np.isfinite(lines)]
    values = values if len(values) else env_rows
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if len(env_rows):
        # For frozen environments, extend the range by at most its own length on each side.
        reach = high - low
        low = max(low - reach, min(low, float(env_rows.min())))
        high = min(high + reach, max(high, float(env_rows.max())))
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def _differences(across: Array, up: Array) -> dict[str, list[Any]]:
    """Returns a curve in the format of ``Curves.lines``."""
    good = np.isfinite(up) & (np.abs(up) < 1.0e4)
    y: list[int | None] = [None] * len(up)
    for i, step in zip(np.flatnonzero(good), _steps(up[good]), strict=True):
        y[i] = step
    return {"x": _steps(across), "y": y}


def _steps(points: Array) -> list[int]:
    steps: list[int] = np.diff(np.round(10.0 * points).astype(np.int64), prepend=0).tolist()
    return steps
