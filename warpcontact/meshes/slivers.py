"""Removes degenerate faces from a surface without opening it."""

from collections import defaultdict, deque

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.examine import SLIVER_LIMIT
from warpcontact.meshes.topology import slenderness

# Largest number of splits per sliver, because splitting a neighbor can create new slivers.
_ROUNDS = 20


def without_slivers(
    v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], int, float]:
    """Removes degenerate faces.

    A face with coincident vertices is a line that its neighbors already share, and is dropped. If a vertex c of a face
    lies on its longest edge ab, the face is merged with the neighbor abd at that edge, and both become acd and cbd, so
    that c is a vertex of both. If there is no single such neighbor, the face is dropped.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3).

    Returns:
        Faces; for each, the number of the input face it is a part of, for its groups; number of faces merged with a
        neighbor; and the largest height of those [m].
    """
    slivers = np.flatnonzero(slenderness(v[faces]) < SLIVER_LIMIT).tolist()
    surface = _Surface(v, faces)
    queue, remaining_rounds, split, height = deque(slivers), _ROUNDS * len(slivers), 0, 0.0
    while queue:
        i = queue.popleft()
        if not surface.is_sliver(i):
            continue
        found = surface.face_behind(i) if remaining_rounds > 0 else None
        if found is None:
            surface.remove(i)
            continue
        remaining_rounds -= 1
        a, b, c, j = found
        height = max(height, _height(v[a], v[b], v[c]))
        surface.split(i, j, a, b, c)
        queue.extend((i, j))
        split += 1
    kept = [i for i, corners in enumerate(surface.corners) if corners]
    result = np.array([surface.corners[i] for i in kept], dtype=np.int64).reshape(-1, 3)
    return result, np.array([surface.source[i] for i in kept], dtype=np.int64), split, height


class _Surface:
    """Changing faces with a map from edges to faces.

    Args:
        v: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3).

    Attributes:
        corners: Vertex indices of each face; empty for a removed one.
        source: Number of the input face that each face is a part of.
    """

    def __init__(self, v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> None:
        self.v = v
        self.corners: list[list[int]] = faces.tolist()
        self.source = list(range(len(faces)))
        self._faces_at_edge: defaultdict[tuple[int, int], set[int]] = defaultdict(set)
        for i, corners in enumerate(self.corners):
            for edge in _edges(corners):
                self._faces_at_edge[edge].add(i)

    def is_sliver(self, i: int) -> bool:
        corners = self.corners[i]
        return bool(corners) and bool(slenderness(self.v[[corners]])[0] < SLIVER_LIMIT)

    def remove(self, i: int) -> None:
        self._set(i, [])

    def face_behind(self, i: int) -> tuple[int, int, int, int] | None:
        """Returns ends of the longest edge of face i, the vertex on it, and the single neighbor there, or ``None``."""
        corners = self.corners[i]
        if len(set(corners)) < 3:
            return None
        lengths = [float(np.linalg.norm(self.v[corners[k]] - self.v[corners[k - 2]])) for k in range(3)]
        k = int(np.argmax(lengths))
        a, b, c = corners[k], corners[k - 2], corners[k - 1]
        others = self._faces_at_edge[_edge(a, b)] - {i}
        if len(others) != 1:
            return None
        j = next(iter(others))
        opposite = set(self.corners[j]) - {a, b}
        # The edge from c to the opposite vertex must be new, because it gets two faces.
        if len(opposite) != 1 or c in opposite or self._faces_at_edge[_edge(c, *opposite)]:
            return None
        return a, b, c, j

    def split(self, i: int, j: int, a: int, b: int, c: int) -> None:
        """Replaces faces i and j by the two parts of face j, whose edge ab is divided at c."""
        face = self.corners[j]
        for k, replaced in ((i, a), (j, b)):
            self._set(k, [c if corner == replaced else corner for corner in face])
        self.source[i] = self.source[j]

    def _set(self, i: int, corners: list[int]) -> None:
        for edge in _edges(self.corners[i]):
            self._faces_at_edge[edge].discard(i)
        self.corners[i] = corners
        for edge in _edges(corners):
            self._faces_at_edge[edge].add(i)


def _edge(p: int, q: int) -> tuple[int, int]:
    return (p, q) if p < q else (q, p)


def _edges(corners: list[int]) -> list[tuple[int, int]]:
    return [_edge(corners[k - 1], corners[k]) for k in range(len(corners))]


def _height(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64], c: npt.NDArray[np.float64]) -> float:
    base = float(np.linalg.norm(b - a))
    return float(np.linalg.norm(np.cross(b - a, c - a))) / base if base > 0.0 else 0.0
