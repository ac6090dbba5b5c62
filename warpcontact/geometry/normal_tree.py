"""Trees over normals of convex polyhedra, by which kernels find the planes and edges above which a point may be highest.

A plane with the normal n and the offset d is the point (n, d) of four dimensions; a convex edge is the arc of the points (n, n·p)
for all n between the normals of its faces and a point p of the edge. The height n·x − d of a point x above those in a box of
four dimensions has a bound by the corners of the box.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.geometry.face_tree import box_tree
from warpcontact.validation.checks import Array

# Largest number of planes or edges of a leaf.
_LEAF = 4
# Margin of the boxes, larger than the rounding of normals, for a polyhedron of size 1 about the origin; and the rounding of arcs
# between orthogonal normals.
_MARGIN, _ROUNDING = 1e-12, 1e-15


@dataclass(frozen=True, eq=False)
class NormalTree:
    """A binary tree of boxes of normals and offsets.

    Attributes:
        order: Planes or edges in the order of the leaves, (N,).
        nodes: First of the two children, which are consecutive, or −1 for a leaf; first item; end of its items; (M, 3). The first
            node is the root.
        lower: Smallest components of normals, and smallest offset, (M, 4).
        upper: Largest ones, (M, 4).
    """

    order: NDArray[np.int32]
    nodes: NDArray[np.int32]
    lower: Array
    upper: Array

    @classmethod
    def of_planes(cls, normals: Array, offsets: Array, *, single: bool) -> "NormalTree":
        """Returns the tree of planes with unit normals (N, 3) and offsets (N,); ``single``: as one leaf."""
        points = np.concatenate([normals, offsets[:, None]], axis=1)
        return cls._of_boxes(points, points, single=single)

    @classmethod
    def of_edges(cls, positions: Array, first: Array, second: Array, *, single: bool) -> "NormalTree":
        """Returns the tree of convex edges.

        Args:
            positions: A point of each edge, (N, 3).
            first: Unit normals of their first faces, (N, 3).
            second: Unit normals of their second faces, (N, 3).
            single: Whether the tree is one leaf.
        """
        ends = [np.concatenate([n, np.einsum("ij,ij->i", n, positions)[:, None]], axis=1) for n in (first, second)]
        lower, upper = np.minimum(*ends), np.maximum(*ends)
        # A component cos θ a + sin θ b along the arc, with its angle θ from the first normal, is extreme at tan θ = b/a.
        cosine = np.einsum("ij,ij->i", first, second)[:, None]
        sine = np.linalg.norm(np.cross(first, second), axis=1)[:, None]
        across = (ends[1] - cosine * ends[0]) / sine
        angle = np.arctan2(sine, cosine)
        extreme = np.hypot(ends[0], across)
        at = np.arctan2(across, ends[0])
        upper = np.where((at > 0.0) & (at < angle), extreme, upper)
        opposite = np.where(at > 0.0, at - np.pi, at + np.pi)
        lower = np.where((opposite > 0.0) & (opposite < angle), -extreme, lower)
        margin = _ROUNDING / sine * np.abs(np.concatenate(ends)).max(axis=0, initial=0.0)
        return cls._of_boxes(lower - margin, upper + margin, single=single)

    @classmethod
    def _of_boxes(cls, lower: Array, upper: Array, *, single: bool) -> "NormalTree":
        size = max(float(np.abs([lower[:, 3], upper[:, 3]]).max(initial=0.0)), np.finfo(float).tiny)
        unit = np.array([1.0, 1.0, 1.0, size])
        # Normals and offsets count alike when items are halved.
        leaf = len(lower) if single else _LEAF
        order, nodes, low, high = box_tree(lower / unit, upper / unit, 0.5 * (lower + upper) / unit, leaf, _MARGIN)
        return cls(order, nodes, low * unit, high * unit)
