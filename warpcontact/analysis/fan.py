"""Quantiles of a sensor over the environments at each time, and their plot."""

from collections.abc import Sequence
from os import PathLike

import numpy as np
import xarray as xr

from warpcontact.algebra.quantiles import quantiles_over
from warpcontact.analysis.results import (
    MISSING,
    STOPPED,
    ResultSource,
    check_usable,
    end_times,
    frozen,
    numbers,
    remaining_dims,
    variable,
)
from warpcontact.files.picture_file import check_path, save
from warpcontact.kernels.catalogue.device_model import as_numbers
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks

# Largest size of the values that are read in one block [bytes].
BLOCK = 256 * 2**20
# Relative tolerance between a clock and the time of a record; less than one step of the longest run.
ROUNDING = 1.0e-9


@explain_keywords
def quantile_fan(
    run: ResultSource,
    sensor: str,
    quantiles: Sequence[float] = (0.05, 0.25, 0.5, 0.75, 0.95),
    *,
    missing: str = "refuse",
    stopped: str = "hold",
) -> xr.DataArray:
    """Returns quantiles of a sensor over the environments, at each time.

    Records are read in blocks, so the series of a large run need not fit into memory.

    Args:
        run: Run with a series of the sensor.
        sensor: Name of the sensor.
        quantiles: Levels from 0 to 1, ascending.
        missing: Policy for environments that are frozen or have a non-finite value at some time. ``"refuse"``: raise
            an error. ``"drop"``: ignore frozen environments, and others at the times without a finite value.
        stopped: Policy for environments after their stop condition. ``"hold"``: use the values held since the stop,
            which the series contains. ``"drop"``: use an environment up to its stop only.

    Returns:
        Quantiles (quantile, time, …), NaN if no environment is left, with the attributes of the sensor. Further
        attributes: ``stopped``, the argument, and ``stopped_environments``, the number of stopped environments.

    Raises:
        ValueError: If there is no such series, the quantiles are invalid, or some environments cannot be used.
    """
    checks.choice("missing", missing, MISSING)
    checks.choice("stopped", stopped, STOPPED)
    given = as_numbers(quantiles)
    levels = np.empty(0) if given is None else given.astype(np.float64)
    if levels.ndim != 1 or not levels.size or not (levels >= 0.0).all() or not (levels <= 1.0).all():
        raise ValueError(f"quantiles must be numbers from 0 to 1, got {quantiles!r}")
    if (np.diff(levels) <= 0.0).any():
        raise ValueError(f"quantiles must be strictly ascending, got {quantiles!r}")
    array = variable(run.series, sensor, "sensor", "time", "env")
    envs = numbers(array)
    halted = np.isin(envs, frozen(run.outcome))
    ends = end_times(run.outcome, envs)
    dims, shape, coords = remaining_dims(array, "env")
    found = np.empty((len(levels), *shape))
    one_time = array.sizes["env"] * int(np.prod(shape[1:])) * found.itemsize
    block = max(1, BLOCK // max(1, one_time))
    # Read whole chunks of the store, so that none is read twice.
    chunk = int(array.encoding.get("preferred_chunks", {}).get("time", 1))
    block = block // chunk * chunk or block
    for first in range(0, array.sizes["time"], block):
        times = slice(first, first + block)
        values = array.isel(time=times).values.astype(np.float64)
        finite = np.isfinite(values)
        always = np.asarray(finite.all(axis=(0, *range(2, values.ndim))))
        check_usable(envs, halted, always, str(array.name), missing)
        if stopped == "drop":
            # Includes the record at the stop time itself; the tolerance allows for rounding of the clocks.
            late = array["time"].values[times, None] > ends * (1.0 + ROUNDING)
            finite &= ~late.reshape(*late.shape, *(1,) * (values.ndim - 2))
        values[~finite] = np.nan
        found[:, times] = quantiles_over(values[:, ~halted], levels)
    return xr.DataArray(
        found,
        dims=("quantile", *dims),
        coords={"quantile": levels, **coords},
        name=array.name,
        attrs=array.attrs | {"stopped": stopped, "stopped_environments": int(np.isfinite(ends).sum())},
    )


@explain_keywords
def write_fan(path: str | PathLike[str], fan: xr.DataArray, title: str | None = None) -> None:
    """Draws a quantile fan: bands between symmetric quantiles, and the median.

    Args:
        path: The .svg or .png file.
        fan: Result of ``quantile_fan``, (quantile, time); for a vector, one component: ``fan.sel(axis="z")``.
        title: Title; ``None``: the name of the sensor.

    Raises:
        ValueError: If the fan has more dimensions, or the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    file = check_path(path)
    if set(fan.dims) != {"quantile", "time"}:
        raise ValueError(f"fan must have the dimensions quantile and time, got {', '.join(map(str, fan.dims))}")
    fan = fan.transpose("quantile", "time")
    levels, times, values = fan["quantile"].values, fan["time"].values, fan.values
    figure = Figure(figsize=(8.0, 4.5), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    bands = len(levels) // 2
    for i in range(bands):
        shade = 0.15 + 0.3 * (i + 1) / bands
        label = f"{levels[i]:.3g} to {levels[-1 - i]:.3g}"
        axes.fill_between(times, values[i], values[-1 - i], color="C0", alpha=shade, lw=0, label=label)
    if len(levels) % 2:
        axes.plot(times, values[bands], color="C0", label=f"{levels[bands]:.3g}")
    unit = fan.attrs.get("units", "-")
    axes.set(xlabel="time [s]", ylabel=str(fan.name) if unit == "-" else f"{fan.name} [{unit}]")
    axes.set_title(str(fan.name) if title is None else title)
    axes.margins(x=0.0)
    count = fan.attrs.get("stopped_environments", 0)
    after = {"hold": "hold their last values", "drop": "count until their stop"}.get(
        fan.attrs.get("stopped", ""), ""
    )
    note = f"\n{count} stopped environments\n{after}" if count else ""
    axes.legend(title=f"quantiles{note}", title_fontsize="small", fontsize="small")
    save(figure, file)
