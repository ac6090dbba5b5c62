"""Takes faces without area out of a surface without opening it."""

from collections import defaultdict, deque

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.examine import SLIVER_LIMIT
from warpcontact.meshes.topology import slenderness

# A face may become part of a sliver again when a neighbour is taken apart, but not for ever.
_ROUNDS = 20


def without_slivers(
    v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], int, float]:
    """Removes degenerate faces.

    One with coincident corners is a line that its neighbours share already: it is dropped. One whose corner c
    lies on its longest edge ab is taken together with the face abd behind that edge: the two become acd and cbd,
    so that c is no longer beside an edge but the end of one. Where there is no such single face, it is dropped.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3).

    Returns:
        Faces; the number of the face as given that each is a part of, which tells its groups; how many were taken
        together with a neighbour; and the greatest height of those [m].
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
    """Faces that change, and which of them there are at each edge.

    Args:
        v: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3).

    Attributes:
        corners: Vertex indices of each face; none of one that was removed.
        source: The face as given that each is a part of.
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
        """Ends of the longest edge of face i, the corner on it, and the one face behind it, if there is one."""
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
        # The edge from c to the far corner is new: with one there, it would be of more than two faces.
        if len(opposite) != 1 or c in opposite or self._faces_at_edge[_edge(c, *opposite)]:
            return None
        return a, b, c, j

    def split(self, i: int, j: int, a: int, b: int, c: int) -> None:
        """Makes faces i and j the two parts of face j, which has the edge ab, on either side of c."""
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
