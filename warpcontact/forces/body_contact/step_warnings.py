"""Warnings about time steps that are too long for body contact."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.forces.contact_warnings import TYPICAL_SPEED, column_of, expected_speed, step_length_warnings
from warpcontact.forces.friction_slopes import Coefficients, steepest_slopes, unstable_friction_warning
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.laws.formulas import contact_time
from warpcontact.kernels.laws.linear_dashpot import restitution_of_damping_ratio
from warpcontact.kernels.types import FIXED, PRESCRIBED, TIME_FUNCTION
from warpcontact.scene.body_contact import Solid
from warpcontact.scene.elements import Body
from warpcontact.scene.mobility import MIN_MOBILITY
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.body_contact.body_contact_set import BodyContactSet
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.body_contact import BodyContact

# Smallest number of steps in the duration π √(m/K) of a contact for which semi-implicit Euler steps are stable: π/2.
STABLE_STEPS = 0.5 * np.pi


@dataclass(frozen=True)
class PairEstimates:
    """Estimates of each pair of a body contact alone, (envs, pairs).

    Bodies meet with the largest side of the smaller one's bounding box, and friction acts under the weight of the lighter one.

    Attributes:
        contact: The body contact.
        area: Largest side of the smaller bounding box [m²].
        mass: Effective mass along the normal [kg].
        turning_mass: Effective mass for a force on a side [kg].
        elastic: Stiffness K and exponent n of the law, K δⁿ [N/mⁿ], or [Pa/mⁿ] of a law per area; ``None``: there is no elastic part.
        restitution: Coefficient of restitution of the law or of its dashpot [-]; 1 if it has neither.
        duration: Duration of an impact at the expected speed [s]; ``None``: the law has no elastic part.
        steep_duration: Likewise, with the slope at the expected speed; ``None``: damping does not grow with the force.
        dashpot: Dashpot of the law at any depth [N·s/m]; ``None``: there is none.
        friction: Dashpot slope [N·s/m] and spring slope [N/m] of the friction model; ``None``: there is none.
    """

    contact: "BodyContact"
    area: Array
    mass: Array
    turning_mass: Array
    elastic: tuple[Array, Array] | None
    restitution: Array
    duration: Array | None
    steep_duration: Array | None
    dashpot: Array | None
    friction: tuple[Array, Array] | None


def pair_estimates(model: "Environments", contact: "BodyContact", group: "BodyContactSet") -> PairEstimates | None:
    """Returns the estimates of a body contact; ``None``: no body moves.

    Args:
        model: The model.
        contact: The body contact.
        group: Its set on the first device.
    """
    solids = {solid: _estimate(model, solid, group) for pair in contact.pairs for solid in pair}
    pairs = [(solids[first], solids[second]) for first, second in contact.pairs]
    mobility = np.stack([first.along + second.along for first, second in pairs], axis=1)
    turning = np.stack([first.across + second.across for first, second in pairs], axis=1)
    speed = np.stack([np.maximum(first.speed, second.speed) for first, second in pairs], axis=1)
    area = np.stack([np.minimum(first.side, second.side) for first, second in pairs], axis=1)
    if (mobility < MIN_MOBILITY).all():
        return None
    mass = 1.0 / np.maximum(mobility, MIN_MOBILITY)
    law = contact.material.law
    values = {
        key: column_of(model, f"{contact.name}.law.{key}") for key in law.parameters(area=1.0) if key != "area"
    }
    if contact.per_area:
        values["area"] = np.ones((1, 1))
    elastic = type(law).elastic(values)
    shape = (model.envs, contact.count)
    dashpot = None if contact.per_area else type(law).dashpot(values, mass)
    restitution = np.broadcast_to(values.get("restitution", 1.0), shape)
    duration = steep_duration = of_law = None
    if elastic is not None:
        of_law = stiffness, exponent = np.broadcast_to(elastic[0], shape), np.broadcast_to(elastic[1], shape)
        if dashpot is not None:
            restitution = restitution_of_damping_ratio(0.5 * dashpot / np.sqrt(stiffness * mass))
        if contact.per_area:
            stiffness = stiffness * area
        duration = contact_time(stiffness, exponent, mass, speed)
        if law.bilinear and "damping" in values:
            # N = K δ (1 + χ δ̇): the slope at the expected speed.
            steep = stiffness * (1.0 + values["damping"] * speed)
            steep_duration = contact_time(steep, exponent, mass, speed)
    kind = contact.material.parts.friction
    slopes = None
    if not issubclass(kind, Frictionless):
        gravity = np.linalg.norm(model["scene.gravity"], axis=1)[:, None]
        load = np.ascontiguousarray(np.broadcast_to(gravity * mass, (model.envs, contact.count)))
        slopes = steepest_slopes(model, kind, _friction(contact), load, np.zeros_like(load))
    turning_mass = 1.0 / np.maximum(turning, MIN_MOBILITY)
    return PairEstimates(
        contact, area, mass, turning_mass, of_law, restitution, duration, steep_duration, dashpot, slopes
    )


def pair_warnings(model: "Environments", pairs: PairEstimates, dt: float) -> list[str]:
    """Returns the warnings about a time step [s] that is too long for a pair of a body contact alone."""
    contact = pairs.contact
    sentences = []
    if pairs.duration is not None:
        sentences = step_length_warnings(model, contact.name, pairs.duration, dt)
    if not sentences and pairs.steep_duration is not None:
        sentences = step_length_warnings(model, contact.name, pairs.steep_duration, dt, enough=STABLE_STEPS)
    if pairs.friction is not None:
        sentences += unstable_friction_warning(
            model,
            contact.name,
            "friction",
            contact.material.parts.friction,
            pairs.friction,
            pairs.turning_mass,
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


def is_movable(body: Body | None) -> bool:
    """Returns whether forces move a body; ``None``: the world."""
    return body is not None and body.motion.kind not in (FIXED, PRESCRIBED, TIME_FUNCTION)


def _estimate(model: "Environments", solid: Solid, group: "BodyContactSet") -> _SolidEstimate:
    _, half = group.tables.bounding_box(model, solid)
    extents = np.sort(half, axis=1)
    side = 4.0 * extents[:, 1] * extents[:, 2]
    body = solid.body
    zero, speed = np.zeros(model.envs), np.full(model.envs, TYPICAL_SPEED)
    if body is not None:
        speed = expected_speed(model, body)[:, 0]
    if body is None or not is_movable(body):
        return _SolidEstimate(side, zero, zero, speed)
    along = 1.0 / model[f"{body.name}.mass"]
    inertia = np.diagonal(model[f"{body.name}.inertia"], axis1=-2, axis2=-1).min(axis=-1)
    return _SolidEstimate(side, along, along + extents[:, 1] ** 2 / inertia, speed)
