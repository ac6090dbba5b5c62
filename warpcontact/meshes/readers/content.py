"""What a reader makes of a file, and how readers of text take numbers and polygons from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.readers.polygons import triangulate
from warpcontact.meshes.readers.unreadable import Unreadable

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass
class Content:
    """What is in a mesh file, before anything is examined.

    Attributes:
        vertices: Positions in the unit of the file, (V, 3).
        faces: Vertex indices of each triangle, (F, 3); they may be out of range.
        groups: Face numbers by the name of the group, ascending.
        unit: Metres per unit, if the file says so.
        unit_warning: What to know if that unit is taken, one sentence.
        warnings: What to know before using it, one sentence each.
        notes: What else there is to say, one sentence each.
    """

    vertices: npt.NDArray[Any]
    faces: Integers
    groups: dict[str, Integers] = field(default_factory=dict)
    unit: float | None = None
    unit_warning: str = ""
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class Groups:
    """Names that faces of a file go under, while it is read.

    A face has the names that are set when it is added; names are set rarely and faces added often.
    """

    def __init__(self) -> None:
        self._runs: list[tuple[int, tuple[str, ...]]] = [(0, ())]

    def set(self, start: int, names: Sequence[str]) -> None:
        """Faces from number ``start`` on have ``names``; empty ones are none."""
        self._runs.append((start, tuple(name for name in names if name)))

    def members(self, count: int, owner: Integers) -> dict[str, Integers]:
        """Returns the triangles of each name, of ``count`` faces; ``owner`` is the face of each triangle."""
        starts = [start for start, _ in self._runs]
        bounds = np.searchsorted(owner, [*starts, count]).tolist()
        spans: dict[str, list[Integers]] = {}
        for (_, names), first, last in zip(self._runs, bounds, bounds[1:], strict=False):
            for name in names if last > first else ():
                spans.setdefault(name, []).append(np.arange(first, last))
        return {name: joined(parts) for name, parts in spans.items()}


def joined(parts: Sequence[Integers]) -> Integers:
    """Returns the face numbers of a group, ascending, from parts that mostly follow each other."""
    members = np.concatenate(parts)
    return members if (members[:-1] < members[1:]).all() else np.unique(members)


def numbers(words: Sequence[bytes], least: int, where: str, kind: Callable[[bytes], Any]) -> list[Any]:
    """Returns at least ``least`` numbers from words.

    Raises:
        Unreadable: If there are fewer; the message begins with ``where``.
    """
    try:
        # Python takes 1_0 for 10.
        values = [] if b"_" in b"".join(words) else [kind(word) for word in words]
    except ValueError:
        values = []
    if len(values) < least:
        text = b" ".join(words)[:80].decode(errors="replace")
        raise Unreadable(f"{where}: {least} or more numbers are needed, got {text!r}")
    return values


def from_polygons(vertices: Floats, counts: Integers, corners: Integers, groups: Groups | None = None) -> Content:
    """Returns the content of a file with polygons, all of three corners or more, as triangles in their order.

    Args:
        vertices: Positions, (V, 3).
        counts: Number of corners of each polygon, (n,).
        corners: Vertex numbers of all of them, one polygon after the other.
        groups: Names that polygons go under.
    """
    faces, owner = triangulate(vertices, counts, corners)
    content = Content(vertices, faces)
    if groups is not None:
        content.groups = groups.members(len(counts), owner)
    if len(faces) != len(counts):
        content.warnings.append(split_warning(len(counts), len(faces)))
    return content


def split_warning(polygons: int, triangles: int) -> str:
    """Returns the sentence on polygons that became triangles."""
    return (
        f"{polygons} faces of the file, some with more than three corners, became {triangles} triangles; "
        "face numbers are those of the triangles"
    )


def lists_as_arrays(rows: list[list[float]], polygons: list[list[int]]) -> tuple[Floats, Integers, Integers]:
    """Returns vertices (V, 3), and number of corners and corners of polygons, from lists."""
    counts = np.fromiter(map(len, polygons), dtype=np.int64, count=len(polygons))
    corners = np.fromiter((i for polygon in polygons for i in polygon), dtype=np.int64, count=int(counts.sum()))
    return np.array(rows, dtype=np.float64).reshape(-1, 3), counts, corners
