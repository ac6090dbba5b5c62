"""Warnings about time steps that are too long for a friction model of points on meshes."""

from typing import TYPE_CHECKING, Any

import numpy as np

from warpcontact.forces.friction_slopes import (
    Coefficients,
    run_formula_kernel,
    steepest_slopes,
    unstable_friction_warning,
)
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.laws import pull_off
from warpcontact.scene.mobility import MIN_MOBILITY, mobility_of
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.elements import Contact

# Maximum number of environments that are checked, to limit the time of the checks.
MAX_CHECKED_ENVS = 4096


def friction_warnings(model: "Environments", contact: "Contact", dt: float) -> list[str]:
    """Returns a warning for each friction model of a contact for which the time step is too long.

    The load is the weight per contact, plus the pull-off force of an adhesive law; the mass is the effective mass
    for sliding, rolling or torsion.

    Args:
        model: The model.
        contact: One of its contacts.
        dt: Time step [s].
    """
    envs = min(model.envs, MAX_CHECKED_ENVS)
    parts = {
        part: kind
        for part, kind in contact.material.parts._asdict().items()
        if part != "law" and not issubclass(kind, Frictionless)
    }
    if not parts:
        return []
    mobility = {name: values[:envs] for name, values in _mobilities(model, contact).items()}
    if (mobility["load"] < MIN_MOBILITY).any():
        return []  # immovable bodies carry no weight here
    gravity = np.linalg.norm(model["scene.gravity"][:envs], axis=1)[:, None]
    # Each body of a set has one contact.
    bearing = 1 if contact.points.spread else contact.count
    load = np.broadcast_to(gravity / mobility["load"] / bearing, (envs, contact.count))
    radius = np.broadcast_to(_radius(model, contact)[:envs], load.shape)
    under = "its weight"
    if contact.material.law.pulls:
        mass = np.broadcast_to(1.0 / mobility["load"], load.shape)
        law = contact.material.parts.law
        (tension,) = run_formula_kernel(
            model, law, coefficients_of(contact, "law"), pull_off.kernel, (mass, radius), outputs=1
        )
        load, under = load + tension, "its weight and pull-off force"
    # The radius of the contact patch depends on the law; assume a typical penetration of R/1000: √(R δ).
    patch = np.sqrt(1.0e-3) * radius
    sentences = []
    for part, kind in parts.items():
        slopes = steepest_slopes(model, kind, coefficients_of(contact, part), load, patch)
        with np.errstate(over="ignore"):
            mass = 1.0 / mobility[part]
        sentences += unstable_friction_warning(model, contact.name, part, kind, slopes, mass, dt, under)
    return sentences


def coefficients_of(contact: "Contact", part: str) -> Coefficients:
    """Returns a function that finds the coefficients of a part of a contact on one device."""

    def find(model: "DeviceModel") -> Any:
        group, first = model.group_of(contact)
        return getattr(group.coefficients, part)[:, first : first + contact.count]

    return find


def _mobilities(model: "Environments", contact: "Contact") -> dict[str, Array]:
    """Returns the mobilities for sliding, rolling, torsion and load, (env, 1) [1/kg].

    For points on a set of bodies, (env, item).
    """
    radius = _radius(model, contact)
    name = f"{contact.name}.torsion_radius"
    arm = _columns(model[name]) if name in model else 0.0 * radius
    away = np.linalg.norm(contact.points.places, axis=1)
    reach = (away if contact.points.spread else away.max()) + radius
    total = {key: np.zeros((model.envs, 1)) for key in ("load", "friction", "rolling", "torsion")}
    for body in (contact.points.body, contact.surface.body):
        if body is None:
            continue
        own = mobility_of(model, contact, body)
        lever = reach if body is contact.points.body and own.rotates_with_force else 0.0
        total["load"] = total["load"] + own.linear
        total["friction"] = total["friction"] + own.linear + lever**2 * own.angular
        total["rolling"] = total["rolling"] + radius**2 * own.angular
        total["torsion"] = total["torsion"] + arm**2 * own.angular
    return {key: np.maximum(values, np.finfo(np.float64).tiny) for key, values in total.items()}


def _radius(model: "Environments", contact: "Contact") -> Array:
    return _columns(model[f"{contact.name}.radius"])


def _columns(values: Array) -> Array:
    return values[:, None] if values.ndim == 1 else values
