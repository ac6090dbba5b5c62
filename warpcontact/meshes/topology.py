"""Topology and geometry of triangles: what vertices, edges and parts of a welded surface there are.

Nothing is checked here; faces must refer to vertices that exist.
"""

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Orientation = Literal["outward", "inward", "open surface", "mixed", "undefined"]

# Border vertices closer than this fraction of the largest dimension are meant to be one. CAD programs write
# the two sides of a seam with different rounding, and float32 resolves 1e-7.
CRACK_LIMIT = 1.0e-6


def examine_surface(
    v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[dict[str, Any], npt.NDArray[np.bool], npt.NDArray[np.intp]]:
    """Topology, size and orientation of a welded surface without degenerate or repeated faces.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3), three different ones.

    Returns:
        Facts by name of the field of ``MeshReport``, none if there is no face; which edges are wound
        inconsistently, (E,); two half-edges of every edge, (E, 2). Half-edge 3·i + j runs from corner j of
        face i to the next corner.
    """
    if not len(faces):
        return {}, np.zeros(0, dtype=bool), np.empty((0, 2), dtype=np.intp)
    ends = np.stack((faces, faces[:, [1, 2, 0]]), axis=2).reshape(-1, 2)
    order, starts = _groups(np.sort(ends, axis=1))
    counts = np.diff(starts, append=len(order))
    balance = np.add.reduceat(np.where(ends[:, 0] < ends[:, 1], 1, -1)[order], starts)
    first = order[starts]
    halves = np.column_stack((first, np.roll(order, -1)[starts]))

    edge = np.repeat(np.arange(len(starts)), counts)
    neighbours = np.column_stack((order[:-1], order[1:]))[edge[:-1] == edge[1:]] // 3
    parts, part = _components(neighbours, len(faces))
    loops, cracks = _border(v, ends[first[counts == 1]], CRACK_LIMIT * float(np.ptp(v[faces], axis=(0, 1)).max()))

    p = v[faces] - 0.5 * (v[faces].min(axis=(0, 1)) + v[faces].max(axis=(0, 1)))  # centred for precision
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    area = 0.5 * float(np.linalg.norm(normals, axis=1).sum())
    volumes = np.bincount(part, np.einsum("ij,ij->i", normals, p[:, 0]) / 6.0, parts)
    nothing = 1e-12 * area * float(np.abs(p).max())  # rounding of a volume that is zero
    odd, mixed = counts % 2 == 1, (counts % 2 == 0) & (balance != 0)
    bounding = np.ones(parts, dtype=bool)
    bounding[part[first[odd | mixed] // 3]] = False
    total = float(volumes.sum())
    orientation: Orientation = "undefined"
    if mixed.any():
        orientation = "mixed"
    elif odd.any():
        orientation = "open surface"
    elif abs(total) > nothing:
        orientation = "outward" if total > 0.0 else "inward"
    lengths = np.linalg.norm(v[ends[first, 0]] - v[ends[first, 1]], axis=1)
    facts = {
        "edge_count": len(starts),
        "area": area,
        "volume": None if (odd | mixed).any() else total,
        "closed": not odd.any(),
        "border_edge_count": int((counts == 1).sum()),
        "border_loop_count": loops,
        "crack_vertex_count": cracks,
        "component_count": parts,
        "inward_component_count": int((bounding & (volumes < -nothing)).sum()),
        "orientation": orientation,
        "non_manifold_edge_count": int((counts > 2).sum()),
        "euler_number": len(np.unique(faces)) - len(starts) + len(faces),
        "shortest_edge": float(lengths.min()),
        "longest_edge": float(lengths.max()),
    }
    return facts, (counts == 2) & (balance != 0), halves


def _border(v: npt.NDArray[np.float64], edges: npt.NDArray[np.intp], near: float) -> tuple[int, int]:
    """Number of loops of border edges (n, 2), and of their vertices with another one within ``near``."""
    from scipy.spatial import KDTree

    if not len(edges):
        return 0, 0
    vertices, links = np.unique(edges, return_inverse=True)
    distances, _ = KDTree(v[vertices]).query(v[vertices], k=2, distance_upper_bound=near)
    return _components(links.reshape(-1, 2), len(vertices))[0], int(np.isfinite(distances[:, 1]).sum())


def _components(links: npt.NDArray[np.intp], count: int) -> tuple[int, npt.NDArray[np.int32]]:
    """Number of connected parts of ``count`` items with links (n, 2), and the part of each item."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), dtype=bool), links.T), shape=(count, count))
    return connected_components(graph, directed=False)


def weld(vertices: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
    """First vertex at the same place, for every vertex; the comparison is exact.

    Args:
        vertices: Positions, (V, 3) [m]. One with a NaN coincides with none.

    Returns:
        Index of the representative vertex, (V,).
    """
    return representatives(vertices).astype(np.int32)


def representatives(rows: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """Index of the first row equal to each row.

    Args:
        rows: Rows to compare exactly, (n, k).

    Returns:
        Indices, (n,).
    """
    order, starts = _groups(rows)
    first = np.empty(len(rows), dtype=np.intp)
    first[order] = np.repeat(order[starts], np.diff(starts, append=len(order)))
    return first


def _groups(rows: npt.NDArray[Any]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Order (stable) that brings equal rows together, and where in it each group starts."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order, np.flatnonzero(new)


def slenderness(corners: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Shape of triangles as |cross|/Σe²: 0 for a point or a line, 0.29 at most.

    Args:
        corners: Corners of each triangle, (n, 3, 3); their precision is that of the result.

    Returns:
        Ratios, (n,).
    """
    a, b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], corners[:, 2] - corners[:, 1]
    squares = sum(np.einsum("ij,ij->i", e, e) for e in (a, b, c))
    return np.linalg.norm(np.cross(a, b), axis=1) / np.where(squares > 0.0, squares, 1.0)
