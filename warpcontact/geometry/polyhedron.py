"""Polyhedra: meshes as convex faces of up to four vertices, on which the columns of body contacts stand."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from warpcontact.geometry.face_tree import FaceTree
from warpcontact.meshes import Mesh
from warpcontact.validation.checks import Array

# Distance from a plane, and deviation from a straight edge, relative to the size of the mesh, below which vertices are
# on it. Coordinates in float32 are not merged: their faces are exact as triangles.
_TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """A polyhedron with convex faces of three or four vertices.

    Attributes:
        vertices: Vertices, (V, 3), in the unit of the mesh.
        faces: Vertices of each face, counter-clockwise as seen from outside, (F, 4); the last of a triangle is −1.
        plane_faces: The first face of each group of connected faces in one plane, (P,).
        face_planes: The group of each face, (F,).
        is_closed: Whether it has no boundary.
        tree: Tree of the faces, in whose order they are.
    """

    vertices: Array
    faces: NDArray[np.int32]
    plane_faces: NDArray[np.int32]
    face_planes: NDArray[np.int32]
    is_closed: bool
    tree: FaceTree

    @classmethod
    def from_faces(
        cls,
        vertices: Array,
        faces: NDArray[np.int32],
        plane_faces: NDArray[np.int32],
        *,
        is_closed: bool,
    ) -> "Polyhedron":
        """Returns the polyhedron of convex faces, sorted by the leaves of their tree; those of a plane are consecutive."""
        tree = FaceTree.from_faces(vertices, faces)
        sorted_number = np.empty(len(faces), dtype=np.int32)
        sorted_number[tree.order] = np.arange(len(faces), dtype=np.int32)
        planes = np.searchsorted(plane_faces, tree.order, side="right").astype(np.int32) - 1
        return cls(vertices, faces[tree.order], sorted_number[plane_faces], planes, is_closed, tree)

    @classmethod
    def from_mesh(cls, mesh: Mesh) -> "Polyhedron":
        """Returns the polyhedron of a mesh. Coplanar triangles are merged, in pairs if the union of all is not convex."""
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        triangles = np.asarray(mesh.welded)[np.asarray(mesh.faces)]
        is_closed = mesh.report.closed
        normals = _unit_normals(vertices, triangles)
        offsets = np.einsum("ij,ij->i", normals, vertices[triangles[:, 0]])
        size = float(np.ptp(vertices, axis=0).max())
        polygons: list[Sequence[int]] = []
        plane_faces = []
        for group in _coplanar_groups(vertices, triangles, normals, offsets, _TOLERANCE * size):
            plane_faces.append(len(polygons))
            if len(group) == 1:
                polygons.append(triangles[group[0]])
                continue
            flat, normal, tolerance = triangles[group], normals[group[0]], _TOLERANCE * size
            outline = _convex_outline(vertices, flat, normal, tolerance)
            if outline is None:
                polygons += _merged_pairs(vertices, flat, normal, tolerance)
            else:
                polygons += _quadrilaterals(outline)
        faces = np.full((len(polygons), 4), -1, dtype=np.int32)
        for row, polygon in zip(faces, polygons, strict=True):
            row[: len(polygon)] = polygon
        planes = np.array(plane_faces, dtype=np.int32)
        return cls.from_faces(vertices, faces, planes, is_closed=is_closed)

    @classmethod
    def unit_box(cls) -> "Polyhedron":
        """Returns the cube |x|, |y|, |z| ≤ 1."""
        vertices = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
        faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        planes = np.arange(6, dtype=np.int32)
        return cls.from_faces(vertices, np.array(faces, dtype=np.int32), planes, is_closed=True)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Smallest and largest coordinates, (3,) each."""
        used = self.vertices[np.unique(self.faces[self.faces >= 0])]
        return used.min(axis=0), used.max(axis=0)

    @cached_property
    def is_convex(self) -> bool:
        """Whether it is closed and convex; takes time and memory in proportion to the product of planes and vertices."""
        if not self.is_closed:
            return False
        normals, _, offsets = (values[self.plane_faces] for values in self.planes())
        used = self.vertices[np.unique(self.faces[self.faces >= 0])]
        heights = used @ normals.T - offsets
        return bool(heights.max() <= _TOLERANCE * np.ptp(used, axis=0).max())

    @cached_property
    def has_paired_edges(self) -> bool:
        """Whether each edge belongs to two faces; not if a vertex of one face is within an edge of another one."""
        counts = (self.faces >= 0).sum(axis=1)
        ends = np.take_along_axis(self.faces, (np.arange(4) + 1) % counts[:, None], axis=1)
        used = np.arange(4) < counts[:, None]
        edges = np.sort(np.stack([self.faces[used], ends[used]], axis=1), axis=1)
        return bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())

    def planes(self) -> tuple[Array, Array, Array]:
        """Returns unit normals (F, 3), unit vectors along the first edges (F, 3), and offsets along the normals (F,)."""
        first, second = (self.vertices[self.faces[:, i]] for i in range(2))
        along = second - first
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # Area vector of the corners: exact for triangles, and not sensitive to a nearly straight corner.
        corners = self.vertices[np.where(self.faces >= 0, self.faces, self.faces[:, :1])] - first[:, None]
        normals = np.cross(corners, np.roll(corners, -1, axis=1)).sum(axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return normals, along, np.einsum("ij,ij->i", normals, first)


def _unit_normals(vertices: Array, triangles: NDArray[np.int32]) -> Array:
    first, second, third = (vertices[triangles[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    lengths: Array = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0.0, lengths, 1.0)


def _coplanar_groups(
    vertices: Array, triangles: NDArray[np.int32], normals: Array, offsets: Array, tolerance: float
) -> list[list[int]]:
    """Returns groups of triangles that are connected by edges and in one plane, in order of their first triangle."""
    neighbors = _coplanar_neighbors(vertices, triangles, normals, offsets, tolerance)
    seen = np.zeros(len(triangles), dtype=bool)
    groups = []
    for start in range(len(triangles)):
        if seen[start]:
            continue
        seen[start] = True
        group, normal, offset = [start], normals[start], offsets[start]
        for number in group:
            for other in neighbors.get(number, ()):
                if seen[other] or normals[other] @ normal <= 0.0:
                    continue
                if np.abs(vertices[triangles[other]] @ normal - offset).max() <= tolerance:
                    seen[other] = True
                    group.append(other)
        groups.append(sorted(group))
    return groups


def _coplanar_neighbors(
    vertices: Array, triangles: NDArray[np.int32], normals: Array, offsets: Array, tolerance: float
) -> dict[int, list[int]]:
    """Returns the triangles that have an edge in common with each triangle and may be in its plane."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owners = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort(edges.T)
    edges, owners = edges[order], owners[order]
    neighbors = defaultdict(list)
    # Triangles of one edge are consecutive. More than two may have it in common.
    for distance in range(1, len(edges)):
        same = (edges[distance:] == edges[:-distance]).all(axis=1)
        if not same.any():
            break
        first, second = owners[:-distance][same], owners[distance:][same]
        heights = np.einsum("ijk,ik->ij", vertices[triangles[second]], normals[first]) - offsets[first, None]
        # Twice the tolerance: a group has the plane of its first triangle.
        flat = (np.abs(heights).max(axis=1) <= 2.0 * tolerance) & (
            np.einsum("ij,ij->i", normals[first], normals[second]) > 0.0
        )
        for one, other in zip(first[flat].tolist(), second[flat].tolist(), strict=True):
            neighbors[one].append(other)
            neighbors[other].append(one)
    return neighbors


def _convex_outline(
    vertices: Array, triangles: NDArray[np.int32], normal: Array, tolerance: float
) -> list[int] | None:
    """Returns the corners of the union of coplanar triangles; ``None``: it is not convex, or has holes."""
    following: dict[int, int] = {}
    directed = {(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)}
    for start, end in directed:
        if (end, start) not in directed:
            if start in following:
                return None
            following[start] = end
    if not following:
        return None
    loop = [min(following)]
    while (after := following.get(loop[-1])) != loop[0]:
        # Faces that overlap or touch at a vertex have no simple outline.
        if after is None or len(loop) == len(following):
            return None
        loop.append(after)
    if len(loop) != len(following):
        return None
    points = vertices[loop]
    previous, subsequent = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    lengths = np.linalg.norm(subsequent - previous, axis=1)
    # Distances of the corners from the lines of their neighbors.
    heights = np.cross(points - previous, subsequent - points) @ normal / np.maximum(lengths, tolerance)
    if heights.min() < -tolerance:
        return None
    corners = [vertex for vertex, height in zip(loop, heights, strict=True) if height > tolerance]
    return corners if len(corners) >= 3 else None


def _merged_pairs(
    vertices: Array, triangles: NDArray[np.int32], normal: Array, tolerance: float
) -> list[list[int]]:
    """Returns the corners of coplanar triangles, merged in pairs with a convex union across their longest edges."""
    owners = defaultdict(list)
    rows = triangles.tolist()
    edges = [[(row[i], row[(i + 1) % 3]) for i in range(3)] for row in rows]
    for number, sides in enumerate(edges):
        for side in sides:
            owners[frozenset(side)].append(number)
    is_done = np.zeros(len(rows), dtype=bool)
    polygons = []
    for number, sides in enumerate(edges):
        if is_done[number]:
            continue
        is_done[number] = True
        polygon = rows[number]
        lengths = [-float(np.linalg.norm(vertices[start] - vertices[end])) for start, end in sides]
        for index in np.argsort(lengths, kind="stable"):
            others = [other for other in owners[frozenset(sides[index])] if not is_done[other]]
            unions = (
                (other, _convex_outline(vertices, triangles[[number, other]], normal, tolerance))
                for other in others
            )
            found = next(((other, union) for other, union in unions if union is not None), None)
            if found is not None:
                is_done[found[0]] = True
                polygon = found[1]
                break
        polygons.append(polygon)
    return polygons


def _quadrilaterals(outline: list[int]) -> list[list[int]]:
    """Returns a convex polygon divided into quadrilaterals and triangles, the middle one first.

    Those at the outline have three edges of it, those next to them have three edges of what remains, and so on. So each meets few
    parts of another polygon that is divided likewise; all parts around one corner would meet each other.
    """
    parts = []
    while len(outline) > 4:
        closed = [*outline, outline[0]]
        parts += [part for i in range(0, len(outline), 3) if len(part := closed[i : i + 4]) > 2]
        outline = outline[::3]
    if len(outline) > 2:
        parts.append(outline)
    return parts[::-1]
