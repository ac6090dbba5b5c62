"""Nesting of closed parts of a surface."""

import numpy as np
import numpy.typing as npt

# Largest number of vertex–face pairs that are tested, about a second of work; beyond it, no result is given.
_BUDGET = 10_000_000
_MOST_PARTS = 2000
_SAMPLES = 3
# Fixed cost of a pair of parts, in faces.
_OVERHEAD = 100


def find_containing_parts(
    v: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    part: npt.NDArray[np.integer],
    closed: npt.NDArray[np.bool],
) -> dict[int, int]:
    """Finds the part in which each closed part lies.

    A part lies in another one if its bounding box lies in that of the other, and samples of its vertices have a winding
    number of ±1. For intersecting parts the result is arbitrary.

    Args:
        v: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3).
        part: Part of each triangle, (F,), numbers from 0.
        closed: Whether each part bounds a volume and is consistently wound, (parts,).

    Returns:
        The smallest enclosing part of each enclosed part; empty if there are too many pairs to test.
    """
    candidates = np.flatnonzero(closed)
    count = len(candidates)
    if not 2 <= count <= _MOST_PARTS:
        return {}
    number = np.full(len(closed), -1)
    number[candidates] = np.arange(count)
    part = number[part]
    order = np.argsort(part, kind="stable")
    order = order[np.searchsorted(part[order], 0) :]  # faces of candidates only
    bounds = np.searchsorted(part[order], np.arange(count + 1))
    corners = v[faces[order]]
    lower = np.minimum.reduceat(corners.min(axis=1), bounds[:-1], axis=0)
    upper = np.maximum.reduceat(corners.max(axis=1), bounds[:-1], axis=0)
    inside = (lower[:, None] >= lower[None]) & (upper[:, None] <= upper[None])
    inner, outer = np.nonzero(inside.all(axis=2) & ~np.eye(count, dtype=bool))
    sizes = np.diff(bounds)
    if _SAMPLES * int((sizes[outer] + _OVERHEAD).sum()) > _BUDGET:
        return {}
    extents = np.prod(upper - lower, axis=1)
    found: dict[int, int] = {}
    smallest = np.argsort(extents[outer], kind="stable")
    for i, j in zip(inner[smallest].tolist(), outer[smallest].tolist(), strict=True):
        if i in found:
            continue
        points = v[np.unique(faces[order[bounds[i] : bounds[i + 1]]])]
        samples = points[np.linspace(0, len(points) - 1, _SAMPLES).astype(int)]
        if all(abs(_winding(corners[bounds[j] : bounds[j + 1]] - sample)) > 0.5 for sample in samples):
            found[i] = j
    return {int(candidates[i]): int(candidates[j]) for i, j in found.items()}


def _winding(corners: npt.NDArray[np.float64]) -> float:
    """Returns the winding number of closed triangles (n, 3, 3) about the origin (van Oosterom & Strackee 1983)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    x, y, z = (np.linalg.norm(p, axis=1) for p in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a)))
    above = np.einsum("ij,ij->i", a, np.cross(b, c))
    return float(np.arctan2(above, x * y * z + ab * z + bc * x + ca * y).sum() / (2.0 * np.pi))
