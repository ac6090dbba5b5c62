"""Closest points of many pairs of segments, on the host."""

import numpy as np

from warpcontact.validation.checks import Array

# Squared sine of the angle below which two segments are parallel.
PARALLEL = 1.0e-10


def closest_on_segments(d: Array, g: Array, h: Array) -> tuple[Array, Array]:
    """Returns the parameters (s, t) in [−1, 1] (n,) of the closest points of pairs of segments.

    For parallel segments that overlap in projection, the middle of the overlap is used.

    Args:
        d: Vector from the middle of the second to that of the first (n, 3) [m].
        g: Vector from the middle of the first to its end (n, 3) [m]; zeros: a point.
        h: Likewise for the second.
    """
    a, b, c = (g * g).sum(axis=1), (g * h).sum(axis=1), (h * h).sum(axis=1)
    e, f = (g * d).sum(axis=1), (h * d).sum(axis=1)
    long_1, long_2 = a > 0.0, c > 0.0
    a_or_1, c_or_1 = np.where(long_1, a, 1.0), np.where(long_2, c, 1.0)
    det = a * c - b * b
    crossing = det > PARALLEL * a * c
    ends = np.stack([-e - b, -e + b]) / a_or_1
    low, high = ends.min(axis=0), ends.max(axis=0)
    beside = 0.5 * (np.maximum(low, -1.0) + np.minimum(high, 1.0))
    # Without overlap: the end that is nearest to the other segment.
    beside = np.where(high < -1.0, -1.0, np.where(low > 1.0, 1.0, beside))
    s = np.where(crossing, (b * f - c * e) / np.where(crossing, det, 1.0), beside)
    s = np.where(long_2, np.clip(s, -1.0, 1.0), np.clip(-e / a_or_1, -1.0, 1.0))
    s = np.where(long_1, s, 0.0)
    t = np.where(long_2, (f + s * b) / c_or_1, 0.0)
    beyond = np.abs(t) > 1.0
    t = np.clip(t, -1.0, 1.0)
    return np.where(beyond & long_1, np.clip((t * b - e) / a_or_1, -1.0, 1.0), s), t
