"""Colours of numbers and of gaps, and colours as displays and as light have them."""

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from warpcontact.drawing.equal_items import merged_items
from warpcontact.validation.checks import Array

#: Perceptually ordered, and readable for who does not see some colours.
COLORMAP = "viridis"
#: Of what has no number.
MISSING = (0.5, 0.5, 0.5)
#: Of gaps, from −1, the deepest overlap, over 0, touch, to 1, far away: RGB in 0…255.
GAPS = (
    (-1.0, (178, 24, 43)),
    (-0.5, (239, 138, 98)),
    (0.0, (247, 247, 247)),
    (0.5, (103, 169, 207)),
    (1.0, (33, 102, 172)),
)


@dataclass(frozen=True)
class Scale:
    """Colours of numbers from the lowest to the highest of some.

    Attributes:
        low: The lowest; above ``high`` if there is none.
        high: The highest.
    """

    low: float = math.inf
    high: float = -math.inf

    def widened(self, values: Array) -> "Scale":
        """Returns the scale of these numbers as well, of which those that are not finite do not count."""
        good = values[np.isfinite(values)]
        return Scale(min(self.low, float(good.min())), max(self.high, float(good.max()))) if len(good) else self

    def colors(self, values: Array) -> Array:
        """Returns the colours of numbers (…) as displayed, RGB in 0…1, (…, 3); grey where there is none."""
        import matplotlib as mpl

        good = np.isfinite(values)
        span = self.high - self.low
        part = (np.where(good, values, self.low) - self.low) / span if span > 0.0 else 0.5
        colors = mpl.colormaps[COLORMAP](np.broadcast_to(part, good.shape))[..., :3]
        return np.where(good[..., None], colors, MISSING)


def per_environment_number(array: xr.DataArray) -> xr.DataArray | None:
    """Returns a variable as one number for each environment, (env,) or, if it is one in each record, (time, env).

    That is so of a parameter of a set, too, if its items agree in each environment. ``None``: it is not so.
    """
    if array.dtype.kind not in "biuf":
        return None
    if array.size and "time" not in array.dims:
        array = merged_items(array)
    return array.transpose("time", "env", missing_dims="ignore") if set(array.dims) - {"time"} == {"env"} else None


def gap_colors(gaps: Array, deepest: float, far: float) -> Array:
    """Returns the colours of gaps as displayed, RGB in 0…1, (…, 3).

    Red where surfaces overlap, pale where they just touch, blue where they are apart, grey where that is unknown.

    Args:
        gaps: Signed distances (…) [m].
        deepest: Depth of the red end [m].
        far: Distance of the blue end [m].
    """
    good = np.isfinite(gaps)
    known = np.where(good, gaps, 0.0)
    part = known / np.where(known < 0.0, deepest, far)
    stops, colors = np.array([stop for stop, _ in GAPS]), np.array([color for _, color in GAPS]) / 255.0
    mixed = np.stack([np.interp(part, stops, component) for component in colors.T], axis=-1)
    return np.where(good[..., None], mixed, MISSING)


def linear(colors: ArrayLike) -> Array:
    """Returns colours as displayed (sRGB) as linear ones, components in 0…1."""
    shown = np.clip(np.asarray(colors, dtype=np.float64), 0.0, 1.0)
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
