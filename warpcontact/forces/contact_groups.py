"""Contacts grouped by the code of their law and friction: one launch of the force kernel per group."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.contact_coupling.contact_couplings import ContactCouplings
from warpcontact.geometry.contact_clusters import ContactClusters
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact import contact_force
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.types import structs
from warpcontact.scene.scene import Contact
from warpcontact.storage.allocation_plan import AllocationPlan, fixed, per_env
from warpcontact.storage.parameters import Field, Parameters, pack
from warpcontact.system.compilation import load
from warpcontact.validation.custom_law_errors import explain_compile_errors, has_user_code


@dataclass(frozen=True)
class ContactGroup:
    """Contacts side by side on the device that share the code of their law and friction models.

    Attributes:
        parts: The classes of law and friction models.
        projected: Whether its contacts are weighed by the normals of their points.
        has_joints: Whether bodies that are not free oppose to its forces what their motions let them.
        real: Type of a real number.
        first: Index of the first contact.
        count: Number of contacts.
        first_cluster: Index of their first block.
        cluster_count: Number of their blocks.
        first_set: Index of their first set.
        set_count: Number of their sets.
        first_coupling: Index of the first contact coupling that is made of them.
        coupling_count: Number of these.
        coefficients: Struct of arrays [env, contact of the group], one per part.
        history_in: Struct of such arrays: what each part remembers of the last accepted step.
        history_out: Likewise, what it will remember if the present step is accepted.
    """

    parts: ContactModel
    projected: bool
    has_joints: bool
    real: type
    first: int
    count: int
    first_cluster: int
    cluster_count: int
    first_set: int
    set_count: int
    first_coupling: int
    coupling_count: int
    coefficients: Any
    history_in: Any
    history_out: Any

    @property
    def kernel(self) -> wp.Kernel:
        """Their force kernel. Where steps are taken in place it may never be needed."""
        return contact_force.kernel(self.parts, self.real, self.has_joints, self.projected)

    def compile(self, device: wp.Device) -> None:
        """Compiles the force kernel of users' laws and friction models, so that a mistake in them shows at once.

        Raises:
            TypeError: If one does not compile.
        """
        compile_force_kernel(self.parts, lambda: self.kernel, device, self.real)

    def history_of(self, part: str, name: str) -> wp.array:
        """Returns what ``part`` remembers as ``name``, a view (envs, contact of the group)."""
        return history_view(getattr(self.history_in, part), name)

    def histories(self) -> list[tuple[type[Formula], wp.array, wp.array]]:
        """Returns (formula, memory, kept) of the parts that remember anything."""
        return [
            (formula, getattr(self.history_in, part), getattr(self.history_out, part))
            for part, formula in self.parts._asdict().items()
            if formula.memories
        ]


def group_by_model(contacts: Sequence[Contact]) -> list[list[Contact]]:
    """Sorts contacts into groups of the same code, in order of first appearance."""
    groups: dict[tuple[ContactModel, bool], list[Contact]] = {}
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
    """Adds the parameters of the laws and friction models of ``contacts``, and the memory that these have.

    ``has_joints`` says whether any body of the scene is not free.
    """
    parts, projected = contacts[0].code
    Coefficients, Memory = group_structs(parts, real)
    coefficients, history_in, history_out = Coefficients(), Memory(), Memory()
    count = sum(contact.count for contact in contacts)
    for part, formula in parts._asdict().items():
        _add_formula(contacts, part, formula, coefficients, couplings, parameters, real)
        for target in (history_in, history_out):
            # Never looked at if the formula remembers nothing.
            shape = per_env(count) if formula.memories else fixed(1, 1)
            transient = target is history_out or not formula.memories
            layout.array("contacts", target, part, memory_struct(formula, real), shape, transient=transient)
    # Only a mass depends on how bodies may move.
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
        *couplings.range_of_contacts(contacts),
        coefficients,
        history_in,
        history_out,
    )


def history_view(history_in: wp.array, name: str) -> wp.array:
    """Returns what is remembered as ``name`` in an array of the memory of a formula, a view of the same shape."""
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
    """Compiles a force kernel if any of its ``parts`` is a user's, so that a mistake in that shows at once.

    Raises:
        TypeError: If a law or friction does not compile.
    """
    if not has_user_code(parts):
        return
    t = structs(real)
    present = {part: formula for part, formula in parts._asdict().items() if formula is not Frictionless}
    with explain_compile_errors(
        present,
        real,
        lambda part: ("c", t.NormalState) if part == "law" else ("s", t.TangentialState),
        "\nConstants, also those that a variable starts with, take the precision of the simulation when written "
        "as type(c.delta)(1.5) in a law, type(s.speed)(1.5) in a friction.",
        "\nThe force of a law is a number of the precision of the simulation, such as type(c.delta)(0.0), that of "
        "a friction a vector.",
    ):
        load(kernel(), device)


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
    # What the sides of a coupling have in common is one number.
    common = couplings.share(fields)
    # Points of a surface have the area that they stand for in its mesh.
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
