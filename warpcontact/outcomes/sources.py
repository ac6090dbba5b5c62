"""Sensors as outcomes, stop conditions and events look at them: found, checked, and brought to one form."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.checks import look_up
from warpcontact.kernels.outcomes.base import COMPONENTS, Source
from warpcontact.kernels.outcomes.source import EACH, SUM, Form
from warpcontact.looks import IN_PARTS
from warpcontact.sensors import AXES, Sensor

if TYPE_CHECKING:
    from warpcontact.draft import PartDraft
    from warpcontact.model import Model
    from warpcontact.unilateral.hard_contacts import HardContacts

#: Those of a contact with a mesh that are not computed where it is known to be far.
OF_NEAR = frozenset(("gap", "normal", "status", "point"))


@dataclass(frozen=True)
class Seen:
    """A source that was found.

    Attributes:
        source: What was asked for.
        sensor: The sensor.
        in_step: Whether it is there in every step.
        searches: Whether for that all contacts have to be looked at in every step.
        shown: Whether it is of a nonsmooth contact, which has to be shown first.
        owner: What to call who asked, in a message.
    """

    source: Source
    sensor: Sensor
    in_step: bool
    searches: bool
    shown: bool
    owner: str

    @property
    def items(self) -> int:
        """Number of items that have a result of their own."""
        return max(1, self.sensor.items) if self.source.items == EACH else 1

    @property
    def components(self) -> int:
        """Number of components that have a result of their own."""
        return 1 if self.source.component is not None or not self.sensor.shape else self.sensor.shape[0]

    @property
    def axis(self) -> str | None:
        """Name of the dimension of its components; ``None``: it has one."""
        return AXES[self.components][0] if self.components > 1 else None

    def form(self, real: type) -> Form:
        """Returns how its numbers become one; before there is an array of it, as if that were of ``real``."""
        items = SUM if self.sensor.total else self.source.items
        return Form(real, self.source.component == "norm", items)

    def view(self, arrays: SimpleNamespace) -> wp.array:
        """Returns what is looked at as an array of numbers (env, item, component)."""
        whole = self.sensor.array(arrays)
        scalar = getattr(whole.dtype, "_wp_scalar_type_", whole.dtype)
        size = wp.types.type_size_in_bytes(scalar)
        width = getattr(whole.dtype, "_length_", 1)
        first = COMPONENTS[self.source.component] if self.source.component is not None else None
        single = whole.ndim == 1
        view = wp.array(
            ptr=whole.ptr + (first or 0) * size,
            dtype=scalar,
            shape=(whole.shape[0], 1 if single else whole.shape[1], width if first is None else 1),
            strides=(whole.strides[0], size if single else whole.strides[1], size),
            device=whole.device,
            copy=False,
        )
        view.memory = whole  # which lives as long
        return view


class Finder:
    """Finds sources among the sensors of a model.

    Args:
        model: The model, or what is drawn up of it.
        hard: The contacts that are solved for impulses.
    """

    def __init__(self, model: "Model | PartDraft", hard: "HardContacts | None") -> None:
        self._sensors: Mapping[str, Sensor] = model.sensors
        self._scene = model.scene
        self._hard: Collection[str] = frozenset()
        if hard is not None:
            own = {one.name: one for one in hard.sensors()}
            self._sensors = {**model.sensors, **own}
            self._hard = hard.names
        self._meshed = {contact.name for contact in model.scene.contacts}
        self._single = [contact.name for contact in model.scene.contacts]
        self._single += [contact.name for contact in model.scene.shape_contacts]
        self._piled = {contact.name for contact in model.scene.particle_contacts}
        self._bodies = {body.name for body in model.scene.bodies}

    @property
    def hard(self) -> frozenset[str]:
        """Names of the contacts that are hard."""
        return frozenset(self._hard)

    def find(self, owner: str, source: Source) -> Seen:
        """Returns what is known of ``source``.

        Raises:
            KeyError: If there is no such sensor.
            ValueError: If it has no such component, no items, or is no vector.
        """
        from warpcontact.unilateral.hard_contacts import sensor_hint

        try:
            hint = partial(sensor_hint, scene=self._scene)
            sensor = look_up("sensor", source.name, self._sensors, hint=hint)
        except KeyError as error:
            raise KeyError(f"{owner}: {error.args[0]}") from None
        if len(sensor.shape) > 1:
            raise ValueError(f"{owner}: {source.name} is a matrix; take sensors of numbers or vectors")
        width = sensor.shape[0] if sensor.shape else 1
        at = COMPONENTS[source.component] if source.component is not None else 0
        if source.component is not None and (width == 1 or (at or 0) >= width):
            has = ", ".join([*map(repr, AXES[width][1]), "'norm'"]) if width > 1 else "no components"
            raise ValueError(f"{owner}: {source.name} has {has}, got component={source.component!r}")
        if source.items != EACH and not sensor.items:
            raise ValueError(f"{owner}: {source.name} is not of a set and takes no items, got {source.items!r}")
        element, _, quantity = source.name.rpartition(".")
        return Seen(
            source,
            sensor,
            in_step=self._lives(source.name),
            searches=element in self._meshed and quantity in OF_NEAR,
            shown=element in self._hard,
            owner=owner,
        )

    def find_in_step(self, owner: str, source: Source) -> Seen:
        """Returns the same of what is there in every step.

        Raises:
            KeyError: If there is no such sensor.
            ValueError: If it has no such component, or is not there in every step.
        """
        found = self.find(owner, source)
        if not found.in_step:
            element = source.name.rpartition(".")[0]
            others = [name for name in self._sensors if name.rpartition(".")[0] == element and self._lives(name)]
            listed = ", ".join(others) or f"those of {', '.join(sorted(self._meshed | self._bodies))}"
            raise ValueError(
                f"{owner}: {source.name} is not there in every step, and may only be Final; in every step there "
                f"are {listed}"
            )
        return found

    def find_number(self, owner: str, source: Source) -> Seen:
        """Returns the same of what is one number of an environment in every step.

        Raises:
            KeyError: If there is no such sensor.
            ValueError: If it is not one number, or not there in every step.
        """
        found = self.find_in_step(owner, source)
        if found.components > 1:
            known = ", ".join([*map(repr, AXES[found.components][1]), "'norm'"])
            raise ValueError(f"{owner}: {source.name} is a vector; say which component: {known}")
        if found.sensor.items and source.items == EACH:
            raise ValueError(f"{owner}: {source.name} is of a set; say items='sum', 'max' or 'min'")
        return found

    def indicator(self, owner: str, contact: str) -> Seen:
        """Returns what is above 0 where ``contact`` touches.

        Raises:
            ValueError: If it is no contact, or one whose touches have no place of their own.
        """
        quantity = "mode" if contact in self._hard else "penetration"
        name = f"{contact}.{quantity}"
        if contact not in self._single:
            what = "not a contact"
            if contact in self._piled:
                what = "a particle contact, the touches of which have no numbers"
            known = ", ".join(map(repr, self._single)) or "none here"
            raise ValueError(f"{owner}: {contact!r} is {what}; events are of {known}")
        return self.find_in_step(owner, Source(name))

    def _lives(self, name: str) -> bool:
        """Whether a sensor is there in every step; wrenches are without impulses until they are asked for."""
        sensor: Any = self._sensors.get(name)
        element, _, quantity = name.rpartition(".")
        if self._hard and element in self._bodies and quantity in ("force", "torque"):
            return False
        return sensor is not None and len(sensor.shape) < 2 and IN_PARTS.issuperset(sensor.needs)
