"""Contact readings as custom attributes, and contact forces as lines."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.scene import Contact
from warpcontact.smooth.elements import SmoothContact
from warpcontact.usd.author import (
    attribute_name,
    attribute_type,
    plain,
    series,
    write_samples,
)
from warpcontact.usd.curves import define_curves, write_curves
from warpcontact.usd.replay import Replay

FORCE_COLOR = (0.9, 0.25, 0.1)
# Length of the longest force line and width of all, in sizes of the largest body.
LONGEST = 1.5
WIDTH = 0.03

_KINDS = {"axis": "vector", "component": "quaternion"}
_ROLES = {"point": "Point3", "normal": "Normal3"}
# These move the prims themselves.
_POSES = ("position", "orientation")


class Readings:
    """Everything numeric that was recorded of one element, ready to be written to a prim per environment.

    Args:
        replay: What to export.
        element: Name of a body or contact, or ``"scene"``.
    """

    def __init__(self, replay: Replay, element: str) -> None:
        self.codes = replay.codes
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
        """Adds the attributes to a prim, with unit and meaning, without values."""
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

    def write(self, prim: Any, row: int) -> None:
        """Writes the values of environment number ``row`` of the export."""
        for quantity, data, values, kind, is_array in self.found:
            attribute = prim.GetAttribute(attribute_name(quantity))
            samples = series(values[:, row], kind, is_array)
            if "time" in data.dims:
                write_samples(attribute, self.codes, samples)
            else:
                attribute.Set(samples[0])


class ForceLines:
    """The force of a contact on the body of its points, from where it acts.

    Attributes:
        contact: The contact.
        start: Point K where the force acts, (time, env, item, 3), world [m].
        force: The force, (time, env, item, 3), world [N]; zero where there is none.
    """

    def __init__(self, contact: Contact | SmoothContact, start: Array, force: Array) -> None:
        self.contact = contact
        # A failed environment may hold NaN, which must not get into the geometry.
        good = np.all(np.isfinite(force) & np.isfinite(start), axis=-1, keepdims=True)
        self.force = np.where(good, force, 0.0)
        self.start = np.where(np.isfinite(start), start, 0.0)

    @classmethod
    def of(cls, replay: Replay, contact: Contact | SmoothContact) -> "ForceLines | None":
        """Returns the lines, or ``None`` unless normal force, normal and point were recorded."""
        shape = (len(replay.codes), len(replay.envs), contact.count)
        parts = {}
        for key in ("normal_force", "normal", "point", "friction_force"):
            values = replay.series(f"{contact.name}.{key}")
            if values is not None:
                length = () if key == "normal_force" else (3,)
                parts[key] = values.astype(np.float64).reshape(*shape, *length)
            elif key != "friction_force":
                return None
        force = parts["normal_force"][..., None] * parts["normal"] + parts.get("friction_force", 0.0)
        return cls(contact, parts["point"], force)

    def peak(self) -> float:
        """Returns the largest force [N]."""
        return float(np.linalg.norm(self.force, axis=-1).max())

    def declare(self, stage: Any, path: str, width: float) -> None:
        """Writes what the lines have in common in all environments."""
        color = FORCE_COLOR if self.contact.color is None else self.contact.color
        meaning = "Force on the body of the points, from the point where it acts."
        define_curves(stage, path, [2] * self.contact.count, width, color, meaning)

    def write(self, prim: Any, replay: Replay, row: int, scale: float, width: float) -> None:
        """Writes the lines of environment number ``row`` of the export, ``scale`` metres per newton long."""
        start, force = self.start[:, row], self.force[:, row]
        ends = np.stack([start, start + scale * force], axis=2).reshape(len(start), -1, 3)
        acting = np.any(force.reshape(len(force), -1), axis=1).tolist()
        write_curves(prim, replay, ends, acting, width)


def length_scale(lines: list[ForceLines], size: float) -> float:
    """Returns the metres per newton that draw the largest force at ``LONGEST`` times ``size`` [m]."""
    peak = max((line.peak() for line in lines), default=0.0)
    return LONGEST * size / peak if peak > 0.0 else 1.0
