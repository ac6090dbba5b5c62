"""Colors environments by one number each."""

from typing import Any

import numpy as np
import xarray as xr

from warpcontact.drawing.colors import COLORMAP, Scale, per_environment_number
from warpcontact.kernels.catalogue.names import stored_name, suggestion
from warpcontact.usd.author import attribute_name
from warpcontact.validation.checks import Array


def named_number(recording: xr.Dataset, name: str, outcome: xr.Dataset | None = None) -> xr.DataArray:
    """Returns a variable of a recording.

    Raises:
        ValueError: If there is none; the message lists the variables with one number per environment, including
            those of ``outcome``.
    """
    if stored_name(name) in recording:
        return recording[stored_name(name)]
    tables = [recording] if outcome is None else [recording, outcome]
    variables = [(str(key), one) for table in tables for key, one in table.data_vars.items()]
    available = sorted({key for key, one in variables if _could_color(one)})
    outcomes = "" if outcome is not None else " (an outcome is given as its values, run.outcome[name])"
    hint = suggestion(name, available) or f"; there are: {', '.join(available) or 'none'}"
    raise ValueError(f"color_by must be something that was recorded, got {name!r}{hint}{outcomes}")


def _could_color(array: xr.DataArray) -> bool:
    """Returns whether a variable may have one number per environment, judged without loading it."""
    return "env" in array.dims and array.dtype.kind in "biuf" and "axis" not in array.dims


class Coloring:
    """One number per environment, constant or per record, and its color.

    Args:
        color_by: Name of a variable of the recording, or values (env,) or (time, env) with these coordinates.
        recording: Recording that is exported.

    Attributes:
        name: Name of the variable.
        unit: Unit of the variable.
        is_time_dependent: Whether there is one number per record.
        scale: Color scale over all numbers scanned so far.
    """

    def __init__(self, color_by: str | xr.DataArray, recording: xr.Dataset) -> None:
        if isinstance(color_by, str):
            values = named_number(recording, color_by)
        elif isinstance(color_by, xr.DataArray):
            values = color_by
        else:
            raise TypeError(f"color_by must be a name or an xarray.DataArray, got {type(color_by).__name__}")
        self.name = str(values.name or "color")
        # Instances of sets store the number of their environment under this name.
        if attribute_name(self.name) == attribute_name("environment"):
            raise ValueError(f"color_by must have another name than {self.name!r}, which is reserved")
        found = per_environment_number(values)
        if found is None:
            raise ValueError(
                f"color_by must be one number for each environment, got {self.name!r} of {values.dtype} along "
                f"{', '.join(map(str, values.dims)) or 'nothing'}; items of a set must agree"
            )
        self.is_time_dependent = "time" in found.dims
        if self.is_time_dependent and found.sizes["time"] != recording.sizes["time"]:
            raise ValueError(
                f"color_by must have the {recording.sizes['time']} records of the recording, got "
                f"{found.sizes['time']} of {self.name!r}"
            )
        self.unit = str(values.attrs.get("units", "-"))
        self._values = found
        self.scale = Scale()

    def of(self, envs: list[int], first: int, stop: int) -> Array:
        """Returns the numbers of environments in a range of records, (time or 1, env); NaN if missing."""
        chosen = self._values.isel(time=slice(first, stop)) if self.is_time_dependent else self._values
        recorded = chosen["env"].values
        values = np.full((chosen.sizes["time"] if self.is_time_dependent else 1, len(envs)), np.nan)
        available = np.isin(envs, recorded)
        order = np.argsort(recorded, kind="stable")
        rows = order[np.searchsorted(recorded, np.asarray(envs)[available], sorter=order)]
        values[:, available] = chosen.isel(env=rows).values.astype(np.float64)
        return values

    def scan_records(self, envs: list[int], first: int, stop: int) -> None:
        """Extends the color scale to the numbers of a range of records."""
        self.scale = self.scale.widened(self.of(envs, first, stop))

    def legend(self) -> dict[str, Any]:
        """Returns the legend of the colors: variable, unit, color map and range."""
        legend: dict[str, Any] = {"colorBy": self.name, "unit": self.unit, "colormap": COLORMAP}
        if self.scale.low <= self.scale.high:
            legend |= {"low": self.scale.low, "high": self.scale.high}
        return legend
