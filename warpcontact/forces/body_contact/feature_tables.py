"""Device tables of the features of solids: vertices, edges and planes, by which points of manifolds are identified."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.geometry.polyhedron import Polyhedron
from warpcontact.geometry.polyhedron_features import PolyhedronFeatures
from warpcontact.kernels.manifolds.features import Features

if TYPE_CHECKING:
    from warpcontact.storage.allocation_plan import AllocationPlan


def declare_features(
    geometries: Sequence[Polyhedron | None], face_counts: Sequence[int], layout: "AllocationPlan", purpose: str
) -> Features:
    """Declares the features of geometries; ``None`` is a half-space or a curved solid.

    Args:
        geometries: The geometries, in the order of their numbers.
        face_counts: Number of faces of those that are no polyhedra: 1 for a half-space, 0 for a curved solid.
        layout: Allocation plan to which the tables are added.
        purpose: Their purpose, for memory estimates.
    """
    columns: dict[str, list[NDArray[np.int32]]] = {
        name: [] for name in ("corner", "edge", "face_edge", "face_plane", "plane_face", "box_plane")
    }
    starts: dict[str, list[int]] = {
        "corner_start": [0],
        "edge_start": [0],
        "plane_start": [0],
        "sharp_end": [],
    }
    starts["is_convex"] = []
    vertex_count, face_count, plane_count = 1, 0, 0
    for geometry, face_count_without in zip(geometries, face_counts, strict=True):
        edge_count = starts["edge_start"][-1]
        if geometry is None:
            own = PolyhedronFeatures.without_edges(face_count_without)
        else:
            own = PolyhedronFeatures.of(geometry)
        faces = len(own.face_planes)
        edges = own.edges + np.array([vertex_count, vertex_count, face_count, face_count], dtype=np.int32)
        columns["edge"].append(np.where(own.edges >= 0, edges, -1))
        columns["corner"].append(own.corners + vertex_count)
        columns["face_edge"].append(np.where(own.face_edges >= 0, own.face_edges + edge_count, -1))
        columns["face_plane"].append(own.face_planes + plane_count)
        columns["box_plane"].append(np.where(own.box_planes >= 0, own.box_planes + plane_count, -1))
        columns["plane_face"].append(np.argsort(own.face_planes, kind="stable").astype(np.int32) + face_count)
        ends = face_count + np.cumsum(np.bincount(own.face_planes))
        starts["plane_start"] += ends.tolist()
        starts["is_convex"].append(int(own.is_convex))
        starts["corner_start"].append(starts["corner_start"][-1] + len(own.corners))
        starts["edge_start"].append(edge_count + len(own.edges))
        starts["sharp_end"].append(edge_count + own.sharp_count)
        vertex_count += 0 if geometry is None else len(geometry.vertices)
        face_count += faces
        plane_count += len(ends)
    features = Features()
    tables = {name: np.concatenate(parts) for name, parts in columns.items()} | starts
    for name, variable in Features.vars.items():
        layout.constant(purpose, features, name, tables[name], variable.type.dtype)
    return features
