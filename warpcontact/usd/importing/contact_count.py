"""Scales the force of sample points by the number of points in contact at the same time, so that stiffness is bounded."""

import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from warpcontact.validation.checks import Array

#: Number of points that may carry their full force; with more, each carries a fraction. With this number, a dashpot at
#: the smallest restitution is stable at time steps of 1/50 of the contact time.
FULL_FORCE_POINTS = 4
# Thickness of a flat part, as a fraction of the size of the point set.
_FLAT = 0.01
# Largest number of points and hull facets that are tested.
_MAX_TRIED = 256


def averaged_force_scale(points: Array, reach: float, *, convex: bool) -> float:
    """Returns the fraction of its force that each point is given.

    Args:
        points: Positions of the points (n, 3) [m].
        reach: Half the size of the opposite body [m], within which points can be in contact simultaneously.
        convex: Whether only points in one flat part of the convex hull can be in contact simultaneously, as for a
            body that lies on another.
    """
    tried = points[:: max(1, len(points) // _MAX_TRIED)]
    count = int(KDTree(points).query_ball_point(tried, reach, return_length=True).max())
    if convex:
        count = min(count, _max_coplanar(points))
    return min(1.0, FULL_FORCE_POINTS / count)


def _max_coplanar(points: Array) -> int:
    """Returns the largest number of points in one flat part of their convex hull."""
    try:
        planes = ConvexHull(points).equations
    except (QhullError, ValueError):  # the points are coplanar
        return len(points)
    planes = planes[:: max(1, len(planes) // _MAX_TRIED)]
    distance = points @ planes[:, :3].T + planes[:, 3]
    return int((distance > -_FLAT * np.ptp(points, axis=0).max()).sum(axis=0).max())
