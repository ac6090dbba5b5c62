"""Poses on the host."""

import numpy as np

from warpcontact.checks import Array


def placed(points: Array, position: Array, orientation: Array) -> Array:
    """Returns points (…, n, 3) [m] of a frame in the frame that carries it.

    Args:
        points: In the frame.
        position: Its origin, (…, 3) [m].
        orientation: Rotation out of it, quaternions (…, 4) in the order x, y, z, w, of length 1.
    """
    axis, angle = orientation[..., None, :3], orientation[..., None, 3:]
    turn = 2.0 * np.cross(axis, points)
    return points + angle * turn + np.cross(axis, turn) + position[..., None, :]
