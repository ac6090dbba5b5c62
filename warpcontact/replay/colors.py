"""Colours as displays and as light have them."""

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.checks import Array


def linear(colors: ArrayLike) -> Array:
    """Returns colours as displayed (sRGB) as linear ones, components in 0…1."""
    shown = np.clip(np.asarray(colors, dtype=np.float64), 0.0, 1.0)
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
