"""Device data of a particle contact: neighbor lists, pair records, launches and sensors.

Kernels: ``kernels/particles``.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra import vectors
from warpcontact.forces.contact_groups import compile_force_kernel
from warpcontact.forces.execution_plan import SMALL_BLOCK
from warpcontact.forces.force_element import BuildContext, ForceElement, ForceTarget, Need
from warpcontact.forces.particle_contact.neighbor_capacity import (
    ALL_PAIRS_LIMIT,
    all_pair_lists,
    max_neighbors,
    owned_records,
)
from warpcontact.forces.particle_contact.step_warnings import particle_contact_warnings
from warpcontact.forces.sensor import Sensor, shape_in
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact.contact_evaluation import group_structs
from warpcontact.kernels.particles import force, history, measures, sums
from warpcontact.kernels.particles import neighbor_lists as lists
from warpcontact.kernels.particles.base import (
    IN_CONTACT,
    NO_INDEX,
    WAS_IN_CONTACT,
    ParticleTraits,
    particle_structs,
)
from warpcontact.scene import elements as limits_of
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.shapes import Shape
from warpcontact.storage.allocation_plan import AllocationPlan, fixed, per_env
from warpcontact.storage.parameters import ContactTolerance, DeviceField, Field, Parameter, Parameters, pack
from warpcontact.storage.state_storage import COUNT
from warpcontact.system.launches import launch_kernel
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel

# Bytes in the CPU cache per entry of a neighbor list, and per particle with the records of its contacts.
ENTRY_BYTES = 8
SHAPE_BYTES = 300

_RANGES = {
    "kappa": limits_of.KAPPA,
    "max_depth": limits_of.MAX_DEPTH,
    "torsion_radius": limits_of.TORSION_RADIUS,
    "force_scale": limits_of.FORCE_SCALE,
    "enabled": limits_of.ENABLED,
}
_TOTALS = {
    "contacts": ("contacts", "-", "number of pairs in contact"),
    "normal_force": ("normal_force", "N", "sum of the normal forces of all pairs"),
    "max_penetration": ("max_penetration", "m", "largest penetration of a pair, 0 without contact"),
    "max_normal_force": ("max_normal_force", "N", "largest normal force of a pair"),
}
_PER_PARTICLE = {
    "coordination": ("coordination", "-", "number of particles in contact with each particle"),
    "force": ("force", "N", "contact force on each particle, world"),
}


class ParticleContactSet(ForceElement):
    """Device data of a particle contact.

    Args:
        contact: The particle contact.
        context: The model to which arrays and parameters are added.

    Attributes:
        contact: The particle contact.
        all_pairs: Whether the neighbor lists are fixed and contain all pairs.
        entries: Number of entries of all neighbor lists of an environment.
        slots: Number of pair records of an environment.
        particles: Geometry and bodies of the particles.
        neighbor_lists: The neighbor lists.
        pair_records: Contact state and history of the pairs in the lists.
        cell_list: Cell list from which the neighbor lists are built.
        measured: Arrays of the sensors.
    """

    family = "particle contact"
    target = ForceTarget.BODIES

    def __init__(self, contact: ParticleContact, context: BuildContext) -> None:
        super().__init__()
        layout, parameters, types = context.layout, context.parameters, context.types
        self.contact = contact
        self.real = types.real
        self._types = types
        self._parts = contact.parts
        t = particle_structs(self.real)
        self.particles, self.neighbor_lists = t.Particles(), t.NeighborLists()
        self._pose = {
            key: [_parameter(parameters, shape, key) for shape in contact.shapes]
            for key in ("radius", "half_length", "position", "orientation")
        }
        count = contact.count
        self.all_pairs = count <= ALL_PAIRS_LIMIT
        self._capacity = self._make_lists(layout, parameters)
        placed = any(shape.positions.any() for shape in contact.shapes)
        self._traits = ParticleTraits(
            has_offsets=placed,
            has_capsules=any(one is not None for one in self._pose["half_length"]),
            all_pairs=self.all_pairs,
        )
        self.pair_records = layout.struct(
            "particles",
            t.PairRecords,
            per_env(self.slots),
            records=True,
            transient=[
                name for name in t.PairRecords.vars if name not in ("entry_speed", "flags", "particle_flags")
            ],
            ranges=dict.fromkeys(("flags", "particle_flags"), (0, IN_CONTACT | WAS_IN_CONTACT)),
            flags=per_env(self.slots),
            particle_flags=per_env(count),
        )
        self._buckets = 1 << (max(16, count) - 1).bit_length()
        self.cell_list = self._make_cell_list(layout)
        self._add_shapes(layout, parameters, sum(body.count for body in context.scene.bodies))
        self._add_settings(parameters)
        self._add_formulas(layout, parameters)
        self.measured = layout.struct(
            "particles",
            measures.measured(self.real),
            per_env(),
            transient=True,
            coordination=per_env(count),
            force=per_env(count),
        )
        has_joints = self._parts.law.needs_mass and context.has_joints
        # On a CPU one thread steps a slice, so wrenches can be added directly.
        self._single_thread = layout.device.is_cpu
        self._kernel = force.kernel(self._parts, self._traits, self.real, has_joints, self._single_thread)

    @property
    def _detection_kernel(self) -> wp.Kernel:
        """The kernel that detects nonsmooth contacts without computing forces."""
        return force.kernel(
            self._parts, self._traits, self.real, has_joints=False, single_thread=True, nonsmooth=True
        )

    def _make_lists(self, layout: AllocationPlan, parameters: Parameters) -> NDArray[np.int_] | None:
        """Declares the neighbor lists; returns the maximum number of neighbors per particle; ``None``: all pairs."""
        contact = self.contact
        count = contact.count
        if self.all_pairs:
            owned, other_pairs = all_pair_lists(contact.bodies, *contact.kinds)
            rows = [[*own, *other] for own, other in zip(owned, other_pairs, strict=True)]
            starts, slots = (np.cumsum([0, *map(len, each)]) for each in (rows, owned))
            slot_of = {
                frozenset((shape, neighbor)): slots[shape] + k
                for shape, own in enumerate(owned)
                for k, neighbor in enumerate(own)
            }
            records = [slot_of[frozenset((shape, neighbor))] for shape, row in enumerate(rows) for neighbor in row]
            # Shared by all environments.
            for name, values in (
                ("owned", [len(own) for own in owned]),
                ("count", [len(row) for row in rows]),
                ("neighbor", [neighbor for row in rows for neighbor in row] or [NO_INDEX]),
                ("slot", records or [NO_INDEX]),
            ):
                parameters.device_field(self.neighbor_lists, name, wp.int32, _constant(values))
            capacity = None
        else:
            if contact.max_neighbors is None:
                capacity = max_neighbors(*self._sizes(), contact.skin).max(axis=0)
            else:
                capacity = np.full(count, min(contact.max_neighbors, count - 1))
            starts, slots = (np.cumsum([0, *most]) for most in (capacity, owned_records(capacity)))
            # Stored in checkpoints, because pair history is indexed by them; they are rebuilt after loading.
            ranges = {
                "owned": (0, np.diff(slots)),
                "count": (0, np.diff(starts)),
                "neighbor": (0, count - 1),
                "slot": (NO_INDEX, int(slots[-1]) - 1),
            }
            for name, entries in (
                ("owned", count),
                ("count", count),
                ("neighbor", starts[-1]),
                ("slot", starts[-1]),
            ):
                layout.array(
                    "particles", self.neighbor_lists, name, wp.int32, per_env(int(entries)), ranges=ranges
                )
        self.entries, self.slots = int(starts[-1]), max(1, int(slots[-1]))
        layout.constant("particles", self.particles, "entry_start", starts, wp.int32)
        layout.constant("particles", self.particles, "slot_start", slots, wp.int32)
        return capacity

    def _make_cell_list(self, layout: AllocationPlan) -> Any:
        count = self.contact.count
        each = fixed(1, 1) if self.all_pairs else per_env(count)
        CellList = particle_structs(self.real).CellList
        counts = dict.fromkeys(("build_count", "overflow"), COUNT)
        return layout.struct(
            "particles",
            CellList,
            each,
            transient=[name for name in CellList.vars if name not in counts],
            ranges=counts,
            stale=per_env(),
            valid=per_env(),
            build_count=per_env(),
            overflow=per_env(),
            head=fixed(1, 1) if self.all_pairs else per_env(self._buckets),
            key=fixed(1, 1) if self.all_pairs else per_env(self.entries),
        )

    def _sizes(self) -> tuple[Array, Array]:
        """Returns radii and half lengths of all particles, (1 or envs, n) each."""
        return self._column("radius"), self._column("half_length")

    def _column(self, key: str) -> Array:
        """Returns a quantity of all particles, (1 or envs, n, …); 0 for shapes without this quantity."""
        columns = [
            np.zeros((1, shape.count)) if one is None else one.field.values[:, one.items]
            for one, shape in zip(self._pose[key], self.contact.shapes, strict=True)
        ]
        envs = max(len(column) for column in columns)
        return np.concatenate([np.broadcast_to(c, (envs, *c.shape[1:])) for c in columns], axis=1)

    def _add_shapes(self, layout: AllocationPlan, parameters: Parameters, body_count: int) -> None:
        """Adds positions, sizes and bodies of the particles."""
        contact, particles, vec3 = self.contact, self.particles, self._types.vec3
        kinds, allowed = contact.kinds
        for name, numbers in (("body", contact.bodies), ("kind", kinds), ("allowed", allowed)):
            layout.constant("particles", particles, name, numbers, wp.int32)
        order = np.argsort(contact.bodies, kind="stable")
        bodies, starts = np.unique(contact.bodies[order], return_index=True)
        self._owners = len(bodies)
        # One particle per body, in the order of the bodies: the index of a particle is that of its body.
        self._one_per_body = np.array_equal(bodies, contact.bodies)
        particle_of_body = np.full(body_count, NO_INDEX)
        particle_of_body[contact.bodies] = np.arange(contact.count)
        layout.constant("particles", particles, "particle_of_body", particle_of_body, wp.int32)
        for name, values in (
            ("owner_body", bodies),
            ("owner_start", [*starts, contact.count]),
            ("owner_particle", order),
        ):
            layout.constant("particles", particles, name, values, wp.int32)

        def axes() -> Array:
            half = self._column("half_length")
            turn = self._column("orientation")
            ends = half[..., None] * np.array([0.0, 0.0, 1.0])
            return vectors.transform_points(ends[..., None, :], np.zeros(3), turn)[..., 0, :]

        follow: dict[str, list[DeviceField]] = {
            "radius": [parameters.device_field(particles, "radius", self.real, self._radii)],
            "half_length": [],
            "position": [],
            "orientation": [],
        }
        follow["position"] = [parameters.device_field(particles, "offset", vec3, self._offsets)]
        if self._traits.has_capsules:
            follow["half_length"] = follow["orientation"] = [
                parameters.device_field(particles, "axis", vec3, axes)
            ]
        else:
            layout.array("particles", particles, "axis", vec3, fixed(1, 1), transient=True)
        for key, device_fields in follow.items():
            for one in self._pose[key]:
                if one is not None:
                    one.device_fields.extend(device_fields)

    def _offsets(self) -> Array:
        """Returns positions of the particles in their bodies, (1 or envs, n, 3).

        Raises:
            ValueError: If one is not at the center of mass and the kernels were compiled without offsets.
        """
        offsets = self._column("position")
        if not self._traits.has_offsets and offsets.any():
            raise ValueError(
                f"{self.contact.name}: all shapes were at the center of mass of their body when the model was "
                "built, so positions cannot be changed; set another position in add_shape"
            )
        return offsets

    def _radii(self) -> Array:
        """Returns the radii of all particles, (1 or envs, n).

        Raises:
            ValueError: If particles can have more neighbors than their lists can hold.
        """
        radius, half = self._sizes()
        if self._capacity is not None and self.contact.max_neighbors is None:
            needed = max_neighbors(radius, half, self.contact.skin)
            if (needed > self._capacity).any():
                shape = int((needed - self._capacity).max(axis=0).argmax())
                raise ValueError(
                    f"{self.contact.name}: with these radii {self.contact.label(shape)!r} can have "
                    f"{needed[:, shape].max()} neighbors, but its list has {self._capacity[shape]} entries. Build the "
                    "scene with the largest and smallest radii that occur, or set max_neighbors in "
                    "add_particle_contact"
                )
        return radius

    def _add_settings(self, parameters: Parameters) -> None:
        contact = self.contact
        struct = particle_structs(self.real).ParticleContactSettings
        # A torsion radius of −1 stands for one computed from the penetration.
        values = {key: getattr(contact, key) for key in _RANGES}
        fields = {key: Field(np.array([-1.0 if value is None else value])) for key, value in values.items()}
        fields["contact_tolerance"] = Field(np.zeros(1))

        def content() -> NDArray[Any]:
            radius, half = self._sizes()
            columns = {key: field.values for key, field in fields.items()}
            columns["skin"] = np.full((1, 1), contact.skin)
            columns["cell"] = 2.0 * (radius + half).max(axis=1, keepdims=True) + contact.skin
            return pack(struct, columns)

        device_field = parameters.device_field(self.particles, "settings", struct, content)
        self.contact_tolerance = ContactTolerance(fields["contact_tolerance"], device_field)
        for key in ("radius", "half_length"):
            for one in self._pose[key]:
                if one is not None:
                    one.device_fields.append(device_field)
        for key, allowed in _RANGES.items():
            if values[key] is not None:
                parameters.add(
                    f"{contact.name}.{key}",
                    fields[key],
                    slice(0, 1),
                    allowed,
                    [device_field],
                    convert=checks.switches if key == "enabled" else None,
                )

    def _add_formulas(self, layout: AllocationPlan, parameters: Parameters) -> None:
        """Adds the parameters of law and friction models, the same for all pairs, and their history arrays."""
        Coefficients, Memory = group_structs(self._parts, self.real)
        self._coefficients, self._memory, self._history_out = Coefficients(), Memory(), Memory()
        for part, formula in self.contact.formulas.items():
            self._add_formula(part, formula, parameters)
            for target in (self._memory, self._history_out):
                # A dummy array if the formula has no history variables.
                shape = per_env(self.slots) if formula.memories else fixed(1, 1)
                transient = target is self._history_out or not formula.memories
                struct = memory_struct(type(formula), self.real)
                layout.array("particles", target, part, struct, shape, transient=transient)

    def _add_formula(self, part: str, formula: Formula, parameters: Parameters) -> None:
        struct = coefficient_struct(type(formula), self.real)
        fields = {name: Field(np.array([float(value)])) for name, value in formula.parameters().items()}

        def content() -> NDArray[Any]:
            if not formula.device_names():
                return pack(struct, {"unused": np.zeros((1, 1))})
            values = [field.values for field in fields.values()]
            computed = formula.coefficients(dict(zip(fields, np.broadcast_arrays(*values), strict=True)))
            return pack(struct, {name: computed[name] for name in formula.device_names()})

        device_field = parameters.device_field(self._coefficients, part, struct, content, items=self.slots)
        for name, field in fields.items():
            full = f"{self.contact.name}.{part}.{name}"
            parameters.add(full, field, slice(0, 1), formula.limits(name), [device_field])

    @property
    def cache_bytes(self) -> int:
        """Estimate of the memory that a step accesses per environment [bytes]."""
        return ENTRY_BYTES * self.entries + SHAPE_BYTES * self.contact.count

    def compile(self, device: wp.Device) -> None:
        """Compiles the force kernel if it has user-defined formulas, to report errors early.

        Raises:
            TypeError: If a law or friction model does not compile.
        """
        compile_force_kernel(self._parts, lambda: self._kernel, device, self.real)

    @property
    def sums_by_body(self) -> bool:
        """Whether the integrator can sum the contacts of a body: one particle per body, and not summed directly."""
        return self._one_per_body and not self._single_thread

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launches that add the contact forces of the particles to the wrenches of ``state``.

        For nonsmooth contact, only pairs are detected.
        """
        launches = [] if self.all_pairs else self._list_stages(plan, state, status)
        nonsmooth = self._is_nonsmooth(plan)
        inputs = {"status": status, "state": state, "wrenches": plan.model.arrays.wrenches, **self.pair_inputs}
        launches += plan.prepare(
            self._detection_kernel if nonsmooth else self._kernel,
            self.contact.count,
            block_dim=SMALL_BLOCK,
            model=plan.model.arrays.model,
            cell_list=self.cell_list,
            history_in=self._memory,
            step=step,
            coefficients=self._coefficients,
            history_out=self._history_out,
            write_outputs=plan.write_outputs,
            **inputs,
        )
        if not (self._single_thread or nonsmooth or by_cluster):
            kernel = sums.add(self.real, self._one_per_body)
            launches += plan.prepare(kernel, self._owners, block_dim=SMALL_BLOCK, **inputs)
        return launches

    @property
    def pair_inputs(self) -> dict[str, Any]:
        """Arguments of kernels that go through the pairs of each particle."""
        return {
            "particles": self.particles,
            "neighbor_lists": self.neighbor_lists,
            "pair_records": self.pair_records,
        }

    @property
    def integrator_inputs(self) -> dict[str, Any]:
        """Arguments of the integration kernel from which it sums the forces."""
        return self.pair_inputs

    def _list_stages(self, plan: "ExecutionPlan", state: Any, status: wp.array) -> list[wp.Launch]:
        """Returns the launches that rebuild the neighbor lists of environments in which they are no longer valid."""
        count, buckets, real, traits = self.contact.count, self._buckets, self.real, self._traits
        cells = {"status": status, "cell_list": self.cell_list}
        positions = {"state": state, "particles": self.particles, **cells}
        pairs = {"particles": self.particles, "neighbor_lists": self.neighbor_lists, **cells}
        launches = plan.prepare(lists.check_validity(traits, real), count, **positions)
        launches += plan.prepare(lists.clear(real), buckets, **cells)
        launches += plan.prepare(lists.fill(traits, real), count, buckets=buckets, **positions)
        kernel = lists.build(traits, real)
        launches += plan.prepare(kernel, count, buckets=buckets, state=state, **cells, **self.pair_inputs)
        if plan.nonsmooth is not None and self._is_nonsmooth(plan):
            kernel, first = lists.transfer_impulses(real), plan.nonsmooth.first_record_of(self.contact)
            launches += plan.prepare(kernel, count, first=first, stored=plan.nonsmooth.stored_impulses, **pairs)
        launches += plan.prepare(
            lists.transfer_history(self._parts, real),
            count,
            pair_records=self.pair_records,
            history_out=self._history_out,
            memory=self._memory,
            **pairs,
        )
        return launches + plan.prepare(lists.build_reverse(real), count, **pairs)

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launch that advances the pair history after an accepted step."""
        return plan.prepare(
            history.accept(self._parts, self.real, self._is_nonsmooth(plan)),
            self.contact.count,
            block_dim=SMALL_BLOCK,
            status=plan.model.arrays.status,
            history_out=self._history_out,
            memory=self._memory,
            **self.pair_inputs,
        )

    def _is_nonsmooth(self, plan: "ExecutionPlan") -> bool:
        return plan.nonsmooth is not None and not plan.nonsmooth.is_compliant(self.contact.name)

    def reset_state(self, chosen: wp.array) -> None:
        """Clears the pair history in the environments of the mask ``chosen`` [env]."""
        launch_kernel(
            history.reset(),
            (len(chosen), max(self.slots, self.contact.count)),
            device=chosen.device,
            mask=chosen,
            flags=self.pair_records.flags,
            particle_flags=self.pair_records.particle_flags,
            valid=self.cell_list.valid,
            build_count=self.cell_list.build_count,
            overflow=self.cell_list.overflow,
        )

    def invalidate_caches(self) -> None:
        """Invalidates all neighbor lists, because radii or positions may have changed."""
        self.cell_list.valid.zero_()

    def check(self) -> None:
        """Waits for the device and checks that no neighbor list was too short since reset.

        Raises:
            RuntimeError: If one was too short.
        """
        needed = int(self.cell_list.overflow.numpy().max(initial=0))
        if needed > 0:
            raise RuntimeError(
                f"{self.contact.name}: a particle had {needed} neighbors more than its list can hold, and their forces "
                "are missing. Increase max_neighbors in add_particle_contact, or reduce skin (now "
                f"{self.contact.skin:g} m)"
            )

    def advice_needs_evaluation(self, model: "Environments", nonsmooth: "NonsmoothContacts | None") -> bool:
        """Returns whether there are contacts with meshes, which sensors of particle contacts evaluate as well."""
        return model.parts[0].contact_count > 0

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about step length and initial penetration."""
        return particle_contact_warnings(model, self.contact, dt, nonsmooth)

    def needs(self) -> Mapping[str, Need]:
        """Returns the need of the sums over pairs, whose arrays always exist."""
        return {"particles": Need()}

    def measure(self, model: "DeviceModel", needs: Collection[str]) -> None:
        """Computes its sensors from the last computed forces."""
        if "particles" not in needs:
            return
        inputs, count, device = {"measured": self.measured, **self.pair_inputs}, self.contact.count, model.device
        launch_kernel(measures.particles(self.real), (model.envs, count), device=device, **inputs)
        launch_kernel(measures.totals(self.real), model.envs, device=device, count=count, **inputs)

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of the particle contact."""
        name, count = self.contact.name, self.contact.count
        for quantity, (attribute, unit, meaning) in _TOTALS.items():
            array, shape = self._array(attribute), shape_in(self.measured, attribute)
            yield Sensor(f"{name}.{quantity}", unit, meaning, array, needs=("contacts", "particles"), shape=shape)
        for quantity, (attribute, unit, meaning) in _PER_PARTICLE.items():
            array = self._array(attribute)
            shape, needs = shape_in(self.measured, attribute), ("contacts", "particles")
            yield Sensor(f"{name}.{quantity}", unit, meaning, array, needs=needs, items=count, shape=shape)

    def _array(self, attribute: str) -> Any:
        return lambda _: getattr(self.measured, attribute)


def _constant(values: list[int]) -> Callable[[], NDArray[Any]]:
    row = np.array(values, dtype=np.int32)[None]
    return lambda: row


def _parameter(parameters: Parameters, shape: Shape, key: str) -> Parameter | None:
    """Returns a parameter of a shape; ``None`` if it does not exist."""
    return parameters.by_name.get(f"{shape.name}.{key}")


def declare(context: BuildContext, elements: Sequence[ParticleContact]) -> list[ForceElement]:
    """Declares the particle contacts of a model."""
    return [ParticleContactSet(contact, context) for contact in elements]
