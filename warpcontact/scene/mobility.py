"""Mobility (inverse effective mass) of bodies at the initial state, for warnings before the first step.

Bodies with joints move only along their degrees of freedom.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpcontact.algebra.vectors import transform_points
from warpcontact.kernels.types import BALL, FREE, HINGE, PLANAR, SLIDER, TRANSLATION
from warpcontact.scene.elements import Body
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.shapes import Shape, ShapeContact
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.scene.elements import Contact


# Below this mobility a body counts as immovable [1/kg].
MIN_MOBILITY = 1.0e-20


@dataclass(frozen=True)
class Mobility:
    """Maximum mobility of a body (envs, 1), or of each body of a set (envs, n); 0 with prescribed motion.

    Attributes:
        linear: For a force at the most mobile point, in the most mobile direction [1/kg]. For free and planar bodies
            it excludes rotation, see ``rotates_with_force``.
        angular: For a torque about the most mobile axis [1/(kg·m²)].
        rotates_with_force: Whether a force with lever arm r adds up to ``angular`` · r² to the linear mobility.
    """

    linear: Array
    angular: Array
    rotates_with_force: bool


def mobility_of(
    model: "Environments", contact: "Contact | ShapeContact | ParticleContact", body: Body
) -> Mobility:
    """Returns the maximum mobility of ``body`` in ``contact``."""
    mass = model[f"{body.name}.mass"].reshape(model.envs, body.count)
    zero = np.zeros_like(mass)
    kind = body.motion.kind
    if kind == FREE:
        smallest = np.diagonal(model[f"{body.name}.inertia"], axis1=-2, axis2=-1).min(axis=-1)
        return Mobility(1.0 / mass, 1.0 / smallest.reshape(mass.shape), True)
    if kind in (TRANSLATION, SLIDER):
        return Mobility(1.0 / mass, zero, False)
    if kind == PLANAR:
        normal = model[f"{body.name}.motion.normal"]
        return Mobility(1.0 / mass, 1.0 / _along(normal, _inertia(model, body)).reshape(mass.shape), True)
    if kind not in (HINGE, BALL):
        return Mobility(zero, zero, False)
    arm, inertia = _anchor_inertia(model, body)
    # Lever arms from the anchor, (envs, points, 3).
    levers = transform_points(_places(contact, body)[None], arm, model[f"{body.name}.orientation"])
    if kind == HINGE:
        axis = model[f"{body.name}.motion.axis"]
        angular = 1.0 / _along(axis, inertia)[:, None]
        reach = np.linalg.norm(np.cross(axis[:, None], levers), axis=2).max(axis=1)[:, None]
        return Mobility(angular * reach**2, angular, False)
    inverse = np.linalg.inv(inertia)
    worst = np.asarray(np.linalg.eigvalsh(inverse)[:, -1:], dtype=np.float64)
    # Columns of ``crossed`` are lever × eᵢ: the mobility along n is nᵀ crossedᵀ I⁻¹ crossed n.
    crossed = np.swapaxes(np.cross(levers[:, :, None], np.eye(3)), 2, 3)
    compliances = np.swapaxes(crossed, 2, 3) @ inverse[:, None] @ crossed
    return Mobility(np.linalg.eigvalsh(compliances)[..., -1].max(axis=1)[:, None], worst, False)


def mobility_along(model: "Environments", body: Body, arm: Array, direction: Array) -> Array:
    """Returns the mobility of ``body`` at a point along a direction, (envs,) [1/kg].

    Args:
        model: The model.
        body: The body.
        arm: Point of action relative to the center of mass, (envs, 3), world [m].
        direction: Unit vectors (envs, 3), world.
    """
    wrench = np.concatenate([direction, np.cross(arm, direction)], axis=1)
    return np.asarray(np.einsum("ei,eij,ej->e", wrench, inverse_mass(model, body), wrench))


def inverse_mass(model: "Environments", body: Body) -> Array:
    """Returns the inverse mass matrix of ``body`` (envs, 6, 6), linear and angular part, world axes [1/kg, 1/(kg·m²)].

    It gives the acceleration of the center of mass by a force there, and by a torque, with the joint of the body; zero with
    prescribed motion.
    """
    kind = body.motion.kind
    mass = model[f"{body.name}.mass"]
    inverse = np.zeros((model.envs, 6, 6))
    linear, angular = inverse[:, :3, :3], inverse[:, 3:, 3:]
    by_mass = np.eye(3) / mass[:, None, None]
    if kind == FREE:
        linear[:], angular[:] = by_mass, np.linalg.inv(_inertia(model, body))
    elif kind == TRANSLATION:
        linear[:] = by_mass
    elif kind == SLIDER:
        linear[:] = _square(model[f"{body.name}.motion.axis"]) / mass[:, None, None]
    elif kind == PLANAR:
        normal = model[f"{body.name}.motion.normal"]
        about = _square(normal)
        linear[:] = by_mass - about / mass[:, None, None]
        angular[:] = about / _along(normal, _inertia(model, body))[:, None, None]
    elif kind in (HINGE, BALL):
        arm, inertia = _anchor_inertia(model, body)
        # Columns are the velocities of the center of mass by unit angular velocities.
        lever = np.swapaxes(np.cross(np.eye(3), arm[:, None]), 1, 2)
        if kind == HINGE:
            axis = model[f"{body.name}.motion.axis"]
            response = _square(axis) / _along(axis, inertia)[:, None, None]
        else:
            response = np.asarray(np.linalg.inv(inertia), dtype=np.float64)
        motion = np.concatenate([lever, np.broadcast_to(np.eye(3), lever.shape)], axis=1)
        inverse[:] = motion @ response @ np.swapaxes(motion, 1, 2)
    return inverse


def _square(vectors: Array) -> Array:
    """Returns the products v vᵀ of vectors (envs, 3) with themselves, (envs, 3, 3)."""
    return vectors[:, :, None] * vectors[:, None, :]


def _inertia(model: "Environments", body: Body) -> Array:
    """Returns the inertia about the center of mass, (envs, 3, 3) or (envs, n, 3, 3), world axes [kg·m²]."""
    inertia, orientation = model[f"{body.name}.inertia"], model[f"{body.name}.orientation"]
    # Rows of ``axes`` are the axes of the body in the world.
    axes = transform_points(np.broadcast_to(np.eye(3), inertia.shape), np.zeros(3), orientation)
    return np.swapaxes(axes, -2, -1) @ inertia @ axes


def _anchor_inertia(model: "Environments", body: Body) -> tuple[Array, Array]:
    """Returns the vector from the anchor of a hinge or ball to the center of mass, and the inertia about the anchor."""
    arm = model[f"{body.name}.position"] - model[f"{body.name}.motion.anchor"]
    steiner = (arm**2).sum(axis=1)[:, None, None] * np.eye(3) - arm[:, :, None] * arm[:, None, :]
    return arm, _inertia(model, body) + model[f"{body.name}.mass"][:, None, None] * steiner


def _along(axis: Array, inertia: Array) -> Array:
    """Returns the moments of inertia (envs, …) about unit vectors (envs, …, 3)."""
    return np.einsum("...i,...ij,...j->...", axis, inertia, axis)


def _places(contact: "Contact | ShapeContact | ParticleContact", body: Body) -> Array:
    """Returns points of ``body`` where ``contact`` can act, as in the scene, in the body frame (n, 3) [m]."""
    if isinstance(contact, ShapeContact | ParticleContact):
        return np.concatenate([_surface_points(shape) for shape in contact.shapes if shape.body is body])
    if body is contact.points.body:
        return contact.points.places
    surface = contact.surface
    corners = np.array(
        [np.where(corner, *mesh.bounds) for mesh in surface.meshes for corner in np.ndindex(2, 2, 2)]
    )
    return transform_points(surface.scale * corners, surface.position, surface.orientation)


def _surface_points(shape: Shape) -> Array:
    """Returns points of the surface of a shape (the first one of a set), in the frame of its body (n, 3) [m]."""
    from warpcontact.scene.shapes import tessellate

    vertices, _ = tessellate(shape.kind, {key: values[0] for key, values in shape.sizes.items()})
    return transform_points(vertices, shape.positions[0], shape.orientations[0])
