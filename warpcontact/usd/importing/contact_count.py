"""How many points of a body may touch at once: each has a spring and a dashpot, and they add up."""

import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from warpcontact.validation.checks import Array

#: So many points may carry in full; of more each carries a part. A dashpot of the least restitution is just within
#: what a step of a fiftieth of the contact time takes four times.
FULL_FORCE_POINTS = 4
# A part is flat within so much of the size of all.
_FLAT = 0.01
# Places, and facets, that are tried.
_MAX_TRIED = 256


def averaged_force_scale(points: Array, reach: float, *, convex: bool) -> float:
    """Returns the part of its force that each point is given.

    Args:
        points: The points (n, 3) [m].
        reach: Half the size of what they touch [m]: it covers no points that are farther from each other.
        convex: Whether only those in a flat part of their convex hull touch at once, as of what lies on something.
    """
    tried = points[:: max(1, len(points) // _MAX_TRIED)]
    count = int(KDTree(points).query_ball_point(tried, reach, return_length=True).max())
    if convex:
        count = min(count, _max_coplanar(points))
    return min(1.0, FULL_FORCE_POINTS / count)


def _max_coplanar(points: Array) -> int:
    """Returns how many points lie in one flat part of their convex hull."""
    try:
        planes = ConvexHull(points).equations
    except (QhullError, ValueError):  # all of them do
        return len(points)
    planes = planes[:: max(1, len(planes) // _MAX_TRIED)]
    distance = points @ planes[:, :3].T + planes[:, 3]
    return int((distance > -_FLAT * np.ptp(points, axis=0).max()).sum(axis=0).max())
