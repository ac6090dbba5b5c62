"""Warnings about shape contacts that run but give wrong results: too long time steps, initial penetration."""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.forces.contact_warnings import (
    column_of,
    is_nonsmooth,
    last_column,
    mass_and_speed,
    nonsmooth_overlap_warnings,
    overlap_warnings,
    step_length_warnings,
)
from warpcontact.kernels.laws.formulas import contact_time
from warpcontact.kernels.types import CONTACT

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.scene.shapes import ShapeContact


def shape_contact_warnings(
    model: "Environments", contact: "ShapeContact", dt: float, nonsmooth: "NonsmoothContacts | None"
) -> list[str]:
    """Returns the warnings about a shape contact, evaluated per item; sensors must have been evaluated."""
    if is_nonsmooth(contact.name, nonsmooth):
        return nonsmooth_overlap_warnings(model, f"{contact.name}.penetration", dt, nonsmooth)
    name, law = contact.name, contact.material.law
    elastic = law.elastic({key: column_of(model, f"{name}.law.{key}") for key in law.parameters()})
    if elastic is None:
        return []
    mass, speed = mass_and_speed(model, contact)
    stiffness, exponent = (np.broadcast_to(part, (model.envs, contact.count)) for part in elastic)
    sentences = step_length_warnings(model, name, contact_time(stiffness, exponent, mass, speed), dt)
    touching = last_column(model, contact, "status") == CONTACT
    depth = np.where(touching, last_column(model, contact, "penetration"), 0.0)
    energy = stiffness * depth ** (exponent + 1.0) / (exponent + 1.0)
    return sentences + overlap_warnings(model, name, depth, np.sqrt(2.0 * energy / mass), speed, latched=False)
