"""Quantiles over the environments at each time."""

from collections.abc import Sequence

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
from warpcontact.kernels.catalogue.device_model import as_numbers
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.validation import checks

# Times are taken together up to this size of what they are computed from [bytes].
BLOCK = 256 * 2**20
# By which part a clock may differ from the time of a record; one step of the longest run is more.
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

    Some times are read at once, so that the series of a large run need not fit into memory.

    Args:
        run: A run with a series of the sensor.
        sensor: Its name.
        quantiles: From 0 to 1, rising.
        missing: What becomes of environments that are frozen or, at a time, without a finite value: ``"refuse"``
            them, or ``"drop"`` the frozen ones, and others at those times.
        stopped: What becomes of environments after a stop condition held them: ``"hold"`` them as they were, which
            is what the series has of them, or ``"drop"`` them, so that each counts up to its stop only.

    Returns:
        Quantiles (quantile, time, …), NaN where no environment is left, with the attributes of the sensor. The
        attribute ``stopped`` is the argument, and ``stopped_environments`` how many a condition held.

    Raises:
        ValueError: If there is no such series, the quantiles are none, or some environments cannot be used.
    """
    checks.choice("missing", missing, MISSING)
    checks.choice("stopped", stopped, STOPPED)
    given = as_numbers(quantiles)
    levels = np.empty(0) if given is None else given.astype(np.float64)
    if levels.ndim != 1 or not levels.size or not (levels >= 0.0).all() or not (levels <= 1.0).all():
        raise ValueError(f"quantiles must be numbers from 0 to 1, got {quantiles!r}")
    if (np.diff(levels) <= 0.0).any():
        raise ValueError(f"quantiles must rise, got {quantiles!r}")
    array = variable(run.series, sensor, "sensor", "time", "env")
    envs = numbers(array)
    halted = np.isin(envs, frozen(run.outcome))
    ends = end_times(run.outcome, envs)
    dims, shape, coords = remaining_dims(array, "env")
    found = np.empty((len(levels), *shape))
    one_time = array.sizes["env"] * int(np.prod(shape[1:])) * found.itemsize
    some = max(1, BLOCK // max(1, one_time))
    # Whole pieces of a store, none of which is read twice then.
    piece = int(array.encoding.get("preferred_chunks", {}).get("time", 1))
    some = some // piece * piece or some
    for first in range(0, array.sizes["time"], some):
        times = slice(first, first + some)
        values = array.isel(time=times).values.astype(np.float64)
        finite = np.isfinite(values)
        always = np.asarray(finite.all(axis=(0, *range(2, values.ndim))))
        check_usable(envs, halted, always, str(array.name), missing)
        if stopped == "drop":
            # The record of the very moment at which it was stopped counts, however the clocks were rounded.
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
