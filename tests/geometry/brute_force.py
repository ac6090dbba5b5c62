"""Brute-force distance and winding number of points and triangles, in float64.

Reference for the closest-point kernels. Shares no code and no method with them: the side comes from the winding
number, not from pseudonormals.
"""

import numpy as np
from scipy.spatial import cKDTree

# Number of point–triangle pairs evaluated together; they need a few tens of megabytes.
PAIRS = 200_000


class Surface:
    """Triangles (F, 3, 3) in float64."""

    def __init__(self, corners):
        self.corners = np.asarray(corners, dtype=np.float64)
        self.low, self.high = self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))
        self.size = float((self.high - self.low).max())
        # Bounding spheres, sorted into classes whose radii differ by at most a factor of two.
        middle = self.corners.mean(axis=1)
        radius = np.linalg.norm(self.corners - middle[:, None], axis=2).max(axis=1)
        order = np.floor(np.log2(radius)).astype(int)
        self._classes = [
            (faces, cKDTree(middle[faces]), radius[faces].max())
            for faces in (np.flatnonzero(order == value) for value in np.unique(order))
        ]

    def nearest(self, points):
        """Returns the distance (N,), the nearest point (N, 3), and its face (N,).

        A triangle is at least as far away as the center of its bounding sphere minus the radius. So the center of
        the nearest triangle is at most the distance to any triangle plus its radius away.
        """
        points = np.asarray(points, dtype=np.float64)
        reach = np.full(len(points), np.inf)
        for faces, tree, _ in self._classes:
            _, at = tree.query(points, k=min(4, len(faces)))
            for column in at.reshape(len(points), -1).T:
                closest_points = nearest_on_triangles(points, self.corners[faces[column]])
                reach = np.minimum(reach, np.linalg.norm(points - closest_points, axis=1))
        # The margin is far larger than the rounding error of a distance.
        reach = reach * (1 + 1e-12) + 1e-12 * self.size
        distance, closest = np.full(len(points), np.inf), np.zeros((len(points), 3))
        face = np.zeros(len(points), dtype=int)
        for faces, tree, largest in self._classes:
            counts = tree.query_ball_point(points, reach + largest, return_length=True)
            for part in _pieces(counts):
                near = tree.query_ball_point(points[part], reach[part] + largest)
                owner = np.repeat(np.arange(part.start, part.stop), counts[part])
                found = faces[np.concatenate([np.asarray(one, dtype=int) for one in near])]
                closest_points = nearest_on_triangles(points[owner], self.corners[found])
                away = np.linalg.norm(points[owner] - closest_points, axis=1)
                # Sorted by decreasing distance: the last write, of the nearest face, remains.
                order = np.argsort(-away, kind="stable")
                order = order[away[order] < distance[owner[order]]]
                best = np.full(len(points), -1)
                best[owner[order]] = order
                better = np.flatnonzero(best >= 0)
                chosen = best[better]
                distance[better], closest[better], face[better] = (
                    away[chosen],
                    closest_points[chosen],
                    found[chosen],
                )
        return distance, closest, face

    def winding(self, points):
        """Returns the winding number (N,) of the closed surface: 0 outside, 1 inside."""
        points = np.asarray(points, dtype=np.float64)
        turns = np.empty(len(points))
        for part in _pieces(np.full(len(points), len(self.corners))):
            # Solid angle of a triangle: A. Van Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125.
            a, b, c = (self.corners[None, :, k] - points[part, None] for k in range(3))
            la, lb, lc = (np.sqrt(_dot(x, x)) for x in (a, b, c))
            volume = _dot(a, np.cross(b, c))
            base = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
            turns[part] = np.arctan2(volume, base).sum(axis=1) / (2 * np.pi)
        return turns

    def first_hit(self, starts, directions):
        """Returns the distance (N,) to the first triangle along each direction; infinite without a hit."""
        a, b, c = (self.corners[None, :, k] for k in range(3))
        along = np.full(len(starts), np.inf)
        for part in _pieces(np.full(len(starts), len(self.corners))):
            ray = directions[part, None]
            side = np.cross(ray, c - a)
            volume = _dot(side, b - a)
            from_a = starts[part, None] - a
            across = np.cross(from_a, b - a)
            with np.errstate(all="ignore"):
                u, v, t = _dot(from_a, side) / volume, _dot(ray, across) / volume, _dot(c - a, across) / volume
                hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9 * self.size)
            along[part] = np.where(hit, t, np.inf).min(axis=1)
        return along

    def pseudonormals(self, point):
        """Returns the pseudonormals (n, 3) of the features of a closed surface that contain a point."""
        near = np.linalg.norm(
            nearest_on_triangles(np.tile(point, (len(self.corners), 1)), self.corners) - point, axis=1
        )
        corners = self.corners[near < 1e-6 * self.size]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        arms = corners - point
        # Angle of the face at the point: the interior angle at a vertex, π on an edge, 2π inside a face, to
        # rounding.
        angles = np.zeros(len(corners))
        for k in range(3):
            a, b = arms[:, k], arms[:, (k + 1) % 3]
            at_corner = (np.linalg.norm(arms, axis=2) < 1e-6 * self.size)[:, [k, (k + 1) % 3]].any(axis=1)
            span = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), _dot(a, b))
            angles += np.where(at_corner, 0.0, span)
        sums = [normals, angles[:, None].T @ normals]
        sums += [normals[i] + normals[i + 1 :] for i in range(len(normals) - 1)]
        found = np.concatenate(sums)
        length = np.linalg.norm(found, axis=1, keepdims=True)
        return found[length[:, 0] > 1e-9] / length[length > 1e-9][:, None]


def nearest_on_triangles(points, corners):
    """Returns the nearest point (N, 3) of triangle i (N, 3, 3) to point i (N, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    over = np.ones(len(points), dtype=bool)
    best, square = None, None
    for k in range(3):
        start = corners[:, k]
        edge = corners[:, (k + 1) % 3] - start
        to_point = points - start
        over &= _dot(np.cross(normal, edge), to_point) > 0
        closest = start + np.clip(_dot(to_point, edge) / _dot(edge, edge), 0, 1)[:, None] * edge
        away = _dot(points - closest, points - closest)
        if best is None:
            best, square = closest, away
        else:
            best, square = np.where((away < square)[:, None], closest, best), np.minimum(away, square)
    height = _dot(points - corners[:, 0], normal) / _dot(normal, normal)
    return np.where(over[:, None], points - height[:, None] * normal, best)


def _dot(a, b):
    return np.einsum("...i,...i->...", a, b)


def _pieces(counts):
    """Yields slices of points with a bounded total of ``counts`` pairs."""
    total = np.cumsum(counts)
    start = 0
    while start < len(counts):
        before = total[start - 1] if start else 0
        stop = max(int(np.searchsorted(total, before + PAIRS, side="right")), start + 1)
        yield slice(start, stop)
        start = stop
