"""Parameters and outcomes of environments as scalar columns, as in the table of a run."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.drawing.equal_items import merged_items
from warpcontact.model.flags import words_of

# Largest number of values per environment of a variable with columns; variables of sets often have more.
MOST = 12
# Variables up to this size are read once instead of once per column [bytes].
AT_ONCE = 256 * 2**20


@dataclass(frozen=True, eq=False)
class Column:
    """One number or code per environment, read on access.

    Attributes:
        name: Name, for vectors with that of the component.
        unit: Unit, ``"-"``: none.
        about: Description.
        words: Meaning of codes; empty for numbers.
        variable: Name of the variable.
        array: Values (env,).
    """

    name: str
    unit: str
    about: str
    words: dict[int, str]
    variable: str
    array: xr.DataArray

    @property
    def values(self) -> NDArray[Any]:
        """Values (env,): numbers as float64, codes unchanged."""
        found = self.array.values
        return found if self.words else found.astype(np.float64)


def columns_of(data: xr.Dataset, without: Collection[str] = ()) -> Iterator[Column]:
    """Iterates over the columns of the variables (env, …) of ``data``, except ``without`` and variables of sets."""
    for key, variable in data.data_vars.items():
        if key in without or not _is_shown(variable):
            continue
        array = merged_items(variable.compute() if variable.nbytes <= AT_ONCE else variable)
        axes = [str(dim) for dim in array.dims if dim != "env"]
        for position in np.ndindex(*(array.sizes[dim] for dim in axes)):
            labels = [
                str(array[dim].values[i]) if dim in array.coords else str(i)
                for dim, i in zip(axes, position, strict=True)
            ]
            yield Column(
                name=".".join([str(key), *labels]),
                unit=str(array.attrs.get("units", "-")),
                about=str(array.attrs.get("long_name", key)),
                words=words_of(array),
                variable=str(key),
                array=array.isel(dict(zip(axes, position, strict=True))),
            )


def too_many_in(data: xr.Dataset) -> list[str]:
    """Returns the names of variables with too many values per environment for columns."""
    return [str(key) for key, array in data.data_vars.items() if "env" in array.dims and not _is_shown(array)]


def _is_shown(array: xr.DataArray) -> bool:
    if "env" not in array.dims or array.dtype.kind not in "biuf":
        return False
    return _values_per_env(array) <= MOST or _values_per_env(merged_items(array)) <= MOST


def _values_per_env(array: xr.DataArray) -> int:
    """Returns the number of values per environment."""
    return int(np.prod([array.sizes[dim] for dim in array.dims if dim != "env"], initial=1))
