"""Contact of points and spheres with meshes as a force element.

The contacts are those of the contact table (``contact_table.py``). Kernels: ``kernels/broadphase``,
``kernels/narrowphase``, ``kernels/contact``.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.contact_groups import ContactGroup
from warpcontact.forces.contact_minima import MINIMUM, minima_sensors
from warpcontact.forces.execution_plan import detection_stages, fused_contact_stages
from warpcontact.forces.force_element import BuildContext, ForceElement, ForceTarget, Need
from warpcontact.forces.mesh_contact.crease_warnings import crease_warnings
from warpcontact.forces.mesh_contact.step_warnings import contacts_to_evaluate, mesh_contact_warnings
from warpcontact.forces.sensor import CONTACT_SENSORS, Sensor, shape_in
from warpcontact.kernels.acceptance import reset
from warpcontact.kernels.contact import history, minima_history
from warpcontact.kernels.outcomes import body_measures
from warpcontact.scene.elements import MOST_MINIMA, Contact
from warpcontact.scene.status import ContactStatus
from warpcontact.storage.allocation_plan import SENSOR_PURPOSE, AllocationPlan, per_env
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments

# Bytes of a contact in the cache of a core; measured.
CONTACT_BYTES = 300
# Sensors that are defined also without contact, which requires a search.
_OF_FAR = ("gap", "normal", "status")
# name: (array, unit, meaning)
_SWEPT = {
    "crossings": ("crossings", "-", "number of steps within which the point crossed the surface, since reset"),
    "crossing_time": ("crossing_time", "s", "time of the first crossing since reset; NaN: none"),
}


class MeshContact(ForceElement):
    """All contacts of points and spheres with meshes.

    Args:
        context: The model; its contacts are declared.
        contacts: The contacts, in the order of the scene.
    """

    family = "mesh contact"
    target = ForceTarget.CLUSTERS
    fused = True

    def __init__(self, context: BuildContext, contacts: Sequence[Contact]) -> None:
        super().__init__()
        self._contacts = contacts
        self._table = context.contacts
        self._arrays, self._types = context.arrays, context.types
        self._count = sum(contact.count for contact in contacts)

    @property
    def contact_count(self) -> int:
        """Number of contacts per environment."""
        return self._count

    @property
    def cache_bytes(self) -> int:
        """Estimate of the memory that a step accesses per environment [bytes]."""
        return CONTACT_BYTES * self._count

    def compile(self, device: wp.Device) -> None:
        """Compiles force kernels with user-defined laws or friction models, to report errors early.

        Raises:
            TypeError: If a law or friction model does not compile.
        """
        for group in self._table.groups:
            group.compile(device)

    def detection_launches(self, plan: "ExecutionPlan", state: Any, status: wp.array) -> list[wp.Launch]:
        """Returns the launches of broad and narrow phase; none if a fused kernel includes them."""
        if state is plan.evaluated_state or plan.shape.fuses_contact:
            return []
        return detection_stages(plan, state, status)

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launches of the contact forces, one per contact group; nonsmooth contacts have no force."""
        a = plan.model.arrays
        ordered_sum = plan.ordered_sum or by_cluster
        fuses_contact = plan.shape.fuses_contact and state is not plan.evaluated_state
        launches = []
        for group in self._table.groups:
            if fuses_contact:
                launches += fused_contact_stages(plan, group, state, step, status, ordered_sum=ordered_sum)
                continue
            clusters = [(group.first_cluster, group.cluster_count)]
            for first_cluster, count in (
                clusters if plan.nonsmooth is None else plan.nonsmooth.compliant_clusters(group)
            ):
                own = (
                    {"history": a.history, "write_outputs": plan.write_outputs}
                    if group.minima is None
                    else group.minima.inputs
                )
                launches += plan.prepare(
                    group.kernel,
                    count,
                    status=status,
                    model=a.model,
                    state=state,
                    step=step,
                    first_cluster=first_cluster,
                    first_contact=group.first,
                    contacts=a.contacts,
                    active_contacts=a.active_contacts,
                    ordered=ordered_sum,
                    wrenches=a.wrenches,
                    **own,
                    **group.material_inputs,
                )
        return launches

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launches that advance minima, and the history variables of laws and friction models."""
        a, real, launches = plan.model.arrays, self._types.real, []
        for group in self._table.groups:
            inputs = {
                "status": a.status,
                "model": a.model,
                "active_contacts": a.active_contacts,
                "first_cluster": group.first_cluster,
                "first_contact": group.first,
            }
            for formula, history_in, history_out in group.histories():
                kernel = (
                    history.material_history_kernel(formula, real)
                    if group.minima is None
                    else minima_history.advance_material_history(formula, real, group.minima.room)
                )
                launches += plan.prepare(
                    kernel, group.cluster_count, history_in=history_in, history_out=history_out, **inputs
                )
            if group.minima is not None:
                kernel = minima_history.advance(real, group.minima.room)
                own = {"minima": group.minima.history, "results": group.minima.results}
                launches += plan.prepare(kernel, group.cluster_count, **own, **inputs)
        return launches

    def reset_state(self, chosen: wp.array) -> None:
        """Clears minima and history variables in the environments of the mask ``chosen`` [env]."""
        for group in self._table.groups:
            if group.minima is not None:
                wp.launch(
                    minima_history.reset(self._types.real, group.minima.room),
                    dim=(len(chosen), group.count),
                    inputs=[chosen, group.minima.history, group.minima.results],
                    device=chosen.device,
                )
            for formula, history_in, _ in group.histories():
                wp.launch(
                    reset.memory(formula, self._types.real),
                    dim=(len(chosen), group.history_count),
                    inputs=[chosen, history_in],
                    device=chosen.device,
                )

    def restore_caches(self) -> None:
        """Clears the crossed faces; −1 because 0 is a valid face."""
        self._arrays.contacts.crossed_face.fill_(-1)

    def advice_needs_evaluation(self, model: "Environments", nonsmooth: "NonsmoothContacts | None") -> bool:
        """Returns whether any initial penetration must be evaluated."""
        return bool(contacts_to_evaluate(model, nonsmooth))

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about step length, friction and initial penetration."""
        return mesh_contact_warnings(model, dt, nonsmooth)

    def final_warnings(self, model: "Environments") -> list[RunWarning]:
        """Returns the warnings about spheres in creases."""
        return crease_warnings(model, self._table.start_of)

    def failures(self) -> dict[str, NDArray[np.int32]]:
        """Returns the number of steps since reset with more minima than room, (envs,) by contact; of a set, the maximum."""
        found = {}
        for contact in self._contacts:
            group, first = self._group_of(contact)
            if group.minima is not None:
                overflow = group.minima.history.overflow.numpy()[:, first : first + contact.count]
                found[contact.name] = overflow.max(axis=1)
        return found

    def failure_warning(self, name: str, count: int, envs: int, first: int) -> RunWarning:
        """Returns a warning that a sphere had more minima than room."""
        contact = next(one for one in self._contacts if one.name == name)
        text = (
            f"{name}: a sphere had more than max_minima = {contact.max_minima} minima in {count} of {envs} environments "
            f"(first: {first}). The deepest acted. Increase max_minima, at most {MOST_MINIMA}, or use a coarser mesh; "
            f"{name}.minimum_overflow counts such steps"
        )
        return RunWarning(text, WarningLevel.CAUTION)

    def _group_of(self, contact: Contact) -> tuple[ContactGroup, int]:
        """Returns the group of a contact, and the index of its first item there."""
        start = self._table.start_of[contact]
        group = next(one for one in self._table.groups if one.first <= start < one.first + one.count)
        return group, start - group.first

    def needs(self) -> Mapping[str, Need]:
        """Returns the need of contact points."""

        def declare(layout: AllocationPlan) -> Any:
            return layout.struct(SENSOR_PURPOSE, body_measures.Points, per_env(self._count))

        return {"points": Need(declare, by_slice=True, all_distances=True)}

    def sensor_launches(
        self, plan: "ExecutionPlan", needs: Collection[str], state: Any, status: wp.array
    ) -> list[wp.Launch]:
        """Returns the launch that computes the contact points."""
        if "points" not in needs:
            return []
        a = plan.model.arrays
        return plan.prepare(
            body_measures.points(self._types.real),
            self._count,
            status=status,
            model=a.model,
            state=state,
            contacts=a.contacts,
            measured=self.measures.get("points"),
        )

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of the contacts."""
        for contact in self._contacts:
            yield from self._sensors_of(contact)

    def _sensors_of(self, contact: Contact) -> Iterator[Sensor]:
        single, start, name = contact.points.single, self._table.start_of[contact], contact.name
        own: int | slice = start if single else slice(start, start + contact.count)
        several = 0 if single else contact.count
        meaning, shape = "point K where the force acts, world", shape_in(body_measures.Points, "position")
        yield Sensor(
            f"{name}.point", "m", meaning, self._point(own), needs=("points",), items=several, shape=shape
        )
        for key, (attribute, unit, meaning) in CONTACT_SENSORS.items():
            codes = ContactStatus if key == "status" else None
            needs = ("contacts", "all_distances") if key in _OF_FAR else ("contacts",)
            options: dict[str, Any] = {"needs": needs, "items": several, "codes": codes}
            shape = shape_in(self._types.Contacts, attribute)
            yield Sensor(
                f"{name}.{key}", unit, meaning, _column("contacts", attribute, own), shape=shape, **options
            )
        group, first = self._group_of(contact)
        in_group: int | slice = first if single else slice(first, first + contact.count)
        items_of = ""
        if group.minima is not None:
            items_of = MINIMUM
            yield from minima_sensors(contact, group.minima, first, several)
            histories = contact.count * group.minima.slots
            in_group, several = (
                slice(first * group.minima.slots, first * group.minima.slots + histories),
                histories,
            )
        for part, formula in contact.material.formulas.items():
            for key, memory in formula.memories.items():
                frame = ", axes of the surface" if memory.tangent else ""
                meaning = f"{memory.meaning}, as of the last step{frame}"
                array, shape = _history(group, part, key, in_group), (3,) if memory.tangent else ()
                options = {"items": several, "shape": shape, "items_of": items_of}
                yield Sensor(f"{name}.{part}.{key}", memory.unit, meaning, array, **options)
        several = 0 if single else contact.count
        for key, (attribute, unit, meaning) in _SWEPT.items() if contact.swept else ():
            array, shape = _column("history", attribute, own), shape_in(self._types.History, attribute)
            yield Sensor(f"{name}.{key}", unit, meaning, array, items=several, shape=shape)

    def _point(self, own: int | slice) -> Callable[[ModelArrays], wp.array]:
        return lambda _: self.measures["points"].position[:, own]


def _column(struct: str, attribute: str, own: int | slice) -> Callable[[ModelArrays], wp.array]:
    return lambda arrays: getattr(getattr(arrays, struct), attribute)[:, own]


def _history(group: ContactGroup, part: str, key: str, own: int | slice) -> Callable[[ModelArrays], wp.array]:
    return lambda _: group.history_of(part, key)[:, own]


def declare(context: BuildContext, elements: Sequence[Contact]) -> list[ForceElement]:
    """Declares the contacts of a model."""
    return [MeshContact(context, elements)]
