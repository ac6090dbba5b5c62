"""Joins the transformed parts of a scene into one mesh."""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.content import Content, Integers, Unreadable, joined


class Parts:
    """Collector of parts.

    Args:
        most_faces: Largest number of triangles. A small file can instance one part many times.
    """

    def __init__(self, most_faces: int) -> None:
        self.most_faces = most_faces
        self._vertices: list[npt.NDArray[np.float64]] = []
        self._faces: list[Integers] = []
        self._groups: dict[str, list[Integers]] = {}
        self._vertex_count = self._face_count = 0

    def add(
        self,
        label: str,
        vertices: npt.NDArray[np.number],
        faces: Integers,
        matrix: npt.NDArray[np.float64],
        *,
        names: Iterable[str] = (),
        groups: Iterable[tuple[str, Integers]] = (),
        flip: bool = False,
    ) -> None:
        """Adds a part.

        Args:
            label: Name of the part in messages.
            vertices: Positions in its own frame, (V, 3).
            faces: Vertex indices of its triangles, (F, 3).
            matrix: Transform (4, 4) to the world, for column vectors.
            names: Groups that all of its faces belong to.
            groups: Further groups, with face numbers in this part.
            flip: Whether its faces run clockwise as seen from outside.
        """
        self._face_count += len(faces)
        self._vertex_count += len(vertices)
        if max(self._face_count, self._vertex_count / 3) > self.most_faces:
            raise too_many(self._face_count, self.most_faces)
        if ((faces < 0) | (faces >= len(vertices))).any():
            # After joining, these indices would silently refer to another part.
            raise Unreadable(f"part {label!r} has a face with an index outside its {len(vertices)} vertices")
        points = np.asarray(vertices, dtype=np.float64)
        if not np.array_equal(matrix, np.eye(4)):
            with np.errstate(all="ignore"):  # the examination reports overflow
                points = points @ matrix[:3, :3].T + matrix[:3, 3]
                # A mirroring transform inverts the part; reversing the winding restores its orientation.
                flip ^= bool(np.linalg.det(matrix[:3, :3]) < 0.0)
        first = self._face_count - len(faces)
        for name, members in (*((name, np.arange(len(faces))) for name in names), *groups):
            self._groups.setdefault(name, []).append(members + first)
        self._faces.append((faces[:, ::-1] if flip else faces) + (self._vertex_count - len(vertices)))
        self._vertices.append(points)

    def content(self) -> Content:
        """Returns all parts joined."""
        return Content(
            np.concatenate((np.empty((0, 3)), *self._vertices)),
            np.concatenate((np.empty((0, 3), dtype=np.int64), *self._faces)),
            {name: joined(members) for name, members in self._groups.items()},
        )


def too_many(count: int, most: int) -> Unreadable:
    """Returns the error for a mesh with too many triangles."""
    return Unreadable(f"the file has {count} triangles or more; allowed: {most}, see Limits")
