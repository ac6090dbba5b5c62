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
        order = np.arange(len(faces), dtype=np.int32)
        nodes = [[-1, 0, len(faces)]]
        boxes: list[tuple[Array, Array]] = []
        for node in nodes:
            _, first, end = node
            own = order[first:end]
            boxes.append((lower[own].min(axis=0) - margin, upper[own].max(axis=0) + margin))
            if end - first <= LEAF_FACES:
                continue
            axis = int(np.argmax(np.ptp(centers[own], axis=0)))
            order[first:end] = own[np.argsort(centers[own, axis], kind="stable")]
            middle = (first + end) // 2
            node[0] = len(nodes)
            nodes += [[-1, first, middle], [-1, middle, end]]
        return cls(order, np.array(nodes, dtype=np.int32), *(np.array(side) for side in zip(*boxes, strict=True)))
