"""Warnings about scenes that run and give nonsense: steps too long for a contact, starts in deep overlap."""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.checks import Array
from warpcontact.friction_advice import friction_advice
from warpcontact.kernels.laws.undamped import contact_time
from warpcontact.kernels.types import CONTACT

if TYPE_CHECKING:
    from warpcontact.model import Model
    from warpcontact.scene import Contact

# Steps per contact time from which on the restitution of a smooth law is kept to about 1e-3.
ENOUGH_STEPS = 20.0
# Impact speed that estimates assume of bodies that start slower [m/s].
USUAL_SPEED = 1.0


class ContactWarning(UserWarning):
    """A scene that will run but hardly mean what its author wants."""


def advice(model: "Model", dt: float) -> list[str]:
    """Returns what to say about the start of a model, a sentence or two per contact.

    Estimates from the elastic part of a law and the masses of the bodies, without their rotation, and from how
    steeply a friction rises; nothing is said of laws that do not tell their elastic part.
    """
    sentences = []
    if model.scene.contacts:
        model.evaluate()
    for group, contact, first in model.grouped_contacts():
        sentences += friction_advice(model, contact, group, first, dt)
        law = type(contact.template.law)
        values = {name: _column(model, f"{contact.name}.law.{name}") for name in contact.parameters("law")}
        if (carrier := contact.area_carrier("law")) is not None:
            values["area"] = values["area"] * _column(model, f"{carrier.name}.scale") ** 2
        elastic = law.elastic(values)
        if elastic is None:
            continue
        stiffness, exponent = elastic
        mass, speed = _mass_and_speed(model, contact)
        sentences += _about_steps(contact.name, contact_time(stiffness, exponent, mass, speed), dt)
        # The energy of the overlap, as speed.
        depth = np.where(
            _reading(model, contact, "status") == CONTACT, _reading(model, contact, "penetration"), 0.0
        )
        thrown = np.sqrt(2.0 * stiffness * depth ** (exponent + 1.0) / ((exponent + 1.0) * mass))
        sentences += _about_overlap(contact.name, depth, thrown, speed)
    return sentences


def _about_steps(name: str, duration: Array, dt: float) -> list[str]:
    shortest = np.min(duration, axis=1)
    worst = int(np.argmin(shortest))
    if shortest[worst] >= ENOUGH_STEPS * dt:
        return []
    return [
        f"{name}: dt = {dt:g} s is too long: a contact takes {shortest[worst]:.2g} s in environment {worst}, "
        f"{shortest[worst] / dt:.1f} steps; take dt ≤ {shortest[worst] / ENOUGH_STEPS:.2g} s for {ENOUGH_STEPS:g}"
    ]


def _about_overlap(name: str, depth: Array, thrown: Array, speed: Array) -> list[str]:
    excess = np.max(thrown - 2.0 * speed, axis=1)
    worst = int(np.argmax(excess))
    if excess[worst] <= 0.0:
        return []
    item = int(np.argmax(thrown[worst]))
    return [
        f"{name}: starts {depth[worst, item]:.3g} m deep in the surface in environment {worst} and will be thrown "
        f"out at about {thrown[worst, item]:.3g} m/s; start outside, or set max_depth or entry='latched'"
    ]


def _mass_and_speed(model: "Model", contact: "Contact") -> tuple[Array, Array]:
    """Returns the reduced mass [kg] and an impact speed to expect [m/s], (envs, 1)."""
    mobility = np.zeros((model.envs, 1))
    speed = np.full((model.envs, 1), USUAL_SPEED)
    for body in (contact.points.body, contact.surface.body):
        if body is not None:
            mobility += 1.0 / model[f"{body.name}.mass"][:, None]
            velocity = np.linalg.norm(model[f"{body.name}.linear_velocity"], axis=1)[:, None]
            speed = np.maximum(speed, velocity)
    return 1.0 / mobility, speed


def _column(model: "Model", name: str) -> Array:
    """Returns a parameter as (envs, items), with one item for a single point."""
    values = model[name]
    return values[:, None] if values.ndim == 1 else values


def _reading(model: "Model", contact: "Contact", quantity: str) -> Array:
    values = model.find_reading(f"{contact.name}.{quantity}").array(model.arrays).numpy()
    return values[:, None] if values.ndim == 1 else values
