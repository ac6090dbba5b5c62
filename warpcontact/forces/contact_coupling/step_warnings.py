"""Warnings about contact couplings: too long time steps, and conditions that reduce the stopping distance."""

import math
from typing import TYPE_CHECKING

import numpy as np

from warpcontact.algebra.vectors import norm
from warpcontact.forces.contact_warnings import TYPICAL_SPEED
from warpcontact.forces.friction_slopes import steepest_slopes
from warpcontact.forces.mesh_contact.friction_warnings import MAX_CHECKED_ENVS, coefficients_of
from warpcontact.kernels.friction import Frictionless
from warpcontact.meshes.topology import area_vectors
from warpcontact.scene.contact_coupling import ExpectedImpact
from warpcontact.scene.mobility import MIN_MOBILITY, mobility_of
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.scene.contact_coupling import ContactCoupling
    from warpcontact.scene.elements import Contact

# Minimum number of steps in the time τ to standstill: the stopping distance is then accurate to 0.1 %.
MIN_STEPS = 20.0
# Maximum overshoot by a steady load without a warning, relative to the stopping distance.
MAX_OVERSHOOT = 0.01
# Number of largest faces whose normals are tried as impact direction.
MAX_FACES = 64


def contact_coupling_warnings(model: "Environments", coupling: "ContactCoupling", dt: float) -> list[str]:
    """Returns the warnings about a contact coupling.

    Contacts are those of the initial state. Masses are those of the bodies, without rotation. The area is the largest
    one that can be in range simultaneously.

    Args:
        model: The model, evaluated at its initial state.
        coupling: One of its couplings.
        dt: Time step [s].
    """
    envs = min(model.envs, MAX_CHECKED_ENVS)
    reach = model[f"{coupling.name}.effective_range"][:envs]
    k1, k2 = (model[f"{coupling.name}.{key}"][:envs] for key in ("k1", "k2"))
    mass, speed = _mass_and_speed(model, coupling, envs)
    area = attainable_area(model, coupling, reach)
    sentences = _step_length_warnings(
        model, coupling, np.sqrt(area * k1 / mass), 0.5 * k2 * np.sqrt(area / (mass * k1)), dt
    )
    impact = coupling.range.impact
    if impact is not None:
        sentences += _area_warnings(model, coupling, impact, area, reach)
        sentences += _load_warnings(model, coupling, impact, k1, reach, mass)
        speed = np.maximum(speed, impact.speed)
    sentences += _start_warnings(model, coupling, k1, mass, np.maximum(speed, TYPICAL_SPEED))
    return sentences + _friction_warnings(model, coupling, np.sqrt(area * k1 * mass) * speed, mass, speed, dt)


def attainable_area(model: "Environments", coupling: "ContactCoupling", reach: Array) -> Array:
    """Returns the largest area of a coupling that can be in range of a plane, (env,) [m²].

    Planes perpendicular to the axes of the mesh and parallel to its largest faces are tried. The area is limited by
    the total area of the other surface.
    """
    sides = []
    for contact in coupling.contacts:
        side, other = _largest_in_range(model, contact, reach), contact.surface
        if len(other.meshes) == 1:
            whole = float(_face_areas(other.mesh)[other.active_faces].sum())
            side = np.minimum(side, whole * model[f"{other.name}.scale"][: len(reach)] ** 2)
        sides.append(side)
    return np.mean(sides, axis=0)


def _largest_in_range(model: "Environments", contact: "Contact", reach: Array) -> Array:
    points, carrier = contact.points, contact.points.surface
    if points.areas is None or points.normals is None or carrier is None:
        raise RuntimeError(f"{contact.name}: the points of a coupling are those of a surface")
    scale = model[f"{carrier.name}.scale"][: len(reach)]
    largest = points.normals[np.argsort(-points.areas)[:MAX_FACES]]
    found = np.zeros(len(reach))
    for direction in np.unique(np.round(np.vstack([np.eye(3), -np.eye(3), largest]), 6), axis=0):
        height = points.positions @ direction
        depth = height.max() - height
        weight = np.maximum(points.normals @ direction, 0.0) if contact.facing == "projected" else 1.0
        order = np.argsort(depth)
        total = np.append(0.0, np.cumsum((points.areas * weight)[order]))
        found = np.maximum(found, total[np.searchsorted(depth[order], reach / scale)])
    return np.maximum(found * scale**2, np.finfo(np.float64).tiny)


def _face_areas(mesh: object) -> Array:
    corners = mesh.vertices[mesh.faces]  # type: ignore[attr-defined]
    return 0.5 * norm(area_vectors(corners))


def _mass_and_speed(model: "Environments", coupling: "ContactCoupling", envs: int) -> tuple[Array, Array]:
    """Returns the reduced mass [kg], including joints, and the initial relative speed [m/s], (env,)."""
    mobility, velocity = np.zeros(envs), np.zeros((envs, 3))
    for body, sign in ((coupling.surface_a.body, 1.0), (coupling.surface_b.body, -1.0)):
        if body is not None:
            mobility += mobility_of(model, coupling.contacts[0], body).linear[:envs, 0]
            velocity += sign * model[f"{body.name}.linear_velocity"][:envs]
    return 1.0 / np.maximum(mobility, MIN_MOBILITY), np.linalg.norm(velocity, axis=1)


def _step_length_warnings(
    model: "Environments", coupling: "ContactCoupling", frequency: Array, ratio: Array, dt: float
) -> list[str]:
    tau = 0.5 * math.pi / frequency
    # Strong damping requires shorter steps for stability.
    limit = np.minimum(tau / MIN_STEPS, 2.0 / frequency * (np.sqrt(1.0 + ratio**2) - ratio))
    worst = int(np.argmin(limit))
    if dt <= limit[worst] * (1.0 + 1.0e-9):
        return []
    return [
        f"{coupling.name}: dt = {dt:g} s is too long: a body stops within {tau[worst]:.2g} s in environment "
        f"{model.first_env + worst}, {tau[worst] / dt:.1f} steps. Use dt ≤ {limit[worst]:.2g} s"
    ]


def _area_warnings(
    model: "Environments", coupling: "ContactCoupling", impact: ExpectedImpact, area: Array, reach: Array
) -> list[str]:
    worst = int(np.argmin(area))
    # The tolerance allows for rounding of the sum over faces.
    if area[worst] >= impact.area * (1.0 - MAX_OVERSHOOT):
        return []
    distance = reach[worst] - impact.closest
    stop = reach[worst] - distance * math.sqrt(impact.area / area[worst])
    result = f"it stops at {stop:.3g} m" if stop > 0.0 else "the surfaces touch"
    return [
        f"{coupling.name}: at most {area[worst]:.3g} m² can be in range in environment {model.first_env + worst}, "
        f"less than the expected {impact.area:.3g} m²: {result} instead of {impact.closest:.3g} m"
    ]


def _load_warnings(
    model: "Environments",
    coupling: "ContactCoupling",
    impact: ExpectedImpact,
    k1: Array,
    reach: Array,
    mass: Array,
) -> list[str]:
    if coupling.surface_b.body is not None:
        return []  # gravity does not press two falling bodies together
    contact = coupling.contacts[0]
    envs = np.arange(len(reach))
    gap = model.last_value(f"{contact.name}.gap")[: len(reach)]
    normal = model.last_value(f"{contact.name}.normal")[: len(reach)]
    nearest = normal[envs, np.argmin(np.where(np.isnan(gap), np.inf, gap), axis=1)]
    pull = np.maximum(-(model["scene.gravity"][: len(reach)] * nearest).sum(axis=1), 0.0)
    squared = impact.area * k1 / mass
    stop = reach - pull / squared - np.sqrt((pull / squared) ** 2 + impact.speed**2 / squared)
    free = reach - impact.speed / np.sqrt(squared)
    distance = reach - free
    worst = int(np.argmax((free - stop) / distance))
    if free[worst] - stop[worst] <= MAX_OVERSHOOT * distance[worst] or stop[worst] >= impact.closest:
        return []
    return [
        f"{coupling.name}: gravity presses the body towards the surface in environment {model.first_env + worst}: "
        f"without damping, at {impact.speed:.3g} m/s, it stops at {stop[worst]:.3g} m instead of "
        f"{impact.closest:.3g} m"
    ]


def _start_warnings(
    model: "Environments", coupling: "ContactCoupling", k1: Array, mass: Array, speed: Array
) -> list[str]:
    squares = np.zeros(len(k1))
    depth = np.zeros(len(k1))
    for contact in coupling.contacts:
        area = model[f"{contact.name}.law.area"][: len(k1)] * model[f"{contact.name}.force_scale"][: len(k1)]
        if (carrier := contact.area_carrier("law")) is not None:
            area = area * model[f"{carrier.name}.scale"][: len(k1), None] ** 2
        initial_overlap = model.last_value(f"{contact.name}.penetration")[: len(k1)].astype(np.float64)
        if contact.facing == "projected":
            # Faces that face away from the surface have no force at any depth.
            initial_overlap = np.where(
                model.last_value(f"{contact.name}.normal_force")[: len(k1)] > 0.0, initial_overlap, 0.0
            )
        squares += (area * initial_overlap**2).sum(axis=1)
        depth = np.maximum(depth, initial_overlap.max(axis=1))
    # Speed that corresponds to the elastic energy of all faces in range.
    ejection_speed = np.sqrt(k1 * squares / mass)
    worst = int(np.argmax(ejection_speed - 2.0 * speed))
    if ejection_speed[worst] <= 2.0 * speed[worst]:
        return []
    return [
        f"{coupling.name}: starts {depth[worst]:.3g} m within its range in environment {model.first_env + worst}. "
        f"The force will eject the body at about {ejection_speed[worst]:.3g} m/s. Start farther away"
    ]


def _friction_warnings(
    model: "Environments", coupling: "ContactCoupling", force: Array, mass: Array, speed: Array, dt: float
) -> list[str]:
    """Returns a warning about friction under the largest force of an impact at ``speed``.

    ``friction_warnings`` checks friction under the weight.
    """
    contact = coupling.contacts[0]
    kind = type(contact.material.friction)
    if kind is Frictionless or contact.points.areas is None:
        return []
    part = contact.points.areas / contact.points.areas.sum()
    load = force[:, None] * part
    dashpot, spring = (
        values.sum(axis=1)
        for values in steepest_slopes(
            model, contact.material.parts.friction, coefficients_of(contact, "friction"), load, 0.0 * load
        )
    )
    with np.errstate(divide="ignore"):
        limit = np.minimum(2.0 * mass / dashpot, 2.0 * np.sqrt(mass / np.maximum(spring, 0.0)))
    worst = int(np.argmin(limit))
    if dt <= limit[worst]:
        return []
    return [
        f"{coupling.name}: dt = {dt:g} s is too long for its friction, {kind.__name__}: it is unstable in "
        f"steps of more than {limit[worst]:.2g} s in environment {model.first_env + worst} under the "
        f"{force[worst]:.3g} N of an impact at {speed[worst]:.3g} m/s. Reduce dt"
    ]
