"""Sensors as outcomes, stop conditions and events look at them: found, checked, and brought to one form."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.kernels.outcomes.base import COMPONENTS, Source
from warpcontact.kernels.outcomes.source import EACH, SUM, SourceForm
from warpcontact.model.sensor_evaluation import SLICE_NEEDS
from warpcontact.model.sensors import AXES, Sensor
from warpcontact.validation.checks import find_entry

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import Model
    from warpcontact.model.plan import DeviceModelPlan

#: Those of a contact with a mesh that are not computed where it is known to be far.
NEAR_ONLY = frozenset(("gap", "normal", "status", "point"))


@dataclass(frozen=True)
class ResolvedSource:
    """A source that was found.

    Attributes:
        source: What was asked for.
        sensor: The sensor.
        in_every_step: Whether it is there in every step.
        needs_all_distances: Whether for that all contacts have to be looked at in every step.
        is_nonsmooth: Whether it is of a nonsmooth contact, which has to be shown first.
        owner: What to call who asked, in a message.
    """

    source: Source
    sensor: Sensor
    in_every_step: bool
    needs_all_distances: bool
    is_nonsmooth: bool
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

    def form(self, real: type) -> SourceForm:
        """Returns how its numbers become one; before there is an array of it, as if that were of ``real``."""
        items = SUM if self.sensor.total else self.source.items
        return SourceForm(real, self.source.component == "norm", items)

    def view(self, arrays: SimpleNamespace) -> wp.array:
        """Returns what is looked at as an array of numbers (env, item, component)."""
        array = self.sensor.array(arrays)
        scalar = getattr(array.dtype, "_wp_scalar_type_", array.dtype)
        size = wp.types.type_size_in_bytes(scalar)
        width = getattr(array.dtype, "_length_", 1)
        first = COMPONENTS[self.source.component] if self.source.component is not None else None
        single = array.ndim == 1
        view = wp.array(
            ptr=array.ptr + (first or 0) * size,
            dtype=scalar,
            shape=(array.shape[0], 1 if single else array.shape[1], width if first is None else 1),
            strides=(array.strides[0], size if single else array.strides[1], size),
            device=array.device,
            copy=False,
        )
        view.memory = array  # which lives as long
        return view


class SourceResolver:
    """Finds sources among the sensors of a model.

    Args:
        model: The model, or what is drawn up of it.
        nonsmooth: The contacts that are solved for impulses.
    """

    def __init__(self, model: "Model | DeviceModelPlan", nonsmooth: "NonsmoothContacts | None") -> None:
        self._sensors: Mapping[str, Sensor] = model.sensors
        self._scene = model.scene
        self._hard: Collection[str] = frozenset()
        if nonsmooth is not None:
            own = {one.name: one for one in nonsmooth.sensors()}
            self._sensors = {**model.sensors, **own}
            self._hard = nonsmooth.names
        self._mesh_contacts = {contact.name for contact in model.scene.contacts}
        self._single_contacts = [contact.name for contact in model.scene.contacts]
        self._single_contacts += [contact.name for contact in model.scene.shape_contacts]
        self._particle_contacts = {contact.name for contact in model.scene.particle_contacts}
        self._bodies = {body.name for body in model.scene.bodies}

    @property
    def nonsmooth(self) -> frozenset[str]:
        """Names of the contacts that are hard."""
        return frozenset(self._hard)

    def resolve(self, owner: str, source: Source) -> ResolvedSource:
        """Returns what is known of ``source``.

        Raises:
            KeyError: If there is no such sensor.
            ValueError: If it has no such component, no items, or is no vector.
        """
        from warpcontact.forces.nonsmooth.contacts import sensor_hint

        try:
            hint = partial(sensor_hint, scene=self._scene)
            sensor = find_entry("sensor", source.name, self._sensors, hint=hint)
        except KeyError as error:
            raise KeyError(f"{owner}: {error.args[0]}") from None
        if len(sensor.shape) > 1:
            raise ValueError(f"{owner}: {source.name} is a matrix; take sensors of numbers or vectors")
        width = sensor.shape[0] if sensor.shape else 1
        component = COMPONENTS[source.component] if source.component is not None else 0
        if source.component is not None and (width == 1 or (component or 0) >= width):
            has = ", ".join([*map(repr, AXES[width][1]), "'norm'"]) if width > 1 else "no components"
            raise ValueError(f"{owner}: {source.name} has {has}, got component={source.component!r}")
        if source.items != EACH and not sensor.items:
            raise ValueError(f"{owner}: {source.name} is not of a set and takes no items, got {source.items!r}")
        element, _, quantity = source.name.rpartition(".")
        return ResolvedSource(
            source,
            sensor,
            in_every_step=self._in_every_step(source.name),
            needs_all_distances=element in self._mesh_contacts and quantity in NEAR_ONLY,
            is_nonsmooth=element in self._hard,
            owner=owner,
        )

    def resolve_in_step(self, owner: str, source: Source) -> ResolvedSource:
        """Returns the same of what is there in every step.

        Raises:
            KeyError: If there is no such sensor.
            ValueError: If it has no such component, or is not there in every step.
        """
        found = self.resolve(owner, source)
        if not found.in_every_step:
            element = source.name.rpartition(".")[0]
            others = [
                name for name in self._sensors if name.rpartition(".")[0] == element and self._in_every_step(name)
            ]
            listed = ", ".join(others) or f"those of {', '.join(sorted(self._mesh_contacts | self._bodies))}"
            raise ValueError(
                f"{owner}: {source.name} is not there in every step, and may only be Final; in every step there "
                f"are {listed}"
            )
        return found

    def resolve_scalar(self, owner: str, source: Source) -> ResolvedSource:
        """Returns the same of what is one number of an environment in every step.

        Raises:
            KeyError: If there is no such sensor.
            ValueError: If it is not one number, or not there in every step.
        """
        found = self.resolve_in_step(owner, source)
        if found.components > 1:
            known = ", ".join([*map(repr, AXES[found.components][1]), "'norm'"])
            raise ValueError(f"{owner}: {source.name} is a vector; say which component: {known}")
        if found.sensor.items and source.items == EACH:
            raise ValueError(f"{owner}: {source.name} is of a set; say items='sum', 'max' or 'min'")
        return found

    def contact_indicator(self, owner: str, contact: str) -> ResolvedSource:
        """Returns what is above 0 where ``contact`` touches.

        Raises:
            ValueError: If it is no contact, or one whose touches have no place of their own.
        """
        quantity = "mode" if contact in self._hard else "penetration"
        name = f"{contact}.{quantity}"
        if contact not in self._single_contacts:
            what = "not a contact"
            if contact in self._particle_contacts:
                what = "a particle contact, the touches of which have no numbers"
            known = ", ".join(map(repr, self._single_contacts)) or "none here"
            raise ValueError(f"{owner}: {contact!r} is {what}; events are of {known}")
        return self.resolve_in_step(owner, Source(name))

    def _in_every_step(self, name: str) -> bool:
        """Whether a sensor is there in every step; wrenches are without impulses until they are asked for."""
        sensor: Any = self._sensors.get(name)
        element, _, quantity = name.rpartition(".")
        if self._hard and element in self._bodies and quantity in ("force", "torque"):
            return False
        return sensor is not None and len(sensor.shape) < 2 and SLICE_NEEDS.issuperset(sensor.needs)
