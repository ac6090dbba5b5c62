"""Where the bars of a histogram begin and end."""

import numpy as np
from numpy.typing import NDArray

BINS = 60
# Whole numbers that span no more than this have a bar each.
WHOLE_BARS = 40


def are_counts(values: NDArray[np.float64]) -> bool:
    """Whether finite values are whole numbers, few enough for a bar each."""
    # Beyond 2⁵¹ there are no numbers half between them.
    small = np.abs(values).max() < 2.0**51
    return bool(small and (values == np.round(values)).all() and np.ptp(values) <= WHOLE_BARS)


def edges_of_bars(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the edges of the bars of finite values."""
    low, high = float(values.min()), float(values.max())
    if are_counts(values):
        return np.arange(low, high + 2.0) - 0.5
    count = int(np.clip(np.sqrt(len(values)), 10, BINS))
    # Values that differ by rounding alone are one bar, not what rounding looks like.
    room = 1.0e-6 * max(abs(low), abs(high))
    if high - low <= room:
        low, high, count = low - room, high + room, 1
    return np.linspace(low, high, count + 1)
