"""Colors of numbers and gaps, and conversion from sRGB to linear colors."""

import math
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from warpcontact.drawing.reduction import merged_items
from warpcontact.validation.checks import Array

#: Perceptually uniform color map, also suitable for color-blind readers.
COLORMAP = "viridis"
#: Perceptually uniform color map of pressures, apart from that of numbers.
PRESSURE_COLORMAP = "plasma"
#: Color of missing numbers, RGB in 0…1.
MISSING = (0.5, 0.5, 0.5)
#: Colors of gaps, from −1 (largest overlap) over 0 (contact) to 1 (far away): RGB in 0…255.
GAPS = (
    (-1.0, (178, 24, 43)),
    (-0.5, (239, 138, 98)),
    (0.0, (247, 247, 247)),
    (0.5, (103, 169, 207)),
    (1.0, (33, 102, 172)),
)


@dataclass(frozen=True)
class Scale:
    """Color scale from the lowest to the highest of some numbers.

    Attributes:
        low: Lowest number; above ``high`` if there are none.
        high: Highest number.
        colormap: Name of the color map.
    """

    low: float = math.inf
    high: float = -math.inf
    colormap: str = COLORMAP

    def widened(self, values: Array) -> "Scale":
        """Returns the scale extended to further numbers; non-finite ones are ignored."""
        good = values[np.isfinite(values)]
        if not len(good):
            return self
        return replace(self, low=min(self.low, float(good.min())), high=max(self.high, float(good.max())))

    def colors(self, values: Array) -> Array:
        """Returns the sRGB colors of numbers (…), in 0…1, (…, 3); gray if not finite."""
        import matplotlib as mpl

        good = np.isfinite(values)
        span = self.high - self.low
        part = (np.where(good, values, self.low) - self.low) / span if span > 0.0 else 0.5
        colors = mpl.colormaps[self.colormap](np.broadcast_to(part, good.shape))[..., :3]
        return np.where(good[..., None], colors, MISSING)


def per_environment_number(array: xr.DataArray) -> xr.DataArray | None:
    """Returns a variable as one number per environment, (env,), or per record and environment, (time, env).

    A parameter of a set is accepted if its items are equal in each environment. ``None`` if there is no such number.
    """
    if array.dtype.kind not in "biuf":
        return None
    if array.size and "time" not in array.dims:
        array = merged_items(array)
    return array.transpose("time", "env", missing_dims="ignore") if set(array.dims) - {"time"} == {"env"} else None


def pressure_scale(largest: float) -> Scale:
    """Returns the color scale of pressures from 0 to the largest one [Pa]."""
    return Scale(0.0, largest, PRESSURE_COLORMAP)


def pressure_stops(count: int = 17) -> list[list[float]]:
    """Returns evenly spaced colors of the color map of pressures, sRGB in 0…1, from 0 to the largest pressure."""
    colors = pressure_scale(1.0).colors(np.linspace(0.0, 1.0, count))
    return [[round(float(part), 4) for part in color] for color in colors]


def gap_colors(gaps: Array, deepest: float, far: float) -> Array:
    """Returns the sRGB colors of gaps, in 0…1, (…, 3).

    Red: overlap; pale: contact; blue: separated; gray: unknown.

    Args:
        gaps: Signed distances (…) [m].
        deepest: Penetration of the red end [m].
        far: Distance of the blue end [m].
    """
    good = np.isfinite(gaps)
    finite_gaps = np.where(good, gaps, 0.0)
    part = finite_gaps / np.where(finite_gaps < 0.0, deepest, far)
    stops, colors = np.array([stop for stop, _ in GAPS]), np.array([color for _, color in GAPS]) / 255.0
    mixed = np.stack([np.interp(part, stops, component) for component in colors.T], axis=-1)
    return np.where(good[..., None], mixed, MISSING)


def linear(colors: ArrayLike) -> Array:
    """Converts sRGB colors to linear ones, components in 0…1."""
    shown = np.clip(np.asarray(colors, dtype=np.float64), 0.0, 1.0)
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
