"""Fewer numbers for pictures, tables and pages: decimated curves, and merged items of sets.

``kept_samples`` divides the samples of a curve into buckets and keeps the smallest and the largest value of each, so that
a peak of a single sample stays at its time and height, and gaps stay gaps. ``merged_items`` merges the items of a set if
they are equal.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    import xarray as xr

# Size of the blocks of environments in which values are compared [bytes].
BLOCK = 32 * 2**20


def item_dimensions(array: "xr.DataArray") -> list[str]:
    """Returns the item dimensions of an array, named by ``recorder.item_dimension_of``."""
    return [dim for dim in map(str, array.dims) if dim == "item" or dim.endswith(".item")]


def merged_items(array: "xr.DataArray") -> "xr.DataArray":
    """Returns an array without its item dimension if the items are equal in every environment, otherwise unchanged.

    NaN equals NaN. Stored arrays are read in blocks of environments, up to the first difference.

    Args:
        array: A parameter (env, …), or that of one environment (…).
    """
    dims = item_dimensions(array)
    if not dims:
        return array
    envs = array.sizes.get("env", 1)
    step = max(1, min(envs, BLOCK * envs // max(1, array.nbytes)))
    for start in range(0, envs, step):
        block = array.isel({"env": slice(start, start + step)}, missing_dims="ignore").transpose(*dims, ...)
        values = block.values
        first = values[(slice(0, 1),) * len(dims)]
        if not ((values == first) | ((values != values) & (first != first))).all():  # NaN is NaN
            return array
    return array.isel(dict.fromkeys(dims, 0), drop=True)


def evenly(size: int, most: int) -> NDArray[np.intp]:
    """Returns at most ``most`` indices of ``size`` items, evenly spaced, including both ends.

    Not for samples of a curve, whose extremes may lie in between: see ``kept_samples``.
    """
    return np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(np.intp))


def kept_samples(curves: ArrayLike, most: int, along: ArrayLike | None = None) -> NDArray[np.intp]:
    """Returns the indices of the samples that a decimated curve consists of, in ascending order.

    The samples are divided into buckets of equal length. In each bucket, the first sample with the smallest value
    and the first with the largest value of each curve are kept. So are the first and the last finite sample. If
    non-finite samples lie between two kept ones, the first of them is kept too: gaps stay gaps.

    Args:
        curves: Values (sample,) or (sample, curve). Several curves, such as x and y of a loop, keep the same
            samples. A sample with any non-finite value is a gap.
        most: Largest number of finite samples kept, at least 2 + 2 · curves.
        along: Rising coordinate (sample,) in which buckets are equally long; ``None``: the number of the sample.
    """
    values = np.asarray(curves, dtype=np.float64)
    size = len(values)
    if size <= most:
        return np.arange(size)
    values = values.reshape(size, -1)
    good: NDArray[np.bool_] = np.asarray(np.isfinite(values).all(axis=1))
    finite = np.flatnonzero(good)
    if not len(finite):
        return np.array([0, size - 1])
    buckets = max(1, (most - 2) // (2 * values.shape[1]))
    if along is None:
        starts = np.linspace(0, size, buckets, endpoint=False).astype(np.intp)
    else:
        places = np.asarray(along, dtype=np.float64)
        ends = np.linspace(places[0], places[-1], buckets, endpoint=False)
        starts = np.unique(np.append(0, np.searchsorted(places, ends[1:])))
        starts = starts[starts < size]
    widths = np.diff(starts, append=size)
    kept = np.zeros(size, dtype=bool)
    kept[finite[[0, -1]]] = True
    for column in values.T:
        kept[_first_smallest(np.where(good, column, np.inf), starts, widths, good)] = True
        kept[_first_smallest(np.where(good, -column, np.inf), starts, widths, good)] = True
    chosen = np.flatnonzero(kept)
    gaps = np.flatnonzero(~good)
    # The first gap after each kept sample, if it comes before the next kept one.
    after = np.append(gaps, size)[np.searchsorted(gaps, chosen[:-1])]
    kept[after[after < chosen[1:]]] = True
    return np.flatnonzero(kept)


def _first_smallest(
    values: Array, starts: NDArray[np.intp], widths: NDArray[np.intp], good: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """Returns the index of the first smallest value of each bucket that has a finite one."""
    smallest = np.repeat(np.minimum.reduceat(values, starts), widths)
    hits = np.flatnonzero((values == smallest) & good)
    _, first = np.unique(np.searchsorted(starts, hits, side="right"), return_index=True)
    return hits[first]
