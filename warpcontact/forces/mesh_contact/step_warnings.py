"""Warnings about contacts of points with meshes: too long time steps, initial penetration, too small ``max_depth``."""

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
from warpcontact.forces.mesh_contact.friction_warnings import MAX_CHECKED_ENVS, friction_warnings
from warpcontact.geometry.initial_clearance import starts_clear
from warpcontact.kernels.laws.formulas import contact_time, greatest_penetration
from warpcontact.kernels.types import CONTACT
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.scene.elements import Contact


def contacts_to_evaluate(model: "Environments", nonsmooth: "NonsmoothContacts | None") -> "frozenset[Contact]":
    """Returns the contacts whose initial penetration must be evaluated.

    Contacts are omitted if bounds prove that they start clear, or if initial penetration does not matter.
    """
    return frozenset(
        contact
        for contact in model.scene.contacts
        if (envs := _evaluated_envs(model, contact, nonsmooth)) and not starts_clear(model, contact, envs)
    )


def _evaluated_envs(model: "Environments", contact: "Contact", nonsmooth: "NonsmoothContacts | None") -> int:
    """Returns the number of environments in which the initial penetration is checked."""
    if contact.facing is not None:
        return 0
    if nonsmooth is not None and is_nonsmooth(contact.name, nonsmooth):
        return 0 if nonsmooth.recovery > 0.0 else model.envs
    return model.envs if contact.count == 1 else min(model.envs, MAX_CHECKED_ENVS)


def mesh_contact_warnings(model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
    """Returns the warnings about the contacts of points with meshes.

    Contact durations are estimated from the elastic part of a law and the masses of the bodies, without rotation, and
    for friction from the slope of its force. Laws without an elastic part are not checked. For a set of points, the
    number of simultaneous contacts is estimated by ``_simultaneous_stiffness``.

    Args:
        model: The model, evaluated at its initial state if ``contacts_to_evaluate`` returns any contact.
        dt: Time step [s].
        nonsmooth: The nonsmooth contacts, which are checked for initial penetration only.
    """
    sentences = []
    evaluated = contacts_to_evaluate(model, nonsmooth)
    for contact in model.scene.contacts:
        if is_nonsmooth(contact.name, nonsmooth):
            if contact in evaluated:
                sentences += nonsmooth_overlap_warnings(model, f"{contact.name}.penetration", dt, nonsmooth)
            continue
        sentences += friction_warnings(model, contact, dt)
        if contact.facing is not None:
            continue
        envs = _evaluated_envs(model, contact, nonsmooth)
        mass, speed = (values[:envs] for values in mass_and_speed(model, contact))
        if contact.swept:
            sentences += _max_depth_warnings(model, contact, speed, dt)
        law = type(contact.material.law)
        values = {
            name: column_of(model, f"{contact.name}.law.{name}")[:envs] for name in contact.parameters("law")
        }
        if (carrier := contact.area_carrier("law")) is not None:
            values["area"] = values["area"] * column_of(model, f"{carrier.name}.scale")[:envs] ** 2
        elastic = law.elastic(values)
        if elastic is None:
            continue
        stiffness, exponent = (np.broadcast_to(part, (envs, contact.count)) for part in elastic)
        group_stiffness = _simultaneous_stiffness(contact, stiffness, exponent, mass, speed)
        sentences += step_length_warnings(
            model, contact.name, contact_time(group_stiffness, exponent, mass, speed), dt
        )
        if contact not in evaluated:
            continue
        depth = np.where(
            last_column(model, contact, "status") == CONTACT, last_column(model, contact, "penetration"), 0.0
        )[:envs]
        energy = stiffness * depth ** (exponent + 1.0) / (exponent + 1.0)
        if not contact.points.spread:
            energy = energy.sum(axis=1, keepdims=True)
        # Speed that corresponds to the elastic energy of all penetrations of a body.
        sentences += overlap_warnings(model, contact.name, depth, np.sqrt(2.0 * energy / mass), speed)
    return sentences


def _simultaneous_stiffness(
    contact: "Contact", stiffness: Array, exponent: Array, mass: Array, speed: Array
) -> Array:
    """Returns the total stiffness of simultaneous contacts, (envs, 1); (envs, items) on a set of bodies.

    Assumes an impact of the point set on a plane along each axis of its body, in both directions. All points within
    the largest penetration count, with the penetration of the first one. If they spread wider than the surface, the
    covered fraction counts. The result is at least the stiffness of one point. Mesh and points are those of the scene.

    Args:
        contact: The contact.
        stiffness: Stiffness K of each point (envs, items) [N/mⁿ].
        exponent: Exponent n of the law (envs, items).
        mass: Reduced mass of the bodies (envs, 1) [kg].
        speed: Expected impact speed (envs, 1) [m/s].
    """
    if contact.points.spread:
        return stiffness
    most = stiffness.max(axis=1, keepdims=True)
    if contact.count == 1:
        return most
    places, surface = contact.points.places, contact.surface
    size = float(surface.scale * max(np.linalg.norm(np.ptp(mesh.bounds, axis=0)) for mesh in surface.meshes))
    for direction in (*np.eye(3), *-np.eye(3)):
        height = -places @ direction
        order = np.argsort(height)
        next_height = np.append(height[order][1:], np.inf) - height.min()
        spread = np.maximum.accumulate(places[order]) - np.minimum.accumulate(places[order])
        width = np.linalg.norm(spread, axis=1)
        covered_fraction = np.where(width > size, size / np.maximum(width, size), 1.0) ** 2
        total = np.maximum(np.cumsum(stiffness[:, order], axis=1) * covered_fraction, most)
        sinking = greatest_penetration(total, exponent[:, order], mass, speed)
        last = np.argmax(sinking <= next_height, axis=1)
        most = np.maximum(most, np.take_along_axis(total, last[:, None], axis=1))
    return most


def _max_depth_warnings(model: "Environments", contact: "Contact", speed: Array, dt: float) -> list[str]:
    deepest = column_of(model, f"{contact.name}.max_depth")[: len(speed)]
    speed = np.broadcast_to(speed, deepest.shape)
    worst, item = np.unravel_index(int(np.argmax(speed * dt - deepest)), deepest.shape)
    if speed[worst, item] * dt <= deepest[worst, item]:
        return []
    return [
        f"{contact.name}: max_depth = {deepest[worst, item]:.3g} m is smaller than the distance per step "
        f"({speed[worst, item] * dt:.2g} m at {speed[worst, item]:.3g} m/s, environment {model.first_env + worst}). "
        "Swept contacts can be lost. Increase or omit max_depth, or reduce dt"
    ]
