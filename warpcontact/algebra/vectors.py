"""Vectors, rotations and rigid transforms on the host, with NumPy arrays.

Products, norms and bounds of 3-vectors are computed by component, for any real type. NumPy is slow along a last axis
of length 3: for thousands of vectors, its ``norm`` takes 2–5 times and bounds 5–9 times as long; for few vectors, its
``cross`` takes twice as long. Norms and products are bitwise identical to NumPy's.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Returns dot products (…) of vectors (…, 3)."""
    result: NDArray[Any] = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return result


def cross(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Returns cross products (…, 3) of vectors (…, 3)."""
    (a0, a1, a2), (b0, b1, b2) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (a, b))
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def norm(vectors: NDArray[Any]) -> NDArray[Any]:
    """Returns lengths (…) of vectors (…, 3)."""
    length: NDArray[Any] = np.sqrt(dot(vectors, vectors))
    return length


def bounds(positions: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Returns the minimum and maximum of each component (3,) of at least one position (…, 3)."""
    axes = [positions[..., k] for k in range(3)]
    return np.array([component.min() for component in axes]), np.array([component.max() for component in axes])


def transform_points(points: Array, position: Array, orientation: Array) -> Array:
    """Returns points (…, n, 3) [m] transformed from a frame to its parent frame.

    Args:
        points: Points in the frame (…, n, 3) [m].
        position: Origin of the frame in the parent frame (…, 3) [m].
        orientation: Rotation from the frame to the parent frame, unit quaternions (x, y, z, w), (…, 4).
    """
    vector, scalar = orientation[..., None, :3], orientation[..., None, 3:]
    t = 2.0 * cross(vector, points)
    return points + scalar * t + cross(vector, t) + position[..., None, :]


def quat_multiply(left: Array, right: Array) -> Array:
    """Returns the quaternion products (…, 4): the rotation ``right`` followed by ``left``."""
    a, p = left[..., :3], left[..., 3:]
    b, q = right[..., :3], right[..., 3:]
    return np.concatenate([p * b + q * a + cross(a, b), p * q - (a * b).sum(axis=-1, keepdims=True)], axis=-1)


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
    one_plus_cosine = 1.0 + directions @ start
    quaternions = np.concatenate([cross(start, directions), one_plus_cosine[..., None]], axis=-1)
    quaternions[one_plus_cosine < 1.0e-12] = (*np.roll(start, 1), 0.0)
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
