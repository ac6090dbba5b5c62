"""Device data of contact couplings: effective area and closest approach of the contacts that a coupling consists of.

The forces are those of the contacts, which mesh contact computes. Kernels: ``kernels/couplings/contact_coupling.py``.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpcontact.forces.contact_coupling.step_warnings import contact_coupling_warnings
from warpcontact.forces.force_element import BuildContext, ForceElement, Need
from warpcontact.forces.sensor import Sensor, shape_in
from warpcontact.kernels.couplings import contact_coupling as kernels
from warpcontact.scene.elements import ENABLED, RANGE
from warpcontact.storage.allocation_plan import SENSOR_PURPOSE, AllocationPlan, per_env
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.validation import checks

if TYPE_CHECKING:
    from warpcontact.forces.contact_groups import ContactGroup
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.contact_coupling import ContactCoupling

NEED = "contact_couplings"
# name: (unit, meaning)
_FORCES = {
    "force": ("N", "force on the body of the first surface, world"),
    "torque": ("N·m", "moment of the force about its center of mass, world axes"),
}
_EXTREMES = {
    "effective_area": ("m²", "largest area in range since reset, as of the last step"),
    "minimum_distance": ("m", "smallest distance of a face in range since reset, as of the last step; NaN: none"),
}


class ContactCouplingSet(ForceElement):
    """All contact couplings of a model.

    Args:
        context: The model; its contacts are declared.
    """

    family = "contact coupling"
    reads_contacts = True

    def __init__(self, context: BuildContext) -> None:
        super().__init__()
        table, layout = context.contacts, context.layout
        self.couplings: Sequence[ContactCoupling] = table.couplings.all
        self._types = context.types
        self._extremes = layout.struct("contacts", self._types.CouplingExtremes, per_env(self.count))
        self._sets = kernels.CouplingSets()
        starts = np.cumsum([0] + [contact.set_count for contact in table.contacts])
        number = {contact: int(first) for contact, first in zip(table.contacts, starts, strict=False)}
        firsts = [number[coupling.contacts[0]] for coupling in self.couplings]
        counts = [len(coupling.contacts) for coupling in self.couplings]
        layout.constant("contacts", self._sets, "first", firsts, wp.int32)
        layout.constant("contacts", self._sets, "count", counts, wp.int32)
        # Contact groups with couplings, each with its first coupling and their number.
        members = [
            [
                contact
                for contact in table.contacts
                if group.first <= table.start_of[contact] < group.first + group.count
            ]
            for group in table.groups
        ]
        ranges = [table.couplings.range_of_contacts(contacts) for contacts in members]
        self._groups: list[tuple[ContactGroup, int, int]] = [
            (group, first, count) for group, (first, count) in zip(table.groups, ranges, strict=True) if count
        ]
        self._add_parameters(context)

    @property
    def count(self) -> int:
        """Number of couplings."""
        return len(self.couplings)

    def _add_parameters(self, context: BuildContext) -> None:
        """Adds the parameters that all contacts of a coupling share."""
        table, device_field = context.contacts, context.contacts.geometry_field
        for coupling in self.couplings:
            first, last = coupling.contacts[0], coupling.contacts[-1]
            items = slice(table.start_of[first], table.start_of[last] + last.count)
            name, fields = coupling.name, table.geometry
            context.parameters.add(f"{name}.effective_range", fields["radius"], items, RANGE, [device_field])
            context.parameters.add(
                f"{name}.enabled", fields["enabled"], items, ENABLED, [device_field], convert=checks.switches
            )

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launches that update the extremes with the contacts of the accepted step."""
        a, real = plan.model.arrays, self._types.real
        launches = []
        for group, first, count in self._groups:
            launches += plan.prepare(
                kernels.advance(group.contact_model.law, real, group.projected),
                count,
                status=a.status,
                model=a.model,
                state=state_in,
                contacts=a.contacts,
                active_contacts=a.active_contacts,
                sets=self._sets,
                first_coupling=first,
                first_contact=group.first,
                coefficients=group.coefficients.law,
                extremes=self._extremes,
            )
        return launches

    def reset_state(self, chosen: wp.array) -> None:
        """Clears the extremes in the environments of the mask ``chosen`` [env]."""
        kernel, shape = kernels.reset(self._types.real), (len(chosen), self.count)
        wp.launch(kernel, dim=shape, inputs=[chosen, self._extremes], device=chosen.device)

    def advice_needs_evaluation(self, model: "Environments", nonsmooth: "NonsmoothContacts | None") -> bool:
        """Returns true: the initial distance of surfaces is checked."""
        return True

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about step length, stopping distance and initial distance."""
        couplings = model.scene.contact_couplings
        return [sentence for one in couplings for sentence in contact_coupling_warnings(model, one, dt)]

    def needs(self) -> Mapping[str, Need]:
        """Returns the need of the total forces."""

        def declare(layout: AllocationPlan) -> Any:
            return layout.struct(SENSOR_PURPOSE, kernels.ContactCouplings, per_env(self.count))

        return {NEED: Need(declare, all_distances=True)}

    def measure(self, model: "DeviceModel", needs: Collection[str]) -> None:
        """Computes the total forces of the couplings from the last evaluated contacts."""
        if NEED not in needs:
            return
        a, kernel = model.arrays, kernels.measure(self._types.real)
        inputs, outputs = [a.model, a.state, a.contacts, self._sets], [self.measures[NEED]]
        wp.launch(kernel, dim=(model.envs, self.count), inputs=inputs, outputs=outputs, device=model.device)

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of the couplings."""
        for item, coupling in enumerate(self.couplings):
            for key, (unit, meaning) in _FORCES.items():
                array, shape = self._force(key, item), shape_in(kernels.ContactCouplings, key)
                yield Sensor(f"{coupling.name}.{key}", unit, meaning, array, needs=(NEED,), shape=shape)
            for key, (unit, meaning) in _EXTREMES.items():
                array, shape = self._extreme(key, item), shape_in(self._types.CouplingExtremes, key)
                yield Sensor(f"{coupling.name}.{key}", unit, meaning, array, shape=shape)

    def _force(self, attribute: str, item: int) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(self.measures[NEED], attribute)[:, item]

    def _extreme(self, attribute: str, item: int) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(self._extremes, attribute)[:, item]


def declare(context: BuildContext, elements: "Sequence[ContactCoupling]") -> list[ForceElement]:
    """Declares all contact couplings of a model."""
    return [ContactCouplingSet(context)]
