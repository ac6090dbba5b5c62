"""Merges parameters of sets that are equal for all items, for tables and reports."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

# Size of the blocks of environments in which values are compared [bytes].
BLOCK = 32 * 2**20


def item_dimensions(array: "xr.DataArray") -> list[str]:
    """Returns the item dimensions of an array, named by ``recorder.item_dimension``."""
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
