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


def product(first: Array, second: Array) -> Array:
    """Returns the quaternions (…, 4) of two rotations one after the other, ``second`` before ``first``."""
    a, p = first[..., :3], first[..., 3:]
    b, q = second[..., :3], second[..., 3:]
    return np.concatenate([p * b + q * a + np.cross(a, b), p * q - (a * b).sum(axis=-1, keepdims=True)], axis=-1)


def inverse(orientation: Array) -> Array:
    """Returns the quaternions (…, 4) of the rotations back."""
    return orientation * np.array([-1.0, -1.0, -1.0, 1.0])
