"""Contact groups: contacts with the same contact model, evaluated by one launch of the force kernel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.contact_coupling.contact_couplings import ContactCouplings
from warpcontact.forces.contact_minima import GroupMinima, declare_minima
from warpcontact.geometry.contact_clusters import ContactClusters
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact import contact_force, minima_force
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.types import structs
from warpcontact.scene.elements import Contact
from warpcontact.storage.allocation_plan import AllocationPlan, fixed, per_env
from warpcontact.storage.parameters import Field, Parameters, pack
from warpcontact.system.compilation import load
from warpcontact.validation.custom_law_errors import explain_compile_errors, has_user_code


@dataclass(frozen=True)
class ContactGroup:
    """Consecutive contacts on the device with the same contact model.

    Attributes:
        contact_model: The classes of law and friction models.
        projected: Whether forces are scaled by the fraction of the area of a point that faces the surface.
        has_joints: Whether the effective mass includes the joints of bodies.
        real: Type of a real number.
        first: Index of the first contact.
        count: Number of contacts.
        first_cluster: Index of the first cluster.
        cluster_count: Number of clusters.
        first_set: Index of the first point set.
        set_count: Number of point sets.
        coefficients: Struct of arrays [env, contact of the group], one per part.
        history_in: Struct of such arrays: history variables of the last accepted step.
        history_out: Struct of such arrays: history variables of the current step, stored if it is accepted.
        minima: Minima of the contacts, each with its history: ``minima.slots`` items per contact in ``history_in`` and
            ``history_out``. ``None``: forces act at the closest point only.
    """

    contact_model: ContactModel
    projected: bool
    has_joints: bool
    real: type
    first: int
    count: int
    first_cluster: int
    cluster_count: int
    first_set: int
    set_count: int
    coefficients: Any
    history_in: Any
    history_out: Any
    minima: GroupMinima | None = None

    @property
    def code(self) -> tuple[ContactModel, bool, int]:
        """Key of the force kernel, see ``Contact.code``."""
        return self.contact_model, self.projected, 0 if self.minima is None else self.minima.room

    @property
    def history_count(self) -> int:
        """Number of histories of law and friction models per environment."""
        return self.count * (1 if self.minima is None else self.minima.slots)

    @property
    def kernel(self) -> wp.Kernel:
        """The force kernel; created on demand, because fused kernels may replace it."""
        if self.minima is not None:
            return minima_force.kernel(self.contact_model, self.real, self.minima.room, self.has_joints)
        return contact_force.kernel(self.contact_model, self.real, self.has_joints, self.projected)

    def compile(self, device: wp.Device) -> None:
        """Compiles the force kernel if it has user-defined laws or friction models, to report errors early.

        Raises:
            TypeError: If a law or friction model does not compile.
        """
        compile_force_kernel(self.contact_model, lambda: self.kernel, device, self.real)

    def history_of(self, part: str, name: str) -> wp.array:
        """Returns history variable ``name`` of ``part``, a view (envs, history of the group)."""
        return history_view(getattr(self.history_in, part), name)

    @property
    def material_inputs(self) -> dict[str, Any]:
        """Coefficients and history variables of law and friction models, as arguments of kernels."""
        return {
            "coefficients": self.coefficients,
            "history_in": self.history_in,
            "history_out": self.history_out,
        }

    def histories(self) -> list[tuple[type[Formula], wp.array, wp.array]]:
        """Returns (formula, history_in, history_out) of the parts with history variables."""
        return [
            (formula, getattr(self.history_in, part), getattr(self.history_out, part))
            for part, formula in self.contact_model._asdict().items()
            if formula.memories
        ]


def group_by_model(contacts: Sequence[Contact]) -> list[list[Contact]]:
    """Groups contacts by contact model, in order of first appearance."""
    groups: dict[tuple[ContactModel, bool, int], list[Contact]] = {}
    for contact in contacts:
        groups.setdefault(contact.code, []).append(contact)
    return list(groups.values())


def make_group(
    contacts: list[Contact],
    first: int,
    couplings: ContactCouplings,
    clusters: ContactClusters,
    layout: AllocationPlan,
    parameters: Parameters,
    real: type,
    has_joints: bool,
) -> ContactGroup:
    """Adds the parameters and history arrays of the laws and friction models of ``contacts``.

    ``has_joints``: whether any body of the scene is not free.
    """
    parts, projected, room = contacts[0].code
    Coefficients, Memory = group_structs(parts, real)
    coefficients, history_in, history_out = Coefficients(), Memory(), Memory()
    count = sum(contact.count for contact in contacts)
    minima = declare_minima(contacts, room, layout, parameters, real) if room else None
    histories = count if minima is None else count * minima.slots
    for part, formula in parts._asdict().items():
        _add_formula(contacts, part, formula, coefficients, couplings, parameters, real)
        for target in (history_in, history_out):
            # A dummy array if the formula has no history variables.
            shape = per_env(histories) if formula.memories else fixed(1, 1)
            transient = target is history_out or not formula.memories
            layout.array("contacts", target, part, memory_struct(formula, real), shape, transient=transient)
    # Joints affect only the effective mass.
    has_joints = has_joints and parts.law.needs_mass
    return ContactGroup(
        parts,
        projected,
        has_joints,
        real,
        first,
        count,
        *clusters.range_of_contacts(first, count),
        *clusters.set_range_of_contacts(first, count),
        coefficients,
        history_in,
        history_out,
        minima,
    )


def history_view(history_in: wp.array, name: str) -> wp.array:
    """Returns history variable ``name`` of an array of history structs, a view of the same shape."""
    offset = np.dtype(history_in.dtype.numpy_dtype()).fields[name][1]
    return wp.array(
        ptr=history_in.ptr + offset,
        dtype=history_in.dtype.vars[name].type,
        shape=history_in.shape,
        strides=history_in.strides,
        device=history_in.device,
        copy=False,
    )


def compile_force_kernel(
    parts: ContactModel, kernel: Callable[[], wp.Kernel], device: wp.Device, real: type
) -> None:
    """Compiles a force kernel if any of its ``parts`` is user-defined, to report errors early.

    Raises:
        TypeError: If a law or friction model does not compile.
    """
    if not has_user_code(parts):
        return
    t = structs(real)
    present = {part: formula for part, formula in parts._asdict().items() if formula is not Frictionless}
    with explain_compile_errors(
        present,
        real,
        lambda part: ("c", t.NormalState) if part == "law" else ("s", t.TangentialState),
        "\nWrite constants and initial values of variables in the precision of the simulation: type(c.delta)(1.5) "
        "in a law, type(s.speed)(1.5) in a friction model.",
        "\nA law returns a number in the precision of the simulation, such as type(c.delta)(0.0); a friction model "
        "returns a vector.",
    ):
        load(kernel(), device)


class _HasMaterial(Protocol):
    """A contact whose coefficients are stored for each of its items."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def count(self) -> int:
        """Number of items."""

    @property
    def single(self) -> bool:
        """Whether it has no item axis."""

    def parameters(self, part: str) -> dict[str, Any]:
        """Returns the parameters of one part of its material."""

    def is_computed(self, part: str, name: str) -> bool:
        """Returns whether a parameter is computed, so that users cannot set it."""


def add_material_parameters(
    contacts: Sequence[_HasMaterial], parts: ContactModel, coefficients: Any, parameters: Parameters, real: type
) -> None:
    """Adds the parameters of the materials of ``contacts``, and the arrays of ``coefficients`` [env, item].

    Args:
        contacts: Contacts with the same contact model, whose items are consecutive.
        parts: Their contact model.
        coefficients: Struct with one array per part, see ``group_structs``.
        parameters: Parameters of the model.
        real: Type of a real number.
    """
    for part, formula in parts._asdict().items():
        _add_part(contacts, part, formula, coefficients, parameters, real)


def _add_part(
    contacts: Sequence[_HasMaterial],
    part: str,
    formula: type[Formula],
    coefficients: Any,
    parameters: Parameters,
    real: type,
) -> None:
    struct = coefficient_struct(formula, real)
    fields = [
        {name: Field(np.full(contact.count, value)) for name, value in contact.parameters(part).items()}
        for contact in contacts
    ]

    def content() -> NDArray[Any]:
        names = formula.device_names()
        if not names:
            return pack(struct, {"unused": np.zeros((1, sum(contact.count for contact in contacts)))})
        envs = max(len(field.values) for own in fields for field in own.values())
        columns: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
        for contact, own in zip(contacts, fields, strict=True):
            values = {name: field.values for name, field in own.items()}
            computed = formula.coefficients(dict(zip(values, np.broadcast_arrays(*values.values()), strict=True)))
            for name, column in columns.items():
                column.append(np.broadcast_to(computed[name], (envs, contact.count)))
        return pack(struct, {name: np.concatenate(column, axis=1) for name, column in columns.items()})

    device_field = parameters.device_field(coefficients, part, struct, content)
    for contact, own in zip(contacts, fields, strict=True):
        for name, field in own.items():
            if contact.is_computed(part, name):
                continue
            full = f"{contact.name}.{part}.{name}"
            items = slice(0, contact.count)
            parameters.add(full, field, items, formula.limits(name), [device_field], single=contact.single)


def _add_formula(
    contacts: list[Contact],
    part: str,
    formula: type[Formula],
    target: Any,
    couplings: ContactCouplings,
    parameters: Parameters,
    real: type,
) -> None:
    """Adds the parameters of one part of ``contacts``, and the array of their coefficients."""
    struct = coefficient_struct(formula, real)
    fields: dict[Contact, dict[str, Field]] = {
        contact: {name: Field(np.full(contact.count, value)) for name, value in contact.parameters(part).items()}
        for contact in contacts
    }
    # Both sides of a contact coupling share some parameters.
    common = couplings.share(fields)
    # Area weights of points of a surface scale with its mesh.
    scales = {
        contact: parameters.by_name[f"{carrier.name}.scale"]
        for contact in contacts
        if (carrier := contact.area_carrier(part)) is not None
    }

    def content() -> NDArray[Any]:
        columns: dict[str, list[NDArray[Any]]] = {name: [] for name in formula.device_names()}
        if not columns:
            return pack(struct, {"unused": np.zeros((1, sum(contact.count for contact in contacts)))})
        values = {contact: {name: field.values for name, field in own.items()} for contact, own in fields.items()}
        for contact, scale in scales.items():
            values[contact]["area"] = values[contact]["area"] * scale.field.values[:, scale.items] ** 2
        envs = max(len(array) for own in values.values() for array in own.values())
        for contact, own in values.items():
            computed = formula.coefficients(dict(zip(own, np.broadcast_arrays(*own.values()), strict=True)))
            for name, column in columns.items():
                column.append(np.broadcast_to(computed[name], (envs, contact.count)))
        return pack(struct, {name: np.concatenate(parts, axis=1) for name, parts in columns.items()})

    device_field = parameters.device_field(target, part, struct, content)
    for scale in scales.values():
        if device_field not in scale.device_fields:
            scale.device_fields.append(device_field)
    for contact, own in fields.items():
        for name, field in own.items():
            single = contact.points.single or field in common
            items = slice(0, field.values.shape[1])
            for full in (f"{contact.name}.{part}.{name}", *couplings.aliases(contact, part, name)):
                parameters.add(full, field, items, formula.limits(name), [device_field], single=single)
