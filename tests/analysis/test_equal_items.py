"""Parameters of sets that are equal for all items are stored as one value, for any size of the set."""

import numpy as np
import pytest
import xarray as xr

from warpcontact.drawing import reduction
from warpcontact.drawing.colors import per_environment_number
from warpcontact.drawing.reduction import merged_items
from warpcontact.visualize.viewer.values import rows_of_parameters

ENVS, ITEMS = 6, 40


def parameter(*, item="item", axes=(), dtype=np.float64):
    """A parameter that varies between environments and is equal for all items; NaN in environment 1."""
    values = np.arange(ENVS, dtype=dtype).reshape(-1, *(1,) * (1 + len(axes)))
    values = np.broadcast_to(values, (ENVS, ITEMS, *(3 for _ in axes))).copy()
    if dtype == np.float64:
        values[1] = np.nan
    return xr.DataArray(values, {"env": np.arange(ENVS)}, ("env", item, *axes), attrs={"units": "m"})


@pytest.mark.parametrize("item", ["item", "feet.item"])
@pytest.mark.parametrize("axes", [(), ("axis",), ("row", "column")])
@pytest.mark.parametrize("block", [reduction.BLOCK, 1])
def test_equal_items_are_merged(item, axes, block, monkeypatch):
    monkeypatch.setattr(reduction, "BLOCK", block)
    array = parameter(item=item, axes=axes)
    merged = merged_items(array)
    assert merged.dims == ("env", *axes)
    assert merged.attrs == array.attrs
    np.testing.assert_array_equal(merged, array.isel({item: 7}))
    # One item of the last environment differs.
    array[-1, 7] = 0.5
    assert merged_items(array) is array
    assert merged_items(array.isel(env=slice(0, -1))).dims == ("env", *axes)


def test_dimensions_other_than_item_are_not_merged():
    array = xr.DataArray(np.zeros((ENVS, 3)), dims=("env", "axis"))
    assert merged_items(array) is array


def test_items_of_one_environment_are_merged():
    array = parameter(dtype=np.int32)
    assert merged_items(array.sel(env=4)).item() == 4
    array[4, 0] = 3
    rows = dict(rows_of_parameters(xr.Dataset({"mu": array}).sel(env=4)))
    assert rows == {"mu": "40 numbers, 3 to 4 m"}
    assert dict(rows_of_parameters(xr.Dataset({"mu": array}).sel(env=3))) == {"mu": "3 m"}


def test_item_comparison_stops_at_the_first_difference(monkeypatch):
    monkeypatch.setattr(reduction, "BLOCK", 1)
    array, blocks, isel = parameter(), [], xr.DataArray.isel
    array[2, 3] = 0.5
    monkeypatch.setattr(xr.DataArray, "isel", lambda self, *a, **k: (blocks.append(a), isel(self, *a, **k))[1])
    assert merged_items(array) is array
    assert [block[0]["env"].start for block in blocks] == [0, 1, 2]


def test_number_per_environment_is_found_for_any_item_dimension():
    array = parameter(item="feet.item", dtype=np.int32)
    np.testing.assert_array_equal(per_environment_number(array), np.arange(ENVS))
    assert per_environment_number(parameter(axes=("axis",))) is None
    over_time = array.expand_dims(time=2)
    assert per_environment_number(over_time) is None
