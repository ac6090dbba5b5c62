"""Parameters and outcomes of the environments, number by number, as the table of a run has them."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.drawing.equal_items import merged_items
from warpcontact.model.flags import words_of

# Numbers of a variable in each environment that have columns; sets of bodies and points have more.
MOST = 12
# A variable of at most this size is read once, and not once for each of its numbers [bytes].
AT_ONCE = 256 * 2**20


@dataclass(frozen=True, eq=False)
class Column:
    """One number, or code, of each environment; read where its values are asked for.

    Attributes:
        name: Its name, of a vector with that of the component.
        unit: Its unit, ``"-"``: none.
        about: What it is.
        words: What codes mean; none: it is a number.
        variable: The variable that it is of.
        array: Its values (env,).
    """

    name: str
    unit: str
    about: str
    words: dict[int, str]
    variable: str
    array: xr.DataArray

    @property
    def values(self) -> NDArray[Any]:
        """Its values (env,): numbers as float64, codes as they are."""
        found = self.array.values
        return found if self.words else found.astype(np.float64)


def columns_of(data: xr.Dataset, without: Collection[str] = ()) -> Iterator[Column]:
    """Iterates over the columns of the variables (env, …) of ``data``, without some of these and those of sets."""
    for key, variable in data.data_vars.items():
        if key in without or not _is_shown(variable):
            continue
        array = merged_items(variable.compute() if variable.nbytes <= AT_ONCE else variable)
        axes = [str(dim) for dim in array.dims if dim != "env"]
        for place in np.ndindex(*(array.sizes[dim] for dim in axes)):
            labels = [
                str(array[dim].values[i]) if dim in array.coords else str(i)
                for dim, i in zip(axes, place, strict=True)
            ]
            yield Column(
                name=".".join([str(key), *labels]),
                unit=str(array.attrs.get("units", "-")),
                about=str(array.attrs.get("long_name", key)),
                words=words_of(array),
                variable=str(key),
                array=array.isel(dict(zip(axes, place, strict=True))),
            )


def too_many_in(data: xr.Dataset) -> list[str]:
    """Returns the names of the variables that have too many numbers in each environment for columns."""
    return [str(key) for key, array in data.data_vars.items() if "env" in array.dims and not _is_shown(array)]


def _is_shown(array: xr.DataArray) -> bool:
    if "env" not in array.dims or array.dtype.kind not in "biuf":
        return False
    return _values_per_env(array) <= MOST or _values_per_env(merged_items(array)) <= MOST


def _values_per_env(array: xr.DataArray) -> int:
    """Returns the number of values of each environment."""
    return int(np.prod([array.sizes[dim] for dim in array.dims if dim != "env"], initial=1))
