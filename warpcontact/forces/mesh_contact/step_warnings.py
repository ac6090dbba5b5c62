"""Warnings about contacts of points with meshes: too long time steps, initial penetration, too small ``max_depth``.

``starts_clear`` proves by bounds, without a closest-point search, that a contact has no initial penetration.
"""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.algebra.vectors import inverse, transform_points
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
from warpcontact.kernels.laws.formulas import contact_time, greatest_penetration
from warpcontact.kernels.types import CONTACT
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.elements import Body, Contact, Surface


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
    largest = stiffness.max(axis=1, keepdims=True)
    if contact.count == 1:
        return largest
    places, surface = contact.points.places, contact.surface
    size = float(surface.scale * max(np.linalg.norm(np.ptp(mesh.bounds, axis=0)) for mesh in surface.meshes))
    for direction in (*np.eye(3), *-np.eye(3)):
        height = -places @ direction
        order = np.argsort(height)
        next_height = np.append(height[order][1:], np.inf) - height.min()
        spread = np.maximum.accumulate(places[order]) - np.minimum.accumulate(places[order])
        width = np.linalg.norm(spread, axis=1)
        covered_fraction = np.where(width > size, size / np.maximum(width, size), 1.0) ** 2
        total = np.maximum(np.cumsum(stiffness[:, order], axis=1) * covered_fraction, largest)
        sinking = greatest_penetration(total, exponent[:, order], mass, speed)
        last = np.argmax(sinking <= next_height, axis=1)
        largest = np.maximum(largest, np.take_along_axis(total, last[:, None], axis=1))
    return largest


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


# Relative to the sum of all coordinates in the chain of transforms; above their rounding error in float32.
ROUNDING = 1.0e-5


def starts_clear(model: "Environments", contact: "Contact", envs: int) -> bool:
    """Returns whether bounds prove that no point of ``contact`` is inside its surface, in the first ``envs`` environments.

    This is so above a whole terrain or bowl (within its boundary), and outside of the bounding box of a solid. Points
    of a rigid set are bounded by a sphere.
    """
    return all(
        _starts_clear_on(part, contact, min(envs - own.start, part.envs))
        for part, own in model.shares()
        if own.start < envs
    )


def _starts_clear_on(part: "DeviceModel", contact: "Contact", envs: int) -> bool:
    points, surface = contact.points, contact.surface

    # All arrays have shape (1 or envs, items, …).
    def values(name: str) -> Array:
        return part.parameters[name].values[:envs]

    def pose_on_body(own: "Surface") -> list[Array]:
        return [values(f"{own.name}.{name}") for name in ("position", "orientation")]

    places = values(f"{points.name}.position")
    low, high = places, places
    if not points.spread:
        low, high = places.min(axis=1, keepdims=True), places.max(axis=1, keepdims=True)
    middle, size = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=-1)
    if points.surface is not None:
        scale = values(f"{points.surface.name}.scale")
        middle, size = _to_parent_frame(scale[..., None] * middle, *pose_on_body(points.surface)), scale * size
    far = _max_coordinate(middle)
    if points.body is not None:
        pose = _pose(part, points.body, envs)
        middle = _to_parent_frame(middle, *pose)
        far = far + _max_coordinate(pose[0]) + _max_coordinate(middle)
    poses = [] if surface.body is None else [_pose(part, surface.body, envs)]
    for pose in (*poses, pose_on_body(surface)):
        middle = _to_local_frame(middle, *pose)
        far = far + _max_coordinate(pose[0]) + _max_coordinate(middle)
    scale = values(f"{surface.name}.scale")
    far = far + scale * max(np.abs(mesh.bounds).max() for mesh in surface.meshes)
    radius = values(f"{contact.name}.radius").max(axis=1, keepdims=True)
    required = (size + radius + ROUNDING * far) / scale
    seen = middle / scale[..., None] - surface.centre
    return all(bool((side_region.clearance(seen) > required).all()) for side_region in part.side_regions[contact])


def _max_coordinate(places: Array) -> Array:
    """Returns the largest absolute coordinate of each position."""
    return np.asarray(np.abs(places).max(axis=-1))


def _pose(part: "DeviceModel", body: "Body", envs: int) -> list[Array]:
    """Returns the current positions and orientations of a body or set of bodies, (envs, n, …)."""
    whole = part.state.body_position, part.state.body_orientation
    return [array[:envs, body.items].numpy().astype(np.float64) for array in whole]


def _to_parent_frame(places: Array, position: Array, orientation: Array) -> Array:
    """Returns positions (…, 3), one per frame, transformed from a frame to its parent frame."""
    return transform_points(places[..., None, :], position, orientation)[..., 0, :]


def _to_local_frame(places: Array, position: Array, orientation: Array) -> Array:
    """Returns positions (…, 3), one per frame, transformed from the parent frame to a frame."""
    return _to_parent_frame(places - position, np.zeros(3), inverse(orientation))
