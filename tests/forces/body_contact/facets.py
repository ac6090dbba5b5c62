"""Separations of two convex meshes along the normals of their planes and normal to all pairs of their edges, by projection."""

import numpy as np
from scipy.spatial import ConvexHull

#: Distance from the extreme, relative to the size, up to which a vertex is extreme along a direction.
EXTREME = 1e-10


class Convex:
    """The hull of vertices (count, 3): its edges with the normals of both faces, and its planes."""

    def __init__(self, vertices):
        hull = ConvexHull(vertices)
        self.vertices = np.asarray(vertices)[hull.vertices]
        renumbered = np.full(len(vertices), -1)
        renumbered[hull.vertices] = np.arange(len(hull.vertices))
        self.size = np.ptp(self.vertices, axis=0).max()
        normals, own = hull.equations[:, :3], hull.simplices
        # Simplices in one plane have one normal.
        self.planes = []
        for normal in normals:
            if not any(np.abs(normal - one).max() < 1e-7 for one in self.planes):
                self.planes.append(normal)
        self.planes = np.array(self.planes)
        edges = {}
        for face, corners in enumerate(own):
            for i in range(3):
                edges.setdefault(frozenset(renumbered[[corners[i], corners[i - 1]]]), []).append(face)
        ends, beside = [], []
        for pair, (one, other) in edges.items():
            if np.linalg.norm(np.cross(normals[one], normals[other])) > 1e-7:
                ends.append(sorted(pair))
                beside.append((normals[one], normals[other]))
        self.edges, self.beside = np.array(ends), np.array(beside)


def separations_of_planes(first, second, position, rotation):
    """Returns separations along the normals of the planes of two meshes, and these normals, out of the second one.

    Args:
        first: The first mesh.
        second: The second one, at the origin.
        position: Position of the first one (3,) [m].
        rotation: Its rotation matrix (3, 3).
    """
    placed = first.vertices @ rotation.T + position
    normals = np.concatenate([second.planes, -first.planes @ rotation.T])
    return separations_along(placed, second.vertices, normals), normals


def separations_along(first, second, normals):
    """Returns separations of vertices (count, 3) along unit vectors (n, 3) out of the second ones, (n,) [m]."""
    return (first @ normals.T).min(axis=0) - (second @ normals.T).max(axis=0)


def separations_of_edges(first, second, position, rotation):
    """Returns separations normal to the pairs of edges that both are extreme along their common normal, and these normals.

    Arguments as ``separations_of_planes``.
    """
    placed = first.vertices @ rotation.T + position
    along_1 = placed[first.edges[:, 1]] - placed[first.edges[:, 0]]
    along_2 = second.vertices[second.edges[:, 1]] - second.vertices[second.edges[:, 0]]
    normals = np.cross(along_1[:, None], along_2[None])
    length = np.linalg.norm(normals, axis=2)
    sine = length / np.linalg.norm(along_1, axis=1)[:, None] / np.linalg.norm(along_2, axis=1)
    i, k = np.nonzero(sine > 1e-6)
    normals = normals[i, k] / length[i, k][:, None]
    normals, i, k = np.concatenate([normals, -normals]), np.tile(i, 2), np.tile(k, 2)
    # Most pairs are excluded by one vertex of each mesh that is not on the edge, before all are compared.
    for _ in range(2):
        chosen = _may_be_extreme(first, second, placed, normals, i, k)
        normals, i, k = normals[chosen], i[chosen], k[chosen]
    low, high = placed @ normals.T, second.vertices @ normals.T
    number = np.arange(len(normals))
    is_extreme = low[first.edges[i, 0], number] <= low.min(axis=0) + EXTREME * first.size
    is_extreme &= high[second.edges[k, 0], number] >= high.max(axis=0) - EXTREME * second.size
    return (low.min(axis=0) - high.max(axis=0))[is_extreme], normals[is_extreme]


def _may_be_extreme(first, second, placed, normals, i, k):
    """Returns whether edges are not behind the extreme vertex of a few of the directions."""
    few = normals[:: max(len(normals) // 20, 1)]
    low = np.unique((placed @ few.T).argmin(axis=0))
    high = np.unique((second.vertices @ few.T).argmax(axis=0))
    own_1, own_2 = placed[first.edges[i, 0]], second.vertices[second.edges[k, 0]]
    height_1, height_2 = np.einsum("ij,ij->i", own_1, normals), np.einsum("ij,ij->i", own_2, normals)
    below = (placed[low] @ normals.T).min(axis=0) < height_1 - EXTREME * first.size
    above = (second.vertices[high] @ normals.T).max(axis=0) > height_2 + EXTREME * second.size
    return ~(below | above)
