"""Device data of shape contacts, grouped by contact model, and within a group by the kinds of the two shapes.

The narrow phase is compiled per pair of kinds, the force kernel per contact model. Kernels: ``kernels/shapes``.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.contact_groups import add_material_parameters, compile_force_kernel, history_view
from warpcontact.forces.force_element import BuildContext, ForceElement, ForceTarget, Need
from warpcontact.forces.sensor import CONTACT_SENSORS, Sensor, shape_in
from warpcontact.forces.shape_contact.measures import has_curvatures, measure
from warpcontact.forces.shape_contact.step_warnings import shape_contact_warnings
from warpcontact.forces.shape_sets import ShapeSet
from warpcontact.kernels.acceptance import reset
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.shapes import force, measures, narrow_phase
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.records import (
    CURVATURE_ARRAYS,
    ORIENTATION_ARRAYS,
    ContactShapes,
    ShapeContactSettings,
    WarmStarts,
    shape_contact_structs,
)
from warpcontact.scene import elements as limits_of
from warpcontact.scene.shapes import ShapeContact
from warpcontact.scene.status import ContactStatus
from warpcontact.storage.allocation_plan import SENSOR_PURPOSE, fixed, per_env
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import ContactTolerance, Field, pack
from warpcontact.storage.state_storage import COUNT, SWITCH
from warpcontact.system.compilation import load
from warpcontact.validation import checks
from warpcontact.validation.custom_law_errors import compile_error_text, has_user_code
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.scene_data import SceneData
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters

# Bytes of a contact in the cache of a core; measured.
CONTACT_BYTES = 300
_RANGES = {
    "kappa": limits_of.KAPPA,
    "max_depth": limits_of.MAX_DEPTH,
    "torsion_radius": limits_of.TORSION_RADIUS,
    "force_scale": limits_of.FORCE_SCALE,
    "enabled": limits_of.ENABLED,
}
_STRUCTS = {
    "shape_points": measures.Points,
    "shape_curvatures": measures.Curvatures,
    "shape_gradients": measures.Gradients,
}
# name: (array, unit, meaning), in addition to the sensors of all contacts
_CONTACT_SENSORS = {
    "iterations": ("iterations", "-", "number of iterations of the narrow phase"),
    "residual": ("residual", "-", "residual of the narrow phase"),
    "converged": ("converged", "-", "1: the narrow phase converged; 0: it did not, and no force is applied"),
    "failures": ("failures", "-", "number of steps in which it did not converge, since reset"),
}
# name: (measure, array, unit, meaning)
_MEASURES = {
    "point": ("shape_points", "point", "m", "contact point K, world"),
    "point_a": ("shape_points", "point_a", "m", "contact point on the first surface, world"),
    "point_b": ("shape_points", "point_b", "m", "contact point on the other surface, world"),
}
# The same, if the curvatures of both shapes are available.
_CURVATURES = {
    "curvature_1": ("shape_curvatures", "curvature_1", "1/m", "smaller principal curvature of the gap"),
    "curvature_2": ("shape_curvatures", "curvature_2", "1/m", "larger principal curvature of the gap"),
}


# Quantity: units of its derivatives with respect to positions and rotations.
_DERIVED = {"gap": ("-", "m"), "normal": ("1/m", "-"), "point_a": ("-", "m"), "point_b": ("-", "m")}
_GRADIENTS = {
    f"{what}_by_{by}_{side}": (
        "shape_gradients",
        f"{what}_by_{by}_{side}",
        units[by == "rotation"],
        f"derivative with respect to the {by} of the body of the {which} shape, world axes",
    )
    for what, units in _DERIVED.items()
    for by in ("position", "rotation")
    for side, which in (("a", "first"), ("b", "other"))
}


class ShapeContactSet(ForceElement):
    """Device data of shape contacts with the same contact model.

    Args:
        contacts: The contacts, ordered by the kinds of their shapes.
        first: Number of the first item among all shape contacts of the scene.
        shapes: The shapes of the scene by kind.
        context: The model to which arrays, ends and parameters are added.

    Attributes:
        parts: The contact model: classes of law and friction models.
        kernel: The force kernel.
        count: Number of contacts, counting all items.
        first: Number of the first item among all shape contacts of the scene.
        first_end: Number of the first end. Contact i of the set has the ends ``first_end`` + 2 i (body of ``shape``)
            and ``first_end`` + 2 i + 1 (body of ``other_shape``).
    """

    family = "shape contact"
    target = ForceTarget.ENDS

    def __init__(
        self,
        contacts: Sequence[ShapeContact],
        first: int,
        shapes: Mapping[type[Form], ShapeSet],
        context: BuildContext,
    ) -> None:
        super().__init__()
        self.parts: ContactModel = contacts[0].parts
        self.first = first
        self.shapes = shapes
        self.real = context.types.real
        starts = np.cumsum([0] + [contact.count for contact in contacts]).tolist()
        self.items = {
            contact: slice(start, start + contact.count) for contact, start in zip(contacts, starts, strict=False)
        }
        self.count: int = starts[-1]
        self.ranges = _ranges(self.items)
        self.needs_curvature, self.needs_surface_axes = (
            force.uses_curvature(self.parts),
            self.parts.needs_surface_axes,
        )
        # Joints affect only the effective mass.
        self.kernel = force.contact_forces(self.parts, self.real, context.has_joints and self.parts.law.needs_mass)
        self._declare(context.layout)
        self.first_end = 2 * context.ends.add(self.bodies)
        self._add_settings(context.parameters)
        add_material_parameters(tuple(self.items), self.parts, self.coefficients, context.parameters, self.real)

    @property
    def contact_count(self) -> int:
        """Number of contacts per environment."""
        return self.count

    @property
    def cache_bytes(self) -> int:
        """Estimate of the memory that a step accesses per environment [bytes]."""
        return CONTACT_BYTES * self.count

    def _declare(self, layout: "AllocationPlan") -> None:
        each, nothing = per_env(self.count), fixed(1, 1)
        absent = ((CURVATURE_ARRAYS, self.needs_curvature), (ORIENTATION_ARRAYS, self.needs_surface_axes))
        other_shapes: dict[str, Any] = {name: nothing for names, there in absent if not there for name in names}
        ShapeContacts = shape_contact_structs(self.real).ShapeContacts
        computed = [name for name in ShapeContacts.vars if name not in ("entry_speed", "failures")]
        self.shape_contacts = layout.struct(
            "shape contacts", ShapeContacts, each, transient=computed, ranges={"failures": COUNT}, **other_shapes
        )
        self.warm_starts = layout.struct("shape contacts", WarmStarts, each, ranges={"warm_start.valid": SWITCH})
        self.new_warm_starts = layout.struct("shape contacts", WarmStarts, each, transient=True)
        self.contact_shapes = ContactShapes()
        bodies = {
            key: np.concatenate([_each(getattr(contact, key).body_numbers, contact) for contact in self.items])
            for key in ("shape", "other_shape")
        }
        numbers = {
            key: np.concatenate(
                [_each(self.shapes[one.kind].numbers(one), contact) for contact, one in self._sides(key)]
            )
            for key in ("shape", "other_shape")
        }
        self.bodies = np.stack([bodies["shape"], bodies["other_shape"]], axis=1)
        for key, suffix in (("shape", "a"), ("other_shape", "b")):
            layout.constant("shape contacts", self.contact_shapes, f"shape_{suffix}", numbers[key], wp.int32)
            layout.constant("shape contacts", self.contact_shapes, f"body_{suffix}", bodies[key], wp.int32)
        Coefficients, Memory = group_structs(self.parts, self.real)
        self.coefficients, self.memory, self.history_out = Coefficients(), Memory(), Memory()
        for part, formula in self.parts._asdict().items():
            for target in (self.memory, self.history_out):
                # A dummy array if the formula has no history variables.
                shape = each if formula.memories else nothing
                transient = target is self.history_out or not formula.memories
                struct = memory_struct(formula, self.real)
                layout.array("shape contacts", target, part, struct, shape, transient=transient)

    def _sides(self, key: str) -> Iterator[tuple[ShapeContact, Any]]:
        return ((contact, getattr(contact, key)) for contact in self.items)

    def _add_settings(self, parameters: "Parameters") -> None:
        self.settings: Any = None
        # A torsion radius of −1 stands for one computed from the penetration.
        fields = {
            key: Field(
                np.concatenate(
                    [
                        np.full(contact.count, -1.0 if (value := getattr(contact, key)) is None else value)
                        for contact in self.items
                    ]
                )
            )
            for key in _RANGES
        }

        fields["contact_tolerance"] = Field(np.zeros(self.count))

        def content() -> NDArray[Any]:
            return pack(ShapeContactSettings, {key: field.values for key, field in fields.items()})

        device_field = parameters.device_field(self, "settings", ShapeContactSettings, content)
        self.contact_tolerance = ContactTolerance(fields["contact_tolerance"], device_field)
        for contact, items in self.items.items():
            for key, allowed in _RANGES.items():
                if getattr(contact, key) is not None:
                    convert = checks.switches if key == "enabled" else None
                    name = f"{contact.name}.{key}"
                    parameters.add(
                        name, fields[key], items, allowed, [device_field], single=contact.single, convert=convert
                    )

    def memories(self) -> Iterator[tuple[type[Formula], wp.array, wp.array]]:
        """Yields (formula, history_in, history_out) of the parts with history variables."""
        for part, formula in self.parts._asdict().items():
            if formula.memories:
                yield formula, getattr(self.memory, part), getattr(self.history_out, part)

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launches of narrow phase and contact forces in ``state``; nonsmooth contacts have no force."""
        a, launches = plan.model.arrays, []
        inputs = {
            "contact_shapes": self.contact_shapes,
            "settings": self.settings,
            "shape_contacts": self.shape_contacts,
        }
        for kinds, items in self.ranges:
            kernel = narrow_phase.kernel(*kinds, self.real, self.needs_curvature, self.needs_surface_axes)
            launches += plan.prepare(
                kernel,
                items.stop - items.start,
                status=status,
                state=state,
                first=items.start,
                shapes_a=self.shapes[kinds[0]].arrays,
                shapes_b=self.shapes[kinds[1]].arrays,
                warm_starts=self.warm_starts,
                new_warm_starts=self.new_warm_starts,
                **inputs,
            )
        acting = [(0, self.count)] if plan.nonsmooth is None else plan.nonsmooth.compliant_items(self.items)
        for first, count in acting:
            launches += plan.prepare(
                self.kernel,
                count,
                status=status,
                model=a.model,
                state=state,
                history_in=self.memory,
                step=step,
                first=first,
                first_end=self.first_end,
                coefficients=self.coefficients,
                history_out=self.history_out,
                ends=a.end_wrenches,
                **inputs,
            )
        return launches

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launches that store warm starts and advance the history after an accepted step."""
        status = plan.model.arrays.status
        launches = plan.prepare(
            force.accept_contacts(self.real),
            self.count,
            status=status,
            new_warm_starts=self.new_warm_starts,
            warm_starts=self.warm_starts,
            shape_contacts=self.shape_contacts,
        )
        for formula, memory, history_out in self.memories():
            kernel = force.advance_history(formula, self.real)
            launches += plan.prepare(kernel, self.count, status=status, history_out=history_out, memory=memory)
        return launches

    def reset_state(self, chosen: wp.array) -> None:
        """Clears warm starts and history in the environments of the mask ``chosen`` [env]."""
        shape, device = (len(chosen), self.count), chosen.device
        wp.launch(
            force.reset_contacts(self.real),
            dim=shape,
            inputs=[chosen, self.warm_starts, self.shape_contacts],
            device=device,
        )
        for formula, memory, _ in self.memories():
            wp.launch(reset.memory(formula, self.real), dim=shape, inputs=[chosen, memory], device=device)

    def compile(self, device: wp.Device) -> None:
        """Compiles kernels with user-defined laws and shapes, to report errors early.

        Raises:
            TypeError: If a law, friction model or shape does not compile.
        """
        for kinds, _ in self.ranges:
            if not has_user_code(kinds):
                continue
            kernel = narrow_phase.kernel(*kinds, self.real, self.needs_curvature, self.needs_surface_axes)
            try:
                load(kernel, device)
            except Exception as error:
                text = compile_error_text(error, kinds)
                given = "\n".join(
                    f"In {kind.__name__}, p has {', '.join(kind.device_names()) or 'nothing'}." for kind in kinds
                )
                raise TypeError(
                    f"shape {kinds[0].__name__} with shape {kinds[1].__name__} does not compile: {text}\n{given}\n"
                    "Functions of a shape use float64: write constants as wp.float64(1.5)."
                ) from error
        compile_force_kernel(self.parts, lambda: self.kernel, device, self.real)

    def advice_needs_evaluation(self, model: "Environments", nonsmooth: "NonsmoothContacts | None") -> bool:
        """Returns true: initial penetration is checked."""
        return True

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about step length and initial penetration."""
        return [
            sentence
            for contact in self.items
            for sentence in shape_contact_warnings(model, contact, dt, nonsmooth)
        ]

    def needs(self) -> Mapping[str, Need]:
        """Returns the needs of points, curvatures and gradients."""
        return {name: Need(self._declare_measure(struct), all_distances=True) for name, struct in _STRUCTS.items()}

    def _declare_measure(self, struct: Any) -> "Callable[[AllocationPlan], Any]":
        return lambda layout: layout.struct(SENSOR_PURPOSE, struct, per_env(self.count))

    def measure(self, model: "DeviceModel", needs: Collection[str]) -> None:
        """Computes points, curvatures and gradients from the last evaluated contacts."""
        for name in _STRUCTS:
            if name in needs:
                measure(name, self, model)

    def failures(self) -> dict[str, NDArray[np.int32]]:
        """Returns the number of steps since reset in which a contact did not converge; of a set, the maximum."""
        values = self.shape_contacts.failures.numpy()
        return {contact.name: values[:, items].max(axis=1) for contact, items in self.items.items()}

    def failure_warning(self, name: str, count: int, envs: int, first: int) -> RunWarning:
        """Returns a warning that a contact did not converge in some steps."""
        contact = next(one for one in self.items if one.name == name)
        text = (
            f"{name}: contact of {contact.shape.name!r} and {contact.other_shape.name!r} did not converge in {count} of "
            f"{envs} environments (first: {first}). No force was applied in those steps; {name}.failures counts them"
        )
        return RunWarning(text, WarningLevel.ERROR)

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of the shape contacts."""
        for contact, items in self.items.items():
            own: int | slice = items.start if contact.single else items
            several = 0 if contact.single else contact.count
            for key, (attribute, unit, meaning) in (CONTACT_SENSORS | _CONTACT_SENSORS).items():
                text = meaning.replace("the point's body", "the body of its first shape")
                text = text.replace("out of the surface", "out of its other shape")
                codes = ContactStatus if key == "status" else None
                array = self._column(attribute, own)
                name = f"{contact.name}.{key}"
                shape = shape_in(self.shape_contacts, attribute)
                options: dict[str, Any] = {"items": several, "codes": codes, "shape": shape}
                yield Sensor(name, unit, text, array, needs=("contacts",), **options)
            of_curvature = _CURVATURES | _GRADIENTS if has_curvatures(contact.kinds) else {}
            for key, (need, attribute, unit, meaning) in (_MEASURES | of_curvature).items():
                array = self._measured(need, attribute, own)
                shape = shape_in(_STRUCTS[need], attribute)
                name = f"{contact.name}.{key}"
                yield Sensor(name, unit, meaning, array, needs=(need,), items=several, shape=shape)
            if of_curvature:
                yield from self._by_sizes(contact, own, several)
            for part, formula in contact.formulas.items():
                for key, memory in formula.memories.items():
                    frame = ", axes of its other shape" if memory.tangent else ""
                    meaning = f"{memory.meaning}, as of the last step{frame}"
                    array = self._history_values(part, key, own)
                    options = {"items": several, "shape": (3,) if memory.tangent else ()}
                    yield Sensor(f"{contact.name}.{part}.{key}", memory.unit, meaning, array, **options)

    def _by_sizes(self, contact: ShapeContact, items: int | slice, several: int) -> Iterator[Sensor]:
        """Yields the sensors of derivatives of the gap with respect to the sizes of both shapes."""
        for side, shape in (("a", contact.shape), ("b", contact.other_shape)):
            first = 0
            for size, width in measures.size_widths(shape.kind):
                meaning = f"derivative of the gap with respect to {size} of {shape.name}"
                array = self._part(f"gap_by_sizes_{side}", first, width, items)
                name = f"{contact.name}.gap_by_{size}_{side}"
                options: dict[str, Any] = {"items": several, "shape": () if width == 1 else (width,)}
                yield Sensor(name, "-", meaning, array, needs=("shape_gradients",), **options)
                first += width

    def _column(self, attribute: str, items: int | slice) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(self.shape_contacts, attribute)[:, items]

    def _history_values(self, part: str, key: str, items: int | slice) -> Callable[[ModelArrays], wp.array]:
        return lambda _: history_view(getattr(self.memory, part), key)[:, items]

    def _measured(self, need: str, attribute: str, items: int | slice) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(self.measures[need], attribute)[:, items]

    def _part(
        self, attribute: str, first: int, width: int, items: int | slice
    ) -> Callable[[ModelArrays], wp.array]:
        """Returns a function that returns a view of ``width`` components, from ``first`` on, of each array entry."""

        def part(_: ModelArrays) -> wp.array:
            whole = getattr(self.measures["shape_gradients"], attribute)
            return wp.array(
                ptr=whole.ptr + 8 * first,
                dtype=wp.float64 if width == 1 else wp.vec3d,
                shape=whole.shape,
                strides=whole.strides,
                device=whole.device,
                copy=False,
            )[:, items]

        return part


def _each(numbers: NDArray[np.int32], contact: ShapeContact) -> NDArray[np.int32]:
    return np.broadcast_to(numbers, contact.count)


def _ranges(items: Mapping[ShapeContact, slice]) -> list[tuple[tuple[type[Form], type[Form]], slice]]:
    """Returns the range of contacts of each pair of kinds; these contacts are consecutive."""
    ranges: list[tuple[tuple[type[Form], type[Form]], slice]] = []
    for contact, own in items.items():
        if ranges and ranges[-1][0] == contact.kinds:
            ranges[-1] = (contact.kinds, slice(ranges[-1][1].start, own.stop))
        else:
            ranges.append((contact.kinds, own))
    return ranges


def sorted_contacts(scene: "SceneData") -> list[list[ShapeContact]]:
    """Returns the shape contacts of a scene grouped by contact model, and ordered by kinds within a group."""
    sets: dict[ContactModel, dict[Any, list[ShapeContact]]] = {}
    for contact in scene.shape_contacts:
        sets.setdefault(contact.parts, {}).setdefault(contact.kinds, []).append(contact)
    return [[contact for alike in own.values() for contact in alike] for own in sets.values()]


def declare(context: BuildContext, elements: Sequence[ShapeContact]) -> list[ForceElement]:
    """Declares the shape contacts of a model, and the shapes of these contacts."""
    sets: list[ForceElement] = []
    first = 0
    for own in sorted_contacts(context.scene):
        contacts = ShapeContactSet(own, first, context.shapes, context)
        sets.append(contacts)
        first += contacts.count
    return sets
