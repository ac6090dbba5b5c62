"""Bins of histograms."""

import numpy as np
from numpy.typing import NDArray

BINS = 60
# Largest span of integer values with one bin each.
MAX_INTEGER_BINS = 40


def has_integer_bins(values: NDArray[np.float64]) -> bool:
    """Whether finite values are integers that span few enough numbers for one bin each."""
    # Beyond 2⁵¹, bin edges between integers cannot be represented.
    small = np.abs(values).max() < 2.0**51
    return bool(small and (values == np.round(values)).all() and np.ptp(values) <= MAX_INTEGER_BINS)


def bin_edges(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the bin edges of a histogram of finite values."""
    low, high = float(values.min()), float(values.max())
    if has_integer_bins(values):
        return np.arange(low, high + 2.0) - 0.5
    count = int(np.clip(np.sqrt(len(values)), 10, BINS))
    # Values that differ only by rounding errors are in one bin.
    margin = 1.0e-6 * max(abs(low), abs(high))
    if high - low <= margin:
        low, high, count = low - margin, high + margin, 1
    return np.linspace(low, high, count + 1)
