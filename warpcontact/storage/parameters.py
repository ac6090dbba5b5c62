"""Numeric parameters of a model: one value that all environments share, or one per environment.

``Field`` holds the values of one quantity for all items (all bodies' masses) on the host in float64;
``Parameter`` is a named view of items of it (``ball.mass``); ``DeviceField`` is a device array computed from fields;
``Parameters`` collects both while a model is built. Values that all environments share are stored once on the device,
with stride 0 over the environments.
"""

import dataclasses
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels.catalogue.device_model import as_numbers, check_values
from warpcontact.storage.allocation_plan import broadcast, row_bytes
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.system.resources import HOST
from warpcontact.validation import checks
from warpcontact.validation.checks import Array


class Field:
    """Values of one quantity, (1 or envs, items, ...).

    Attributes:
        values: The values.
        shared: Whether all environments of the model share the values. Needed, because one row may also belong to a
            part with one environment.
    """

    def __init__(self, values: Array) -> None:
        """Creates a field of ``values`` (items, ...) that all environments share."""
        self.values = np.array(values, dtype=np.float64)[None]
        self.shared = True

    def assign(self, items: slice, values: Array, envs: int, *, shared: bool) -> None:
        """Sets ``items`` to ``values`` (1 or envs, 1 or items, ...), in all environments if ``shared``."""
        if self.shared and not shared:
            self.values = np.repeat(self.values, envs, axis=0)
            self.shared = False
        self.values[:, items] = values

    def copy(self) -> "Field":
        """Returns a copy, for ``restore``."""
        copied = Field(self.values[0])
        copied.values, copied.shared = self.values.copy(), self.shared
        return copied

    def restore(self, earlier: "Field") -> None:
        """Restores values from ``earlier``, a copy."""
        self.values, self.shared = earlier.values, earlier.shared


@dataclass(frozen=True)
class Parameter:
    """A named quantity of one element.

    Args:
        name: ``<element>.<quantity>``.
        field: Field with its values.
        items: Its items of the field.
        limits: Unit and allowed range, see ``check_values``.
        tail: Shape of one value, () for a number.
        single: Whether it has no item axis.
        whole: Whether its values are integers.
        convert: Converts checked values (..., *given) to stored values, or raises ``ValueError``.
        given: Allowed shapes of one user value, if they differ from ``tail``.
        device_fields: Device fields to upload when it changes.
    """

    name: str
    field: Field
    items: slice
    limits: Mapping[str, Any]
    tail: tuple[int, ...] = ()
    single: bool = True
    whole: bool = False
    convert: Callable[[str, Array], Array] | None = None
    given: tuple[tuple[int, ...], ...] = ()
    device_fields: "list[DeviceField]" = dataclasses.field(default_factory=list)

    @property
    def count(self) -> int:
        """Number of items."""
        return self.items.stop - self.items.start

    @property
    def values(self) -> Array:
        """Values as a view (1 or envs, items, *tail): one row if all environments share them."""
        return self.field.values[:, self.items]

    def parse(self, value: ArrayLike, envs: int) -> Array:
        """Returns ``value`` checked, with shape (1 or envs, 1 or items, *tail).

        Raises:
            ValueError: If the shape is that of neither one value nor one per environment, or a value is out of range.
        """
        given = as_numbers(value)
        if given is None and self.convert is checks.switches:
            given = _as_switches(value)
        if given is None:
            raise ValueError(f"{self.name} must be numeric, got {value!r}")
        values = given.astype(np.float64)
        found = []
        for tail in self.given or (self.tail,):
            lead = values.shape[: values.ndim - len(tail)]
            if values.shape[len(lead) :] != tail:
                continue
            if lead == ():
                shaped = values[None, None]
            elif lead == (envs,):
                shaped = values[:, None]
                if not self.single and envs == self.count > 1:
                    # One value per item, the same in all environments, has this shape, too.
                    found.append(values[None])
            elif not self.single and lead in ((1, self.count), (envs, self.count), (envs, 1)):
                shaped = values
            else:
                continue
            found.append(shaped)
        if len(found) > 1:
            raise ValueError(
                f"{self.name} of shape {values.shape} is ambiguous: one row for all environments, or one per "
                f"environment; use shape {(envs, *self.tail) if self.single else (envs, self.count, *self.tail)}"
            )
        if found:
            check_values(self.name, values, self.limits)
            if self.whole:
                checks.integers(self.name, values)
            return self.convert(self.name, found[0]) if self.convert else found[0]
        raise ValueError(
            f"{self.name} must have shape {' or '.join(str(s) for s in self._shapes(envs))}, got {values.shape}"
        )

    def _shapes(self, envs: int) -> list[tuple[int, ...]]:
        leads: list[tuple[int, ...]] = [(), (envs,)]
        if not self.single:
            leads += [(1, self.count), (envs, self.count)]
        return [lead + tail for tail in (self.given or (self.tail,)) for lead in leads]

    def read(self, envs: int) -> Array:
        """Returns a view (envs, *tail), or (envs, items, *tail) for a set."""
        values = np.broadcast_to(self.values, (envs, *self.values.shape[1:]))
        return values[:, 0] if self.single else values

    def widening(self, envs: int) -> list[MemoryItem]:
        """Returns the additional memory of separate values for ``envs`` environments that share one value now."""
        row = row_bytes(self.field.values)
        memory_items = [MemoryItem("parameters", HOST, envs * row, row)]
        for device_field in self.device_fields:
            if not device_field.wide:
                memory_items.append(
                    MemoryItem("parameters", str(device_field.device), *device_field.size(envs, varied=True))
                )
        return memory_items


def _as_switches(value: ArrayLike) -> NDArray[Any] | None:
    """Returns ``value`` as an array of booleans, or ``None`` if it contains anything else."""
    try:
        given = np.asarray(value)
    except ValueError:  # rows of different length
        return None
    return given if given.dtype == bool else None


class DeviceField:
    """A device array of a struct, computed from fields.

    Args:
        struct: Instance of a Warp struct.
        attribute: Name of its array attribute, ``[env, item]``.
        dtype: Warp type of the elements.
        compute: Returns the content as NumPy array (1 or envs, items, ...).
        device: Device of the array.
        items: Number of items that share the single item of the content. ``None``: items are not shared.
    """

    def __init__(
        self,
        struct: Any,
        attribute: str,
        dtype: Any,
        compute: Callable[[], NDArray[Any]],
        device: wp.Device,
        items: int | None = None,
    ) -> None:
        self.struct = struct
        self.attribute = attribute
        self.dtype = dtype
        self.compute = compute
        self.device = device
        self.items = items
        self._memory: wp.array | None = None
        self._row_bytes: int | None = None

    @property
    def wide(self) -> bool:
        """Whether environments have separate values."""
        return self._memory is not None and self._memory.shape[0] > 1

    def size(self, envs: int, varied: bool = False) -> tuple[int, int]:
        """Returns the size of the array and its size per environment [bytes].

        Args:
            envs: Number of environments.
            varied: Whether to assume separate values per environment.
        """
        if self._row_bytes is None:
            self._row_bytes = row_bytes(self.compute())
        own = varied or self.wide
        return (envs if own else 1) * self._row_bytes, self._row_bytes if own else 0

    def content(self) -> NDArray[Any]:
        """Returns the content for the current values of the fields.

        Raises:
            ValueError: If a value is out of range for the precision of the device.
        """
        return np.ascontiguousarray(self.compute())

    def upload(self, content: NDArray[Any], envs: int) -> bool:
        """Copies ``content`` to the device, for ``envs`` environments; returns whether the array was reallocated.

        Prepared launches must be rebuilt then.
        """
        if self._memory is not None and self._memory.shape == content.shape[:2]:
            self._memory.assign(content)
            return False
        self._memory = wp.array(content, dtype=self.dtype, device=self.device)
        setattr(self.struct, self.attribute, broadcast(self._memory, envs, self.items))
        return True


@dataclass(frozen=True)
class ContactTolerance:
    """Gaps below which contacts are closed: 0, or the tolerance of nonsmooth contact. Not a user parameter.

    Attributes:
        field: Field with the gaps [m].
        device_field: Their device field.
    """

    field: Field
    device_field: DeviceField

    def assign(self, items: NDArray[np.int_], gap: float) -> None:
        """Sets ``items`` to ``gap`` [m]; ``device_field`` must be uploaded afterwards."""
        self.field.values[:, items] = gap


class Parameters:
    """The parameters and device fields of a model while it is planned.

    Args:
        device: Device of the arrays.
        real: Warp type of a real number on the device.
    """

    def __init__(self, device: wp.Device, real: type) -> None:
        self.device = device
        self.real = wp.dtype_to_numpy(real)
        self.by_name: dict[str, Parameter] = {}
        self.device_fields: list[DeviceField] = []

    def device_field(
        self,
        struct: Any,
        attribute: str,
        dtype: Any,
        compute: Callable[[], NDArray[Any]],
        items: int | None = None,
    ) -> DeviceField:
        """Adds a device field of ``struct``; real numbers are rounded to the precision of the device.

        Arguments are those of ``DeviceField``.
        """

        def content() -> NDArray[Any]:
            values = compute()
            return rounded(attribute, values, self.real) if values.dtype.kind == "f" else values

        device_field = DeviceField(struct, attribute, dtype, content, self.device, items)
        self.device_fields.append(device_field)
        return device_field

    def add(
        self,
        name: str,
        field: Field,
        items: slice,
        allowed: Mapping[str, Any],
        device_fields: list[DeviceField],
        **options: Any,
    ) -> None:
        """Adds a parameter; ``options`` are those of ``Parameter``."""
        self.by_name[name] = Parameter(name, field, items, allowed, device_fields=device_fields, **options)


def parameter_memory(
    parameters: Mapping[str, Parameter], device_fields: list[DeviceField], envs: int, varied: Collection[str] = ()
) -> list[MemoryItem]:
    """Returns the memory of parameters: values on the host and device fields.

    Args:
        parameters: The parameters by name.
        device_fields: All device fields.
        envs: Number of environments.
        varied: Names of parameters with separate values per environment.
    """
    fields = {id(parameter.field): parameter.field for parameter in parameters.values()}
    wide_fields = {id(parameters[name].field) for name in varied}
    wide_uploads = {id(device_field) for name in varied for device_field in parameters[name].device_fields}
    memory_items = []
    for key, field in fields.items():
        row, own = row_bytes(field.values), key in wide_fields or not field.shared
        memory_items.append(MemoryItem("parameters", HOST, (envs if own else 1) * row, row if own else 0))
    for device_field in device_fields:
        memory_items.append(
            MemoryItem(
                "parameters", str(device_field.device), *device_field.size(envs, id(device_field) in wide_uploads)
            )
        )
    return memory_items


def pack(struct: Any, columns: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Returns a structured array for a Warp struct from one array (1 or envs, items, …) per field."""
    envs = max(len(column) for column in columns.values())
    items = max(column.shape[1] for column in columns.values())
    packed = np.zeros((envs, items), dtype=struct.numpy_dtype())
    for name, column in columns.items():
        packed[name] = rounded(name, column, packed.dtype[name].base)
    return packed


def rounded(name: str, values: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Returns ``values`` in the precision of the device.

    Raises:
        ValueError: If a finite value becomes infinite, or a nonzero one zero.
    """
    with np.errstate(over="ignore", under="ignore"):
        result = values.astype(dtype)
    lost = (np.isfinite(values) & ~np.isfinite(result)) | ((values != 0) & (result == 0))
    if lost.any():
        raise ValueError(f"{name}: {values[lost].flat[0]:g} does not fit into {np.dtype(dtype).name}")
    return result


def split(name: str, values: Array, dtype: Any) -> tuple[Array, Array]:
    """Returns ``values`` rounded to ``dtype``, and the rounding remainder, both as float64.

    Raises:
        ValueError: If a value is out of range for ``dtype``.
    """
    leading = rounded(name, values, dtype).astype(np.float64)
    with np.errstate(under="ignore"):
        return leading, (values - leading).astype(dtype).astype(np.float64)
