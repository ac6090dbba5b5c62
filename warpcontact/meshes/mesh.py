"""Oriented triangle mesh whose arrays are validated, so that Warp can use them safely."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property, partial
from math import inf, nan
from numbers import Real
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.meshes.examine import examine
from warpcontact.meshes.groups import FaceChoice, checked_groups, face_mask
from warpcontact.meshes.mesh_warnings import flipped, with_inherited_warnings
from warpcontact.meshes.report import MeshReport
from warpcontact.meshes.topology import weld
from warpcontact.validation.safe_text import SafeTextError


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
        self._take(vertices, faces, groups, examine(vertices, faces, name), f"mesh {name!r}")

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
            vertices, self._faces, with_inherited_warnings(self._report, examine(vertices, self._faces, self.name))
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
        from warpcontact.meshes.overlap import intersections

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
        from warpcontact.meshes.picture.sheet import plot_arrays

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
