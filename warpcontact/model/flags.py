"""Names of integer codes of variables, from the CF attributes ``flag_values`` and ``flag_meanings``."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


def words_of(array: "xr.DataArray") -> dict[int, str]:
    """Returns the names of the codes of an array, by code; empty if its values are no codes."""
    if "flag_meanings" not in array.attrs:
        return {}
    codes = np.atleast_1d(array.attrs.get("flag_values", ()))
    return dict(zip(map(int, codes), str(array.attrs["flag_meanings"]).split(), strict=False))
