"""Features of polyhedra: edges with their faces, and planes, by which contact points are identified."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.geometry.polyhedron import Polyhedron

#: Largest number of planes of a convex solid whose planes and edges are all compared; others are treated as meshes.
MAX_CONVEX_PLANES = 2000
#: Largest number of vertices of the outline of a plane; the faces of others are treated one by one.
MAX_OUTLINE = 48
# Sine of the angle between two faces, below which their edge is flat.
_FLAT = 1e-9


@dataclass(frozen=True, eq=False)
class PolyhedronFeatures:
    """Features of a polyhedron.

    Attributes:
        corners: Vertices of faces, (N,).
        edges: Two vertices and two faces of each edge, convex ones first, (E, 4). The edge runs from the first to the second
            vertex in the first face. The second face is −1 at a boundary.
        sharp_count: Number of convex edges.
        face_edges: Edges of each face, the first from its first to its second vertex, (F, 4); the last of a triangle is −1.
        face_planes: Plane of each face, (F,).
        is_convex: Whether ``has_convex_features`` holds.
        box_planes: Planes of a box on both sides of each axis, (6,); −1 if the polyhedron is no box with the axes of its frame.
        outlines: Vertices and following edges of the outline of each plane with several faces, (2, N), by plane. Only of convex
            polyhedra, and outlines of at most ``MAX_OUTLINE`` vertices.
    """

    corners: NDArray[np.int32]
    edges: NDArray[np.int32]
    sharp_count: int
    face_edges: NDArray[np.int32]
    face_planes: NDArray[np.int32]
    is_convex: bool
    box_planes: NDArray[np.int32]
    outlines: dict[int, NDArray[np.int32]]

    @classmethod
    def without_edges(cls, count: int) -> "PolyhedronFeatures":
        """Returns the features of a half-space or a curved solid: ``count`` faces without vertices."""
        nothing = np.zeros(0, dtype=np.int32)
        face_edges = np.full((count, 4), -1, dtype=np.int32)
        edges, planes = np.zeros((0, 4), dtype=np.int32), np.arange(count, dtype=np.int32)
        return cls(nothing, edges, 0, face_edges, planes, False, np.full(6, -1, dtype=np.int32), {})

    @classmethod
    def of(cls, polyhedron: Polyhedron) -> "PolyhedronFeatures":
        """Returns the features of a polyhedron."""
        faces = polyhedron.faces
        counts = (faces >= 0).sum(axis=1)
        starts = np.where(np.arange(4) < counts[:, None], faces, -1)
        ends = np.take_along_axis(faces, (np.arange(4) + 1) % counts[:, None], axis=1)
        own = np.argwhere(starts >= 0)
        start, end = starts[starts >= 0], ends[starts >= 0]
        # Both directions of an edge have the same key.
        keys = np.stack([np.minimum(start, end), np.maximum(start, end)], axis=1)
        _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        number = number.reshape(-1)
        edges = np.full((len(first), 4), -1, dtype=np.int32)
        edges[:, 0], edges[:, 1], edges[:, 2] = start[first], end[first], own[first, 0]
        other = np.setdiff1d(np.arange(len(own)), first)
        edges[number[other], 3] = own[other, 0]
        sharp = _is_convex(polyhedron, edges)
        order = np.argsort(~sharp, kind="stable")
        renumbered = np.empty(len(order), dtype=np.int32)
        renumbered[order] = np.arange(len(order), dtype=np.int32)
        face_edges = np.full(faces.shape, -1, dtype=np.int32)
        face_edges[own[:, 0], own[:, 1]] = renumbered[number]
        corners = np.unique(faces[faces >= 0]).astype(np.int32)
        sharp_count = int(sharp.sum())
        planes, box_planes = polyhedron.face_planes, _box_planes(polyhedron)
        is_convex = has_convex_features(polyhedron)
        outlines = _outlines(polyhedron, face_edges) if is_convex else {}
        return cls(corners, edges[order], sharp_count, face_edges, planes, is_convex, box_planes, outlines)


def has_convex_features(polyhedron: Polyhedron) -> bool:
    """Returns whether a polyhedron is convex with at most ``MAX_CONVEX_PLANES`` planes, all next to their neighbors.

    Searches from plane to plane need an edge between each pair of neighbors.
    """
    few = len(polyhedron.plane_faces) <= MAX_CONVEX_PLANES
    return few and polyhedron.is_convex and polyhedron.has_paired_edges


def _outlines(polyhedron: Polyhedron, face_edges: NDArray[np.int32]) -> dict[int, NDArray[np.int32]]:
    """Returns vertices and following edges of the outline of each plane with several faces, (2, N), by plane."""
    outlines = {}
    planes = polyhedron.face_planes
    for plane in np.flatnonzero(np.bincount(planes) > 1):
        own = np.flatnonzero(planes == plane)
        # Edges of the outline are those of one face of the plane.
        edges, counts = np.unique(face_edges[own][face_edges[own] >= 0], return_counts=True)
        following = {}
        for face in own:
            count = int((polyhedron.faces[face] >= 0).sum())
            for i in range(count):
                if counts[np.searchsorted(edges, face_edges[face, i])] == 1:
                    start, end = polyhedron.faces[face, i], polyhedron.faces[face, (i + 1) % count]
                    following[int(start)] = int(end), int(face_edges[face, i])
        vertex = next(iter(following))
        outline: list[tuple[int, int]] = []
        while vertex in following and len(outline) <= len(following):
            outline.append((vertex, following[vertex][1]))
            vertex = following[vertex][0]
            if vertex == outline[0][0]:
                break
        # A single closed loop through all of these edges.
        if len(outline) == len(following) and vertex == outline[0][0] and len(outline) <= MAX_OUTLINE:
            outlines[int(plane)] = np.array(outline, dtype=np.int32).T
    return outlines


def _box_planes(polyhedron: Polyhedron) -> NDArray[np.int32]:
    """Returns the planes of a box, (6,); −1 if a polyhedron is no box with the axes of its frame."""
    normals = polyhedron.planes()[0][polyhedron.plane_faces]
    planes = np.full(6, -1, dtype=np.int32)
    if len(normals) == 6 and polyhedron.is_convex:
        axes = np.abs(normals).argmax(axis=1)
        exact = np.eye(3)[axes] * np.sign(normals[np.arange(6), axes])[:, None]
        numbers = 2 * axes + (normals[np.arange(6), axes] > 0.0)
        if np.array_equal(np.abs(normals), np.abs(exact)) and len(np.unique(numbers)) == 6:
            planes[numbers] = np.arange(6)
    return planes


def _is_convex(polyhedron: Polyhedron, edges: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Returns whether each edge has two faces that form a convex angle."""
    normals = polyhedron.planes()[0]
    along = polyhedron.vertices[edges[:, 1]] - polyhedron.vertices[edges[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    turns = np.einsum("ij,ij->i", np.cross(normals[edges[:, 2]], normals[edges[:, 3]]), along)
    return (edges[:, 3] >= 0) & (turns > _FLAT)
