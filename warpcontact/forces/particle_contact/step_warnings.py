"""Warnings about particle contacts that run but give wrong results: too long time steps, initial penetration."""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.forces.contact_warnings import (
    column_of,
    expected_speed,
    is_nonsmooth,
    nonsmooth_overlap_warnings,
    overlap_warnings,
    step_length_warnings,
)
from warpcontact.kernels.laws.formulas import contact_time
from warpcontact.scene.mobility import MIN_MOBILITY, mobility_of

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.scene.particles import ParticleContact

# Minimum number of steps per contact duration, accurate to about 1e-2: single impacts matter less.
MIN_STEPS_PER_PARTICLE_CONTACT = 10.0


def particle_contact_warnings(
    model: "Environments", contact: "ParticleContact", dt: float, nonsmooth: "NonsmoothContacts | None"
) -> list[str]:
    """Returns the warnings about a particle contact, for the two bodies with the largest mobility."""
    if is_nonsmooth(contact.name, nonsmooth):
        return nonsmooth_overlap_warnings(model, f"{contact.name}.max_penetration", dt, nonsmooth)
    name, law = contact.name, contact.material.law
    elastic = law.elastic({key: column_of(model, f"{name}.law.{key}") for key in law.parameters()})
    if elastic is None:
        return []
    # A body with several shapes counts once.
    bodies = dict.fromkeys(shape.body for shape in contact.shapes if shape.body is not None)
    mobilities = np.concatenate([mobility_of(model, contact, body).linear for body in bodies], axis=1)
    group_stiffness = np.sort(mobilities, axis=1)[:, -2:].sum(axis=1, keepdims=True)
    mass = 1.0 / np.maximum(group_stiffness, MIN_MOBILITY)
    speed = np.max([expected_speed(model, body).max(axis=1) for body in bodies], axis=0)[:, None]
    stiffness, exponent = (np.broadcast_to(part, (model.envs, 1)) for part in elastic)
    sentences = step_length_warnings(
        model, name, contact_time(stiffness, exponent, mass, speed), dt, MIN_STEPS_PER_PARTICLE_CONTACT
    )
    depth = model.sensor(f"{name}.max_penetration")[:, None]
    energy = stiffness * depth ** (exponent + 1.0) / (exponent + 1.0)
    return sentences + overlap_warnings(model, name, depth, np.sqrt(2.0 * energy / mass), speed, latched=False)
