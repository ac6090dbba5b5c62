"""Recorded sensors of an element as custom attributes."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.drawing.replay import Replay
from warpcontact.usd.author import Samples, attribute_name, attribute_type, plain, series

_KINDS = {"axis": "vector", "component": "quaternion"}
_ROLES = {"point": "Point3", "normal": "Normal3"}
# Poses are written as transforms of the prims.
_POSES = ("position", "orientation")


class Sensors:
    """Numeric sensors recorded for one element, ready to be written to a prim per environment.

    Args:
        replay: Replay that is exported.
        element: Name of an element, or ``"scene"``.
    """

    def __init__(self, replay: Replay, element: str) -> None:
        self.found: list[tuple[str, xr.DataArray, NDArray[Any], str, bool]] = []
        for quantity, data in replay.of_element(element):
            kind = _KINDS.get(str(data.dims[-1]), "number") if data.dims else "number"
            over_time = "time" in data.dims
            leading = ("time", "env") if over_time else ("env",)
            items = len(data.dims) - len(leading) - (kind != "number")
            fits = set(leading) <= set(data.dims) and items in (0, 1) and data.dtype.kind in "fiub"
            if not fits or quantity in _POSES:
                continue
            values = plain(data.transpose(*leading, ...).values)
            if kind != "number" and values.dtype.kind != "f":
                values = values.astype(np.float64)
            if not over_time:
                values = values[None]
            self.found.append((quantity, data, values, kind, items == 1))

    def declare(self, prim: Any) -> None:
        """Declares the attributes on a prim, with unit and meaning, without values."""
        for quantity, data, values, kind, is_array in self.found:
            role = _ROLES.get(quantity, "Vector3")
            attribute = prim.CreateAttribute(
                attribute_name(quantity), attribute_type(values.dtype, kind, is_array, role), custom=True
            )
            unit = str(data.attrs.get("units", "-"))
            meaning = str(data.attrs.get("long_name", quantity))
            if "flag_meanings" in data.attrs:
                flags = zip(data.attrs["flag_values"], str(data.attrs["flag_meanings"]).split(), strict=True)
                meaning += ": " + ", ".join(f"{value} {name}" for value, name in flags)
            attribute.SetDocumentation(f"{meaning} [{unit}]")
            attribute.SetCustomDataByKey("warpcontact:name", data.name)
            attribute.SetCustomDataByKey("warpcontact:unit", unit)

    def write(self, prim: Any, samples: Samples, row: int) -> None:
        """Writes the values of environment ``row`` of the export."""
        for quantity, data, values, kind, is_array in self.found:
            attribute = prim.GetAttribute(attribute_name(quantity))
            env_values = series(values[:, row], kind, is_array)
            if "time" in data.dims:
                samples.write(attribute, env_values)
            elif samples.defaults:
                attribute.Set(env_values[0])
