"""Bounds that prove that a contact has no initial penetration, without a closest-point search.

Used by the warnings about initial penetration (``forces/mesh_contact/step_warnings.py``).
"""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.algebra.poses import inverse, transform_points
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.elements import Body, Contact, Surface

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
