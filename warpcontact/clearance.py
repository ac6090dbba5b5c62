"""Which contacts start clear of their surface, as bounds of both tell: nothing has to be searched for there."""

from typing import TYPE_CHECKING

import numpy as np

from warpcontact.checks import Array
from warpcontact.frames import inverse, placed

if TYPE_CHECKING:
    from warpcontact.elements import Body, Surface
    from warpcontact.environments import Environments
    from warpcontact.model import Model
    from warpcontact.scene import Contact

# Of the coordinates: more than float32 loses of them.
ROUNDING = 1.0e-5


def is_clear(model: "Environments", contact: "Contact") -> bool:
    """Returns whether every point of ``contact`` is surely outside of its surface, in all environments.

    It is so above the whole of a terrain or bowl, over its rim, and beside the box about a solid. Of points that
    move together the ball about them is asked.
    """
    return all(_is_clear_on(part, contact) for part in model.parts)


def _is_clear_on(part: "Model", contact: "Contact") -> bool:
    points, surface = contact.points, contact.surface
    # All are (1 or envs, items, …).
    places = part.parameters[f"{points.name}.position"].values
    if points.surface is not None:
        position, orientation, scale = _pose_on_body(part, points.surface)
        places = placed(scale[..., None] * places, position[:, 0], orientation[:, 0])
    low, high = places, places
    if not points.spread:
        low, high = places.min(axis=1, keepdims=True), places.max(axis=1, keepdims=True)
    middle, size = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=-1)
    if points.body is not None:
        middle = placed(middle[..., None, :], *_pose(part, points.body))[..., 0, :]
    far = np.abs(middle).max(axis=-1)
    if surface.body is not None:
        middle = _seen_from(middle, *_pose(part, surface.body))
        far = far + np.abs(middle).max(axis=-1)
    position, orientation, scale = _pose_on_body(part, surface)
    middle = _seen_from(middle, position, orientation) / scale[..., None] - surface.centre
    radius = part.parameters[f"{contact.name}.radius"].values.max(axis=1, keepdims=True)
    needed = (size + radius + ROUNDING * far) / scale
    return all(bool((sides.clearance(middle) > needed).all()) for sides in part.sides[contact])


def _pose_on_body(part: "Model", surface: "Surface") -> list[Array]:
    """Returns position, orientation and scale of a surface, (1 or envs, 1, …)."""
    return [part.parameters[f"{surface.name}.{name}"].values for name in ("position", "orientation", "scale")]


def _pose(part: "Model", body: "Body") -> list[Array]:
    """Returns where a body is now, or those of a set are, and how they are turned, (envs, n, …)."""
    whole = part.state.body_position, part.state.body_orientation
    return [values.numpy()[:, body.items].astype(np.float64) for values in whole]


def _seen_from(places: Array, position: Array, orientation: Array) -> Array:
    """Returns places in a frame that has this pose where they are given."""
    return placed((places - position)[..., None, :], np.zeros(3), inverse(orientation))[..., 0, :]
