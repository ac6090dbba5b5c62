"""Bounding volume hierarchy (BVH) over the faces of a query mesh, with eight branches per node.

A bounding volume is a flat cylinder ("disk") whose axis is the mean normal of its faces. On smooth surfaces it is
thin, unlike axis-aligned boxes on inclined surfaces. ``kernels/lowlevel/bvh8.py`` searches the BVH on a
CPU; GPUs use the queries of ``wp.Mesh``. On a CPU these give bitwise identical results, but a step of the benchmark
scenes takes 5 to 16 % more processor time: see *Distance cache* in ``docs/scheduling.md``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.validation.checks import Array

#: Branches per node.
BRANCHES = 8
#: Numbers of a bounding disk: center (3), radius, unit normal (3), half the thickness.
BOUND = 8
# Maximum number of points to bound a branch with; with more, the corners of boxes around its parts are used.
MAX_POINTS = 24
# Number of branches bounded together, so that temporary arrays fit into the cache.
BATCH = 4096


@dataclass(frozen=True)
class FaceBvh:
    """A complete BVH: all leaves are at the same depth.

    Attributes:
        width: Number of branches of the root, at most 8. Nodes are numbered level by level from the root. The
            branches of node i are 8 i + width − 7 and following; numbers beyond the last node are leaves (faces).
        faces: Face numbers of the leaves, less than twice the number of faces. Entries not below the number of faces
            are empty.
        bounds: Bounding disks (nodes, 8 numbers, 8 branches); NaN for empty branches.
    """

    width: int
    faces: NDArray[np.int32]
    bounds: NDArray[np.float32]


def node_count(faces: int) -> int:
    """Returns the number of nodes of a BVH over a number of faces."""
    width, levels = _shape(faces)
    return 1 + width * (BRANCHES**levels - 1) // (BRANCHES - 1)


def face_capacity(faces: int) -> int:
    """Returns the number of leaves of a BVH over a number of faces."""
    width, levels = _shape(faces)
    return width * BRANCHES**levels


def _shape(faces: int) -> tuple[int, int]:
    """Returns the number of branches of the root, and the number of node levels below it."""
    levels = 0
    while BRANCHES ** (levels + 1) < faces:
        levels += 1
    return -(-faces // BRANCHES**levels), levels


def build_bvh(corner: NDArray[np.float64], normal: NDArray[np.float64]) -> FaceBvh:
    """Returns the BVH over faces with vertices ``corner`` (F, 3, 3) and unit normals (F, 3)."""
    count = len(corner)
    width, levels = _shape(count)
    order = _split_faces(((corner[:, 0] + corner[:, 1] + corner[:, 2]) / 3.0).T, width, levels)
    empty, filled = order >= count, order.clip(max=count - 1)
    # Error bound of vertices in float32.
    rounding = 2.0 * float(np.finfo(np.float32).eps) * float(np.abs(corner).max())
    points = np.ascontiguousarray(corner[filled].transpose(2, 1, 0))  # (3, K, N)
    normals = np.ascontiguousarray(normal[filled].T)  # (3, N)
    bounds: list[NDArray[np.float32]] = []
    while len(bounds) <= levels:
        if bounds:
            # One level up: merge eight branches.
            points = (
                points.reshape(3, points.shape[1], -1, BRANCHES)
                .swapaxes(2, 3)
                .reshape(3, BRANCHES * points.shape[1], -1)
            )
            normals = normals.reshape(3, -1, BRANCHES).sum(axis=2)
            empty = np.logical_and.reduce(empty.reshape(-1, BRANCHES), axis=1)
        parts = [slice(k, k + BATCH) for k in range(0, len(empty), BATCH)]
        boxed = BRANCHES * points.shape[1] > MAX_POINTS
        own = [
            _bounding_disks(np.ascontiguousarray(points[:, :, part]), normals[:, part], rounding, boxed)
            for part in parts
        ]
        disks = np.concatenate([part for part, _ in own], axis=1)
        disks[:, empty] = np.nan
        missing = -len(empty) % BRANCHES
        disks = np.pad(disks, ((0, 0), (0, missing)), constant_values=np.nan)
        bounds.append(disks.reshape(BOUND, -1, BRANCHES).swapaxes(0, 1))
        if boxed:
            points = np.concatenate([boxes for _, boxes in own], axis=2)
    return FaceBvh(width, order.astype(np.int32), np.concatenate(bounds[::-1]))


def _split_faces(middle: Array, width: int, levels: int) -> NDArray[np.intp]:
    """Returns face numbers in the order of the leaves, for faces with centroids ``middle`` (3, F).

    Branches are split at the median along the axis of largest extent. Empty leaves have numbers from F on.
    """
    count = middle.shape[1]
    order = np.arange(width * BRANCHES**levels)
    # Empty leaves get the position of the last face, so that they are close to it.
    middle = np.ascontiguousarray(middle[:, order.clip(max=count - 1)].astype(np.float32))
    parts = 1
    # The order of branches in a node of the last level does not matter, so it is not sorted.
    for branches in (width, *[2] * (3 * (levels - 1))) if levels else ():
        own = middle[:, order].reshape(3, parts, -1)
        # NumPy reduces along the first axis of many short parts faster than along a short last axis.
        across = np.ascontiguousarray(own.swapaxes(1, 2))
        axis = np.ptp(across, axis=1).argmax(axis=0)
        along = own[axis, np.arange(parts)]
        if branches > 1:
            cuts = along.shape[1] // branches * np.arange(1, branches)
            turn = np.argpartition(along, cuts, axis=1)
            order = np.take_along_axis(order.reshape(parts, -1), turn, axis=1).ravel()
        parts *= branches
    return order


def _bounding_disks(points: Array, normals: Array, off: float, boxed: bool) -> tuple[NDArray[np.float32], Array]:
    """Returns bounding disks (8, N) of points (3, K, N) and, if ``boxed``, corners (3, 8, N) of bounding boxes."""
    length = np.sqrt((normals**2).sum(axis=0))
    normal = np.where(length > 0.0, normals / np.where(length > 0.0, length, 1.0), [[0.0], [0.0], [1.0]])
    # Two axes perpendicular to the normal, from the coordinate axis with its smallest component.
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=0)].T, axis=0)
    first /= np.sqrt((first**2).sum(axis=0))
    axes = (first, np.cross(normal, first, axis=0), normal)
    along = [_dot(points, axis) for axis in axes]
    low, high = [one.min(axis=0) for one in along], [one.max(axis=0) for one in along]
    centre = np.zeros_like(normal)
    corners = np.zeros((3, 8, normal.shape[1] if boxed else 0))
    for j, axis in enumerate(axes):
        centre += 0.5 * (low[j] + high[j]) * axis
        for k in range(8 if boxed else 0):
            corners[:, k] += (high if k >> j & 1 else low)[j] * axis
    centre = centre.astype(np.float32)
    away = points - centre.astype(np.float64)[:, None]
    height = _dot(away, normal)
    lateral = np.sqrt(np.maximum(_dot(away, away) - height**2, 0.0).max(axis=0))
    widened = [(1.0 + 1e-6) * bound + off for bound in (lateral, np.abs(height).max(axis=0))]
    # The normal is not widened; the traversal accounts for its rounding.
    return np.concatenate([centre, widened[:1], normal, widened[1:]]).astype(np.float32), corners


def _dot(points: Array, axis: Array) -> Array:
    """Returns dot products (K, N) of points (3, K, N) with axes (3, N) or (3, K, N)."""
    return np.asarray(sum(points[i] * axis[i] for i in range(3)))


def declare_bvhs(
    counts: Sequence[int],
    build: Callable[[], list[FaceBvh]],
    search_meshes: Sequence[int],
    model: Any,
    layout: AllocationPlan,
) -> None:
    """Declares the BVHs of the query meshes of ``model``, on a CPU; empty arrays on a GPU.

    Args:
        counts: Number of faces of each search mesh.
        build: Returns the BVH of each search mesh.
        search_meshes: For each query mesh, the number of its search mesh.
        model: Struct that gets the arrays.
        layout: Allocation plan to which they are added.
    """
    if not layout.device.is_cpu:
        counts = ()
    nodes = np.cumsum([0, *map(node_count, counts)])
    places = np.cumsum([0, *map(face_capacity, counts)])
    rows = [(nodes[k], nodes[k + 1] - nodes[k], _shape(counts[k])[0], places[k]) for k in search_meshes if counts]
    layout.constant("surfaces", model, "query_mesh_bvh", np.array(rows).reshape(-1, 4), wp.vec4i)

    def make(_: int) -> None:
        bvhs = build() if counts else []
        none = FaceBvh(0, np.zeros(0, dtype=np.int32), np.zeros((0, BOUND, BRANCHES), dtype=np.float32))
        bounds = np.concatenate([tree.bounds for tree in (none, *bvhs)]).ravel()
        faces = np.concatenate([tree.faces for tree in (none, *bvhs)])
        model.bvh_bound = wp.array(bounds, dtype=wp.float32, device=layout.device)
        model.bvh_face = wp.array(faces, dtype=wp.int32, device=layout.device)

    layout.custom("surfaces", int(4 * (BOUND * BRANCHES * nodes[-1] + places[-1])), make)
