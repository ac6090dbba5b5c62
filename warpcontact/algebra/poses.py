"""Poses on the host."""

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.validation.checks import Array


def transform_points(points: Array, position: Array, orientation: Array) -> Array:
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


def shortest_rotations(start: ArrayLike, directions: Array) -> Array:
    """Returns the quaternions (…, 4) of the shortest rotations of an axis onto directions.

    Args:
        start: The axis, one of x, y and z, (3,).
        directions: Unit vectors (…, 3); the one opposite to ``start`` is reached by half a turn about the axis
            after it, in the order x, y, z.
    """
    start = np.asarray(start, dtype=np.float64)
    # Half the angle from the sum of both; 1e-12 is what rounding leaves of it where they are opposite.
    whole = 1.0 + directions @ start
    quaternions = np.concatenate([np.cross(start, directions), whole[..., None]], axis=-1)
    quaternions[whole < 1.0e-12] = (*np.roll(start, 1), 0.0)
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
