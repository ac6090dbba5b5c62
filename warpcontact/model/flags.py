"""Codes of variables in words, by the attributes of the CF conventions."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


def words_of(array: "xr.DataArray") -> dict[int, str]:
    """Returns what the codes of an array mean; none: they are no codes."""
    if "flag_meanings" not in array.attrs:
        return {}
    codes = np.atleast_1d(array.attrs.get("flag_values", ()))
    return dict(zip(map(int, codes), str(array.attrs["flag_meanings"]).split(), strict=False))
