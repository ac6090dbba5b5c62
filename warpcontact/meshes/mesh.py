"""Oriented triangle mesh, named groups of its faces, and length units of mesh files.

Arrays are validated, so that Warp can use them safely.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property, partial
from math import inf, nan
from numbers import Real
from os import PathLike
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.meshes.examine import examine
from warpcontact.meshes.report import MeshReport, flipped, with_inherited_warnings
from warpcontact.meshes.topology import weld
from warpcontact.validation.safe_text import SafeTextError

#: Selection of faces: a mask (F,) or face numbers; names of groups; or a function that takes the centroids
#: (F, 3) [m], in the frame of the mesh, and returns a mask. ``None``: all.
FaceChoice = npt.ArrayLike | str | Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | None


class Faces(Protocol):
    """Triangles with named groups."""

    @property
    def vertices(self) -> npt.NDArray[np.float64]:
        """Positions, (V, 3) [m]."""

    @property
    def faces(self) -> npt.NDArray[Any]:
        """Vertex indices of each triangle, (F, 3)."""

    @property
    def groups(self) -> Mapping[str, npt.NDArray[Any]]:
        """Face numbers by group name."""


def checked_groups(groups: Mapping[str, npt.ArrayLike] | None, count: int) -> Mapping[str, npt.NDArray[np.int32]]:
    """Returns groups of a mesh with ``count`` faces as ascending read-only arrays.

    Raises:
        ValueError: If a name is not a non-empty string, or a face number is out of range.
    """
    checked: dict[str, npt.NDArray[np.int32]] = {}
    for name, members in (groups or {}).items():
        if not isinstance(name, str) or not name:
            raise ValueError(f"a group must have a non-empty string for a name, got {name!r}")
        checked[name] = _numbers(f"groups[{name!r}]", members, count)
        checked[name].flags.writeable = False
    return MappingProxyType(checked)


def face_mask(label: str, choice: FaceChoice, mesh: Faces) -> npt.NDArray[np.bool]:
    """Returns the mask (F,) of the selected faces of a mesh.

    Args:
        label: Name of the argument in messages.
        choice: Selection of faces.
        mesh: A ``Mesh``, or the content of a file, which may be invalid.

    Raises:
        ValueError: If the selection is invalid, a number is out of range, or a group does not exist.
    """
    count = len(mesh.faces)
    if callable(choice):
        found = np.asarray(choice(_centroids(mesh.vertices, mesh.faces)))
        if found.dtype != bool or found.shape != (count,):
            raise ValueError(
                f"{label} as a function must return a mask of shape ({count},), got {found.dtype} values of shape "
                f"{found.shape}"
            )
        return found.copy()
    names = [choice] if isinstance(choice, str) else choice
    if isinstance(names, list | tuple | set) and any(isinstance(name, str) for name in names):
        mask = np.zeros(count, dtype=bool)
        for name in names:
            if name not in mesh.groups:
                in_range = ", ".join(sorted(mesh.groups)[:20]) + (", …" if len(mesh.groups) > 20 else "")
                raise ValueError(f"{label} must be groups of the mesh ({in_range or 'it has none'}), got {name!r}")
            mask[mesh.groups[name]] = True
        return mask
    return _mask(label, choice, count)


def _centroids(vertices: npt.NDArray[np.float64], faces: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Returns the centroids (F, 3) of faces; NaN if a vertex index is out of range."""
    in_range = np.all((faces >= 0) & (faces < len(vertices)), axis=1)
    centroids = np.full((len(faces), 3), np.nan)
    centroids[in_range] = vertices[faces[in_range]].mean(axis=1)
    return centroids


def _mask(label: str, faces: Any, count: int) -> npt.NDArray[np.bool]:
    """Returns a mask over ``count`` faces from a mask, face numbers, or ``None`` for all."""
    if faces is None:
        return np.ones(count, dtype=bool)
    mask = np.zeros(count, dtype=bool)
    mask[_numbers(label, faces, count)] = True
    return mask


def _numbers(label: str, faces: Any, count: int) -> npt.NDArray[np.int32]:
    """Returns ascending face numbers from a mask over ``count`` faces, or face numbers."""
    given = np.asarray(faces)
    if given.dtype == bool:
        if given.shape != (count,):
            raise ValueError(f"{label} as a mask must have shape ({count},), got {given.shape}")
        return np.flatnonzero(given).astype(np.int32)
    if given.size == 0:
        return np.empty(0, dtype=np.int32)
    if given.ndim != 1 or not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"{label} must be a mask of {count} booleans or face numbers, got {given.dtype} values")
    if given.min() < 0 or given.max() >= count:
        outside = given[(given < 0) | (given >= count)]
        raise ValueError(f"{label} must be face numbers from 0 to {count - 1}, got {outside[0]}")
    # Most numbers are sorted already; sorting each of possibly many groups would be slow.
    return (given if (given[:-1] < given[1:]).all() else np.unique(given)).astype(np.int32)


#: Meters per unit.
UNITS = {
    "m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048,
}  # fmt: skip


def metres(scale: object, unit: str | None, own: float | None) -> float:
    """Returns meters per unit of a file, multiplied by ``scale``.

    Args:
        scale: Additional factor.
        unit: Name of the unit; ``None``: the unit given in the file.
        own: Meters per unit given in the file, or ``None``.

    Raises:
        ValueError: If ``scale`` is not positive and finite, or the unit does not exist.
    """
    factor = positive("scale", scale)
    if unit is not None:
        if not isinstance(unit, str) or unit not in UNITS:
            raise ValueError(f"unit must be one of {', '.join(UNITS)}, got {unit!r}{suggestion(unit, UNITS)}")
        return factor * UNITS[unit]
    return factor * own if own is not None and 0.0 < own < inf else factor


# Recommendation of a repair step to users with arrays; functions that read files have an argument ``repair`` instead.
_REMEDY = 'wc.meshes.repaired(mesh, "{step}") of a trimesh.Trimesh or another object with vertices and faces'


class MeshError(SafeTextError):
    """Mesh or mesh file that cannot be used; the message lists all problems."""


@explain_keywords_of
class Mesh:
    """An immutable, oriented triangle mesh.

    On the outer side of a face, its vertices run counter-clockwise. Open surfaces, several parts, non-manifold edges
    and inward orientation are allowed and listed in the warnings of :attr:`report`. Everything that would crash Warp,
    or make it silently skip a face, is an error.

    Args:
        vertices: Positions, (V, 3) real numbers [m]; finite, each coordinate within ±1e6 m.
        faces: Vertex indices of each triangle, (F, 3) integers from 0 to V − 1.
        name: Name for messages, reports and scenes.
        groups: Face numbers, or a mask (F,), by group name; groups may overlap.

    Raises:
        MeshError: If the arrays have wrong shapes or types, or are empty, a vertex is not finite or too far away, an
            index is out of range, a face is degenerate or a duplicate, or neighboring faces are wound
            inconsistently. Lists all problems, each with a count and its first case.
        ValueError: If the name is not a non-empty string, or a group has an invalid face number.
    """

    def __init__(
        self,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        *,
        name: str = "mesh",
        groups: Mapping[str, npt.ArrayLike] | None = None,
    ) -> None:
        if not isinstance(name, str) or not name:
            raise ValueError(f"name must be a non-empty string, got {name!r}")
        self._take(vertices, faces, groups, examine(vertices, faces, name, remedy=_REMEDY), f"mesh {name!r}")

    def _take(
        self,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        groups: Mapping[str, npt.ArrayLike] | None,
        report: MeshReport,
        subject: str,
    ) -> None:
        """Sets the arrays described by ``report``; raises ``MeshError``, which begins with ``subject``, if unusable."""
        if len(report.errors) == 1:
            raise MeshError(f"{subject}: {report.errors[0]}")
        if report.errors:
            listed = "".join(f"\n  - {error}" for error in report.errors)
            raise MeshError(f"{subject} has {len(report.errors)} problems:{listed}")
        self._groups = checked_groups(groups, report.face_count)
        sizes = tuple((name, len(members)) for name, members in self._groups.items())
        self._report = replace(report, groups=sizes)
        # Copies, because the arrays of the caller may change and these must not.
        self._vertices = np.array(vertices, dtype=np.float64, order="C")
        self._faces = np.array(faces, dtype=np.int32, order="C")
        self._vertices.flags.writeable = False
        self._faces.flags.writeable = False

    @classmethod
    def _examined(
        cls,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        groups: Mapping[str, npt.ArrayLike],
        report: MeshReport,
        subject: str,
    ) -> "Mesh":
        """Creates a mesh from arrays that were examined already."""
        mesh = cls.__new__(cls)
        mesh._take(vertices, faces, groups, report, subject)
        return mesh

    @classmethod
    def from_trimesh(cls, obj: Any, *, name: str = "mesh") -> "Mesh":
        """Creates a mesh from a ``trimesh.Trimesh``, or from any object with ``vertices`` and ``faces``.

        Args:
            obj: The object; its arrays are copied. Nothing is repaired or merged.
            name: Name of the mesh.

        Returns:
            The mesh, with the face numbers of ``obj``.

        Raises:
            TypeError: If ``obj`` has no vertices and faces, such as a ``trimesh.Scene``.
            MeshError: As for the constructor.
        """
        if not (hasattr(obj, "vertices") and hasattr(obj, "faces")):
            raise TypeError(f"obj must have vertices and faces, like trimesh.Trimesh, got {type(obj).__name__}")
        return cls(np.asarray(obj.vertices), np.asarray(obj.faces), name=name)

    @property
    def name(self) -> str:
        """Name for messages, reports and scenes."""
        return self._report.name

    @property
    def vertices(self) -> npt.NDArray[np.float64]:
        """Positions as given, (V, 3) [m], read-only."""
        return self._vertices

    @property
    def faces(self) -> npt.NDArray[np.int32]:
        """Vertex indices of each triangle as given, (F, 3), read-only."""
        return self._faces

    @property
    def groups(self) -> Mapping[str, npt.NDArray[np.int32]]:
        """Groups of faces: ascending face numbers by name, read-only; a face may be in several groups."""
        return self._groups

    @cached_property
    def welded(self) -> npt.NDArray[np.int32]:
        """Index of the first vertex at exactly the same position, for each vertex, (V,), read-only.

        ``mesh.welded[mesh.faces]`` gives the connectivity of the surface, even if the file repeats vertices.
        """
        welded = weld(self._vertices)
        welded.flags.writeable = False
        return welded

    @property
    def report(self) -> MeshReport:
        """Report on the mesh: size, topology, orientation, warnings."""
        return self._report

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """Smallest and largest x, y, z of the vertices that faces use, (2, 3) [m]."""
        return np.array([self._report.lower, self._report.upper])

    def flipped(self) -> "Mesh":
        """Returns the same surface with the winding of all faces reversed, so that its sides are exchanged.

        All calls return the same object.
        """
        return self._flipped

    @cached_property
    def _flipped(self) -> "Mesh":
        # Data derived from a mesh, such as patch tables, are cached per mesh object and shared by scenes.
        return self._changed(self._vertices, self._faces[:, [0, 2, 1]], flipped(self._report))

    def scaled(self, factor: float) -> "Mesh":
        """Returns the mesh scaled about its origin, for example by 0.001 from millimeters to meters.

        Args:
            factor: Positive finite number [-].

        Returns:
            A new mesh with the same faces.

        Raises:
            ValueError: If the factor is not positive and finite.
            MeshError: If the result is too large, or so small that faces become degenerate.
        """
        with np.errstate(over="ignore"):  # the examination reports infinity
            vertices = self._vertices * positive("factor", factor)
        # Examine again, because some errors depend on the size.
        return self._changed(
            vertices,
            self._faces,
            with_inherited_warnings(self._report, examine(vertices, self._faces, self.name, remedy=_REMEDY)),
        )

    def _changed(self, vertices: npt.ArrayLike, faces: npt.ArrayLike, report: MeshReport) -> "Mesh":
        return Mesh._examined(vertices, faces, self._groups, report, f"mesh {self.name!r}")

    def self_intersections(self) -> npt.NDArray[np.int64]:
        """Finds pairs of faces that intersect or overlap in a plane, for meshes of any size.

        Faces that penetrate each other by less than 1e-6 of the mesh size do not count.

        Returns:
            Face numbers of each pair, the lower one first, (n, 2).

        Raises:
            MeshError: If too many faces are so close together that not all pairs can be tested.
        """
        from warpcontact.meshes.examine import intersections

        pairs = intersections(self._vertices, self.welded[self._faces].astype(np.int64))
        if pairs is None:
            raise MeshError(f"mesh {self.name!r} has too many faces close to each other to compare them all")
        return pairs

    def plot(
        self,
        path: str | PathLike[str],
        *,
        active_faces: FaceChoice = None,
        direction: npt.ArrayLike | None = None,
    ) -> None:
        """Draws the mesh, shaded and with its defects marked, into an .svg or .png file.

        Args:
            path: Picture file to write.
            active_faces: Active faces, as for ``Scene.add_surface``: a mask (F,), face numbers, names of groups, or a
                function of the centroids; ``None``: all.
            direction: Direction from the mesh to the camera in the left view, (3,); the right view is opposite.
                ``None``: the direction from which most of the outer side is visible.

        Raises:
            ValueError: If the picture cannot be written, or an argument is invalid.
        """
        from warpcontact.meshes.picture import plot_arrays

        active = None if active_faces is None else face_mask("active_faces", active_faces, self)
        plot_arrays(self._vertices, self._faces, self._report, path, active=active, direction=direction)

    def __reduce__(self) -> tuple[Any, ...]:
        # NumPy drops the read-only flag in copies and pickles; the constructor sets it again.
        make = partial(Mesh, name=self.name, groups=dict(self._groups))
        return make, (self._vertices, self._faces), {"_report": self._report}

    def __repr__(self) -> str:
        kind = "closed" if self._report.closed else "open"
        return f"Mesh({self.name!r}, {len(self._vertices)} vertices, {len(self._faces)} faces, {kind})"


def positive(label: str, value: object) -> float:
    """Returns ``value`` as a float.

    Raises:
        ValueError: If it is not a positive finite real number; the message begins with ``label``.
    """
    try:
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else nan
    except OverflowError:  # an integer beyond float64
        number = inf
    if not 0.0 < number < inf:
        raise ValueError(f"{label} must be a positive finite number, got {value!r}")
    return number
