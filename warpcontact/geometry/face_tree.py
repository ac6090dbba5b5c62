"""Trees of bounding boxes over the faces of polyhedra, which kernels of body contact traverse."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array

# Largest number of faces of a leaf.
LEAF_FACES = 8
# Margin of the boxes relative to the size of the polyhedron, larger than the rounding of queries.
_MARGIN = 1e-10


@dataclass(frozen=True, eq=False)
class FaceTree:
    """A binary tree of bounding boxes.

    Attributes:
        order: Number of each face before it was sorted by leaves, (F,).
        nodes: First of the two children, which are consecutive, or −1 for a leaf; first face; end of its faces; (N, 3). The
            first node is the root.
        lower: Smallest coordinates, (N, 3).
        upper: Largest coordinates, (N, 3).
    """

    order: NDArray[np.int32]
    nodes: NDArray[np.int32]
    lower: Array
    upper: Array

    @classmethod
    def from_faces(cls, vertices: Array, faces: NDArray[np.int32]) -> "FaceTree":
        """Returns the tree of faces, (F, 4), with the last vertex of a triangle −1: halves by the median of centers."""
        corners = vertices[np.where(faces >= 0, faces, faces[:, :1])]
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        centers = 0.5 * (lower + upper)
        margin = _MARGIN * float((upper.max(axis=0) - lower.min(axis=0)).max())
        return cls(*box_tree(lower, upper, centers, LEAF_FACES, margin))


def box_tree(
    lower: Array, upper: Array, centers: Array, leaf: int, margin: float
) -> tuple[NDArray[np.int32], NDArray[np.int32], Array, Array]:
    """Returns a binary tree of boxes, halved by the median of their centers: order, nodes, lower and upper as in ``FaceTree``.

    Args:
        lower: Smallest coordinates of the items, (N, D).
        upper: Their largest coordinates, (N, D).
        centers: Coordinates by which they are halved, along the axis of the largest extent, (N, D).
        leaf: Largest number of items of a leaf.
        margin: Margin of the boxes of nodes.
    """
    order = np.arange(len(lower), dtype=np.int32)
    nodes = [[-1, 0, len(lower)]]
    boxes: list[tuple[Array, Array]] = []
    for node in nodes:
        _, first, end = node
        own = order[first:end]
        boxes.append((lower[own].min(axis=0) - margin, upper[own].max(axis=0) + margin))
        if end - first <= leaf:
            continue
        axis = int(np.argmax(np.ptp(centers[own], axis=0)))
        order[first:end] = own[np.argsort(centers[own, axis], kind="stable")]
        middle = (first + end) // 2
        node[0] = len(nodes)
        nodes += [[-1, first, middle], [-1, middle, end]]
    low, high = (np.array(side) for side in zip(*boxes, strict=True))
    return order, np.array(nodes, dtype=np.int32), low, high
