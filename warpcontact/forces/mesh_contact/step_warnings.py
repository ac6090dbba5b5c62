"""Warnings about scenes that run but give wrong results: too long time steps, initial penetration.

``scene_warnings`` collects the warnings of all elements; it is called by ``Simulation.check`` and at the first step.
"""

import sys
from typing import TYPE_CHECKING

import numpy as np

from warpcontact.forces.contact_coupling.step_warnings import contact_coupling_warnings
from warpcontact.forces.couplings.step_warnings import coupling_warnings
from warpcontact.forces.mesh_contact.friction_warnings import MAX_CHECKED_ENVS, TYPICAL_SPEED, friction_warnings
from warpcontact.geometry.initial_clearance import starts_clear
from warpcontact.kernels.laws.formulas import contact_time, greatest_penetration
from warpcontact.kernels.types import CONTACT
from warpcontact.scene.mobility import MIN_MOBILITY, mobility_of
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.scene.elements import Body, Contact
    from warpcontact.scene.particles import ParticleContact
    from warpcontact.scene.shapes import ShapeContact

# Minimum number of steps per contact duration: the restitution of a smooth law is then accurate to about 1e-3.
MIN_STEPS_PER_CONTACT = 20.0
# The same for particle contact, accurate to about 1e-2: single impacts matter less.
MIN_STEPS_PER_PARTICLE_CONTACT = 10.0


def caller_stacklevel() -> int:
    """Returns the ``stacklevel`` for a warning in the caller that refers to the code outside of this package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals["__name__"].partition(".")[0] == "warpcontact":
        level, frame = level + 1, frame.f_back
    return level


def contacts_to_evaluate(
    model: "Environments", nonsmooth: "NonsmoothContacts | None"
) -> "frozenset[Contact] | None":
    """Returns the point contacts whose initial penetration must be evaluated; ``None``: no evaluation is needed.

    Contacts are omitted if bounds prove that they start clear, or if initial penetration does not matter.
    """
    scene = model.scene
    found = frozenset(
        contact
        for contact in scene.contacts
        if (envs := _evaluated_envs(model, contact, nonsmooth)) and not starts_clear(model, contact, envs)
    )
    # Sensors of particle contacts evaluate the point contacts as well.
    evaluated = scene.shape_contacts or scene.contact_couplings or (scene.particle_contacts and scene.contacts)
    return found if found or evaluated else None


def _evaluated_envs(model: "Environments", contact: "Contact", nonsmooth: "NonsmoothContacts | None") -> int:
    """Returns the number of environments in which the initial penetration is checked."""
    if contact.facing is not None:
        return 0
    if nonsmooth is not None and not nonsmooth.is_compliant(contact.name):
        return 0 if nonsmooth.recovery > 0.0 else model.envs
    return model.envs if contact.count == 1 else min(model.envs, MAX_CHECKED_ENVS)


def scene_warnings(model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
    """Returns the warnings about the initial state of a model and the time step.

    Contact durations are estimated from the elastic part of a law and the masses of the bodies, without rotation, and
    for friction from the slope of its force. Laws without an elastic part are not checked. For a set of points, the
    number of simultaneous contacts is estimated by ``_simultaneous_stiffness``.

    Args:
        model: The model.
        dt: Time step [s].
        nonsmooth: The nonsmooth contacts, which are checked for initial penetration only.
    """

    def has_force(name: str) -> bool:
        return nonsmooth is None or nonsmooth.is_compliant(name)

    def overlap_warnings(name: str) -> list[str]:
        return (
            []
            if nonsmooth is not None and nonsmooth.recovery > 0.0
            else _nonsmooth_overlap_warnings(model, name, dt)
        )

    sentences = []
    evaluated = contacts_to_evaluate(model, nonsmooth)
    if evaluated is None:
        evaluated = frozenset()
    else:
        model.evaluate()
    for coupling in model.scene.contact_couplings:
        sentences += contact_coupling_warnings(model, coupling, dt)
    for contact in model.scene.contacts:
        if not has_force(contact.name):
            sentences += overlap_warnings(f"{contact.name}.penetration") if contact in evaluated else []
            continue
        sentences += friction_warnings(model, contact, dt)
        if contact.facing is not None:
            continue
        envs = _evaluated_envs(model, contact, nonsmooth)
        mass, speed = (values[:envs] for values in _mass_and_speed(model, contact))
        if contact.swept:
            sentences += _max_depth_warnings(model, contact, speed, dt)
        law = type(contact.material.law)
        values = {name: _column(model, f"{contact.name}.law.{name}")[:envs] for name in contact.parameters("law")}
        if (carrier := contact.area_carrier("law")) is not None:
            values["area"] = values["area"] * _column(model, f"{carrier.name}.scale")[:envs] ** 2
        elastic = law.elastic(values)
        if elastic is None:
            continue
        stiffness, exponent = (np.broadcast_to(part, (envs, contact.count)) for part in elastic)
        group_stiffness = _simultaneous_stiffness(contact, stiffness, exponent, mass, speed)
        sentences += _step_length_warnings(
            model, contact.name, contact_time(group_stiffness, exponent, mass, speed), dt
        )
        if contact not in evaluated:
            continue
        depth = np.where(
            _sensor(model, contact, "status") == CONTACT, _sensor(model, contact, "penetration"), 0.0
        )[:envs]
        energy = stiffness * depth ** (exponent + 1.0) / (exponent + 1.0)
        if not contact.points.spread:
            energy = energy.sum(axis=1, keepdims=True)
        # Speed that corresponds to the elastic energy of all penetrations of a body.
        sentences += _overlap_warnings(model, contact.name, depth, np.sqrt(2.0 * energy / mass), speed)
    for shape_contact in model.scene.shape_contacts:
        if has_force(shape_contact.name):
            sentences += _shape_contact_warnings(model, shape_contact, dt)
        else:
            sentences += overlap_warnings(f"{shape_contact.name}.penetration")
    for particle_contact in model.scene.particle_contacts:
        if has_force(particle_contact.name):
            sentences += _particle_contact_warnings(model, particle_contact, dt)
        else:
            sentences += overlap_warnings(f"{particle_contact.name}.max_penetration")
    return sentences + coupling_warnings(model, dt)


def _shape_contact_warnings(model: "Environments", contact: "ShapeContact", dt: float) -> list[str]:
    """Returns the warnings about a shape contact, evaluated per item."""
    name, law = contact.name, contact.material.law
    elastic = law.elastic({key: _column(model, f"{name}.law.{key}") for key in law.parameters()})
    if elastic is None:
        return []
    mass, speed = _mass_and_speed(model, contact)
    stiffness, exponent = (np.broadcast_to(part, (model.envs, contact.count)) for part in elastic)
    sentences = _step_length_warnings(model, name, contact_time(stiffness, exponent, mass, speed), dt)
    touching = _sensor(model, contact, "status") == CONTACT
    depth = np.where(touching, _sensor(model, contact, "penetration"), 0.0)
    energy = stiffness * depth ** (exponent + 1.0) / (exponent + 1.0)
    return sentences + _overlap_warnings(model, name, depth, np.sqrt(2.0 * energy / mass), speed, latched=False)


def _particle_contact_warnings(model: "Environments", contact: "ParticleContact", dt: float) -> list[str]:
    """Returns the warnings about a particle contact, for the two bodies with the largest mobility."""
    name, law = contact.name, contact.material.law
    elastic = law.elastic({key: _column(model, f"{name}.law.{key}") for key in law.parameters()})
    if elastic is None:
        return []
    # A body with several shapes counts once.
    bodies = dict.fromkeys(shape.body for shape in contact.shapes if shape.body is not None)
    mobilities = np.concatenate([mobility_of(model, contact, body).linear for body in bodies], axis=1)
    group_stiffness = np.sort(mobilities, axis=1)[:, -2:].sum(axis=1, keepdims=True)
    mass = 1.0 / np.maximum(group_stiffness, MIN_MOBILITY)
    speed = np.max([_speed(model, body).max(axis=1) for body in bodies], axis=0)[:, None]
    stiffness, exponent = (np.broadcast_to(part, (model.envs, 1)) for part in elastic)
    sentences = _step_length_warnings(
        model, name, contact_time(stiffness, exponent, mass, speed), dt, MIN_STEPS_PER_PARTICLE_CONTACT
    )
    depth = model.sensor(f"{name}.max_penetration")[:, None]
    energy = stiffness * depth ** (exponent + 1.0) / (exponent + 1.0)
    return sentences + _overlap_warnings(model, name, depth, np.sqrt(2.0 * energy / mass), speed, latched=False)


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
    deepest = _column(model, f"{contact.name}.max_depth")[: len(speed)]
    speed = np.broadcast_to(speed, deepest.shape)
    worst, item = np.unravel_index(int(np.argmax(speed * dt - deepest)), deepest.shape)
    if speed[worst, item] * dt <= deepest[worst, item]:
        return []
    return [
        f"{contact.name}: max_depth = {deepest[worst, item]:.3g} m is smaller than the distance per step "
        f"({speed[worst, item] * dt:.2g} m at {speed[worst, item]:.3g} m/s, environment {model.first_env + worst}). "
        "Swept contacts can be lost. Increase or omit max_depth, or reduce dt"
    ]


def _step_length_warnings(
    model: "Environments", name: str, duration: Array, dt: float, enough: float = MIN_STEPS_PER_CONTACT
) -> list[str]:
    shortest = np.min(duration, axis=1)
    worst = int(np.argmin(shortest))
    if shortest[worst] >= enough * dt:
        return []
    return [
        f"{name}: dt = {dt:g} s is too long: a contact lasts {shortest[worst]:.2g} s in environment "
        f"{model.first_env + worst}, {shortest[worst] / dt:.1f} steps. Use dt ≤ "
        f"{shortest[worst] / enough:.2g} s for {enough:g} steps"
    ]


def _overlap_warnings(
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


def _nonsmooth_overlap_warnings(model: "Environments", name: str, dt: float) -> list[str]:
    """Returns a warning if the initial penetration of a nonsmooth contact exceeds the displacement per step."""
    depth = model.sensor(name).reshape(model.envs, -1).max(axis=1)
    worst = int(np.argmax(depth))
    if depth[worst] <= TYPICAL_SPEED * dt:
        return []
    return [
        f"{name.rpartition('.')[0]}: initial penetration is {depth[worst]:.3g} m in environment "
        f"{model.first_env + worst}. It will remain, because impulses do not separate bodies. Start outside, or set "
        "recovery_time of MoreauJean"
    ]


def _mass_and_speed(model: "Environments", contact: "Contact | ShapeContact") -> tuple[Array, Array]:
    """Returns the reduced mass [kg], including joints, and the expected impact speed [m/s], (envs, 1).

    For points on a set of bodies, (envs, items).
    """
    mobility = np.zeros((model.envs, 1))
    speed = np.full((model.envs, 1), TYPICAL_SPEED)
    for body in contact.bodies:
        if body is not None:
            mobility = mobility + mobility_of(model, contact, body).linear
            speed = np.maximum(speed, _speed(model, body))
    # Immovable bodies get a very large finite mass.
    return 1.0 / np.maximum(mobility, MIN_MOBILITY), speed


def _speed(model: "Environments", body: "Body") -> Array:
    """Returns the speed of a body, at least ``TYPICAL_SPEED``, (envs, 1), or (envs, n) for a set [m/s]."""
    velocity = np.linalg.norm(model[f"{body.name}.linear_velocity"], axis=-1)
    return np.maximum(velocity.reshape(model.envs, body.count), TYPICAL_SPEED)


def _column(model: "Environments", name: str) -> Array:
    """Returns a parameter as (envs, items), with one item for a single point."""
    values = model[name]
    return values[:, None] if values.ndim == 1 else values


def _sensor(model: "Environments", contact: "Contact | ShapeContact", quantity: str) -> Array:
    values = model.last_value(f"{contact.name}.{quantity}")
    return values[:, None] if values.ndim == 1 else values
