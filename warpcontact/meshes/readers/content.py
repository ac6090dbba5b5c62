"""Content of a mesh file as read, and parsing of numbers and polygons in text files."""

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
    """Content of a mesh file before examination.

    Attributes:
        vertices: Positions in the unit of the file, (V, 3).
        faces: Vertex indices of each triangle, (F, 3); they may be out of range.
        groups: Face numbers by group name, ascending.
        unit: Meters per unit, if given in the file.
        unit_warning: Warning if that unit is used, one sentence.
        warnings: Possible problems, one sentence each.
        notes: Normal properties, one sentence each.
    """

    vertices: npt.NDArray[Any]
    faces: Integers
    groups: dict[str, Integers] = field(default_factory=dict)
    unit: float | None = None
    unit_warning: str = ""
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class Groups:
    """Group names of faces, collected while a file is read.

    A face gets the names that are current when it is added. Names change rarely, so ranges of faces are stored.
    """

    def __init__(self) -> None:
        self._runs: list[tuple[int, tuple[str, ...]]] = [(0, ())]

    def set(self, start: int, names: Sequence[str]) -> None:
        """Sets the names of faces from number ``start`` on; empty names are ignored."""
        self._runs.append((start, tuple(name for name in names if name)))

    def members(self, count: int, owner: Integers) -> dict[str, Integers]:
        """Returns the triangles of each name, given ``count`` faces and the face of each triangle, ``owner``."""
        starts = [start for start, _ in self._runs]
        bounds = np.searchsorted(owner, [*starts, count]).tolist()
        spans: dict[str, list[Integers]] = {}
        for (_, names), first, last in zip(self._runs, bounds, bounds[1:], strict=False):
            for name in names if last > first else ():
                spans.setdefault(name, []).append(np.arange(first, last))
        return {name: joined(parts) for name, parts in spans.items()}


def joined(parts: Sequence[Integers]) -> Integers:
    """Returns the face numbers of a group, ascending, from parts that are mostly in order."""
    members = np.concatenate(parts)
    return members if (members[:-1] < members[1:]).all() else np.unique(members)


def numbers(words: Sequence[bytes], least: int, where: str, kind: Callable[[bytes], Any]) -> list[Any]:
    """Converts words to at least ``least`` numbers.

    Raises:
        Unreadable: If there are fewer, or one is invalid; the message begins with ``where``.
    """
    try:
        # Python accepts 1_0 as 10.
        values = [] if b"_" in b"".join(words) else [kind(word) for word in words]
    except ValueError:
        values = []
    if len(values) < least:
        text = b" ".join(words)[:80].decode(errors="replace")
        raise Unreadable(f"{where}: {least} or more numbers are needed, got {text!r}")
    return values


def from_polygons(vertices: Floats, counts: Integers, corners: Integers, groups: Groups | None = None) -> Content:
    """Returns the content of a file with polygons of at least three vertices, as triangles in their order.

    Args:
        vertices: Positions, (V, 3).
        counts: Number of vertices of each polygon, (n,).
        corners: Vertex indices of all polygons, one polygon after the other.
        groups: Group names of the polygons.
    """
    faces, owner = triangulate(vertices, counts, corners)
    content = Content(vertices, faces)
    if groups is not None:
        content.groups = groups.members(len(counts), owner)
    if len(faces) != len(counts):
        content.warnings.append(split_warning(len(counts), len(faces)))
    return content


def split_warning(polygons: int, triangles: int) -> str:
    """Returns the warning about polygons that were triangulated."""
    return (
        f"{polygons} faces of the file, some with more than three vertices, became {triangles} triangles; "
        "face numbers are those of the triangles"
    )


def lists_as_arrays(rows: list[list[float]], polygons: list[list[int]]) -> tuple[Floats, Integers, Integers]:
    """Returns vertices (V, 3), and number of vertices and vertex indices of polygons, from lists."""
    counts = np.fromiter(map(len, polygons), dtype=np.int64, count=len(polygons))
    corners = np.fromiter((i for polygon in polygons for i in polygon), dtype=np.int64, count=int(counts.sum()))
    return np.array(rows, dtype=np.float64).reshape(-1, 3), counts, corners
