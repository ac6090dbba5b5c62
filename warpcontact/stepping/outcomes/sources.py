"""Resolves and checks the sensors of outcomes, stop conditions and events, and returns views of their arrays."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.sensor import AXES, Sensor
from warpcontact.kernels.outcomes.base import COMPONENTS, Source
from warpcontact.kernels.outcomes.source import EACH, SUM, SourceForm
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.validation.checks import find_entry

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import DeviceModel
    from warpcontact.model.plan import DeviceModelPlan

#: Sensors of a contact with a mesh that are not computed while the contact is culled.
NEAR_ONLY = frozenset(("gap", "normal", "status", "point"))


@dataclass(frozen=True)
class ResolvedSource:
    """A source with its sensor.

    Attributes:
        source: The requested source.
        sensor: The sensor.
        in_every_step: Whether the sensor is available in every step.
        needs_all_distances: Whether this requires the evaluation of all contacts in every step.
        is_nonsmooth: Whether it is a sensor of a nonsmooth contact, which is copied by ``show_stages`` first.
        owner: Name of the user of the source, for messages.
    """

    source: Source
    sensor: Sensor
    in_every_step: bool
    needs_all_distances: bool
    is_nonsmooth: bool
    owner: str

    @property
    def items(self) -> int:
        """Number of items with separate results."""
        return max(1, self.sensor.items) if self.source.items == EACH else 1

    @property
    def components(self) -> int:
        """Number of components with separate results."""
        return 1 if self.source.component is not None or not self.sensor.shape else self.sensor.shape[0]

    @property
    def axis(self) -> str | None:
        """Name of the dimension of the components; ``None``: one component."""
        return AXES[self.components][0] if self.components > 1 else None

    def form(self, real: type) -> SourceForm:
        """Returns the reduction of the source to a scalar; ``real`` is the assumed dtype before allocation."""
        items = SUM if self.sensor.total else self.source.items
        return SourceForm(real, self.source.component == "norm", items)

    def view(self, arrays: ModelArrays) -> wp.array:
        """Returns a view of the sensor's array as scalars (env, item, component)."""
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
        view.memory = array  # keeps the memory alive
        return view


class SourceResolver:
    """Finds sources among the sensors of a model.

    Args:
        model: The model, or its plan.
        nonsmooth: The nonsmooth contacts, if any.
    """

    def __init__(self, model: "DeviceModel | DeviceModelPlan", nonsmooth: "NonsmoothContacts | None") -> None:
        self._sensors: Mapping[str, Sensor] = model.sensors
        self._model, self._scene = model, model.scene
        self._nonsmooth: Collection[str] = frozenset()
        if nonsmooth is not None:
            own = {one.name: one for one in nonsmooth.sensors()}
            self._sensors = {**model.sensors, **own}
            self._nonsmooth = nonsmooth.names
        self._mesh_contacts = {contact.name for contact in model.scene.contacts}
        self._single_contacts = [contact.name for contact in model.scene.contacts]
        self._single_contacts += [contact.name for contact in model.scene.shape_contacts]
        self._body_contacts = {contact.name for contact in model.scene.body_contacts}
        self._single_contacts += self._body_contacts
        self._particle_contacts = {contact.name for contact in model.scene.particle_contacts}
        self._bodies = {body.name for body in model.scene.bodies}

    @property
    def nonsmooth(self) -> frozenset[str]:
        """Names of the nonsmooth contacts."""
        return frozenset(self._nonsmooth)

    def resolve(self, owner: str, source: Source) -> ResolvedSource:
        """Returns the resolved ``source``.

        Raises:
            KeyError: If the sensor does not exist.
            ValueError: If the sensor is a matrix, or has no such component or no items.
        """
        from warpcontact.forces.nonsmooth.sensors import sensor_hint

        try:
            hint = partial(sensor_hint, scene=self._scene)
            sensor = find_entry("sensor", source.name, self._sensors, hint=hint)
        except KeyError as error:
            raise KeyError(f"{owner}: {error.args[0]}") from None
        if len(sensor.shape) > 1:
            raise ValueError(f"{owner}: {source.name} is a matrix; use sensors that are scalars or vectors")
        width = sensor.shape[0] if sensor.shape else 1
        component = COMPONENTS[source.component] if source.component is not None else 0
        if source.component is not None and (width == 1 or (component or 0) >= width):
            has = ", ".join([*map(repr, AXES[width][1]), "'norm'"]) if width > 1 else "no components"
            raise ValueError(f"{owner}: {source.name} has {has}, got component={source.component!r}")
        if source.items != EACH and not sensor.items:
            raise ValueError(f"{owner}: {source.name} has no items, got items={source.items!r}")
        element, _, quantity = source.name.rpartition(".")
        return ResolvedSource(
            source,
            sensor,
            in_every_step=self._in_every_step(source.name),
            needs_all_distances=element in self._mesh_contacts and quantity in NEAR_ONLY,
            is_nonsmooth=element in self._nonsmooth,
            owner=owner,
        )

    def resolve_in_step(self, owner: str, source: Source) -> ResolvedSource:
        """Returns the resolved ``source``, which must be available in every step.

        Raises:
            KeyError: If the sensor does not exist.
            ValueError: If it has no such component, or is not available in every step.
        """
        found = self.resolve(owner, source)
        if not found.in_every_step:
            element = source.name.rpartition(".")[0]
            others = [
                name for name in self._sensors if name.rpartition(".")[0] == element and self._in_every_step(name)
            ]
            listed = ", ".join(others) or f"those of {', '.join(sorted(self._mesh_contacts | self._bodies))}"
            raise ValueError(
                f"{owner}: {source.name} is not computed in every step, so only Final can use it. Sensors of every "
                f"step: {listed}"
            )
        return found

    def resolve_scalar(self, owner: str, source: Source) -> ResolvedSource:
        """Returns the resolved ``source``, which must be one number per environment in every step.

        Raises:
            KeyError: If the sensor does not exist.
            ValueError: If it is not one number per environment, or not available in every step.
        """
        found = self.resolve_in_step(owner, source)
        if found.components > 1:
            known = ", ".join([*map(repr, AXES[found.components][1]), "'norm'"])
            raise ValueError(f"{owner}: {source.name} is a vector; set component to {known}")
        if found.sensor.items and source.items == EACH:
            raise ValueError(f"{owner}: {source.name} has several items; set items='sum', 'max' or 'min'")
        return found

    def contact_indicator(self, owner: str, contact: str) -> ResolvedSource:
        """Returns a source that is positive while ``contact`` is closed.

        Raises:
            ValueError: If it is no contact, or a particle contact, whose pairs have no fixed numbers.
        """
        quantity = "mode" if contact in self._nonsmooth else "penetration"
        if contact in self._body_contacts:
            quantity = "normal_force" if contact in self._nonsmooth else "area"
        name = f"{contact}.{quantity}"
        if contact not in self._single_contacts:
            what = "not a contact"
            if contact in self._particle_contacts:
                what = "a particle contact, whose contact pairs have no fixed numbers"
            known = ", ".join(map(repr, self._single_contacts)) or "none"
            raise ValueError(f"{owner}: {contact!r} is {what}; contacts that can have events: {known}")
        return self.resolve_in_step(owner, Source(name))

    def _in_every_step(self, name: str) -> bool:
        """Returns whether a sensor is available in every step.

        Body wrenches are not, with nonsmooth contact: impulses are added to them only in an evaluation.
        """
        sensor: Any = self._sensors.get(name)
        element, _, quantity = name.rpartition(".")
        if self._nonsmooth and element in self._bodies and quantity in ("force", "torque"):
            return False
        return sensor is not None and len(sensor.shape) < 2 and self._model.are_by_slice(sensor.needs)
