"""Separation of a curved solid of ``convex_separation.SIZES`` from a convex polyhedron, by dense sampling of directions.

Maxima of the separation are at normals of faces and flat ends, along the arcs between normals of adjacent faces, along the circles of
normals of straight lines of the curved solid, or between these. All are sampled, and the best ones refined.
"""

import numpy as np
from convex_separation import ridges, support

REFINEMENTS, STARTS, SHRINK = 34, 4, 0.55


class PolyhedronSeparation:
    """Separation of curved solids from one convex polyhedron at the origin.

    Args:
        vertices: Vertices (n, 3) [m].
        faces: Triangles with outward normals (m, 3).
    """

    def __init__(self, vertices, faces):
        self.vertices = np.asarray(vertices)
        corners = self.vertices[np.asarray(faces)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.normals = normals / np.linalg.norm(normals, axis=1)[:, None]
        owner = {}
        for number, face in enumerate(faces):
            for i in range(3):
                owner[int(face[i]), int(face[(i + 1) % 3])] = number
        pairs = [(owner[a, b], owner[b, a]) for a, b in owner if a < b]
        self.arcs = self.normals[np.array(pairs)]
        self.arcs = self.arcs[np.einsum("ij,ij->i", self.arcs[:, 0], self.arcs[:, 1]) < 1.0 - 1e-12]

    def along(self, kind, position, rotation, n):
        """Returns the separations along unit vectors out of the polyhedron, (count, 3) → (count,) [m]."""
        return n @ position - support(kind, -(n @ rotation)) - (n @ self.vertices.T).max(axis=1)

    def of_faces(self, kind, position, rotation):
        """Returns the largest separation along the normals of faces and flat ends, and this normal."""
        ends = rotation[:, 2:].T * {"cylinder": [[1], [-1]], "cone": [[1]]}.get(kind, np.zeros((0, 1)))
        directions = np.concatenate([self.normals, ends.reshape(-1, 3)])
        values = self.along(kind, position, rotation, directions)
        return values.max(), directions[values.argmax()]

    def largest(self, kind, position, rotation):
        """Returns the largest separation over all directions [m], and this direction."""

        def gaps(n):
            return self.along(kind, position, rotation, n)

        normal = self.of_faces(kind, position, rotation)[1]
        found = [normal]
        fractions = np.linspace(0.0, 1.0, 33)
        arcs = unit(self.arcs[:, :1] + fractions[:, None] * (self.arcs[:, 1:] - self.arcs[:, :1]))
        on_arcs = gaps(arcs.reshape(-1, 3)).reshape(arcs.shape[:2])
        for arc in np.argsort(-on_arcs.max(axis=1))[:6]:
            start, end = self.arcs[arc]
            center, width = fractions[on_arcs[arc].argmax()], 1 / 32
            for _ in range(REFINEMENTS):
                trial = np.clip(center + width * np.linspace(-1, 1, 9), 0.0, 1.0)
                center = trial[gaps(unit(start + trial[:, None] * (end - start))).argmax()]
                width *= SHRINK
            found.append(unit(start + center * (end - start)))
        for circle in ridges(kind):
            angles, width = np.linspace(0.0, 2.0 * np.pi, 721), np.pi / 360
            for _ in range(REFINEMENTS):
                best = angles[gaps(-circle(angles) @ rotation.T).argmax()]
                angles = best + width * np.linspace(-1, 1, 9)
                width *= SHRINK
            found.append(-circle(np.array([best]))[0] @ rotation.T)
        # Smooth maxima, and those where an arc crosses a circle.
        free = unit(np.random.default_rng(0).normal(size=(1000, 3)))
        starts = np.concatenate([free, found, arcs.reshape(-1, 3)])
        best = []
        for i in np.argsort(-gaps(starts)):
            if all(starts[i] @ one < 0.98 for one in best):
                best.append(starts[i])
            if len(best) == STARTS:
                break
        steps = np.linspace(-1.0, 1.0, 7)
        grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        for start in best:
            center, width = start, 0.1
            for _ in range(REFINEMENTS):
                plane = np.linalg.svd(center[None])[2][1:]
                trial = unit(center + width * grid @ plane)
                center = trial[gaps(trial).argmax()]
                width *= SHRINK
            found.append(center)
        values = gaps(np.array(found))
        return values.max(), found[values.argmax()]


def unit(vectors):
    """Returns vectors divided by their lengths."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
