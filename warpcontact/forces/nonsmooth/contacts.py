"""Nonsmooth contacts of a model on its device: the rows of a step, what is remembered, and what the step launches."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.contact_groups import ContactGroup, group_by_model
from warpcontact.forces.nonsmooth.materials import CONTACT_GAP, NonsmoothSource, material_upload, parameters_of
from warpcontact.forces.particle_contact.contact_set import ParticleContactSet
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.nonsmooth import build_rows, exact_sleep, save_impulses, sequence, velocity_update
from warpcontact.kernels.nonsmooth.rows import body_response_struct, row_structs
from warpcontact.kernels.shapes.records import shape_contact_structs
from warpcontact.kernels.types import MODE_OPEN, MODE_SLIP
from warpcontact.model.sensors import Sensor
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.scene import Contact, Scene
from warpcontact.scene.shapes import ShapeContact
from warpcontact.scene.status import ContactMode
from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.storage.parameters import Parameter
from warpcontact.storage.state_storage import COUNT, SWITCH, Allowed
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.validation.checks import similar

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet
    from warpcontact.model.model import Model
    from warpcontact.model.plan import DeviceModelPlan


PURPOSE = "nonsmooth contacts"


@dataclass
class _ItemList:
    """Which of the items of some arrays are hard.

    Attributes:
        first: Number of the contact of the first item.
        numbers: The items that are hard.
        items: These, on the device.
    """

    first: int
    numbers: NDArray[np.int_]
    items: Any = None

    @property
    def count(self) -> int:
        """Number of items that are hard."""
        return len(self.numbers)


class NonsmoothContacts:
    """What stepping nonsmooth contacts takes beside a model.

    Contacts are numbered: those with meshes as they lie on the device, then smooth ones, then the records of pairs
    of particle contacts that are hard. Materials likewise, but one for all pairs of a particle contact.

    Args:
        model: The model, or what is drawn up of it.
        compliant: Names of the contacts that are not hard, beside those of contact couplings.
        scratch: For each solver, by its name, what returns the struct of what it keeps of a row, by precision and
            whether anything opposes rolling or spinning.
        tolerance: Of a solve.
        recovery: Share of an overlap that is taken back in a second [1/s].
        layout: Where to declare arrays.
        sequential: Whether impacts come one after the other.

    Attributes:
        compliant: Names of the contacts that are not hard.
        tolerance: Of a solve.
        recovery: Share of an overlap that is taken back in a second [1/s].
        monitored: Whether every step is looked at, so that none is left out.
        capacity: Most rows of an environment.
        half_step_state: State at half a step.
        rows: The closed contacts of a step.
        body_response: The bodies under impulses.
        solve_result: How the last solve went.
        velocity_change: What impulses have changed of these.
        impact_rows: What impacts one after the other work in; ``None``: they are simultaneous.
        restitution_limit: How far restitution was lowered in the last step.
        stored_impulses: Of each contact, from the last step in which it was closed.
        statistics: Of each environment, since reset.
        displayed: What sensors show.
        reactions: Mean wrenches of the last step on the bodies.
        material: [env, material].
    """

    def __init__(
        self,
        model: "Model | DeviceModelPlan",
        compliant: Collection[str],
        scratch: Mapping[str, Callable[[type, bool], Any]],
        tolerance: float,
        recovery: float,
        layout: AllocationPlan,
        sequential: bool = False,
    ) -> None:
        t = model.types
        scene: Scene = model.scene
        forces = [contact.name for contact in scene.contacts if contact.facing is not None]
        self.compliant = frozenset([*compliant, *forces])
        self.tolerance, self.recovery = tolerance, recovery
        self.monitored = False
        self._real = t.real
        self._contacts = t.Contacts
        self._device = layout.device
        rows, records = row_structs(t.real), record_structs(t.real)
        contacts = [contact for group in group_by_model(scene.contacts) for contact in group]
        starts = np.cumsum([0] + [contact.count for contact in contacts]).tolist()
        meshes = {contact: _slice(start, contact.count) for contact, start in zip(contacts, starts, strict=False)}
        self._blocks_of = {
            contact: _slice(*model.clusters.range_of_contacts(own.start, contact.count))
            for contact, own in meshes.items()
        }
        self._mesh = self._item_list(0, meshes, layout)
        self._mesh_blocks = self._item_list(0, self._blocks_of, layout)
        # What sensors show of single contacts.
        self._displayed: dict[Contact | ShapeContact, slice] = dict(meshes.items())
        self._shape_contact_sets: list[tuple[ShapeContactSet, _ItemList]] = []
        for one in model.shape_contact_sets:
            first = starts[-1] + one.first
            self._displayed |= {
                contact: slice(first + own.start, first + own.stop) for contact, own in one.items.items()
            }
            self._shape_contact_sets.append((one, self._item_list(first, one.items, layout)))
        count = starts[-1] + model.shape_contact_count
        stored_count = count
        self._first_records: dict[ParticleContact, int] = {}
        self._particle_contact_sets: list[
            tuple[ParticleContactSet, int]
        ] = []  # those that are hard, with their material
        for pile in model.particle_contact_sets:
            if not self.is_compliant(pile.contact.name):
                self._particle_contact_sets.append((pile, count + len(self._particle_contact_sets)))
                self._first_records[pile.contact] = stored_count
                stored_count += pile.slots
        self.capacity = self._mesh.count + sum(own.count for _, own in self._shape_contact_sets)
        self.capacity += sum(pile.slots for pile, _ in self._particle_contact_sets)
        everything = (*self._displayed, *self._first_records)
        self._nonsmooth = [contact for contact in everything if not self.is_compliant(contact.name)]

        bodies, each_row = per_env(model.body_count), per_env(max(1, self.capacity))
        self.half_step_state = layout.struct(PURPOSE, t.State, bodies, transient=True)
        made = {
            "rows": (rows.Row, each_row),
            "body_response": (body_response_struct(t.real, model.has_joints), bodies),
            "velocity_change": (velocity_update.velocity_change_struct(t.real), bodies),
            "stored_impulses": (records.StoredImpulse, per_env(max(1, stored_count))),
        }
        self.rows = self.body_response = self.velocity_change = self.stored_impulses = None
        remembered: dict[str, Allowed] = {
            "stored_impulses.mode": (MODE_OPEN, MODE_SLIP),
            "stored_impulses.stamp": COUNT,
        }
        for name, (struct, shape) in made.items():
            layout.array(
                PURPOSE, self, name, struct, shape, transient=name != "stored_impulses", ranges=remembered
            )
        self._scratch = SimpleNamespace()
        for name, make in scratch.items():
            setattr(self._scratch, name, None)
            layout.array(PURPOSE, self._scratch, name, make(t.real, self.rolls), each_row, transient=True)
        self.impact_rows: Any = None
        if sequential:
            layout.array(PURPOSE, self, "impact_rows", sequence.scratch(t.real), each_row, transient=True)
        solved = {"count": (0, self.capacity), "iterations": COUNT, "converged": SWITCH}
        self.solve_result = layout.struct(
            PURPOSE, rows.SolveResult, per_env(), transient=("slack",), ranges=solved
        )
        self.restitution_limit = layout.struct(PURPOSE, records.RestitutionLimit, per_env(), transient=True)
        counts = dict.fromkeys(("step", "failures", "restitution_limited"), COUNT)
        self.statistics = layout.struct(
            PURPOSE, records.StepStatistics, per_env(), transient=("unchanged_steps",), ranges=counts
        )
        self.displayed = layout.struct(PURPOSE, records.DisplayedImpulses, per_env(max(1, count)), transient=True)
        self.reactions = layout.struct(PURPOSE, t.Wrenches, bodies)
        self.material: Any = None
        self._bodies, self._step = 0, None
        self._upload: Any = None
        self._materials = [
            NonsmoothSource(one, one.material.formulas, own.stop - own.start)
            for one, own in self._displayed.items()
        ]
        self._materials += [NonsmoothSource(one, one.formulas, 1) for one in self._first_records]

    def _item_list(self, first: int, items: Mapping[Any, slice], layout: AllocationPlan) -> _ItemList:
        """Declares the list of those of ``items``, by contact, that are hard."""
        nonsmooth = [
            np.arange(own.start, own.stop) for contact, own in items.items() if not self.is_compliant(contact.name)
        ]
        numbers = np.concatenate([np.zeros(0, np.int64), *nonsmooth])
        made = _ItemList(first, numbers)
        # No array is empty.
        layout.constant(PURPOSE, made, "items", numbers if len(numbers) else [0], wp.int32)
        return made

    def material_need(self, parameters: Mapping[str, Parameter], envs: int, varied: Collection[str]) -> MemoryItem:
        """Returns what the materials of ``envs`` environments take; ``varied`` are to have a value in each."""
        device_field = self._upload or material_upload(self, self._materials, parameters, self._device, self._real)
        fields = {id(parameters[name].field) for name in varied}
        own = any(
            id(source.field) in fields or not source.field.shared
            for source in parameters_of(self._materials, parameters)
        )
        return MemoryItem(PURPOSE, str(self._device), *device_field.size(envs, own))

    def attach_simulation(self, model: "Model", step: wp.array) -> None:
        """Takes what is allocated: the model, and the length of a step [env, 0] [s]."""
        self.check_shares(model.parameters)
        self._bodies, self._step = model.body_count, step
        self._upload = material_upload(self, self._materials, model.parameters, model.device, self._real)

    def activate(self, model: "Model") -> None:
        """Lets restitution and coefficients of friction follow their parameters; no contact remembers anything.

        Losses and counts go on.
        """
        for parameter in parameters_of(self._materials, model.parameters):
            if self._upload not in parameter.device_fields:
                parameter.device_fields.append(self._upload)
        model.upload([self._upload], [self._upload.content()])
        self._set_contact_gap(model, CONTACT_GAP[self._real])
        self._reset(wp.full(model.envs, True, dtype=wp.bool, device=model.device), all_statistics=False)
        self._reset_laws(model)

    def deactivate(self, model: "Model") -> None:
        """Follows the parameters no longer."""
        self._reset_laws(model)
        self._set_contact_gap(model, 0.0)
        for parameter in parameters_of(self._materials, model.parameters):
            if self._upload in parameter.device_fields:
                parameter.device_fields.remove(self._upload)

    def _set_contact_gap(self, model: "Model", gap: float) -> None:
        """Sets the gap below which the nonsmooth contacts are closed [m]."""
        closed = [(model.arrays.closed, self._mesh.numbers)] if self._mesh.count else []
        closed += [(one.closed, own.numbers) for one, own in self._shape_contact_sets if own.count]
        closed += [(pile.closed, np.arange(1)) for pile, _ in self._particle_contact_sets]
        for one, items in closed:
            one.assign(items, gap)
        model.upload([one.device_field for one, _ in closed], [one.device_field.content() for one, _ in closed])

    def _reset_laws(self, model: "Model") -> None:
        """Lets laws and friction models of nonsmooth contacts begin anew should they act again: none has been going on."""
        history, contacts = model.arrays.history, model.arrays.contacts
        if self._mesh.count:
            nonsmooth = self._mesh.items.numpy()
            for array, nothing in ((history.entry_speed, -1.0), (contacts.approach_speed, 0.0)):
                values = array.numpy()
                values[:, nonsmooth] = nothing
                array.assign(values)

    @property
    def scratch(self) -> dict[str, Any]:
        """What each solver, by its name, works in [env, row]."""
        return vars(self._scratch)

    def is_compliant(self, name: str) -> bool:
        """Whether the contact ``name`` acts by the force of its law."""
        return name in self.compliant

    def first_record_of(self, contact: ParticleContact) -> int:
        """Returns the number of the first record of a particle contact that is hard."""
        return self._first_records[contact]

    @property
    def names(self) -> frozenset[str]:
        """Names of the contacts that are hard."""
        return frozenset(contact.name for contact in self._nonsmooth)

    @property
    def rolls(self) -> bool:
        """Whether anything opposes rolling or spinning of a nonsmooth contact."""
        return any(
            contact.material.parts.has_rolling or contact.material.parts.has_torsion for contact in self._nonsmooth
        )

    def has_restitution(self, parameters: Mapping[str, Parameter]) -> bool:
        """Whether any nonsmooth contact has a restitution now: impacts may then bring energy."""
        names = [f"{one.name}.law.restitution" for one in self._nonsmooth]
        return any(bool(parameters[name].field.values.any()) for name in names if name in parameters)

    def check_shares(self, parameters: Mapping[str, Parameter]) -> None:
        """Checks that no nonsmooth contact has the share 0: it would act in spite of that.

        Raises:
            ValueError: If one has; names the contact.
        """
        for one in self._nonsmooth:
            own = parameters.get(f"{one.name}.force_scale")
            if own is not None:
                self.check_share(own.name, own.values)

    def check_share(self, name: str, values: NDArray[np.float64]) -> None:
        """Raises the same error if ``values`` of parameter ``name`` are shares of a nonsmooth contact with a 0."""
        element, _, quantity = name.rpartition(".")
        if quantity == "force_scale" and element in self.names and not values.all():
            raise ValueError(
                f"{name} must be greater than 0, got 0: rigid contact has no force to scale. Set "
                f"{element}.enabled to 0 to switch it off"
            )

    def compliant_clusters(self, group: ContactGroup) -> list[tuple[int, int]]:
        """Returns the blocks of the contacts of ``group`` that are not hard: the first and their number."""
        last = group.first_cluster + group.cluster_count
        return self.compliant_items(
            {contact: own for contact, own in self._blocks_of.items() if group.first_cluster <= own.start < last}
        )

    def compliant_items(self, items: Mapping[Any, slice]) -> list[tuple[int, int]]:
        """Returns where those of ``items``, by contact, are that are not hard: the first and how many follow."""
        return _runs(own for contact, own in items.items() if self.is_compliant(contact.name))

    def collect_stages(self, plan: "ExecutionPlan") -> list[wp.Launch]:
        """Returns the launches that list the closed contacts of the middle of the step."""
        a, real = plan.model.arrays, self._real
        outputs = [
            self.recovery,
            self.material,
            self.stored_impulses,
            self.statistics,
            self.rows,
            self.solve_result,
        ]
        launches = []
        if self._mesh.count:
            blocks = self._mesh_blocks
            inputs = [
                a.status,
                a.model,
                self.half_step_state,
                a.contacts,
                a.active_contacts,
                blocks.items,
                blocks.count,
            ]
            launches += plan.prepare(build_rows.mesh_rows(real), 1, [*inputs, *outputs])
        for one, own in self._shape_contact_sets:
            if own.count:
                inputs = [
                    a.status,
                    self.half_step_state,
                    own.first,
                    own.items,
                    own.count,
                    one.contact_shapes,
                    one.settings,
                ]
                launches += plan.prepare(
                    build_rows.shape_rows(real, one.needs_curvature), 1, [*inputs, one.shape_contacts, *outputs]
                )
        for pile, material in self._particle_contact_sets:
            contact = pile.contact
            inputs = [
                a.status,
                self.half_step_state,
                contact.count,
                pile.particles,
                pile.neighbor_lists,
                pile.pair_records,
            ]
            inputs += [self._first_records[contact], material]
            launches += plan.prepare(build_rows.particle_rows(real), 1, [*inputs, *outputs])
        return launches

    def sleep_stages(self, plan: "ExecutionPlan", step: wp.array) -> list[wp.Launch]:
        """Returns the launch that leaves environments at rest out of a step, none where that may be wrong.

        Only contacts with surfaces do the same in every step in which nothing moves.
        """
        model = plan.model
        others = (
            model.has_joints
            or model.prescribed_motions
            or model.couplings
            or model.shape_contact_sets
            or model.particle_contact_sets
            or model.has_latched_contacts
        )
        if self.monitored or others or any(self.compliant_clusters(group) for group in model.groups):
            return []
        inputs = [model.arrays.status, step, model.arrays.time, self.statistics]
        return plan.prepare(exact_sleep.kernel(self._real), 1, inputs)

    @shared_capture_lock()
    def wake(self) -> None:
        """Lets no environment rest: something may have been changed from outside."""
        self.statistics.unchanged_steps.zero_()

    @shared_capture_lock()
    def reset_residuals(self) -> None:
        """Sets the largest residuals of unsolved problems to 0."""
        self.statistics.largest_residual.zero_()

    def accept_stages(self, plan: "ExecutionPlan", step: wp.array) -> list[wp.Launch]:
        """Returns the launch that remembers what an accepted step led to; ``step`` [env, 0] [s]."""
        inputs = [plan.model.arrays.status, step, self.tolerance, plan.model.body_count]
        inputs += [self.half_step_state, self.rows, self.body_response]
        inputs += [
            self.solve_result,
            self.restitution_limit,
            self.stored_impulses,
            self.statistics,
            self.reactions,
        ]
        return plan.prepare(save_impulses.kernel(self._real, plan.model.has_joints, self.rolls), 1, inputs)

    def reset_state(self, chosen: wp.array) -> None:
        """Empties what the environments of the mask ``chosen`` [env] remember."""
        self._reset(chosen, all_statistics=True)

    def _reset(self, chosen: wp.array, all_statistics: bool) -> None:
        inputs = [chosen, int(all_statistics), self._bodies, self.solve_result, self.statistics, self.reactions]
        wp.launch(save_impulses.reset(self._real), dim=len(chosen), inputs=inputs, device=self._device)

    def show_stages(self, plan: "ExecutionPlan", status: wp.array) -> list[wp.Launch]:
        """Returns the launches that put the last step where sensors of contacts look, but for those of piles.

        ``status`` [env] says which environments are active.
        """
        a, real = plan.model.arrays, self._real
        targets = [(self._mesh, save_impulses.display_contacts(real, self._contacts), a.contacts)]
        for one, own in self._shape_contact_sets:
            targets.append(
                (
                    own,
                    save_impulses.display_contacts(real, shape_contact_structs(real).ShapeContacts),
                    one.shape_contacts,
                )
            )
        launches = []
        for own, kernel, target in targets:
            inputs = [
                status,
                self._step,
                own.first,
                own.items,
                self.stored_impulses,
                self.statistics,
                target,
                self.displayed,
            ]
            launches += plan.prepare(kernel, own.count, inputs)
        return launches

    def show(self, model: "Model") -> None:
        """Puts the last step where sensors look; forces are the mean over it."""
        from warpcontact.forces.execution_plan import ExecutionPlan

        a, device, real = model.arrays, self._device, self._real
        for launch in self.show_stages(
            ExecutionPlan(model, model.envs, uses_cache=False, ordered_sum=True), model.active_status
        ):
            launch.launch()
        stored_count = [self.stored_impulses, self.statistics]
        for pile, _ in self._particle_contact_sets:
            inputs = [
                self._step,
                self._first_records[pile.contact],
                pile.particles,
                pile.neighbor_lists,
                *stored_count,
                pile.pair_records,
            ]
            shape = (model.envs, pile.contact.count)
            wp.launch(save_impulses.display_particles(real), dim=shape, inputs=inputs, device=device)
        shape = (model.envs, model.body_count)
        wp.launch(
            save_impulses.reaction_forces(real), dim=shape, inputs=[self.reactions, a.wrenches], device=device
        )

    def sensors(self) -> Iterator[Sensor]:
        """Iterates over what can be measured of nonsmooth contacts."""
        for contact, numbers in self._displayed.items():
            if self.is_compliant(contact.name):
                continue
            if isinstance(contact, ShapeContact):
                single, on = contact.single, "the body of its first shape"
            else:
                single, on = contact.points.single, "the point's body"
            own: int | slice = numbers.start if single else numbers
            several = 0 if single else contact.count
            name, array = f"{contact.name}.impulse", _displayed("impulse", own)
            text = f"impulse of the last step on {on}, world"
            yield Sensor(name, "N·s", text, array, needs=("contacts",), items=several, shape=(3,))
            name, array = f"{contact.name}.mode", _displayed("mode", own)
            text = "whether it stuck or slipped in the last step"
            yield Sensor(name, "-", text, array, needs=("contacts",), items=several, codes=ContactMode)
        for key, (part, attribute, unit, meaning) in OF_SCENE.items():
            yield Sensor(f"scene.{key}", unit, meaning, _of_scene(part, attribute))


# name: (struct, array, unit, what it is)
OF_SCENE = {
    "closed_contacts": ("solve_result", "count", "-", "nonsmooth contacts that were closed in the last step"),
    "solve_residual": ("solve_result", "residual", "-", "what is left of the contact problem of the last step"),
    "solve_iterations": ("solve_result", "iterations", "-", "iterations of its solver"),
    "solve_converged": ("solve_result", "converged", "-", "1: to its tolerance"),
    "solve_failures": ("statistics", "failures", "-", "steps that were not solved to it, since reset"),
    "restitution_limited": (
        "statistics",
        "restitution_limited",
        "-",
        "steps in which restitution was lowered to bring no energy",
    ),
    "friction_dissipation": (
        "statistics",
        "friction_dissipation",
        "J",
        "energy that friction of nonsmooth contacts took, since reset",
    ),
    "impact_dissipation": (
        "statistics",
        "impact_dissipation",
        "J",
        "energy that impacts of nonsmooth contacts took, since reset",
    ),
}


def is_nonsmooth_sensor(name: str) -> bool:
    """Whether a sensor is one of nonsmooth contacts alone, by its name."""
    element, _, quantity = name.rpartition(".")
    return quantity in OF_SCENE if element == "scene" else quantity in ("impulse", "mode")


def sensor_hint(name: str, stored_count: Collection[str], scene: Scene) -> str:
    """Returns the end of a message about an unknown sensor: the integrator that has it, or similar names."""
    element = name.rpartition(".")[0]
    contacts = {contact.name for contact in scene.contacts} | {contact.name for contact in scene.shape_contacts}
    if is_nonsmooth_sensor(name) and (element == "scene" or element in contacts):
        return "; only nonsmooth contact has it, with the integrator MoreauJean"
    return similar(name, stored_count)


def _displayed(attribute: str, own: int | slice) -> Any:
    return lambda arrays: getattr(arrays.nonsmooth.displayed, attribute)[:, own]


def _of_scene(part: str, attribute: str) -> Any:
    return lambda arrays: getattr(getattr(arrays.nonsmooth, part), attribute)


def _slice(first: int, count: int) -> slice:
    return slice(first, first + count)


def _runs(ranges: Iterable[slice]) -> list[tuple[int, int]]:
    """Returns what lies side by side of some ranges in order, as the first and how many."""
    runs: list[tuple[int, int]] = []
    for own in ranges:
        if runs and sum(runs[-1]) == own.start:
            runs[-1] = (runs[-1][0], own.stop - runs[-1][0])
        else:
            runs.append((own.start, own.stop - own.start))
    return runs
