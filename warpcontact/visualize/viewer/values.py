"""Conversion of sensor and parameter values to text and of text to parameter values."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.drawing.reduction import merged_items
from warpcontact.model.environments import Environments
from warpcontact.validation.checks import Array

# Up to this number of values, all are listed. With more, their number and range are given.
MOST = 9


def value_text(values: Any, flags: dict[str, Any] | None = None) -> str:
    """Returns a value as text: numbers separated by commas, or names if ``flags`` has CF flag attributes."""
    array = np.asarray(values)
    if flags and "flag_values" in flags:
        names = dict(zip(flags["flag_values"], str(flags["flag_meanings"]).split(), strict=False))
        named = [names.get(int(one), str(one)) for one in array.reshape(-1)[:MOST]]
        return ", ".join(named) + (", …" if array.size > MOST else "")
    if array.dtype.kind not in "fiub":
        return ", ".join(map(str, array.reshape(-1)[:MOST]))
    if array.size > MOST:
        finite = array[np.isfinite(array)]
        span = f", {_number(finite.min())} to {_number(finite.max())}" if finite.size else ""
        return f"{array.size} numbers{span}"
    digits = 6 if array.size == 1 else 4
    return ", ".join(_number(one, digits) for one in array.reshape(-1))


def _number(value: Any, digits: int = 6) -> str:
    return f"{value:.{digits}g}" if isinstance(value, float | np.floating) else str(value)


def rows_of(data: xr.Dataset) -> list[tuple[str, str]]:
    """Returns each variable of the data of one environment as (name, value with unit)."""
    rows = []
    for name, array in data.data_vars.items():
        unit = str(array.attrs.get("units", ""))
        value = value_text(array.values, array.attrs)
        rows.append((str(name), f"{value} {unit}".strip() if unit not in ("", "-", "1") else value))
    return rows


def rows_of_parameters(data: xr.Dataset) -> list[tuple[str, str]]:
    """Returns the rows of parameters of one environment. A set has a single value if all its items are equal."""
    return rows_of(data.map(merged_items, keep_attrs=True))


class ParameterText:
    """Parameter of a model, read and written as text.

    Args:
        model: Model with the parameter.
        name: Name of the parameter.

    Raises:
        KeyError: If the model has no such parameter.
    """

    def __init__(self, model: Environments, name: str) -> None:
        self.model = model
        self.name = name
        self.parameter = model.find_parameter(name)

    @property
    def unit(self) -> str:
        """SI unit of the parameter."""
        return str(self.parameter.limits["unit"])

    @property
    def is_set(self) -> bool:
        """Whether the parameter has a value for each of several items."""
        return not self.parameter.single

    @property
    def is_initial(self) -> bool:
        """Whether the parameter is an initial value, which takes effect at the next reset."""
        return any(part.sets_initial_state(part.parameters[self.name]) for part in self.model.parts)

    def read(self, env: int, item: int | None = None) -> str:
        """Returns the value of an item; without ``item``, the common value of all items, or "" if they differ.

        Raises:
            ValueError: If the item does not exist.
        """
        values = self._values(env)
        if item is None:
            return _exact(values[0]) if (values == values[:1]).all() else ""
        self._check_item(item)
        return _exact(values[item])

    def write(self, env: int, text: str, item: int | None = None) -> None:
        """Sets the value of one item, or of all items, in one environment.

        Raises:
            ValueError: If the text is not a valid value. The model is unchanged then.
            MemoryError: If the values of all environments do not fit into memory.
        """
        numbers = self._parse(text)
        if item is not None:
            self._check_item(item)
        # With 0 environments, ``parse`` reads one value for all of them.
        value = self.parameter.parse(numbers, 0)[0, 0]
        current = np.array(self.model[self.name])
        values = current[:, None] if self.parameter.single else current
        values[env, slice(None) if item is None else item] = value
        self.model.assign(self.name, values)

    def _values(self, env: int) -> Array:
        values = self.model[self.name][env]
        return values[None] if self.parameter.single else values

    def _check_item(self, item: int) -> None:
        count = self.parameter.count
        if not 0 <= item < count:
            raise ValueError(f"{self.name} has items 0 to {count - 1}, got {item}")

    def _parse(self, text: str) -> NDArray[np.float64]:
        try:
            numbers = np.array([float(one) for one in text.replace(",", " ").replace(";", " ").split()])
        except ValueError:
            raise ValueError(f"{self.name} must be numbers, got {text[:80]!r}") from None
        shapes = self.parameter.given or (self.parameter.tail,)
        for shape in shapes:
            if numbers.size == int(np.prod(shape)):
                return numbers.reshape(shape)
        allowed = " or ".join(sorted({str(int(np.prod(shape))) for shape in shapes}))
        raise ValueError(
            f"{self.name} must be {allowed} number{'' if allowed == '1' else 's'}, got {numbers.size}"
        )


def _exact(values: Array) -> str:
    """Returns numbers as text that is parsed to the same values; a diagonal matrix as its diagonal."""
    if values.shape == (3, 3) and not (values - np.diag(np.diag(values))).any():
        values = np.diag(values)
    return ", ".join(
        f"{one:.15g}" if float(f"{one:.15g}") == one else repr(float(one)) for one in values.reshape(-1)
    )
