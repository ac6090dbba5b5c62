"""Reads, repairs and examines a mesh file, in a sandboxed process or in the main process."""

from dataclasses import asdict, dataclass, replace
from math import inf
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import norm
from warpcontact.meshes.examine import examine
from warpcontact.meshes.mesh import FaceChoice, MeshError, face_mask, metres
from warpcontact.meshes.readers import Content, Unreadable, read
from warpcontact.meshes.repair import repair_arrays
from warpcontact.meshes.report import MeshReport
from warpcontact.meshes.topology import area_vectors


@dataclass(frozen=True)
class Task:
    """Task for a mesh file, in plain values that have been validated.

    Attributes:
        file: Path of the file.
        title: Name for the report.
        prim: Path of a prim, for USD only.
        scale: Factor on all lengths.
        unit: Unit of the file; ``None``: the unit given in the file.
        steps: Names of the repair steps.
        tolerance: Merging distance, relative to the largest dimension.
        faces: Largest number of triangles.
    """

    file: str
    title: str
    prim: str | None
    scale: float
    unit: str | None
    steps: tuple[str, ...]
    tolerance: float
    faces: int


class ExaminedMesh(NamedTuple):
    """Content of a file, empty if it is unreadable, and its report.

    Attributes:
        vertices: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3); they may be out of range.
        groups: Face numbers by group name.
        report: Report without groups.
    """

    vertices: npt.NDArray[Any]
    faces: npt.NDArray[Any]
    groups: dict[str, npt.NDArray[np.int64]]
    report: MeshReport

    def active(self, choice: FaceChoice) -> npt.NDArray[np.bool] | None:
        """Returns the mask (F,) of the selected faces; ``None`` if nothing is selected or there are no faces."""
        return None if choice is None or not len(self.faces) else face_mask("active_faces", choice, self)

    def complete_report(self, active: npt.NDArray[np.bool] | None) -> MeshReport:
        """Returns the report with the groups, and with number and area of the active faces if a mask (F,) is given."""
        groups = tuple((name, len(members)) for name, members in self.groups.items())
        report = replace(self.report, groups=groups)
        if active is None:
            return report
        chosen = self.faces[active]
        corners = self.vertices[chosen[np.all((chosen >= 0) & (chosen < len(self.vertices)), axis=1)]]
        area = 0.5 * float(norm(area_vectors(corners)).sum())
        return replace(report, active_face_count=len(chosen), active_area=area)


def examine_task(task: Task, *, confined: bool) -> ExaminedMesh:
    """Reads, repairs and examines a mesh file; problems are listed in the report.

    Args:
        task: Task to execute.
        confined: Whether the layers of a USD stage must lie in or below the folder of the file.
    """
    try:
        content = read(task.file, task.prim, task.faces, confined=confined)
        factor = _factor(task, content)
    except Unreadable as error:
        return unreadable(task.title, error)
    with np.errstate(over="ignore"):  # the examination reports infinity
        vertices = np.asarray(content.vertices, dtype=np.float64) * factor
    try:
        vertices, faces, groups, repairs = repair_arrays(
            vertices, content.faces, content.groups, task.steps, task.tolerance
        )
    except MeshError as error:
        report = MeshReport(task.title, errors=(str(error),))
        return ExaminedMesh(vertices, content.faces, content.groups, report)
    report = examine(vertices, faces, task.title, overlaps=True)
    unit_warnings, unit_notes = _about_unit(task, content)
    report = replace(
        report,
        repairs=repairs,
        warnings=(*content.warnings, *unit_warnings, *report.warnings),
        notes=(*unit_notes, *content.notes, *report.notes),
    )
    return ExaminedMesh(vertices, faces, groups, report)


def answer(task: dict[str, Any]) -> tuple[dict[str, Any], list[npt.NDArray[Any]]]:
    """Returns the answer of the reader process: a header, and the flat arrays that it announces."""
    vertices, faces, groups, report = examine_task(Task(**task), confined=True)
    arrays = [
        np.ascontiguousarray(vertices, dtype="<f8"),
        np.ascontiguousarray(faces, dtype="<i8"),
        *(np.ascontiguousarray(members, dtype="<i8") for members in groups.values()),
    ]
    header = {
        "vertices": len(vertices),
        "faces": len(faces),
        "groups": [[name, len(members)] for name, members in groups.items()],
        "report": asdict(report),
    }
    return header, [array.reshape(-1) for array in arrays if array.size]


def unreadable(title: str, error: Unreadable) -> ExaminedMesh:
    """Returns the empty content and the report of a file that cannot be read."""
    report = MeshReport(title, errors=(str(error),))
    return ExaminedMesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), {}, report)


def _about_unit(task: Task, content: Content) -> tuple[list[str], list[str]]:
    """Returns warnings and notes about the length unit used."""
    if task.unit is None and content.unit_warning:
        return [content.unit_warning], []
    scaled = "" if task.scale == 1.0 else f", times {task.scale:g}"
    if task.unit is not None:
        return [], [f"read in {task.unit}, the given unit{scaled}"]
    if content.unit is None:
        return [], [f"no unit in this file; read in meters{scaled}"]
    return [], [f"read in the unit of the file, {content.unit:g} m{scaled}"]


def _factor(task: Task, content: Content) -> float:
    """Returns meters per unit of the file, including the scale."""
    own = content.unit
    if task.unit is None and own is not None and not 0.0 < own < inf:
        raise Unreadable(f"metersPerUnit must be positive and finite, got {own:g}; pass a unit to override it")
    return metres(task.scale, task.unit, own)
