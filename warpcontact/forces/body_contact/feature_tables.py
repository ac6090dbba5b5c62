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
    names = ("corner", "neighbor", "plane_neighbor", "edge", "face_edge", "face_plane", "plane_face", "box_plane")
    columns: dict[str, list[NDArray[np.int32]]] = {name: [] for name in names}
    counts: dict[str, list[NDArray[np.int64]]] = {
        name: [] for name in ("corner", "neighbor", "plane_neighbor", "edge", "plane", "outline", "plane_outline")
    }
    # Outlines: those of all faces, and after them those of planes with several faces.
    face_outlines: list[NDArray[np.int32]] = []
    merged: list[NDArray[np.int32]] = []
    plane_outlines: list[NDArray[np.int32]] = []
    sharp_end, is_convex = [], []
    face_total = sum(
        count if geometry is None else len(geometry.faces)
        for geometry, count in zip(geometries, face_counts, strict=True)
    )
    vertex_count, edge_count, face_count, plane_count = 1, 0, 0, 0
    counts["neighbor"].append(np.zeros(1, dtype=np.int64))
    for geometry, face_count_without in zip(geometries, face_counts, strict=True):
        own = PolyhedronFeatures.without_edges(face_count_without)
        faces, vertices = np.full((face_count_without, 4), -1, dtype=np.int32), 0
        if geometry is not None:
            own, faces, vertices = PolyhedronFeatures.of(geometry), geometry.faces, len(geometry.vertices)
        ends = np.array([vertex_count, vertex_count, face_count, face_count], dtype=np.int32)
        columns["edge"].append(np.where(own.edges >= 0, own.edges + ends, -1))
        columns["corner"].append(own.corners + vertex_count)
        columns["face_edge"].append(np.where(own.face_edges >= 0, own.face_edges + edge_count, -1))
        columns["face_plane"].append(own.face_planes + plane_count)
        columns["box_plane"].append(np.where(own.box_planes >= 0, own.box_planes + plane_count, -1))
        in_planes = np.argsort(own.face_planes, kind="stable").astype(np.int32)
        columns["plane_face"].append(in_planes + face_count)
        faces_of_planes = np.bincount(own.face_planes)
        both_ways = np.concatenate([own.edges[:, :2], own.edges[:, 1::-1]])[: None if own.is_convex else 0]
        columns["neighbor"].append(both_ways[np.argsort(both_ways[:, 0], kind="stable"), 1] + vertex_count)
        counts["neighbor"].append(np.bincount(both_ways[:, 0], minlength=vertices))
        # Planes on both sides of an edge, each pair once.
        beside = own.face_planes[own.edges[:, 2:]][: None if own.is_convex else 0]
        beside = beside[beside[:, 0] != beside[:, 1]]
        beside = np.unique(np.concatenate([beside, beside[:, ::-1]]), axis=0)
        columns["plane_neighbor"].append(beside[:, 1] + plane_count)
        counts["plane_neighbor"].append(np.bincount(beside[:, 0], minlength=len(faces_of_planes)))
        used = faces >= 0
        face_outlines.append(np.stack([faces[used] + vertex_count, own.face_edges[used] + edge_count]))
        counts["outline"].append(used.sum(axis=1))
        outlines = np.split(in_planes + face_count, np.cumsum(faces_of_planes))[:-1]
        for plane, outline in own.outlines.items():
            outlines[plane] = np.array([face_total + len(merged)], dtype=np.int32)
            merged.append(outline + np.array([[vertex_count], [edge_count]], dtype=np.int32))
        plane_outlines += outlines
        counts["plane_outline"].append(np.array([len(one) for one in outlines]))
        counts["corner"].append(np.array([len(own.corners)]))
        counts["edge"].append(np.array([len(own.edges)]))
        counts["plane"].append(faces_of_planes)
        is_convex.append(int(own.is_convex))
        sharp_end.append(edge_count + own.sharp_count)
        vertex_count += vertices
        edge_count += len(own.edges)
        face_count += len(faces)
        plane_count += len(faces_of_planes)
    counts["outline"].append(np.array([one.shape[1] for one in merged], dtype=np.int64))
    tables = {name: np.concatenate(parts) for name, parts in columns.items()}
    tables["outline_vertex"], tables["outline_edge"] = np.concatenate([*face_outlines, *merged], axis=1)
    tables["plane_outline"] = np.concatenate([np.zeros(0, dtype=np.int32), *plane_outlines])
    for name, numbers in counts.items():
        tables[f"{name}_start"] = np.concatenate([[0], np.cumsum(np.concatenate(numbers))])
    tables |= {"sharp_end": np.array(sharp_end), "is_convex": np.array(is_convex)}
    features = Features()
    for name, variable in Features.vars.items():
        layout.constant(purpose, features, name, tables[name], variable.type.dtype)
    return features
