"""Device data of a contact group with forces at all local minima of the distance (``minima="all"``)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.sensor import Sensor, shape_in
from warpcontact.kernels.contact.minima_records import minima_structs, slot_count
from warpcontact.scene.elements import GROUP_ANGLE, Contact, check_group_angle
from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.storage.parameters import DeviceField, Field, Parameters, pack
from warpcontact.storage.state_storage import COUNT
from warpcontact.validation.checks import Array

#: Kind of the items of sensors with one value per slot, see ``Sensor.items_of``.
MINIMUM = "minimum"
#: Sensors of the minima of a contact, one value per slot. name: (array, unit, meaning)
SLOT_SENSORS = {
    "minimum_penetration": ("penetration", "m", "penetration at each minimum, 0 in empty slots"),
    "minimum_normal": ("normal", "-", "unit normal at each minimum, out of the surface, world"),
    "minimum_normal_force": ("normal_force", "N", "normal force at each minimum, with its share"),
}
#: Sensors of a contact with minima.
CONTACT_SENSORS = {
    "force": ("results", "force", "N", "sum of the forces at all minima, on the point's body, world"),
    "center": (
        "results",
        "center",
        "m",
        "mean of the points K weighted by normal force, world; 0 without contact",
    ),
    "minimum_count": ("results", "count", "-", "number of minima within reach, also of those beyond max_minima"),
    "minimum_overflow": (
        "history",
        "overflow",
        "-",
        "number of steps with more than max_minima minima, since reset",
    ),
}


@dataclass(frozen=True)
class GroupMinima:
    """Minima of the contacts of a group.

    Attributes:
        room: Largest number of minima of a contact.
        slots: Number of slots of a contact for minima.
        settings: Owner of the array of parameters [env, contact of the group], ``settings.values``.
        history: Minima of the last accepted step, struct ``MinimaHistory``.
        results: Minima of the current step, struct ``MinimaResults``.
    """

    room: int
    slots: int
    settings: Any
    history: Any
    results: Any

    @property
    def inputs(self) -> dict[str, Any]:
        """Arguments of the force kernel."""
        return {"settings": self.settings.values, "minima": self.history, "results": self.results}


@dataclass
class _Settings:
    """Owner of the array of parameters; ``None`` before allocation."""

    values: Any = None


def declare_minima(
    contacts: list[Contact], room: int, layout: AllocationPlan, parameters: Parameters, real: type
) -> GroupMinima:
    """Declares the minima of the contacts of a group, and adds the parameters ``<contact>.group_angle``."""
    count, slots = sum(contact.count for contact in contacts), slot_count(room)
    MinimaSettings, MinimaHistory, MinimaResults = minima_structs(real)
    each, of_slots = per_env(count), per_env(count * slots)
    history = layout.struct("contacts", MinimaHistory, of_slots, ranges={"overflow": COUNT}, overflow=each)
    results = layout.struct(
        "contacts", MinimaResults, of_slots, transient=True, count=each, force=each, center=each
    )
    settings = _Settings()
    field = Field(np.concatenate([np.tile(contact.group_angle, (contact.count, 1)) for contact in contacts]))

    def content() -> NDArray[Any]:
        one, none = np.moveaxis(np.cos(field.values), -1, 0)
        return pack(MinimaSettings, {"cosine_one": one, "cosine_none": none})

    device_field = parameters.device_field(settings, "values", MinimaSettings, content)
    start = 0
    for contact in contacts:
        items = slice(start, start + contact.count)
        start = items.stop
        _add_angle(contact, field, items, device_field, parameters)
    return GroupMinima(room, slots, settings, history, results)


def _add_angle(
    contact: Contact, field: Field, items: slice, device_field: DeviceField, parameters: Parameters
) -> None:
    def check(name: str, values: Array) -> Array:
        check_group_angle(name, values)
        return values

    parameters.add(
        f"{contact.name}.group_angle",
        field,
        items,
        GROUP_ANGLE,
        [device_field],
        tail=(2,),
        single=contact.points.single,
        convert=check,
    )


def minima_sensors(contact: Contact, minima: GroupMinima, first: int, several: int) -> Iterator[Sensor]:
    """Yields the sensors of the minima of a contact.

    Args:
        contact: The contact.
        minima: Minima of its group.
        first: Index of its first item in the group.
        several: Number of its items; 0: a single point, without an item axis.
    """
    slots = contact.count * minima.slots
    of_slots = slice(first * minima.slots, first * minima.slots + slots)
    for key, (attribute, unit, meaning) in SLOT_SENSORS.items():
        yield Sensor(
            f"{contact.name}.{key}",
            unit,
            meaning,
            _column(minima, "results", attribute, of_slots),
            needs=("contacts",),
            items=slots,
            shape=shape_in(minima.results, attribute),
            items_of=MINIMUM,
        )
    own: int | slice = slice(first, first + contact.count) if several else first
    for key, (struct, attribute, unit, meaning) in CONTACT_SENSORS.items():
        yield Sensor(
            f"{contact.name}.{key}",
            unit,
            meaning,
            _column(minima, struct, attribute, own),
            needs=("contacts",) if struct == "results" else (),
            items=several,
            shape=shape_in(getattr(minima, struct), attribute),
        )


def _column(minima: GroupMinima, struct: str, attribute: str, own: int | slice) -> Callable[[Any], wp.array]:
    return lambda _: getattr(getattr(minima, struct), attribute)[:, own]
