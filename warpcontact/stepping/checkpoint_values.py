"""Checks of checkpoint values by their meaning: clocks, states, parameters and external forces."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.device_model import check_values
from warpcontact.kernels.types import ENV_FROZEN
from warpcontact.storage.parameters import Field, Parameter
from warpcontact.validation import checks
from warpcontact.validation.safe_text import SafeTextError

if TYPE_CHECKING:
    from warpcontact.model.model import DeviceModel

# Tolerances: of the norm of stored quaternions, and of values that are normalized when they are set (relative).
UNIT_ROUNDING = 1.0e-3
CONVERTED_ROUNDING = 1.0e-9

_EXTERNAL = ("force", "torque")


class CheckpointError(SafeTextError):
    """Raised for a file that is no checkpoint, is damaged, or belongs to another simulation."""


def check_clocks(arrays: Mapping[str, NDArray[Any]], parts: int) -> None:
    """Raises ``CheckpointError`` unless ``elapsed`` and ``is_initial`` are valid for all parts of the model."""
    for name, dtype in (("elapsed", np.float64), ("is_initial", np.bool_)):
        found = arrays.get(name)
        if found is None or found.dtype != dtype or found.shape != (parts,):
            got = "nothing" if found is None else f"{found.dtype} of shape {found.shape}"
            raise CheckpointError(
                f"array {name!r} must be {dtype.__name__} of shape ({parts},), one per device, got {got}"
            )
    _check_times("elapsed", arrays["elapsed"])


def check_states(found: Mapping[str, NDArray[Any]]) -> None:
    """Raises ``CheckpointError`` unless clocks and states of all environments are valid.

    States of frozen environments are not checked. All others are finite, because a step to a non-finite state is
    not accepted.

    Args:
        found: ``status`` and ``time`` (envs,), and the arrays of the state (envs, bodies, …), by name.
    """
    _check_times("time", found["time"])
    active = found["status"] != ENV_FROZEN
    for name, values in found.items():
        if name.startswith("body_"):
            _raise_for_first(name, values, ~np.isfinite(values).all(axis=-1) & active[:, None], "finite")
    orientation = found["body_orientation"]
    with np.errstate(over="ignore", invalid="ignore"):
        long = np.abs(np.linalg.norm(orientation, axis=-1) - 1.0) > UNIT_ROUNDING
    _raise_for_first("body_orientation", orientation, long & active[:, None], "a unit quaternion (x, y, z, w)")


def _check_times(name: str, times: NDArray[Any]) -> None:
    _raise_for_first(name, times, ~(np.isfinite(times) & (times >= 0.0)), "a time of at least 0 s")


def _raise_for_first(name: str, values: NDArray[Any], invalid: NDArray[np.bool_], condition: str) -> None:
    """Raises ``CheckpointError`` for the first of ``values`` that is ``invalid``."""
    if invalid.any():
        index = tuple(np.argwhere(invalid)[0])
        entry = f"{name}[{', '.join(map(str, index))}]"
        raise CheckpointError(f"{entry} must be {condition}, got {values[index].tolist()}")


class ParameterValues:
    """Values of the parameters of one part of a model, and external forces that the user writes between steps.

    Args:
        part: The part.
        number: Its number among the parts.

    Attributes:
        part: The part.
        fields: Values of all parameters, each once.
        changed: Values of the file that differ from the current ones, by number of the field; after ``check``.
        external: External forces and torques of the file, if any; after ``check``.
    """

    def __init__(self, part: "DeviceModel", number: int) -> None:
        self.part = part
        self.fields = list({id(one.field): one.field for one in part.parameters.values()}.values())
        self.changed: dict[int, NDArray[np.float64]] = {}
        self.external: dict[str, NDArray[Any]] = {}
        self._number = number

    def saved(self) -> dict[str, NDArray[Any]]:
        """Returns the arrays to write to a file, by name."""
        arrays: dict[str, NDArray[Any]] = {self._name(key): field.values for key, field in enumerate(self.fields)}
        if self.part.external_exposed:
            for name in _EXTERNAL:
                arrays[self._external_name(name)] = self._external(name).numpy()
        return arrays

    def check(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Checks the values of a file and stores those that differ in ``changed`` and ``external``.

        Raises:
            CheckpointError: If a value is missing or not allowed.
        """
        for key, field in enumerate(self.fields):
            found = arrays.get(self._name(key))
            if found is None:
                raise CheckpointError(f"array {self._name(key)!r} is missing")
            shape = field.values.shape[1:]
            if (
                found.dtype != np.float64
                or found.shape[1:] != shape
                or found.shape[:1] not in ((1,), (self.part.envs,))
            ):
                raise CheckpointError(
                    f"array {self._name(key)!r} must be float64 of shape {(self.part.envs, *shape)} or "
                    f"{(1, *shape)}, got {found.dtype} of shape {found.shape}"
                )
            if not np.array_equal(field.values, found):
                self.changed[key] = found
        numbers = {id(field): key for key, field in enumerate(self.fields)}
        for parameter in self.part.parameters.values():
            values = self.changed.get(numbers[id(parameter.field)])
            if values is not None:
                _check_parameter(self.part, parameter, values[:, parameter.items])
        self._check_external(arrays)

    def _check_external(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        found = {name: arrays[full] for name in _EXTERNAL if (full := self._external_name(name)) in arrays}
        if not found:
            return
        shape = (self.part.envs, self.part.body_count, 3)
        real = np.dtype(wp.dtype_to_numpy(self.part.types.real))
        for name in _EXTERNAL:
            own = found.get(name)
            if own is None or own.dtype != real or own.shape != shape:
                raise CheckpointError(f"array {self._external_name(name)!r} must be {real} of shape {shape}")
            _raise_for_first(self._external_name(name), own, ~np.isfinite(own).all(axis=-1), "finite")
        self.external = found

    def set_host_fields(self) -> None:
        """Sets the fields on the host; ``upload`` must follow."""
        for key, values in self.changed.items():
            field = self.fields[key]
            field.shared = len(values) == 1 and (self.part.envs > 1 or field.shared)
            field.values = np.array(values)

    def contents(self) -> dict[Any, NDArray[Any]]:
        """Returns the values to upload, by device field.

        Raises:
            ValueError: If values are inconsistent, or out of range for the precision of the device.
        """
        changed = {id(self.fields[key]) for key in self.changed}
        device_fields = [
            device_field
            for parameter in self.part.parameters.values()
            if id(parameter.field) in changed
            for device_field in parameter.device_fields
        ]
        return {device_field: device_field.content() for device_field in dict.fromkeys(device_fields)}

    def upload(self, contents: Mapping[Any, NDArray[Any]]) -> None:
        """Copies ``contents`` and external forces to the device."""
        self.part.upload(contents.keys(), contents.values())
        for name, values in self.external.items():
            self._external(name).assign(values)

    def _name(self, key: int) -> str:
        return f"{self._number}/values/{key}"

    def _external_name(self, name: str) -> str:
        return f"{self._number}/external/{name}"

    def _external(self, name: str) -> wp.array:
        return getattr(self.part.external, name)


def set_values(parts: Iterable[ParameterValues]) -> None:
    """Sets the checked values of all parts of a model.

    Raises:
        CheckpointError: If values are inconsistent. The model is unchanged then.
    """
    parts = list(parts)
    before: list[tuple[Field, Field]] = [(field, field.copy()) for one in parts for field in one.fields]
    try:
        for one in parts:
            one.set_host_fields()
        contents = [one.contents() for one in parts]
    except ValueError as error:
        for field, earlier in before:
            field.restore(earlier)
        raise CheckpointError(str(error)) from None
    for one, content in zip(parts, contents, strict=True):
        one.upload(content)


def _check_parameter(part: "DeviceModel", parameter: Parameter, values: NDArray[np.float64]) -> None:
    """Raises ``CheckpointError`` unless ``values`` (1 or envs, items, …) are allowed for a parameter."""
    try:
        check_values(parameter.name, values, parameter.limits)
        if parameter.whole:
            checks.integers(parameter.name, values)
        part.check_value(parameter.name, values)
        converted = parameter.convert(parameter.name, values) if parameter.convert else values
    except ValueError as error:
        raise CheckpointError(str(error)) from None
    if np.abs(converted - values).max(initial=0.0) > CONVERTED_ROUNDING * np.abs(values).max(initial=0.0):
        raise CheckpointError(f"{parameter.name} must be normalized")
