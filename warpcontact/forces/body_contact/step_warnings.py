"""Warnings about time steps that are too long for body contact."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.forces.contact_warnings import TYPICAL_SPEED, column_of, expected_speed, step_length_warnings
from warpcontact.forces.friction_slopes import Coefficients, steepest_slopes, unstable_friction_warning
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.laws.formulas import contact_time
from warpcontact.kernels.types import FIXED, PRESCRIBED, TIME_FUNCTION
from warpcontact.scene.body_contact import Solid
from warpcontact.scene.mobility import MIN_MOBILITY
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.body_contact.body_contact_set import BodyContactSet
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.body_contact import BodyContact

# Smallest number of steps in the duration π √(m/K) of a contact for which semi-implicit Euler steps are stable: π/2.
STABLE_STEPS = 0.5 * np.pi


def body_contact_warnings(
    model: "Environments", contact: "BodyContact", group: "BodyContactSet", dt: float
) -> list[str]:
    """Returns the warnings about the time step of a body contact.

    Estimates are those of each pair alone: bodies that meet with the largest side of the smaller one's bounding box, and
    friction under the weight of the lighter one.

    Args:
        model: The model.
        contact: The body contact.
        group: Its set on the first device.
        dt: Time step [s].
    """
    solids = {solid: _estimate(model, solid, group) for pair in contact.pairs for solid in pair}
    pairs = [(solids[first], solids[second]) for first, second in contact.pairs]
    mobility = np.stack([first.along + second.along for first, second in pairs], axis=1)
    turning = np.stack([first.across + second.across for first, second in pairs], axis=1)
    speed = np.stack([np.maximum(first.speed, second.speed) for first, second in pairs], axis=1)
    area = np.stack([np.minimum(first.side, second.side) for first, second in pairs], axis=1)
    if (mobility < MIN_MOBILITY).all():
        return []
    mass = 1.0 / np.maximum(mobility, MIN_MOBILITY)
    law = contact.material.law
    values = {
        key: column_of(model, f"{contact.name}.law.{key}") for key in law.parameters(area=1.0) if key != "area"
    }
    if contact.per_area:
        values["area"] = np.ones((1, 1))
    elastic = type(law).elastic(values)
    sentences = []
    if elastic is not None:
        shape = (model.envs, contact.count)
        stiffness, exponent = (np.broadcast_to(part, shape) for part in elastic)
        if contact.per_area:
            stiffness = stiffness * area
        sentences = step_length_warnings(model, contact.name, contact_time(stiffness, exponent, mass, speed), dt)
        if not sentences and law.bilinear and "damping" in values:
            # N = K δ (1 + χ δ̇): the slope at the expected speed.
            steep = stiffness * (1.0 + values["damping"] * speed)
            duration = contact_time(steep, exponent, mass, speed)
            sentences = step_length_warnings(model, contact.name, duration, dt, enough=STABLE_STEPS)
    kind = contact.material.parts.friction
    if not issubclass(kind, Frictionless):
        gravity = np.linalg.norm(model["scene.gravity"], axis=1)[:, None]
        load = np.ascontiguousarray(np.broadcast_to(gravity * mass, (model.envs, contact.count)))
        slopes = steepest_slopes(model, kind, _friction(contact), load, np.zeros_like(load))
        sentences += unstable_friction_warning(
            model,
            contact.name,
            "friction",
            kind,
            slopes,
            1.0 / np.maximum(turning, MIN_MOBILITY),
            dt,
            "its weight",
        )
    return sentences


def _friction(contact: "BodyContact") -> Coefficients:
    """Returns a function that finds the coefficients of the friction of a body contact on one device."""

    def find(model: "DeviceModel") -> Any:
        elements: list[Any] = [one for one in model.force_elements if contact in getattr(one, "items", {})]
        (group,) = elements
        return group.coefficients.friction[:, group.items[contact]]

    return find


@dataclass(frozen=True)
class _SolidEstimate:
    """A solid in all environments.

    Attributes:
        side: Largest side of its bounding box, (envs,) [m²].
        along: Mobility for a force through the center of mass of its body, (envs,) [1/kg]; joints are left out.
        across: Mobility for a force on a side, with half of the middle extent as lever, (envs,) [1/kg].
        speed: Expected speed of its body, (envs,) [m/s].
    """

    side: Array
    along: Array
    across: Array
    speed: Array


def _estimate(model: "Environments", solid: Solid, group: "BodyContactSet") -> _SolidEstimate:
    extents = np.sort(group.tables.half_extents(model, solid), axis=1)
    side = 4.0 * extents[:, 1] * extents[:, 2]
    body = solid.body
    zero, speed = np.zeros(model.envs), np.full(model.envs, TYPICAL_SPEED)
    if body is not None:
        speed = expected_speed(model, body)[:, 0]
    if body is None or body.motion.kind in (FIXED, PRESCRIBED, TIME_FUNCTION):
        return _SolidEstimate(side, zero, zero, speed)
    along = 1.0 / model[f"{body.name}.mass"]
    inertia = np.diagonal(model[f"{body.name}.inertia"], axis1=-2, axis2=-1).min(axis=-1)
    return _SolidEstimate(side, along, along + extents[:, 1] ** 2 / inertia, speed)
