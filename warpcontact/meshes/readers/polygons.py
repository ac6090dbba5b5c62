"""Triangulation of polygons: fans for convex ones, ear clipping for others."""

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.unreadable import Unreadable

# Ear clipping of polygons with more vertices takes too long.
MOST_CORNERS = 2000

_Integers = npt.NDArray[np.int64]


def triangulate(
    vertices: npt.NDArray[np.float64], counts: _Integers, corners: _Integers
) -> tuple[_Integers, _Integers]:
    """Splits polygons into triangles, in their order and with their orientation.

    Args:
        vertices: Positions, (V, 3).
        counts: Number of vertices of each polygon, at least three, (n,).
        corners: Vertex indices of all polygons, one polygon after the other; they may be out of range.

    Returns:
        Triangles, (F, 3), counts − 2 per polygon; and the polygon of each, (F,).

    Raises:
        Unreadable: If a polygon with more than ``MOST_CORNERS`` vertices is not convex.
    """
    starts, pieces = np.cumsum(counts) - counts, counts - 2
    owner = np.repeat(np.arange(len(counts)), pieces)
    first = np.cumsum(pieces) - pieces
    step = np.arange(len(owner)) - first[owner]
    begin = starts[owner]
    faces = np.stack((corners[begin], corners[begin + step + 1], corners[begin + step + 2]), axis=1)
    for count in np.unique(counts[counts > 3]).tolist():
        selected = np.flatnonzero(counts == count)
        polygons = corners[starts[selected, None] + np.arange(count)]
        for i in np.flatnonzero(_concave(vertices, polygons)).tolist():
            if count > MOST_CORNERS:
                raise Unreadable(
                    f"face {selected[i]} has {count} vertices and is not convex; allowed: {MOST_CORNERS} vertices, or "
                    "any number of a convex face"
                )
            ears = _ears(vertices[polygons[i]])
            if ears is not None:
                start = first[selected[i]]
                faces[start : start + count - 2] = polygons[i][ears]
    return faces.reshape(-1, 3), owner


def _concave(vertices: npt.NDArray[np.float64], polygons: _Integers) -> npt.NDArray[np.bool]:
    """Returns which polygons (n, k) are concave; false if a vertex does not exist."""
    usable = ((polygons >= 0) & (polygons < len(vertices))).all(axis=1)
    concave = np.zeros(len(polygons), dtype=bool)
    p = vertices[polygons[usable]]
    with np.errstate(all="ignore"):  # NaN and overflow are reported by the examination
        turns = np.cross(p - np.roll(p, 1, axis=1), np.roll(p, -1, axis=1) - p)
        normal = _normals(p)
        square = np.einsum("ij,ij->i", normal, normal)
        concave[usable] = (np.einsum("ijk,ik->ij", turns, normal) < -1e-9 * square[:, None]).any(axis=1)
    return concave


def _normals(p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the area vectors of polygons (n, k, 3), with twice the areas as lengths."""
    spokes = p - p[:, :1]
    return np.cross(spokes, np.roll(spokes, -1, axis=1)).sum(axis=1)


def _ears(p: npt.NDArray[np.float64]) -> _Integers | None:
    """Returns triangles of a polygon (k, 3) as vertex numbers, (k − 2, 3); ``None`` if it intersects itself."""
    normal = _normals(p[None])[0]
    drop = int(np.abs(normal).argmax())
    # Project along the largest normal component, so that the polygon runs counter-clockwise.
    axes = [(1, 2), (2, 0), (0, 1)][drop]
    flat = p[:, axes] * (1.0 if normal[drop] > 0.0 else np.array([-1.0, 1.0]))
    remaining, ears = list(range(len(p))), []
    while len(remaining) > 3:
        ear = _ear(flat[remaining])
        if ear is None:
            return None
        ears.append((remaining[ear - 1], remaining[ear], remaining[(ear + 1) % len(remaining)]))
        del remaining[ear]
    return np.array([*ears, remaining])


def _ear(q: npt.NDArray[np.float64]) -> int | None:
    """Returns the best vertex of a polygon (k, 2) to cut off: convex, with no other vertex in its triangle."""
    before, after = np.roll(q, 1, axis=0), np.roll(q, -1, axis=0)
    area = _cross(q - before, after - q)
    longest = np.square(np.stack((q - before, after - q, before - after))).sum(axis=2).max(axis=0)
    # Prefer fat ears, because thin ones leave slivers.
    for i in np.argsort(-area / np.where(longest > 0.0, longest, 1.0)).tolist():
        if not area[i] > 0.0:
            return None
        a, b, c = before[i], q[i], after[i]
        # Vertices that coincide with the ear's, as where an outline runs along a slit, are not inside.
        others = q[~((q == a).all(axis=1) | (q == b).all(axis=1) | (q == c).all(axis=1))]
        inside = (_cross(b - a, others - a) >= 0) & (_cross(c - b, others - b) >= 0)
        if not (inside & (_cross(a - c, others - c) >= 0)).any():
            return i
    return None


def _cross(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
