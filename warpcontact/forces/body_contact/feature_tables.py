"""Device tables of the features of solids: vertices, edges and planes, by which points of manifolds are identified."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.geometry.normal_tree import NormalTree
from warpcontact.geometry.polyhedron import Polyhedron
from warpcontact.geometry.polyhedron_features import PolyhedronFeatures
from warpcontact.kernels.manifolds.features import Features

if TYPE_CHECKING:
    from warpcontact.storage.allocation_plan import AllocationPlan


def declare_features(
    geometries: Sequence[Polyhedron | None], face_counts: Sequence[int], layout: "AllocationPlan", purpose: str
) -> tuple[Features, int]:
    """Declares the features of geometries; ``None`` is a half-space or a curved solid.

    Args:
        geometries: The geometries, in the order of their numbers.
        face_counts: Number of faces of those that are no polyhedra: 1 for a half-space, 0 for a curved solid.
        layout: Allocation plan to which the tables are added.
        purpose: Their purpose, for memory estimates.

    Returns:
        The features, and the largest number of corners of an outline.
    """
    names = (
        "corner", "neighbor", "vertex_plane", "edge", "face_edge", "face_plane", "plane_face", "box_plane",
    )  # fmt: skip
    columns: dict[str, list[NDArray[np.int32]]] = {name: [] for name in names}
    counts: dict[str, list[NDArray[np.int64]]] = {
        name: []
        for name in (
            "corner",
            "neighbor",
            "vertex_plane",
            "edge",
            "plane",
            "outline",
            "plane_outline",
        )
    }
    # Outlines: those of all faces, and after them those of planes with several faces.
    face_outlines: list[NDArray[np.int32]] = []
    merged: list[NDArray[np.int32]] = []
    plane_outlines: list[NDArray[np.int32]] = []
    sharp_end, is_convex = [], []
    # Trees of normals with the first of their planes or edges, and the numbers of those of each geometry.
    trees: list[tuple[NormalTree, int]] = []
    roots: list[tuple[int, int]] = []
    face_total = sum(
        count if geometry is None else len(geometry.faces)
        for geometry, count in zip(geometries, face_counts, strict=True)
    )
    vertex_count, edge_count, face_count, plane_count = 1, 0, 0, 0
    for name in ("neighbor", "vertex_plane"):
        counts[name].append(np.zeros(1, dtype=np.int64))
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
        used = faces >= 0
        at_vertices = np.stack([faces[used], own.face_planes[np.nonzero(used)[0]]], axis=1)
        at_vertices = np.unique(at_vertices[: None if own.is_convex else 0], axis=0)
        columns["vertex_plane"].append(at_vertices[:, 1] + plane_count)
        counts["vertex_plane"].append(np.bincount(at_vertices[:, 0], minlength=vertices))
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
        roots.append((len(trees), len(trees) + 1) if own.is_convex else (-1, -1))
        if geometry is not None and own.is_convex:
            planes_tree, edges_tree = _normal_trees(geometry, own)
            trees += [(planes_tree, plane_count), (edges_tree, edge_count)]
        sharp_end.append(edge_count + own.sharp_count)
        vertex_count += vertices
        edge_count += len(own.edges)
        face_count += len(faces)
        plane_count += len(faces_of_planes)
    counts["outline"].append(np.array([one.shape[1] for one in merged], dtype=np.int64))
    tables: dict[str, NDArray[Any]] = {name: np.concatenate(parts) for name, parts in columns.items()}
    tables["outline_vertex"], tables["outline_edge"] = np.concatenate([*face_outlines, *merged], axis=1)
    tables["plane_outline"] = np.concatenate([np.zeros(0, dtype=np.int32), *plane_outlines])
    for name, numbers in counts.items():
        tables[f"{name}_start"] = np.concatenate([[0], np.cumsum(np.concatenate(numbers))])
    tables |= {"sharp_end": np.array(sharp_end), "is_convex": np.array(is_convex)}
    tables |= _tables_of_trees(trees, roots)
    features = Features()
    for name, variable in Features.vars.items():
        layout.constant(purpose, features, name, tables[name], variable.type.dtype)
    return features, max((one.max() for one in counts["outline"] if len(one)), default=0)


def _normal_trees(geometry: Polyhedron, own: PolyhedronFeatures) -> tuple[NormalTree, NormalTree]:
    """Returns the trees of the planes and of the convex edges of a convex polyhedron."""
    # Boxes may have different scales along their axes, which the bounds of several nodes do not allow for.
    single = bool(own.box_planes[0] >= 0)
    normals = geometry.planes()[0]
    center = 0.5 * (geometry.bounds[0] + geometry.bounds[1])
    edges = own.edges[: own.sharp_count]
    in_planes = normals[geometry.plane_faces]
    on_planes = geometry.vertices[geometry.faces[geometry.plane_faces, 0]] - center
    planes = NormalTree.of_planes(in_planes, np.einsum("ij,ij->i", in_planes, on_planes), single=single)
    positions = geometry.vertices[edges[:, 0]] - center
    return planes, NormalTree.of_edges(positions, normals[edges[:, 2]], normals[edges[:, 3]], single=single)


def _tables_of_trees(
    trees: Sequence[tuple[NormalTree, int]], roots: Sequence[tuple[int, int]]
) -> dict[str, NDArray[Any]]:
    """Returns the tables of trees of normals.

    Args:
        trees: The trees, and the first plane or edge of their geometry.
        roots: Numbers of the trees of planes and of edges of each geometry; −1: none.
    """
    nodes: list[NDArray[Any]] = [np.zeros((0, 3), dtype=np.int64)]
    items: list[NDArray[Any]] = [np.zeros(0, dtype=np.int64)]
    starts = [0]
    for tree, first in trees:
        count = sum(len(one) for one in items)
        inner = tree.nodes[:, :1] >= 0
        moved = np.where(inner, tree.nodes[:, :1] + starts[-1], -1)
        nodes.append(np.concatenate([moved, tree.nodes[:, 1:] + count], axis=1))
        items.append(tree.order + first)
        starts.append(starts[-1] + len(tree.nodes))
    numbers = np.array([*starts[:-1], -1])[np.array(roots).reshape(-1, 2)]
    empty = np.zeros((0, 4))
    return {
        "normal_node": np.concatenate(nodes),
        "normal_item": np.concatenate(items),
        "normal_lower": np.concatenate([empty, *(tree.lower for tree, _ in trees)]),
        "normal_upper": np.concatenate([empty, *(tree.upper for tree, _ in trees)]),
        "plane_root": numbers[:, 0],
        "edge_root": numbers[:, 1],
    }
