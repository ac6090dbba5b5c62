"""Topology and geometry of triangles: vertices, edges and connected parts of a welded surface, and their nesting.

Inputs are not validated; faces must refer to existing vertices.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import bounds, cross, dot, norm

Orientation = Literal["outward", "inward", "open surface", "mixed", "undefined"]

# Boundary vertices closer than this fraction of the largest dimension are assumed to be meant as one. CAD programs
# round the two sides of a seam differently, and float32 resolves 1e-7.
CRACK_LIMIT = 1.0e-6
# A mesh is far from its origin if its largest coordinate exceeds this multiple of its size.
FAR = 4.0
# Directions along which points of lattices rarely coincide [-]; slightly shorter than unit vectors.
SLANTED = np.array(((0.548, 0.448, 0.701), (-0.311, 0.857, -0.404)))
# Largest number of components that are described individually.
MOST_COMPONENTS = 100


@dataclass(frozen=True)
class Component:
    """Part of a surface that is connected across edges.

    Attributes:
        first_face: Lowest of its face numbers.
        face_count: Number of its faces.
        closed: Whether it bounds a volume by itself and is consistently wound.
        volume: Signed volume [m³] if it is closed; negative if its faces are oriented inward.
        inside: Index of the smallest closed component that encloses it, if there is one.
    """

    first_face: int
    face_count: int
    closed: bool
    volume: float | None
    inside: int | None


class Edges:
    """Edges of triangles.

    Half-edge 3·i + j runs from vertex j of face i to the next vertex.

    Args:
        faces: Welded vertex indices of each triangle, (F, 3), three different ones.

    Attributes:
        ends: Vertices of each half-edge, (3F, 2).
        order: Half-edges, grouped by edge, (3F,).
        starts: Index in ``order`` of the first half-edge of each edge, (E,).
        counts: Number of faces of each edge, (E,).
        balance: Number of half-edges that run to the vertex with the higher index, minus the others, (E,).
    """

    def __init__(self, faces: npt.NDArray[np.int64]) -> None:
        self.ends = np.stack((faces, faces[:, [1, 2, 0]]), axis=2).reshape(-1, 2)
        low, high = (end(*self.ends.T) for end in (np.minimum, np.maximum))
        self.order, self.starts = _groups(np.column_stack((low, high)))
        self.counts = np.diff(self.starts, append=len(self.order))
        upward = np.where(self.ends[:, 0] < self.ends[:, 1], 1, -1)
        self.balance = np.add.reduceat(upward[self.order], self.starts)

    @property
    def first(self) -> npt.NDArray[np.intp]:
        """One half-edge of each edge, (E,)."""
        return self.order[self.starts]

    @property
    def halves(self) -> npt.NDArray[np.intp]:
        """Two half-edges of each edge, (E, 2); the second is arbitrary for a boundary edge."""
        return np.column_stack((self.first, np.roll(self.order, -1)[self.starts]))

    @property
    def links(self) -> npt.NDArray[np.intp]:
        """Pairs of half-edges that connect all half-edges of each edge, (n, 2)."""
        edge = np.repeat(np.arange(len(self.starts)), self.counts)
        return np.column_stack((self.order[:-1], self.order[1:]))[edge[:-1] == edge[1:]]

    def fans(self, faces: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
        """Returns the number of fans at each vertex, (V,): groups of its faces connected across edges."""
        half = np.arange(3 * len(faces))
        after = half - half % 3 + (half + 1) % 3
        upward = self.ends[:, 0] < self.ends[:, 1]
        low, high = np.where(upward, half, after), np.where(upward, after, half)
        links = self.links
        fans, fan = components(np.concatenate((low[links], high[links])), 3 * len(faces))
        vertex = np.empty(fans, dtype=np.int64)
        vertex[fan] = faces.reshape(-1)
        return np.bincount(vertex)


def examine_surface(
    v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[dict[str, Any], npt.NDArray[np.bool], npt.NDArray[np.intp]]:
    """Returns topology, size and orientation of a welded surface without degenerate or repeated faces.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3), three different ones.

    Returns:
        Facts by field name of ``MeshReport``, empty if there are no faces; which edges are wound inconsistently,
        (E,); two half-edges of each edge, (E, 2), as in ``Edges``.
    """
    if not len(faces):
        return {}, np.zeros(0, dtype=bool), np.empty((0, 2), dtype=np.intp)
    edges = Edges(faces)
    ends, counts, balance, first = edges.ends, edges.counts, edges.balance, edges.first
    parts, part = components(edges.links // 3, len(faces))
    lower, upper = bounds(v[faces])
    loops, cracks = _boundary(v, ends[first[counts == 1]], CRACK_LIMIT * float((upper - lower).max()))

    area, volumes, zero_volume = volumes_of(v, faces, part, parts)
    odd, mixed = counts % 2 == 1, (counts % 2 == 0) & (balance != 0)
    bounding = np.ones(parts, dtype=bool)
    bounding[part[first[odd | mixed] // 3]] = False
    total = float(volumes.sum())
    orientation: Orientation = "undefined"
    if mixed.any():
        orientation = "mixed"
    elif odd.any():
        orientation = "open surface"
    elif abs(total) > zero_volume:
        orientation = "outward" if total > 0.0 else "inward"
    lengths = norm(v[ends[first, 0]] - v[ends[first, 1]])
    facts = {
        "edge_count": len(counts),
        "area": area,
        "volume": None if (odd | mixed).any() else total,
        "closed": not odd.any(),
        "boundary_edge_count": int((counts == 1).sum()),
        "boundary_loop_count": loops,
        "crack_vertex_count": cracks,
        "component_count": parts,
        "components": _describe(v, faces, part, bounding, volumes),
        "inward_component_count": int((bounding & (volumes < -zero_volume)).sum()),
        "outward_component_count": int((bounding & (volumes > zero_volume)).sum()),
        "orientation": orientation,
        "non_manifold_edge_count": int((counts > 2).sum()),
        "non_manifold_vertex_count": int((edges.fans(faces) > 1).sum()),
        "euler_number": int((np.bincount(faces.reshape(-1)) > 0).sum()) - len(counts) + len(faces),
        "shortest_edge": float(lengths.min()),
        "longest_edge": float(lengths.max()),
    }
    return facts, (counts == 2) & (balance != 0), edges.halves


def volumes_of(
    v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64], part: npt.NDArray[np.integer], parts: int
) -> tuple[float, npt.NDArray[np.float64], float]:
    """Returns area, signed volume of each part of a surface, and the rounding error of a zero volume.

    Args:
        v: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3).
        part: Part of each triangle, (F,).
        parts: Number of parts.

    Returns:
        The area [m²]; the volumes (parts,) [m³], meaningful for closed parts only; the error bound [m³].
    """
    lower, upper = bounds(v[faces])
    p = v[faces] - 0.5 * (lower + upper)  # centered for precision
    normals = area_vectors(p)
    area = 0.5 * float(norm(normals).sum())
    pyramids = dot(normals, p[:, 0]) / 6.0
    volumes = np.bincount(part, pyramids, parts).astype(np.float64)
    return area, volumes, 1e-12 * area * float(np.abs(p).max())


def _describe(
    v: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    part: npt.NDArray[np.int32],
    closed: npt.NDArray[np.bool],
    volumes: npt.NDArray[np.float64],
) -> tuple[Component, ...]:
    """Returns the first ``MOST_COMPONENTS`` components, in the order of their first faces."""
    first = np.unique(part, return_index=True)[1]  # components are numbered by their first faces
    counts = np.bincount(part)
    containing = find_containing_parts(v, faces, part, closed)
    return tuple(
        Component(
            first_face=int(first[i]),
            face_count=int(counts[i]),
            closed=bool(closed[i]),
            volume=float(volumes[i]) if closed[i] else None,
            inside=containing.get(i),
        )
        for i in range(min(len(first), MOST_COMPONENTS))
    )


def _boundary(v: npt.NDArray[np.float64], edges: npt.NDArray[np.intp], near: float) -> tuple[int, int]:
    """Returns numbers of loops of boundary edges (n, 2), and of their vertices with another one within ``near``."""
    vertices, links = np.unique(edges, return_inverse=True)
    if not len(edges):
        return 0, 0
    return components(links.reshape(-1, 2), len(vertices))[0], int(has_near_neighbor(v[vertices], near).sum())


def has_near_neighbor(points: npt.NDArray[np.float64], near: float) -> npt.NDArray[np.bool]:
    """Returns whether another one of the points (n, 3) is within distance ``near`` of each."""
    # Near points are near along any direction. Few others are near along two directions, and if none are left, the
    # import of the tree, which takes as long as building a model, is avoided.
    found = np.arange(len(points))
    for direction in SLANTED:
        along = (points[found] - points[:1]) @ direction  # relative to one point, to reduce rounding
        order = np.argsort(along)
        close = np.diff(along[order]) <= near
        one = np.zeros(len(found), dtype=bool)
        one[order[1:][close]] = one[order[:-1][close]] = True
        found = found[one]
    if len(found):
        from scipy.spatial import KDTree

        distances, _ = KDTree(points[found]).query(points[found], k=2, distance_upper_bound=near)
        found = found[np.isfinite(distances[:, 1])]
    has_neighbor = np.zeros(len(points), dtype=bool)
    has_neighbor[found] = True
    return has_neighbor


def components(links: npt.NDArray[np.intp], count: int) -> tuple[int, npt.NDArray[np.int32]]:
    """Returns connected parts of ``count`` items with links (n, 2).

    Returns:
        Number of parts, and part of each item; parts are numbered by their first items.
    """
    part = np.arange(count)
    a, b = links.T
    # Each round joins every part that has a lower neighbor. A part lower than all its neighbors is joined in the next
    # round, unless one was joined to it. So two rounds leave at most half of the parts that have neighbors.
    while len(a):
        np.minimum.at(part, np.maximum(a, b), np.minimum(a, b))
        while ((lowest := part[part]) != part).any():
            part = lowest
        a, b = part[a], part[b]
        apart = a != b
        a, b = a[apart], b[apart]
    first = part == np.arange(count)
    return int(first.sum()), (np.cumsum(first) - 1)[part].astype(np.int32)


def weld(vertices: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
    """Returns the first vertex at exactly the same position, for each vertex.

    Args:
        vertices: Positions, (V, 3) [m]. A vertex with a NaN coincides with no other.

    Returns:
        Index of the representative vertex, (V,).
    """
    return representatives(vertices).astype(np.int32)


def representatives(rows: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """Returns the index of the first row equal to each row.

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
    """Returns a stable order that groups equal rows, and the index in it at which each group starts."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order, np.flatnonzero(new)


def area_vectors(corners: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns vectors (n, 3) along the normals of triangles (n, 3, 3), with twice their areas as lengths."""
    return cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def slenderness(corners: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns the shape of triangles as |cross|/Σe²: 0 for a point or line, at most 0.29.

    Args:
        corners: Vertices of each triangle, (n, 3, 3); the result has their precision.

    Returns:
        Ratios, (n,).
    """
    a, b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], corners[:, 2] - corners[:, 1]
    squares = dot(a, a) + dot(b, b) + dot(c, c)
    return norm(cross(a, b)) / np.where(squares > 0.0, squares, 1.0)


def seen_from(lower: npt.NDArray[np.float64], upper: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the origin relative to which float32 resolves a surface within these bounds.

    The origin is the center of the bounds if the surface is far from the origin of its frame, and otherwise zero, so
    that coordinates are not rounded.
    """
    far = np.abs([lower, upper]).max() > FAR * (upper - lower).max()
    return 0.5 * (lower + upper) if far else np.zeros(3)


def angles(corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the angles of triangles at their vertices [rad].

    Normals weighted with these angles do not depend on the triangulation of a flat side.

    Args:
        corners: Vertices of each triangle, (n, 3, 3), none degenerate.

    Returns:
        Angles, (n, 3).
    """
    after = np.roll(corners, -1, axis=1) - corners
    after /= norm(after)[..., None]
    before = -np.roll(after, 1, axis=1)
    return np.arctan2(norm(cross(after, before)), dot(after, before))


def directions(sums: npt.NDArray[np.float64], instead: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns unit vectors along sums of weighted unit normals.

    Args:
        sums: Vectors, (…, 3).
        instead: Replacement for sums of almost zero length, as between two sheets back to back; broadcast to the
            shape of ``sums``.
    """
    length = norm(sums)[..., None]
    valid = length > 1.0e-9
    found: npt.NDArray[np.float64] = sums / np.where(valid, length, 1.0)
    return found if valid.all() else np.where(valid, found, np.broadcast_to(instead, sums.shape))


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
