"""Detection of faces of a surface that intersect or overlap."""

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import bounds, norm
from warpcontact.meshes.topology import CRACK_LIMIT, area_vectors

#: Largest number of faces that are examined by default.
MOST_FACES = 100_000
# Largest number of box pairs on one level of the tree; beyond it, no result is given.
_MAX_PAIRS = 8_000_000
_CHUNK = 500_000

_Pairs = npt.NDArray[np.int64]
_Floats = npt.NDArray[np.float64]


def intersections(v: _Floats, faces: npt.NDArray[np.int64]) -> _Pairs | None:
    """Finds pairs of faces that have more than a vertex or an edge in common.

    Two faces count if an edge of one passes through the other by more than 1e-6 of the surface size on both sides, or
    if they are coplanar to that accuracy and overlap. Faces of parts that touch along an edge or at a vertex do not
    count.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3), none degenerate.

    Returns:
        Face numbers of each pair, the lower one first, (n, 2), sorted; ``None`` if there are too many candidates.
    """
    if len(faces) < 2:
        return np.empty((0, 2), dtype=np.int64)
    corners = v[faces]
    lower, upper = bounds(corners)
    corners = corners - 0.5 * (lower + upper)  # for precision
    pairs = _candidates(corners)
    if pairs is None:
        return None
    tolerance = CRACK_LIMIT * float((upper - lower).max())
    normals = area_vectors(corners)
    normals /= norm(normals)[:, None]
    found = [np.empty((0, 2), dtype=np.int64)]
    for start in range(0, len(pairs), _CHUNK):
        block = pairs[start : start + _CHUNK]
        found.append(block[_intersect(corners, normals, faces, block, tolerance)])
    result = np.concatenate(found)
    return result[np.lexsort(result.T[::-1])]


def _candidates(corners: _Floats) -> _Pairs | None:
    """Returns pairs of faces with overlapping boxes, by a tree of boxes over faces sorted along a Z curve."""
    count = len(corners)
    levels = int(np.ceil(np.log2(count)))
    order = np.argsort(_z_curve(corners.mean(axis=1)), kind="stable")
    lower, upper = np.full((2**levels, 3), np.inf), np.full((2**levels, 3), -np.inf)
    lower[:count], upper[:count] = corners.min(axis=1)[order], corners.max(axis=1)[order]
    tree = [(lower, upper)]
    for _ in range(levels):
        low, high = tree[-1]
        tree.append((low.reshape(-1, 2, 3).min(axis=1), high.reshape(-1, 2, 3).max(axis=1)))
    pairs = np.zeros((1, 2), dtype=np.int64)
    for low, high in tree[-2::-1]:
        # Children of two different nodes form four pairs, children of the same node three.
        is_same = pairs[:, 0] == pairs[:, 1]
        a, b = 2 * pairs[:, 0], 2 * pairs[:, 1]
        twice = [(a, b), (a, b + 1), (a + 1, b + 1)]
        halves = [np.column_stack(pair) for pair in twice] + [np.column_stack((a + 1, b))[~is_same]]
        if sum(map(len, halves)) > _MAX_PAIRS:
            return None
        pairs = np.concatenate([half[_boxes_overlap(low, high, half)] for half in halves])
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return np.sort(order[pairs], axis=1)


def _boxes_overlap(low: _Floats, high: _Floats, pairs: _Pairs) -> npt.NDArray[np.bool]:
    a, b = pairs.T
    overlapping = (low[a, 0] <= high[b, 0]) & (low[b, 0] <= high[a, 0])
    for axis in (1, 2):
        overlapping &= (low[a, axis] <= high[b, axis]) & (low[b, axis] <= high[a, axis])
    return overlapping


def _z_curve(points: _Floats) -> npt.NDArray[np.uint64]:
    """Returns the positions of points along a Z-order curve."""
    span = np.ptp(points, axis=0).max()
    cells = ((points - points.min(axis=0)) / (span if span > 0.0 else 1.0) * (2**20 - 1)).astype(np.uint64)
    for shift, mask in (
        (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249),
    ):  # fmt: skip
        cells = (cells | cells << np.uint64(shift)) & np.uint64(mask)
    return cells[:, 0] | cells[:, 1] << np.uint64(1) | cells[:, 2] << np.uint64(2)


def _intersect(
    corners: _Floats, normals: _Floats, faces: npt.NDArray[np.int64], pairs: _Pairs, tolerance: float
) -> npt.NDArray[np.bool]:
    """Returns which pairs of faces intersect or overlap in a plane."""
    overlapping = np.zeros(len(pairs), dtype=bool)
    candidates = np.arange(len(pairs))
    heights: list[_Floats] = []
    for a, b in ((0, 1), (1, 0)):  # discard pairs with one face entirely on one side of the other
        p, q = pairs[candidates, a], pairs[candidates, b]
        height = np.einsum("ijk,ik->ij", corners[p] - corners[q][:, :1], normals[q])
        across = (height.min(axis=1) <= tolerance) & (height.max(axis=1) >= -tolerance)
        heights = [previous[across] for previous in (*heights, height)]
        candidates = candidates[across]
    block = pairs[candidates]
    same = faces[block[:, 0]][:, :, None] == faces[block[:, 1]][:, None, :]
    found = np.zeros(len(block), dtype=bool)
    for (a, b), height, shared in zip(
        ((0, 1), (1, 0)), heights, (same.any(axis=2), same.any(axis=1)), strict=True
    ):
        p, q = block[:, a], block[:, b]
        for i in range(3):
            j = (i + 1) % 3
            low, high = np.minimum(height[:, i], height[:, j]), np.maximum(height[:, i], height[:, j])
            # An edge that ends at a shared vertex only touches the other face.
            todo = np.flatnonzero((low < -tolerance) & (high > tolerance) & ~shared[:, i] & ~shared[:, j] & ~found)
            found[todo] = _line_crosses_face(corners[p[todo], i], corners[p[todo], j], corners[q[todo]])
        flat = np.flatnonzero((np.abs(height) <= tolerance).all(axis=1) & ~found)
        found[flat] = _overlap(corners[p[flat]], corners[q[flat]], normals[q[flat]], tolerance)
    overlapping[candidates] = found
    return overlapping


def _line_crosses_face(tail: _Floats, head: _Floats, q: _Floats) -> npt.NDArray[np.bool]:
    """Returns whether the line through two points (n, 3) passes through a triangle (n, 3, 3)."""
    a, b, c = (q[:, i] - tail for i in range(3))
    along = head - tail
    sides = np.stack([np.einsum("ij,ij->i", along, np.cross(x, y)) for x, y in ((a, b), (b, c), (c, a))], axis=1)
    total = np.abs(sides).sum(axis=1, keepdims=True)
    return (sides >= -1e-9 * total).all(axis=1) | (sides <= 1e-9 * total).all(axis=1)


def _overlap(p: _Floats, q: _Floats, normal: _Floats, tolerance: float) -> npt.NDArray[np.bool]:
    """Returns whether coplanar triangles (n, 3, 3) overlap: no edge of either is a separating axis."""
    candidates = np.arange(len(p))
    for use_p in (True, False):
        for i in range(3):
            shape = (p if use_p else q)[candidates]
            side = np.cross(shape[:, (i + 1) % 3] - shape[:, i], normal[candidates])
            reach = tolerance * np.sqrt(np.einsum("ij,ij->i", side, side))
            s, t = (np.matmul(x[candidates], side[:, :, None])[:, :, 0] for x in (p, q))
            apart = (s.min(axis=1) > t.max(axis=1) - reach) | (t.min(axis=1) > s.max(axis=1) - reach)
            candidates = candidates[~apart]
    overlap = np.zeros(len(p), dtype=bool)
    overlap[candidates] = True
    return overlap
