"""Parameters of sets that are equal for all items: one value in tables and on pages."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

# Values are compared in blocks of environments of up to this size [bytes].
BLOCK = 32 * 2**20


def item_dimensions(array: "xr.DataArray") -> list[str]:
    """Returns the dimensions of the items of a set, as ``recorder.item_dimension`` names them."""
    return [dim for dim in map(str, array.dims) if dim == "item" or dim.endswith(".item")]


def merged_items(array: "xr.DataArray") -> "xr.DataArray":
    """Returns an array without the dimension of its items if these are equal in every environment, else unchanged.

    NaN equals NaN. Stored arrays are read in blocks of environments, up to the first block with a difference.

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
