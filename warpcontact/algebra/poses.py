"""Rotations and rigid transforms on the host, with NumPy arrays."""

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.validation.checks import Array


def transform_points(points: Array, position: Array, orientation: Array) -> Array:
    """Returns points (…, n, 3) [m] transformed from a frame to its parent frame.

    Args:
        points: Points in the frame (…, n, 3) [m].
        position: Origin of the frame in the parent frame (…, 3) [m].
        orientation: Rotation from the frame to the parent frame, unit quaternions (x, y, z, w), (…, 4).
    """
    axis, angle = orientation[..., None, :3], orientation[..., None, 3:]
    turn = 2.0 * np.cross(axis, points)
    return points + angle * turn + np.cross(axis, turn) + position[..., None, :]


def product(first: Array, second: Array) -> Array:
    """Returns the quaternion products (…, 4): the rotation ``second`` followed by ``first``."""
    a, p = first[..., :3], first[..., 3:]
    b, q = second[..., :3], second[..., 3:]
    return np.concatenate([p * b + q * a + np.cross(a, b), p * q - (a * b).sum(axis=-1, keepdims=True)], axis=-1)


def inverse(orientation: Array) -> Array:
    """Returns the quaternions (…, 4) of the inverse rotations."""
    return orientation * np.array([-1.0, -1.0, -1.0, 1.0])


def shortest_rotations(start: ArrayLike, directions: Array) -> Array:
    """Returns the quaternions (…, 4) of the shortest rotations of an axis onto directions.

    Args:
        start: The axis, one of x, y and z, (3,).
        directions: Unit vectors (…, 3). A direction opposite to ``start`` gives a rotation by π about the axis that
            follows ``start`` in the order x, y, z.
    """
    start = np.asarray(start, dtype=np.float64)
    # q ∝ (a × b, 1 + a·b). For opposite vectors, rounding leaves 1 + a·b below 1e-12.
    whole = 1.0 + directions @ start
    quaternions = np.concatenate([np.cross(start, directions), whole[..., None]], axis=-1)
    quaternions[whole < 1.0e-12] = (*np.roll(start, 1), 0.0)
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
