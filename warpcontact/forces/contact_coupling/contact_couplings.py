"""Device data of contact couplings: their contacts, parameters and extremes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpcontact.algebra.poses import transform_points
from warpcontact.kernels.couplings import contact_coupling as kernels
from warpcontact.kernels.types import Structs
from warpcontact.scene.elements import ENABLED, RANGE, Contact
from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import DeviceField, Field, Parameters
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.scene.contact_coupling import ContactCoupling

# Law parameter → name in the coupling. Parameters of friction models keep their names.
_OF_LAW = {"k1": "k1", "k2": "k2", "ramp": "damping_ramp"}


@dataclass(frozen=True)
class ContactCouplings:
    """All contact couplings, in the device order of their contacts.

    Attributes:
        all: The couplings.
        of: Coupling of each contact that belongs to one.
        contacts: All contacts of the scene in device order.
    """

    all: tuple["ContactCoupling", ...]
    of: Mapping[Contact, "ContactCoupling"]
    contacts: Sequence[Contact]

    @classmethod
    def order(cls, couplings: Sequence["ContactCoupling"], contacts: Sequence[Contact]) -> "ContactCouplings":
        """Returns ``couplings`` in the order of their ``contacts``."""
        of = {contact: coupling for coupling in couplings for contact in coupling.contacts}
        return cls(tuple(dict.fromkeys(of[contact] for contact in contacts if contact in of)), of, contacts)

    def range_of_contacts(self, contacts: Sequence[Contact]) -> tuple[int, int]:
        """Returns the index of the first coupling and the number of couplings of consecutive ``contacts``."""
        found = list(dict.fromkeys(self.of[contact] for contact in contacts if contact in self.of))
        return (self.all.index(found[0]) if found else 0), len(found)

    def share(self, fields: Mapping[Contact, dict[str, Field]]) -> set[Field]:
        """Makes the contacts of a coupling share one field per parameter, except the area; returns these fields."""
        shared: dict[tuple[ContactCoupling, str], Field] = {}
        for contact, own in fields.items():
            if contact not in self.of:
                continue
            for name, field in own.items():
                if name != "area":
                    first = Field(field.values[0, :1])
                    own[name] = shared.setdefault((self.of[contact], name), first)
        return set(shared.values())

    def aliases(self, contact: Contact, part: str, name: str) -> list[str]:
        """Returns the alternative names of a parameter of law or friction model of ``contact``."""
        coupling = self.of.get(contact)
        if coupling is None or contact is not coupling.contacts[0]:
            return []
        if part == "law":
            return [f"{coupling.name}.{_OF_LAW[name]}"] if name in _OF_LAW else []
        return [f"{coupling.name}.{part}.{name}"]

    def add_geometry(
        self,
        start_of: Mapping[Contact, int],
        fields: Mapping[str, Field],
        parameters: Parameters,
        device_field: DeviceField,
    ) -> None:
        """Adds the parameters that all contacts of a coupling share; their ``fields`` must exist."""
        for coupling in self.all:
            first, last = coupling.contacts[0], coupling.contacts[-1]
            items = slice(start_of[first], start_of[last] + last.count)
            parameters.add(f"{coupling.name}.effective_range", fields["radius"], items, RANGE, [device_field])
            parameters.add(
                f"{coupling.name}.enabled",
                fields["enabled"],
                items,
                ENABLED,
                [device_field],
                convert=checks.switches,
            )

    def declare(self, arrays: ModelArrays, layout: AllocationPlan, t: Structs) -> None:
        """Declares the arrays of extremes and of the contacts of couplings, if there are couplings."""
        if not self.all:
            return
        arrays.coupling_extremes = layout.struct("contacts", t.CouplingExtremes, per_env(len(self.all)))
        arrays.coupling_contacts = kernels.CouplingSets()
        sets = np.cumsum([0] + [contact.set_count for contact in self.contacts])
        number = {contact: int(first) for contact, first in zip(self.contacts, sets, strict=False)}
        firsts = [number[coupling.contacts[0]] for coupling in self.all]
        counts = [len(coupling.contacts) for coupling in self.all]
        layout.constant("contacts", arrays.coupling_contacts, "first", firsts, wp.int32)
        layout.constant("contacts", arrays.coupling_contacts, "count", counts, wp.int32)

    def upload_normals(self, model: object, point_count: int, parameters: Parameters, t: Structs) -> None:
        """Adds the device field of point normals, in their bodies, if a contact has ``facing="projected"``."""
        weighed = [
            (points, points.normals, parameters.by_name[f"{points.surface.name}.orientation"])
            for points in (contact.points for contact in self.contacts if contact.facing == "projected")
            if points.surface is not None and points.normals is not None
        ]
        if not weighed:
            return

        def normals() -> Array:
            envs = max(len(turn.field.values) for _, _, turn in weighed)
            values = np.zeros((envs, point_count, 3))
            for points, own, turn in weighed:
                items = slice(points.start, points.start + len(own))
                values[:, items] = transform_points(own, np.zeros(3), turn.field.values[:, turn.items.start])
            return values

        device_field = parameters.device_field(model, "point_normal", t.vec3, normals)
        for _, _, turn in weighed:
            if device_field not in turn.device_fields:
                turn.device_fields.append(device_field)
