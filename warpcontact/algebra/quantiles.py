"""Quantiles over the environments."""

import warnings

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.validation.checks import Array


def quantiles_over(values: Array, levels: ArrayLike) -> Array:
    """Returns quantiles (level, time, …) of the values (time, env, …) that are not NaN."""
    levels = np.asarray(levels)
    found = np.full((len(levels), len(values), *values.shape[2:]), np.nan)
    if not values.shape[1]:
        return found
    is_complete = ~np.isnan(values).any(axis=tuple(range(1, values.ndim)))
    if is_complete.any():
        found[:, is_complete] = np.quantile(values[is_complete], levels, axis=1)
    # Much slower.
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice", RuntimeWarning)
        if not is_complete.all():
            found[:, ~is_complete] = np.nanquantile(values[~is_complete], levels, axis=1)
    return found
