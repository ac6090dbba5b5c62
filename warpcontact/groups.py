"""Contacts grouped by the code of their law and friction: one launch of the force kernel per group."""

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels import contact_force
from warpcontact.kernels.formula import Formula, coefficient_struct
from warpcontact.parameters import Field, Parameters, pack
from warpcontact.scene import Contact


@dataclass(frozen=True)
class Group:
    """Contacts side by side on the device that share the code of their law and friction."""

    kernel: wp.Kernel
    first: int  # index of the first contact
    count: int
    coefficients: SimpleNamespace  # .law, .friction: arrays [env, contact of the group]


def by_code(contacts: Sequence[Contact]) -> list[list[Contact]]:
    """Sorts contacts into groups of the same law and friction class, in order of first appearance."""
    groups: dict[tuple[type, type], list[Contact]] = {}
    for contact in contacts:
        code = type(contact.template.law), type(contact.template.friction)
        groups.setdefault(code, []).append(contact)
    return list(groups.values())


def make_group(contacts: list[Contact], first: int, parameters: Parameters, real: type) -> Group:
    """Compiles the force kernel of ``contacts`` and adds the parameters of their laws and frictions.

    Raises:
        TypeError: If a law or friction does not compile.
    """
    template = contacts[0].template
    law, friction = type(template.law), type(template.friction)
    coefficients = SimpleNamespace(law=None, friction=None)
    _add_formula(contacts, "law", law, coefficients, parameters, real)
    _add_formula(contacts, "friction", friction, coefficients, parameters, real)
    return Group(
        kernel=_compiled(law, friction, parameters.device, real),
        first=first,
        count=sum(contact.count for contact in contacts),
        coefficients=coefficients,
    )


def _compiled(law: type[Formula], friction: type[Formula], device: wp.Device, real: type) -> wp.Kernel:
    """Returns the force kernel, compiled here so that a mistake in a user's law shows at once."""
    kernel = contact_force.kernel(law, friction, real)
    try:
        kernel.module.load(device)
    except Exception as error:
        hint = ""
        if "types must be the same" in str(error):
            hint = (
                "\nConstants take the precision of the simulation when written as type(c.delta)(1.5) in a law, "
                "type(s.speed)(1.5) in a friction."
            )
        raise TypeError(
            f"law {law.__name__} with friction {friction.__name__} does not compile in {real.__name__}: {error}\n"
            f"p has {', '.join(law.device_names())} in the law, "
            f"{', '.join(friction.device_names()) or 'nothing'} in the friction.{hint}"
        ) from error
    return kernel


def _add_formula(
    contacts: list[Contact],
    part: str,
    formula: type[Formula],
    target: SimpleNamespace,
    parameters: Parameters,
    real: type,
) -> None:
    """Adds the parameters of the law or friction of ``contacts``, and the array of their coefficients."""
    struct = coefficient_struct(formula, real)
    fields: dict[Contact, dict[str, Field]] = {
        contact: {
            name: Field(np.full(contact.count, value))
            for name, value in getattr(contact.template, part).parameters().items()
        }
        for contact in contacts
    }

    def content() -> NDArray[Any]:
        columns: dict[str, list[NDArray[Any]]] = {name: [] for name in formula.device_names()}
        if not columns:
            return pack(struct, {"unused": np.zeros((1, sum(contact.count for contact in contacts)))})
        envs = max(len(field.values) for own in fields.values() for field in own.values())
        for contact, own in fields.items():
            given = np.broadcast_arrays(*(field.values for field in own.values()))
            computed = formula.coefficients(dict(zip(own, given, strict=True)))
            for name, column in columns.items():
                column.append(np.broadcast_to(computed[name], (envs, contact.count)))
        return pack(struct, {name: np.concatenate(parts, axis=1) for name, parts in columns.items()})

    upload = parameters.upload(target, part, struct, content)
    for contact, own in fields.items():
        for name, field in own.items():
            parameters.add(
                f"{contact.name}.{part}.{name}",
                field,
                slice(0, contact.count),
                formula.limits(name),
                [upload],
                single=contact.points.single,
            )
