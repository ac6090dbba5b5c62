"""Device data of body contacts, grouped by contact model. Kernels: ``kernels/body_contact``."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.body_contact.body_sums import sum_warnings
from warpcontact.forces.body_contact.curved_shapes import is_curved
from warpcontact.forces.body_contact.manifold_set import ManifoldSet
from warpcontact.forces.body_contact.overlap_warnings import (
    body_overlap_warnings,
    deep_contact_warnings,
    overlaps_may_eject,
)
from warpcontact.forces.body_contact.solid_tables import SolidTables
from warpcontact.forces.body_contact.step_warnings import PairEstimates, pair_estimates, pair_warnings
from warpcontact.forces.contact_groups import add_material_parameters, compile_force_kernel
from warpcontact.forces.contact_warnings import is_nonsmooth, nonsmooth_overlap_warnings
from warpcontact.forces.force_element import BuildContext, ForceElement, ForceTarget
from warpcontact.forces.sensor import Sensor, shape_in
from warpcontact.kernels.acceptance import reset
from warpcontact.kernels.body_contact import acceptance, bounds, force, step_oscillations
from warpcontact.kernels.body_contact.patches import PATCH_COUNT
from warpcontact.kernels.body_contact.records import BodyContactSettings, Patches, SolidPairs, body_contact_structs
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs, history_precision
from warpcontact.scene import elements as limits_of
from warpcontact.scene.body_contact import BodyContact, reference_share
from warpcontact.scene.status import ContactStatus
from warpcontact.storage.allocation_plan import fixed, per_env
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import Field, Parameters, pack
from warpcontact.storage.state_storage import COUNT
from warpcontact.validation import checks
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.storage.allocation_plan import AllocationPlan

# Bytes of a pair in the cache of a core: two solids and the results.
PAIR_BYTES = 500
_PURPOSE = "body contacts"
_RANGES = {
    "kappa": limits_of.KAPPA,
    "max_depth": limits_of.MAX_DEPTH,
    "margin": limits_of.MARGIN,
    "force_scale": limits_of.FORCE_SCALE,
    "enabled": limits_of.ENABLED,
}
# name: (array, unit, meaning)
_SENSORS = {
    "status": ("status", "-", "state of the contact"),
    "depth": ("depth", "m", "depth of the overlap, 0 without"),
    "normal_force": ("normal_force", "N", "normal force, the sum of its magnitude over the area"),
    "friction_force": ("friction_force", "N", "friction force on the first body, world"),
    "force": ("force", "N", "force on the first body, world"),
    "torque": ("torque", "N·m", "torque on the first body about its center of mass, world"),
    "area": ("area", "m²", "area of contact"),
    "center": ("center", "m", "center of pressure, world"),
    "normal": ("normal", "-", "mean unit normal out of the second solid, weighted by pressure, world"),
    "max_pressure": ("max_pressure", "Pa", "largest pressure"),
    "volume": ("volume", "m³", "volume of the columns"),
    "reference": ("share", "-", "weight of the second solid as the reference, 0 to 1"),
    "approach_speed": ("approach_speed", "m/s", "mean rate of penetration over the area, 0 without contact"),
}


class BodyContactSet(ForceElement):
    """Device data of body contacts with the same contact model.

    Args:
        contacts: The contacts.
        tables: Geometries and poses of the solids of all body contacts.
        computes_boxes: Whether it computes the boxes around the solids, for itself and the sets after it.
        context: The model to which arrays, ends and parameters are added.

    Attributes:
        parts: The contact model: classes of law and friction models.
        kernels: The force kernels, one for each number of curved solids of a pair that occurs.
        count: Number of pairs.
        first_end: Number of the first end. Pair i has the ends ``first_end`` + 2 i (first body) and
            ``first_end`` + 2 i + 1 (second body).
        manifolds: Manifolds of all pairs if the law is rigid; otherwise ``None``, and a simulation with nonsmooth contact
            declares them.
        active_manifolds: Manifolds of the nonsmooth contacts that are stepped; ``None``: there are none.
    """

    family = "body contact"
    target = ForceTarget.ENDS

    def __init__(
        self, contacts: Sequence[BodyContact], tables: SolidTables, computes_boxes: bool, context: BuildContext
    ) -> None:
        super().__init__()
        self.computes_boxes = computes_boxes
        self.parts: ContactModel = contacts[0].parts
        self.tables = tables
        self.real = context.types.real
        starts = np.cumsum([0] + [contact.count for contact in contacts]).tolist()
        self.items = {
            contact: slice(start, start + contact.count) for contact, start in zip(contacts, starts, strict=False)
        }
        self.count: int = starts[-1]
        has_joints = context.has_joints and self.parts.law.needs_mass
        # Each kernel skips the pairs of the others.
        curved_counts = {sum(is_curved(one) for one in pair) for each in contacts for pair in each.pairs}
        self.kernels = tuple(
            force.contact_forces(self.parts, self.real, contacts[0].per_area, has_joints, count)
            for count in sorted(curved_counts)
        )
        numbers = np.array([[tables.number(one) for one in pair] for each in contacts for pair in each.pairs])
        self.first_end = 2 * context.ends.add(tables.bodies[numbers])
        self._declare(context.layout, numbers)
        self._add_settings(context.parameters)
        rigid = self.parts.law.rigid
        self.manifolds = ManifoldSet(self, self.items, context.layout) if rigid else None
        self.active_manifolds = self.manifolds
        add_material_parameters(tuple(self.items), self.parts, self.coefficients, context.parameters, self.real)

    @property
    def contact_count(self) -> int:
        """Number of pairs per environment."""
        return self.count

    @property
    def cache_bytes(self) -> int:
        """Estimate of the memory that a step accesses per environment [bytes]."""
        return PAIR_BYTES * self.count

    def _declare(self, layout: "AllocationPlan", numbers: NDArray[np.int_]) -> None:
        self.pairs = SolidPairs()
        for key, column in (("first", numbers[:, 0]), ("second", numbers[:, 1])):
            layout.constant(_PURPOSE, self.pairs, key, column, wp.int32)
        BodyContacts = body_contact_structs(self.real).BodyContacts
        computed = [name for name in BodyContacts.vars if name != "entry_speed"]
        self.body_contacts = layout.struct(_PURPOSE, BodyContacts, per_env(self.count), transient=computed)
        self.oscillations: Any = None
        if not self.parts.law.rigid:
            StepOscillations = step_oscillations.oscillation_structs(self.real).StepOscillations
            ranges = {"reversals": COUNT, "unstable_steps": COUNT}
            self.oscillations = layout.struct(_PURPOSE, StepOscillations, per_env(self.count), ranges=ranges)
        Coefficients, Memory = group_structs(self.parts, self.real, per_patch=self.parts.acts_per_patch)
        self.coefficients, self.memory, self.history_out = Coefficients(), Memory(), Memory()
        # History variables of law and friction: one set per patch.
        self.has_patches = self.parts.acts_per_patch
        self.has_law_history = bool(self.parts.law.memories)
        each = per_env(PATCH_COUNT * self.count) if self.has_patches else fixed(1, 1)
        for part, formula in self.parts._asdict().items():
            precision = history_precision(part, formula, self.real, per_patch=True)
            for target in (self.memory, self.history_out):
                # A dummy array if the formula has no history variables.
                shape = each if formula.memories else fixed(1, 1)
                transient = target is self.history_out or not formula.memories
                layout.array(_PURPOSE, target, part, memory_struct(formula, precision), shape, transient=transient)
        self.patches, self.patches_out = Patches(), Patches()
        fields = (("normal", wp.vec3d, self.has_patches), ("entry_speed", wp.float64, self.has_law_history))
        for key, kind, is_used in fields:
            for target in (self.patches, self.patches_out):
                transient = target is self.patches_out or not is_used
                shape = each if is_used else fixed(1, 1)
                layout.array(_PURPOSE, target, key, kind, shape, transient=transient)

    def _add_settings(self, parameters: Parameters) -> None:
        self.settings: Any = None
        fields = {
            key: Field(np.concatenate([np.full(one.count, getattr(one, key)) for one in self.items]))
            for key in _RANGES
        }
        fields["reference"] = Field(np.concatenate([reference_share(one) for one in self.items]))

        def content() -> NDArray[Any]:
            return pack(BodyContactSettings, {key: field.values for key, field in fields.items()})

        device_field = parameters.device_field(self, "settings", BodyContactSettings, content)
        for contact, items in self.items.items():
            for key, allowed in _RANGES.items():
                convert = checks.switches if key == "enabled" else None
                name = f"{contact.name}.{key}"
                parameters.add(
                    name, fields[key], items, allowed, [device_field], single=contact.single, convert=convert
                )

    def compile(self, device: wp.Device) -> None:
        """Compiles the force kernels if they have user-defined laws, to report errors early.

        Raises:
            TypeError: If a law or friction model does not compile.
        """
        for number in range(len(self.kernels)):
            compile_force_kernel(self.parts, partial(self.kernels.__getitem__, number), device, self.real)

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launches that compute overlaps and forces in ``state``, or manifolds of nonsmooth contacts."""
        a = plan.model.arrays
        tables = self.tables
        common = {"status": status, "state": state, "geometries": tables.geometries, "solids": tables.solids}
        launches: list[wp.Launch] = []
        if self.computes_boxes:
            launches = plan.prepare(bounds.solid_boxes(self.real), tables.count, boxes=tables.boxes, **common)
        for first, count in self._compliant_pairs(plan):
            for kernel in self.kernels:
                launches += plan.prepare(
                    kernel,
                    count,
                    model=a.model,
                    step=step,
                    first_pair=first,
                    first_end=self.first_end,
                    boxes=tables.boxes,
                    pairs=self.pairs,
                    settings=self.settings,
                    coefficients=self.coefficients,
                    history_in=self.memory,
                    history_out=self.history_out,
                    patches_in=self.patches,
                    patches_out=self.patches_out,
                    body_contacts=self.body_contacts,
                    ends=a.end_wrenches,
                    **common,
                )
        manifolds = self.manifolds if plan.nonsmooth is None else plan.nonsmooth.manifolds_of(self)
        if manifolds is not None:
            launches += manifolds.find_launches(plan, state, step, status)
        return launches

    def _compliant_pairs(self, plan: "ExecutionPlan") -> list[tuple[int, int]]:
        """Returns ranges (first, count) of the pairs that have forces."""
        if self.parts.law.rigid:
            return []
        return [(0, self.count)] if plan.nonsmooth is None else plan.nonsmooth.compliant_items(self.items)

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launches that count unstable steps and store entry speeds, patches and history variables after a step."""
        launches: list[wp.Launch] = []
        for first, count in self._compliant_pairs(plan):
            launches += plan.prepare(
                step_oscillations.count_oscillations(self.real),
                count,
                status=plan.model.arrays.status,
                step=dt.real,
                first_pair=first,
                body_contacts=self.body_contacts,
                oscillations=self.oscillations,
            )
        return launches + plan.prepare(
            acceptance.accept_contacts(self.parts, self.real),
            self.count,
            status=plan.model.arrays.status,
            step=dt.real,
            body_contacts=self.body_contacts,
            patches_out=self.patches_out,
            patches=self.patches,
            history_out=self.history_out,
            memory=self.memory,
        )

    def reset_state(self, chosen: wp.array) -> None:
        """Clears entry speeds, patches and history in the environments of the mask ``chosen`` [env]."""
        envs, device = len(chosen), chosen.device
        if self.manifolds is not None:
            self.manifolds.reset_state(chosen)
        inputs = [chosen, self.body_contacts]
        wp.launch(acceptance.reset_contacts(self.real), dim=(envs, self.count), inputs=inputs, device=device)
        if self.oscillations is not None:
            kernel, inputs = step_oscillations.reset_oscillations(self.real), [chosen, self.oscillations]
            wp.launch(kernel, dim=(envs, self.count), inputs=inputs, device=device)
        if self.has_patches:
            dim = (envs, PATCH_COUNT * self.count)
            wp.launch(
                acceptance.reset_patches(self.has_law_history),
                dim=dim,
                inputs=[chosen, self.patches],
                device=device,
            )
            for part, formula in self.parts._asdict().items():
                if formula.memories:
                    inputs = [chosen, getattr(self.memory, part)]
                    precision = history_precision(part, formula, self.real, per_patch=True)
                    wp.launch(reset.memory(formula, precision), dim=dim, inputs=inputs, device=device)

    def failures(self) -> dict[str, NDArray[np.int32]]:
        """Returns the number of steps since reset in which forces were wrong, (envs,) by contact; the maximum of its pairs.

        Nonsmooth contacts had more patches than room; the time step was too long for the others.
        """
        found = {} if self.active_manifolds is None else self.active_manifolds.failures()
        if self.oscillations is not None and self.oscillations.unstable_steps is not None:
            values = self.oscillations.unstable_steps.numpy()
            for contact, items in self.items.items():
                found.setdefault(contact.name, values[:, items].max(axis=1))
        return found

    def failure_warning(self, name: str, count: int, envs: int, first: int) -> RunWarning:
        """Returns a warning that two solids had more patches than room, or that the time step was too long."""
        if self.active_manifolds is None or name not in self.active_manifolds.failures():
            return RunWarning(
                f"{name}: dt was too long in {count} of {envs} environments (first: {first}): the rate of penetration changed "
                "its sign in successive steps without decay, so bodies gain energy. Use a shorter dt. While bodies are in "
                f"contact, Simulation.check recommends one. {name}.unstable_steps counts such steps",
                WarningLevel.ERROR,
            )
        text = (
            f"{name}: two solids touched with more than {self.active_manifolds.patch_count} different normals in {count} of {envs} environments "
            f"(first: {first}). The areas with the smallest gaps acted. Use several surfaces instead of one mesh, or "
            f"compliant=[{name!r}]; {name}.overflow counts such steps"
        )
        return RunWarning(text, WarningLevel.CAUTION)

    def final_warnings(self, model: "Environments") -> list[RunWarning]:
        """Returns warnings about contacts that are deep at the end of a run."""
        nonsmooth = [] if self.active_manifolds is None else list(self.active_manifolds.contacts)
        compliant = [contact for contact in self.items if contact not in nonsmooth]
        found = deep_contact_warnings(model, self.tables, nonsmooth, nonsmooth=True)
        return found + deep_contact_warnings(model, self.tables, compliant, nonsmooth=False)

    def advice_needs_evaluation(self, model: "Environments", nonsmooth: "NonsmoothContacts | None") -> bool:
        """Returns whether some contacts are nonsmooth, or bodies might overlap enough to be ejected."""
        if any(is_nonsmooth(contact.name, nonsmooth) for contact in self.items):
            return True
        return self.computes_boxes and overlaps_may_eject(model, self.tables, self._estimates(model, nonsmooth))

    def _estimates(self, model: "Environments", nonsmooth: "NonsmoothContacts | None") -> list[PairEstimates]:
        """Returns the estimates of the compliant contacts of all sets."""
        return [
            pairs
            for one in model.parts[0].of_family(self.family)
            for contact in one.items
            if not is_nonsmooth(contact.name, nonsmooth)
            and (pairs := pair_estimates(model, contact, one)) is not None
        ]

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about the time step and about initial penetration.

        The first set returns those of compliant contacts for all sets, because contacts of a body act together.
        """
        sentences = []
        for contact in self.items:
            if is_nonsmooth(contact.name, nonsmooth):
                sentences += nonsmooth_overlap_warnings(model, f"{contact.name}.depth", dt, nonsmooth)
        if not self.computes_boxes:
            return sentences
        estimates = self._estimates(model, nonsmooth)
        alone = [sentence for pairs in estimates for sentence in pair_warnings(model, pairs, dt)]
        if estimates and not alone:
            alone = sum_warnings(model, self.tables, estimates, dt)
        if overlaps_may_eject(model, self.tables, estimates):
            alone += body_overlap_warnings(model, estimates)
        return sentences + alone

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of the body contacts."""
        for contact, items in self.items.items():
            own: int | slice = items.start if contact.single else items
            several = 0 if contact.single else contact.count
            for key, (attribute, unit, meaning) in _SENSORS.items():
                yield Sensor(
                    f"{contact.name}.{key}",
                    unit,
                    meaning,
                    self._column(attribute, own),
                    needs=("contacts",),
                    items=several,
                    codes=ContactStatus if key == "status" else None,
                    shape=shape_in(self.body_contacts, attribute),
                )
            if self.oscillations is not None:
                yield Sensor(
                    f"{contact.name}.unstable_steps",
                    "-",
                    "number of steps since reset that were too long: the rate of penetration changed its sign without decay",
                    self._column("unstable_steps", own, of="oscillations"),
                    items=several,
                )

    def _column(
        self, attribute: str, items: int | slice, of: str = "body_contacts"
    ) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(getattr(self, of), attribute)[:, items]


def declare(context: BuildContext, elements: Sequence[BodyContact]) -> list[ForceElement]:
    """Declares the body contacts of a model, and their solids."""
    solids = list(dict.fromkeys(solid for contact in elements for pair in contact.pairs for solid in pair))
    tables = SolidTables(solids, context.layout, context.parameters)
    groups: dict[Any, list[BodyContact]] = {}
    for contact in elements:
        groups.setdefault((contact.parts, contact.per_area), []).append(contact)
    return [BodyContactSet(own, tables, i == 0, context) for i, own in enumerate(groups.values())]
