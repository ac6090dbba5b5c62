"""Locations of the defects of a mesh that its report counts."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.examine import COORDINATE_LIMIT, SLIVER_LIMIT
from warpcontact.meshes.overlap import intersections
from warpcontact.meshes.topology import (
    CRACK_LIMIT,
    Edges,
    has_near_neighbor,
    representatives,
    slenderness,
    volumes_of,
)

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Defects:
    """Defects: faces as masks over all faces, (F,); edges as vertex indices, (n, 2); and vertices, (n,).

    Topology is that of the report: of the welded surface and its valid faces.
    """

    drawable: Mask  # all vertices exist, are finite and near
    degenerate: Mask
    duplicate: Mask
    inward: Mask  # faces of closed parts with inward orientation
    cutting: Mask  # faces that intersect others, or overlap them in a plane
    boundary: npt.NDArray[np.int64]
    non_manifold: npt.NDArray[np.int64]
    inconsistent: npt.NDArray[np.int64]
    pinched: npt.NDArray[np.int64]  # vertices at which parts of the surface meet in a single point
    cracks: npt.NDArray[np.int64]  # boundary vertices that nearly coincide with another one


def find_defects(vertices: npt.NDArray[np.float64], faces: npt.NDArray[Any], *, cuts: bool = True) -> Defects:
    """Returns the defects of any arrays (V, 3) and (F, 3), usable as a mesh or not.

    ``cuts``: whether to search for intersecting faces, the slowest part.
    """
    near: Mask = np.all(np.abs(vertices) <= COORDINATE_LIMIT, axis=1)  # false for NaN
    in_range: Mask = np.all((faces >= 0) & (faces < len(vertices)), axis=1)
    index = np.where(in_range[:, None], faces, 0).astype(np.int64)
    drawable: Mask = in_range & np.all(near[index], axis=1)
    degenerate = np.zeros(len(faces), dtype=bool)
    degenerate[drawable] = slenderness(vertices[index[drawable]]) < SLIVER_LIMIT

    corners = representatives(vertices)[index]
    valid_faces = np.flatnonzero(drawable & (corners != corners[:, [1, 2, 0]]).all(axis=1))
    duplicate = np.zeros(len(faces), dtype=bool)
    first = representatives(np.sort(corners[valid_faces], axis=1))
    duplicate[valid_faces] = np.bincount(first, minlength=len(valid_faces))[first] > 1
    # A copy in the opposite direction counts as a separate face, as in the report.
    rotated = (corners[valid_faces].argmin(axis=1)[:, None] + np.arange(3)) % 3
    valid_faces = valid_faces[
        representatives(np.take_along_axis(corners[valid_faces], rotated, axis=1)) == np.arange(len(valid_faces))
    ]

    ends = np.stack((corners[valid_faces], corners[valid_faces][:, [1, 2, 0]]), axis=2).reshape(-1, 2)
    edge = representatives(np.sort(ends, axis=1))
    count = np.bincount(edge, minlength=len(edge))
    balance = np.bincount(edge, np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0), len(edge))
    inward = np.zeros(len(faces), dtype=bool)
    inward[valid_faces] = _inward(vertices, corners[valid_faces], edge, (count % 2 == 1) | (balance != 0.0))
    boundary, seamed = ends[count == 1], np.zeros(0, dtype=np.int64)
    pinched, cutting = seamed, np.zeros(len(faces), dtype=bool)
    if len(valid_faces):
        boundary_vertices = np.unique(boundary)
        size = float(np.ptp(vertices[corners[valid_faces]], axis=(0, 1)).max())
        seamed = boundary_vertices[has_near_neighbor(vertices[boundary_vertices], CRACK_LIMIT * size)]
        pinched = np.flatnonzero(Edges(corners[valid_faces]).fans(corners[valid_faces]) > 1)
        proper_faces = valid_faces[~degenerate[valid_faces]]
        pairs = intersections(vertices, corners[proper_faces]) if cuts else None
        if pairs is not None:
            cutting[proper_faces[np.unique(pairs)]] = True
    return Defects(
        drawable=drawable,
        degenerate=degenerate,
        duplicate=duplicate,
        inward=inward,
        cutting=cutting,
        boundary=boundary,
        non_manifold=ends[count > 2],
        inconsistent=ends[(count == 2) & (balance != 0.0)],
        pinched=pinched,
        cracks=seamed,
    )


def _inward(
    vertices: npt.NDArray[np.float64],
    corners: npt.NDArray[np.int64],
    edge: npt.NDArray[np.intp],
    open_edge: Mask,
) -> Mask:
    """Returns the faces of connected parts that are closed and have a negative volume.

    Args:
        vertices: Positions, (V, 3).
        corners: Vertices of each face, (F, 3).
        edge: First half-edge of the same edge, for each half-edge, (3 F,).
        open_edge: Whether an edge is a boundary or inconsistent, by its first half-edge, (3 F,).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(corners):
        return np.zeros(0, dtype=bool)
    half = np.arange(len(edge))
    links = coo_array((np.ones(len(edge), dtype=bool), (half // 3, edge // 3)), shape=(len(corners),) * 2)
    parts, part = connected_components(links, directed=False)
    _, volume, zero_volume = volumes_of(vertices, corners, part, parts)
    bounding = np.ones(parts, dtype=bool)
    bounding[part[half[open_edge[edge]] // 3]] = False
    return (bounding & (volume < -zero_volume))[part]
