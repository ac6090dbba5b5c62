"""Nonsmooth contacts of a model: device arrays, launches and sensors.

In each step, closed contacts are collected as rows (``build_rows``), a solver computes their impulses
(``stepping/integrators/moreau_jean.py``), and an accepted step stores impulses for warm starts and statistics
(``save_impulses``). Kernels: ``kernels/nonsmooth``.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.body_contact.manifold_set import ManifoldSet, nonsmooth_contacts
from warpcontact.forces.contact_groups import ContactGroup, group_by_model
from warpcontact.forces.force_element import ForceElement
from warpcontact.forces.nonsmooth.contact_items import ItemList, Scratch, runs_of, share_loads, slice_of
from warpcontact.forces.nonsmooth.materials import CONTACT_GAP, NonsmoothSource, material_upload, parameters_of
from warpcontact.forces.nonsmooth.minima import NonsmoothMinima
from warpcontact.forces.nonsmooth.sensors import OF_SCENE
from warpcontact.forces.particle_contact.contact_set import ParticleContactSet
from warpcontact.forces.sensor import Sensor
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.nonsmooth import build_rows, save_impulses, sequence
from warpcontact.kernels.nonsmooth.rows import body_response_struct, row_structs, velocity_change_struct
from warpcontact.kernels.shapes.records import shape_contact_structs
from warpcontact.kernels.types import MODE_OPEN, MODE_SLIP
from warpcontact.scene.elements import Contact
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.shapes import ShapeContact
from warpcontact.scene.status import ContactMode
from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import Parameter
from warpcontact.storage.state_storage import COUNT, SWITCH, Allowed
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.launches import launch_kernel

if TYPE_CHECKING:
    from warpcontact.forces.body_contact.body_contact_set import BodyContactSet
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet
    from warpcontact.model.model import DeviceModel
    from warpcontact.model.plan import DeviceModelPlan


PURPOSE = "nonsmooth contacts"


class NonsmoothContacts(ForceElement):
    """Device data of nonsmooth contacts, in addition to the model.

    A force element of a simulation. It acts by impulses, which the integrator computes, and has no force launches.

    Contacts are numbered: mesh contacts in device order, then shape contacts, then points of manifolds of nonsmooth body
    contacts, then pair records of nonsmooth particle contacts. Materials are numbered in the same order, with one material
    per pair of body contacts and one per particle contact.

    Args:
        model: The model, or its plan.
        compliant: Names of compliant contacts. Contact couplings are always compliant.
        scratch: By name of the solver, a function that returns the struct of its working memory per row, for a
            precision and whether there is rolling or torsional friction.
        tolerance: Tolerance of the relative residual.
        recovery: Fraction of the penetration that is removed per second [1/s].
        layout: Allocation plan to which the arrays are added.
        sequential: Whether simultaneous impacts are computed sequentially.

    Attributes:
        compliant: Names of compliant contacts, including contact couplings.
        tolerance: Tolerance of the relative residual.
        recovery: Fraction of the penetration that is removed per second [1/s].
        monitored: Whether a monitor evaluates every step; steps of sleeping environments are then not skipped.
        capacity: Maximum number of rows of an environment.
        half_step_state: State at half a step.
        rows: Constraint rows: the closed contacts of a step.
        body_response: Response of bodies to impulses.
        solve_result: Result of the last solve: number of rows, iterations, residual, convergence.
        velocity_change: Velocity changes of bodies by the impulses.
        impact_rows: Working memory of sequential impacts; ``None``: impacts are simultaneous.
        restitution_limit: Reduction of restitution in the last step.
        stored_impulses: Impulse of each contact from the last step in which it was closed, for warm starts.
        statistics: Statistics of each environment since reset.
        displayed: Values of sensors.
        reactions: Mean wrenches of the contact impulses on bodies in the last step.
        material: Materials [env, material].
    """

    family = "nonsmooth contact"

    def __init__(
        self,
        model: "DeviceModel | DeviceModelPlan",
        compliant: Collection[str],
        scratch: Mapping[str, Callable[[type, bool], Any]],
        tolerance: float,
        recovery: float,
        layout: AllocationPlan,
        sequential: bool = False,
    ) -> None:
        super().__init__()
        t = model.types
        scene: SceneData = model.scene
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
        meshes = {
            contact: slice_of(start, contact.count) for contact, start in zip(contacts, starts, strict=False)
        }
        self._blocks_of = {
            contact: slice_of(*model.clusters.range_of_contacts(own.start, contact.count))
            for contact, own in meshes.items()
        }
        self._mesh = self._item_list(0, meshes, layout)
        # Those with one minimum per point, the others are in ``_minima``.
        nearest = {contact: own for contact, own in meshes.items() if contact.minima == "nearest"}
        self._nearest = self._mesh if len(nearest) == len(meshes) else self._item_list(0, nearest, layout)
        self._mesh_blocks = self._item_list(0, {one: self._blocks_of[one] for one in nearest}, layout)
        # Range of sensor values of each mesh or shape contact.
        self._displayed: dict[Contact | ShapeContact, slice] = dict(meshes.items())
        self._shape_contact_sets: list[tuple[ShapeContactSet, ItemList]] = []
        for one in model.of_family("shape contact"):
            first = starts[-1] + one.first
            self._displayed |= {
                contact: slice(first + own.start, first + own.stop) for contact, own in one.items.items()
            }
            self._shape_contact_sets.append((one, self._item_list(first, one.items, layout)))
        count = starts[-1] + sum(one.count for one, _ in self._shape_contact_sets)
        stored_count = material_count = count
        # Manifolds of nonsmooth body contacts, with the numbers of their first point and of their first material.
        self._manifold_sets: dict[BodyContactSet, tuple[ManifoldSet, int, int]] = {}
        for body_contacts in model.of_family("body contact"):
            if rigid := nonsmooth_contacts(body_contacts, self.compliant):
                manifolds = body_contacts.manifolds or ManifoldSet(body_contacts, rigid, layout)
                self._manifold_sets[body_contacts] = manifolds, stored_count, material_count
                stored_count += manifolds.slot_count
                material_count += manifolds.count
        self._first_records: dict[ParticleContact, int] = {}
        self._particle_contact_sets: list[
            tuple[ParticleContactSet, int]
        ] = []  # nonsmooth ones, with the number of their material
        for particle_set in model.of_family("particle contact"):
            if not self.is_compliant(particle_set.contact.name):
                self._particle_contact_sets.append(
                    (particle_set, material_count + len(self._particle_contact_sets))
                )
                self._first_records[particle_set.contact] = stored_count
                stored_count += particle_set.slots
        self._minima: list[NonsmoothMinima] = []
        for group in model.groups:
            own = [one for one in contacts if one.code == group.code and not self.is_compliant(one.name)]
            if own and group.minima is not None:
                items, clusters = (
                    [number for one in own for number in range(of[one].start, of[one].stop)]
                    for of in (meshes, self._blocks_of)
                )
                self._minima.append(NonsmoothMinima(group, items, clusters, stored_count, layout, PURPOSE))
                stored_count += self._minima[-1].stored_count
        self.capacity = self._nearest.count + sum(one.row_count for one in self._minima)
        self.capacity += sum(own.count for _, own in self._shape_contact_sets)
        self.capacity += sum(manifolds.slot_count for manifolds, _, _ in self._manifold_sets.values())
        self.capacity += sum(particle_set.slots for particle_set, _ in self._particle_contact_sets)
        bodies_in_contact = [one for manifolds, _, _ in self._manifold_sets.values() for one in manifolds.contacts]
        everything = (*self._displayed, *bodies_in_contact, *self._first_records)
        self._nonsmooth = [contact for contact in everything if not self.is_compliant(contact.name)]

        bodies, each_row = per_env(model.body_count), per_env(max(1, self.capacity))
        self.half_step_state = layout.struct(
            PURPOSE, t.State, bodies, transient=True, body_orientation_remainder=per_env(0)
        )
        made = {
            "rows": (rows.Row, each_row),
            "body_response": (body_response_struct(t.real, model.has_joints), bodies),
            "velocity_change": (velocity_change_struct(t.real), bodies),
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
        self._scratch = {name: Scratch() for name in scratch}
        for name, make in scratch.items():
            owner, struct = self._scratch[name], make(t.real, self.rolls)
            layout.array(PURPOSE, owner, "rows", struct, each_row, transient=True)
        self.impact_rows: Any = None
        if sequential:
            layout.array(PURPOSE, self, "impact_rows", sequence.scratch(t.real), each_row, transient=True)
        solved = {"count": (0, self.capacity), "iterations": COUNT, "converged": SWITCH}
        computed = ("slack", "step", "solved_residual", "was_cleared")
        self.solve_result = layout.struct(PURPOSE, rows.SolveResult, per_env(), transient=computed, ranges=solved)
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
        self._materials += [NonsmoothSource(one, one.formulas, one.count) for one in bodies_in_contact]
        self._materials += [NonsmoothSource(one, one.formulas, 1) for one in self._first_records]

    def _item_list(self, first: int, items: Mapping[Any, slice], layout: AllocationPlan) -> ItemList:
        """Declares the list of the nonsmooth ones of ``items``, given by contact."""
        nonsmooth = [
            np.arange(own.start, own.stop) for contact, own in items.items() if not self.is_compliant(contact.name)
        ]
        numbers = np.concatenate([np.zeros(0, np.int64), *nonsmooth])
        made = ItemList(first, numbers)
        # Warp needs at least one element.
        layout.constant(PURPOSE, made, "items", numbers if len(numbers) else [0], wp.int32)
        return made

    def material_need(self, parameters: Mapping[str, Parameter], envs: int, varied: Collection[str]) -> MemoryItem:
        """Returns the memory of the materials; parameters ``varied`` have separate values per environment."""
        device_field = self._upload or material_upload(self, self._materials, parameters, self._device, self._real)
        fields = {id(parameters[name].field) for name in varied}
        own = any(
            id(source.field) in fields or not source.field.shared
            for source in parameters_of(self._materials, parameters)
        )
        return MemoryItem(PURPOSE, str(self._device), *device_field.size(envs, own))

    def attach_simulation(self, model: "DeviceModel", step: wp.array) -> None:
        """Attaches the allocated model and the step length [env, 0] [s]."""
        self.check_shares(model.parameters)
        self._bodies, self._step = model.body_count, step
        self._upload = material_upload(self, self._materials, model.parameters, model.device, self._real)

    def activate(self, model: "DeviceModel") -> None:
        """Activates nonsmooth contact: materials follow their parameters, and stored impulses are cleared.

        Dissipated energies and counts are kept.
        """
        for parameter in parameters_of(self._materials, model.parameters):
            if self._upload not in parameter.device_fields:
                parameter.device_fields.append(self._upload)
        model.upload([self._upload], [self._upload.content()])
        for body_contacts, (manifolds, _, _) in self._manifold_sets.items():
            body_contacts.active_manifolds = manifolds
        self._set_contact_gap(model, CONTACT_GAP[self._real])
        self._reset(wp.full(model.envs, True, dtype=wp.bool, device=model.device), all_statistics=False)
        self._reset_laws(model)

    def deactivate(self, model: "DeviceModel") -> None:
        """Deactivates nonsmooth contact: materials no longer follow their parameters."""
        self._reset_laws(model)
        for body_contacts in self._manifold_sets:
            body_contacts.active_manifolds = body_contacts.manifolds
        self._set_contact_gap(model, 0.0)
        for parameter in parameters_of(self._materials, model.parameters):
            if self._upload in parameter.device_fields:
                parameter.device_fields.remove(self._upload)

    def _set_contact_gap(self, model: "DeviceModel", gap: float) -> None:
        """Sets the gap below which the nonsmooth contacts are closed [m]."""
        tolerances = [(model.arrays.contact_tolerance, self._mesh.numbers)] if self._mesh.count else []
        tolerances += [(one.contact_tolerance, own.numbers) for one, own in self._shape_contact_sets if own.count]
        tolerances += [(one.contact_tolerance, np.arange(1)) for one, _ in self._particle_contact_sets]
        for one, items in tolerances:
            one.assign(items, gap)
        model.upload(
            [one.device_field for one, _ in tolerances], [one.device_field.content() for one, _ in tolerances]
        )

    def _reset_laws(self, model: "DeviceModel") -> None:
        """Clears entry speeds and approach speeds of nonsmooth contacts, whose laws were not evaluated meanwhile."""
        history, contacts = model.arrays.history, model.arrays.contacts
        if self._mesh.count:
            nonsmooth = self._mesh.items.numpy()
            for array, nothing in ((history.entry_speed, -1.0), (contacts.approach_speed, 0.0)):
                values = array.numpy()
                values[:, nonsmooth] = nothing
                array.assign(values)
        for minima in self._minima:
            minima.reset(model.envs, model.device)
        for body_contacts in self._manifold_sets:
            body_contacts.reset_state(wp.full(model.envs, True, dtype=wp.bool, device=model.device))

    @property
    def scratch(self) -> dict[str, Any]:
        """Working memory of each solver, by name [env, row]."""
        return {name: own.rows for name, own in self._scratch.items()}

    @property
    def problem_inputs(self) -> dict[str, Any]:
        """The contact problem of a step, as arguments of kernels."""
        return {
            "rows": self.rows,
            "body_response": self.body_response,
            "solve_result": self.solve_result,
            "velocity_change": self.velocity_change,
            "tolerance": self.tolerance,
        }

    def is_compliant(self, name: str) -> bool:
        """Returns whether the contact ``name`` is compliant."""
        return name in self.compliant

    def manifolds_of(self, body_contacts: "BodyContactSet") -> ManifoldSet | None:
        """Returns the manifolds of the nonsmooth contacts of a set; ``None``: it has none."""
        found = self._manifold_sets.get(body_contacts)
        return None if found is None else found[0]

    def first_record_of(self, contact: ParticleContact) -> int:
        """Returns the number of the first record of a nonsmooth particle contact."""
        return self._first_records[contact]

    @property
    def names(self) -> frozenset[str]:
        """Names of the nonsmooth contacts."""
        return frozenset(contact.name for contact in self._nonsmooth)

    @property
    def rolls(self) -> bool:
        """Whether any nonsmooth contact has rolling or torsional friction."""
        return any(
            contact.material.parts.has_rolling or contact.material.parts.has_torsion for contact in self._nonsmooth
        )

    @property
    def shares_loads(self) -> bool:
        """Whether two bodies may have several contacts, between which equilibrium does not determine the loads."""
        return share_loads(self._nonsmooth)

    def has_restitution(self, parameters: Mapping[str, Parameter]) -> bool:
        """Returns whether any nonsmooth contact has a restitution; impacts can then add energy."""
        return self._is_used("restitution", parameters)

    def has_compliance(self, parameters: Mapping[str, Parameter]) -> bool:
        """Returns whether any nonsmooth contact with a rigid law has a compliance."""
        return self._is_used("compliance", parameters)

    def _is_used(self, key: str, parameters: Mapping[str, Parameter]) -> bool:
        tables = (one.resolved(parameters) for one in self._materials)
        return any(bool(found.field.values.any()) for table in tables if (found := table[key]) is not None)

    def check_shares(self, parameters: Mapping[str, Parameter]) -> None:
        """Checks that no nonsmooth contact has the share 0: it would act in spite of that.

        Raises:
            ValueError: If one has; the message names the contact.
        """
        for one in self._nonsmooth:
            own = parameters.get(f"{one.name}.force_scale")
            if own is not None:
                self.check_share(own.name, own.values)

    def check_share(self, name: str, values: NDArray[np.float64]) -> None:
        """Raises ``ValueError`` if ``name`` is the ``force_scale`` of a nonsmooth contact and a value is 0."""
        element, _, quantity = name.rpartition(".")
        if quantity == "force_scale" and element in self.names and not values.all():
            raise ValueError(
                f"{name} must be greater than 0, got 0: rigid contact has no force to scale. Set "
                f"{element}.enabled to 0 to switch it off"
            )

    def compliant_clusters(self, group: ContactGroup) -> list[tuple[int, int]]:
        """Returns ranges (first, count) of the clusters of compliant contacts of ``group``."""
        last = group.first_cluster + group.cluster_count
        return self.compliant_items(
            {contact: own for contact, own in self._blocks_of.items() if group.first_cluster <= own.start < last}
        )

    def compliant_items(self, items: Mapping[Any, slice]) -> list[tuple[int, int]]:
        """Returns ranges (first, count) of the compliant ones of ``items``, given by contact."""
        return runs_of(own for contact, own in items.items() if self.is_compliant(contact.name))

    def collect_stages(self, plan: "ExecutionPlan") -> list[wp.Launch]:
        """Returns the launches that collect the closed contacts at half a step as rows."""
        a, real = plan.model.arrays, self._real
        inputs = {
            "status": a.status,
            "state": self.half_step_state,
            "recovery": self.recovery,
            "material": self.material,
            "stored_impulses": self.stored_impulses,
            "statistics": self.statistics,
            "rows": self.rows,
            "solve_result": self.solve_result,
        }
        launches = []
        if self._nearest.count:
            launches += plan.prepare(
                build_rows.mesh_rows(real),
                1,
                model=a.model,
                contacts=a.contacts,
                active_contacts=a.active_contacts,
                clusters=self._mesh_blocks.items,
                block_count=self._mesh_blocks.count,
                **inputs,
            )
        for minima in self._minima:
            launches += minima.row_launches(plan, inputs)
        for one, own in self._shape_contact_sets:
            if own.count:
                launches += plan.prepare(
                    build_rows.shape_rows(real, one.needs_curvature),
                    1,
                    first=own.first,
                    items=own.items,
                    item_count=own.count,
                    contact_shapes=one.contact_shapes,
                    settings=one.settings,
                    shape_contacts=one.shape_contacts,
                    **inputs,
                )
        for manifolds, first, material in self._manifold_sets.values():
            launches += manifolds.row_launches(plan, self._step, first, material, inputs)
        for particle_set, material in self._particle_contact_sets:
            launches += plan.prepare(
                build_rows.particle_rows(real),
                1,
                particle_count=particle_set.contact.count,
                particles=particle_set.particles,
                neighbor_lists=particle_set.neighbor_lists,
                pair_records=particle_set.pair_records,
                first=self._first_records[particle_set.contact],
                material_index=material,
                **inputs,
            )
        return launches

    def sleep_stages(self, plan: "ExecutionPlan", step: wp.array) -> list[wp.Launch]:
        """Returns the launch that skips a step of sleeping environments; none if skipping could change results.

        Sleeping is exact only if all contacts are nonsmooth mesh contacts, and there are no latched contacts, joints,
        couplings or monitors.
        """
        model = plan.model
        others = model.tracks_faces or not all(element.fused for element in model.force_elements)
        if self.monitored or others or any(self.compliant_clusters(group) for group in model.groups):
            return []
        return plan.prepare(
            save_impulses.skip_sleeping(self._real),
            1,
            status=model.arrays.status,
            step=step,
            time=model.arrays.time,
            statistics=self.statistics,
        )

    @shared_capture_lock()
    def wake(self) -> None:
        """Wakes all environments, because the user may have changed state or parameters."""
        self.statistics.unchanged_steps.zero_()

    @shared_capture_lock()
    def reset_residuals(self) -> None:
        """Sets the largest residuals of steps without convergence to 0."""
        self.statistics.largest_residual.zero_()

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launches that store impulses, statistics and points of an accepted step."""
        launches = [
            launch
            for manifolds, _, _ in self._manifold_sets.values()
            for launch in manifolds.accept_launches(plan)
        ]
        return launches + plan.prepare(
            save_impulses.kernel(self._real, plan.model.has_joints, self.rolls),
            1,
            status=plan.model.arrays.status,
            step=dt.real,
            tolerance=self.tolerance,
            model=plan.model.arrays.model,
            bodies=plan.model.body_count,
            half_step_state=self.half_step_state,
            rows=self.rows,
            body_response=self.body_response,
            correction=self.velocity_change,
            solve_result=self.solve_result,
            restitution_limit=self.restitution_limit,
            stored_impulses=self.stored_impulses,
            statistics=self.statistics,
            reactions=self.reactions,
        )

    def reset_state(self, chosen: wp.array) -> None:
        """Clears stored impulses and statistics in the environments of the mask ``chosen`` [env]."""
        self._reset(chosen, all_statistics=True)

    def _reset(self, chosen: wp.array, all_statistics: bool) -> None:
        launch_kernel(
            save_impulses.reset(self._real),
            len(chosen),
            device=self._device,
            mask=chosen,
            all_statistics=int(all_statistics),
            bodies=self._bodies,
            solve_result=self.solve_result,
            statistics=self.statistics,
            reactions=self.reactions,
        )
        for manifolds, _, _ in self._manifold_sets.values():
            manifolds.reset_state(chosen)

    def show_stages(self, plan: "ExecutionPlan", status: wp.array) -> list[wp.Launch]:
        """Returns the launches that copy the last step to the sensor arrays of mesh and shape contacts.

        ``status`` [env]: environments that are not active are skipped.
        """
        a, real = plan.model.arrays, self._real
        targets = [(self._nearest, save_impulses.display_contacts(real, self._contacts), a.contacts)]
        targets += [
            (
                own,
                save_impulses.display_contacts(real, shape_contact_structs(real).ShapeContacts),
                one.shape_contacts,
            )
            for one, own in self._shape_contact_sets
        ]
        stored = {"stored_impulses": self.stored_impulses, "statistics": self.statistics}
        inputs = stored | {"status": status, "step": self._step, "displayed": self.displayed}
        launches = []
        for own, kernel, target in targets:
            launches += plan.prepare(
                kernel, own.count, first=own.first, items=own.items, contacts=target, **inputs
            )
        for minima in self._minima:
            launches += minima.show_launches(plan, inputs)
        for manifolds, first, _ in self._manifold_sets.values():
            launches += manifolds.show_launches(plan, status, self._step, first, stored)
        return launches

    def show(self, model: "DeviceModel") -> None:
        """Copies the last step to the sensor arrays of all contacts and bodies; forces are means over the step."""
        from warpcontact.forces.execution_plan import ExecutionPlan

        a, device, real = model.arrays, self._device, self._real
        for launch in self.show_stages(
            ExecutionPlan(model, model.envs, uses_cache=False, ordered_sum=True), model.active_status
        ):
            launch.launch()
        for particle_set, _ in self._particle_contact_sets:
            launch_kernel(
                save_impulses.display_particles(real),
                (model.envs, particle_set.contact.count),
                device=device,
                step=self._step,
                first=self._first_records[particle_set.contact],
                particles=particle_set.particles,
                neighbor_lists=particle_set.neighbor_lists,
                stored_impulses=self.stored_impulses,
                statistics=self.statistics,
                pair_records=particle_set.pair_records,
            )
        shape = (model.envs, model.body_count)
        wp.launch(
            save_impulses.reaction_forces(real), dim=shape, inputs=[self.reactions, a.wrenches], device=device
        )

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of nonsmooth contacts."""
        for contact, numbers in self._displayed.items():
            if self.is_compliant(contact.name):
                continue
            if isinstance(contact, ShapeContact):
                single, on = contact.single, "the body of its first shape"
            else:
                single, on = contact.points.single, "the point's body"
            own: int | slice = numbers.start if single else numbers
            several = 0 if single else contact.count
            name, array = f"{contact.name}.impulse", self._display("impulse", own)
            text = f"impulse of the last step on {on}, world"
            yield Sensor(name, "N·s", text, array, needs=("contacts",), items=several, shape=(3,))
            name, array = f"{contact.name}.mode", self._display("mode", own)
            text = "contact mode in the last step"
            yield Sensor(name, "-", text, array, needs=("contacts",), items=several, codes=ContactMode)
        for manifolds, _, _ in self._manifold_sets.values():
            yield from manifolds.sensors()
        for key, (part, attribute, unit, meaning) in OF_SCENE.items():
            yield Sensor(f"scene.{key}", unit, meaning, self._of_scene(part, attribute))

    def _display(self, attribute: str, own: int | slice) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(self.displayed, attribute)[:, own]

    def _of_scene(self, part: str, attribute: str) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(getattr(self, part), attribute)
