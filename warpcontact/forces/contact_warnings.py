"""Warnings that contacts of all families share: too long time steps and initial penetration."""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.scene.mobility import MIN_MOBILITY, mobility_of
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.scene.elements import Body, Contact
    from warpcontact.scene.shapes import ShapeContact

# Minimum number of steps per contact duration: the restitution of a smooth law is then accurate to about 1e-3.
MIN_STEPS_PER_CONTACT = 20.0
# Impact speed that estimates assume for bodies with a lower initial speed [m/s].
TYPICAL_SPEED = 1.0


def is_nonsmooth(name: str, nonsmooth: "NonsmoothContacts | None") -> bool:
    """Returns whether the contact ``name`` has impulses instead of a force."""
    return nonsmooth is not None and not nonsmooth.is_compliant(name)


def step_length_warnings(
    model: "Environments", name: str, duration: Array, dt: float, enough: float = MIN_STEPS_PER_CONTACT
) -> list[str]:
    """Returns a warning if a contact of ``duration`` (envs, items) [s] lasts less than ``enough`` steps."""
    shortest = np.min(duration, axis=1)
    worst = int(np.argmin(shortest))
    if shortest[worst] >= enough * dt:
        return []
    return [
        f"{name}: dt = {dt:g} s is too long: a contact lasts {shortest[worst]:.2g} s in environment "
        f"{model.first_env + worst}, {shortest[worst] / dt:.1f} steps. Use dt ≤ "
        f"{shortest[worst] / enough:.2g} s for {enough:g} steps"
    ]


def overlap_warnings(
    model: "Environments", name: str, depth: Array, ejection_speed: Array, speed: Array, *, latched: bool = True
) -> list[str]:
    """Returns a warning about initial penetration; ``latched``: whether the contact supports ``entry="latched"``."""
    excess = ejection_speed - 2.0 * speed
    worst, body = np.unravel_index(int(np.argmax(excess)), excess.shape)
    if excess[worst, body] <= 0.0:
        return []
    item = int(np.argmax(depth[worst])) if excess.shape[1] == 1 else body
    return [
        f"{name}: initial penetration is {depth[worst, item]:.3g} m in environment {model.first_env + worst}. The "
        f"contact force will eject the body at about {ejection_speed[worst, body]:.3g} m/s. Start outside, or set "
        "max_depth" + (" or entry='latched'" if latched else "")
    ]


def nonsmooth_overlap_warnings(
    model: "Environments", name: str, dt: float, nonsmooth: "NonsmoothContacts | None"
) -> list[str]:
    """Returns a warning if the initial penetration of a nonsmooth contact exceeds the displacement per step.

    ``name`` is the sensor of the penetration. No warning if penetration is reduced during steps.
    """
    if nonsmooth is not None and nonsmooth.recovery > 0.0:
        return []
    depth = model.sensor(name).reshape(model.envs, -1).max(axis=1)
    worst = int(np.argmax(depth))
    if depth[worst] <= TYPICAL_SPEED * dt:
        return []
    return [
        f"{name.rpartition('.')[0]}: initial penetration is {depth[worst]:.3g} m in environment "
        f"{model.first_env + worst}. It will remain, because impulses do not separate bodies. Start outside, or set "
        "recovery_time of MoreauJean"
    ]


def mass_and_speed(model: "Environments", contact: "Contact | ShapeContact") -> tuple[Array, Array]:
    """Returns the reduced mass [kg], including joints, and the expected impact speed [m/s], (envs, 1).

    For points on a set of bodies, (envs, items).
    """
    mobility = np.zeros((model.envs, 1))
    speed = np.full((model.envs, 1), TYPICAL_SPEED)
    for body in contact.bodies:
        if body is not None:
            mobility = mobility + mobility_of(model, contact, body).linear
            speed = np.maximum(speed, expected_speed(model, body))
    # Immovable bodies get a very large finite mass.
    return 1.0 / np.maximum(mobility, MIN_MOBILITY), speed


def expected_speed(model: "Environments", body: "Body") -> Array:
    """Returns the speed of a body, at least ``TYPICAL_SPEED``, (envs, 1), or (envs, n) for a set [m/s]."""
    velocity = np.linalg.norm(model[f"{body.name}.linear_velocity"], axis=-1)
    return np.maximum(velocity.reshape(model.envs, body.count), TYPICAL_SPEED)


def column_of(model: "Environments", name: str) -> Array:
    """Returns a parameter as (envs, items), with one item for a single point."""
    values = model[name]
    return values[:, None] if values.ndim == 1 else values


def last_column(model: "Environments", contact: "Contact | ShapeContact", quantity: str) -> Array:
    """Returns the last value of a sensor of a contact as (envs, items), with one item for a single point."""
    values = model.last_value(f"{contact.name}.{quantity}")
    return values[:, None] if values.ndim == 1 else values
