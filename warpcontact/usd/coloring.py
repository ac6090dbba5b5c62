"""Colours of environments by a number that each has."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.checks import Array

#: Perceptually ordered, and readable for who does not see some colours.
COLORMAP = "viridis"
#: Of what has no number.
MISSING = (0.5, 0.5, 0.5)


class Coloring:
    """A number for each environment, in all records or in each, and the colours of it.

    Args:
        color_by: Name of a variable of the recording, or values (env,) or (time, env) with that coordinate.
        recording: The recording.

    Attributes:
        name: Name of the variable.
        unit: Its unit.
        moves: Whether there is a number in each record.
        low: Smallest finite one; with ``high`` the ends of the colours.
        high: Largest.
    """

    def __init__(self, color_by: str | xr.DataArray, recording: xr.Dataset) -> None:
        if isinstance(color_by, str):
            if color_by not in recording:
                raise ValueError(
                    f"color_by must be something that was recorded, got {color_by!r}; there are: "
                    f"{', '.join(map(str, recording.data_vars))}"
                )
            values = recording[color_by]
        elif isinstance(color_by, xr.DataArray):
            values = color_by
        else:
            raise TypeError(f"color_by must be a name or an xarray.DataArray, got {type(color_by).__name__}")
        self.name = str(values.name or "color")
        dims = set(values.dims)
        if dims not in ({"env"}, {"time", "env"}) or values.dtype.kind not in "fiub":
            raise ValueError(
                f"color_by must be one number for each environment, got {self.name!r} of "
                f"{values.dtype} along {', '.join(map(str, values.dims)) or 'nothing'}"
            )
        if "time" in dims and values.sizes["time"] != recording.sizes["time"]:
            raise ValueError(
                f"color_by must have the {recording.sizes['time']} records of the recording, got "
                f"{values.sizes['time']} of {self.name!r}"
            )
        self.moves = "time" in dims
        self.unit = str(values.attrs.get("units", "-"))
        self._values = values.transpose("time", "env") if self.moves else values
        self.low, self.high = np.inf, -np.inf

    def of(self, envs: list[int], first: int, stop: int) -> Array:
        """Returns the numbers of environments in a range of records, (time or 1, env); NaN where there is none."""
        chosen = self._values.isel(time=slice(first, stop)) if self.moves else self._values
        known = chosen["env"].values
        values = np.full((chosen.sizes["time"] if self.moves else 1, len(envs)), np.nan)
        there = np.isin(envs, known)
        order = np.argsort(known, kind="stable")
        rows = order[np.searchsorted(known, np.asarray(envs)[there], sorter=order)]
        values[:, there] = chosen.isel(env=rows).values.astype(np.float64)
        return values

    def look_through(self, envs: list[int], first: int, stop: int) -> None:
        """Widens the range to the numbers of a range of records."""
        values = self.of(envs, first, stop)
        good = values[np.isfinite(values)]
        if len(good):
            self.low, self.high = min(self.low, float(good.min())), max(self.high, float(good.max()))

    def colors(self, values: Array) -> NDArray[np.float32]:
        """Returns the colours of numbers (…), RGB in 0…1, (…, 3)."""
        import matplotlib as mpl

        span = self.high - self.low
        part = (values - self.low) / span if span > 0.0 else np.where(np.isfinite(values), 0.5, np.nan)
        good = np.isfinite(part)
        colors = mpl.colormaps[COLORMAP](np.where(good, part, 0.0))[..., :3]
        return np.where(good[..., None], colors, MISSING).astype(np.float32)

    def legend(self) -> dict[str, Any]:
        """Returns what the colours mean."""
        told: dict[str, Any] = {"colorBy": self.name, "unit": self.unit, "colormap": COLORMAP}
        if self.low <= self.high:
            told |= {"low": self.low, "high": self.high}
        return told
