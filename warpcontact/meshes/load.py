"""Loads, examines and draws mesh files: STL, OBJ, PLY, OFF, GLB and USD."""

import os
from pathlib import Path

from warpcontact.files.picture_file import check_path
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import open_file
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.meshes.intake import ExaminedMesh, Task, examine_task, unreadable
from warpcontact.meshes.isolation import Limits, examine_task_sandboxed
from warpcontact.meshes.mesh import FaceChoice, Mesh, MeshError, metres, positive
from warpcontact.meshes.readers import SUFFIXES, USD_SUFFIXES, Unreadable
from warpcontact.meshes.repair import RepairRequest, check_tolerance, steps_of
from warpcontact.meshes.report import MeshReport
from warpcontact.meshes.topology import CRACK_LIMIT


@explain_keywords
def load_mesh(
    path: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    unit: str | None = None,
    name: str | None = None,
    prim: str | None = None,
    repair: RepairRequest = False,
    tolerance: float = CRACK_LIMIT,
    trusted: bool = False,
    limits: Limits | None = None,
) -> Mesh:
    """Loads a triangle mesh from a file.

    The file is read, repaired and examined in a sandboxed process, with limits on memory and time. Files outside its
    folder are not opened. A damaged or malicious file therefore causes an error only.

    Args:
        path: An .stl (binary or text), .obj, .ply, .off, .glb, .usd, .usda, .usdc or .usdz file, in upper or lower
            case. All parts of a scene are joined, each at its position. Axes are not changed.
        scale: Factor on all lengths, for example 0.001 for millimeters; positive. Multiplies ``unit`` if both are given.
        unit: Unit of the file: m, dm, cm, mm, um, µm, km, in or ft. Default: the unit given in the file (USD), or m.
        name: Name of the mesh. Default: the file name without extension.
        prim: Path of a prim in a USD file: a mesh, or a group whose visible meshes are loaded.
        repair: Repair steps: ``True`` for all, or names out of merge, degenerate, duplicate, orient and unused; see
            ``docs/meshes.md``. Default: none. ``report.repairs`` lists the changes.
        tolerance: Distance below which ``merge`` joins vertices, relative to the largest dimension.
        trusted: Whether to read in this process, without limits on memory and time, and to follow all references of a
            USD file: for files from trusted sources that are large, or spread over folders.
        limits: Limits on memory, time and size. Default: ``Limits()``.

    Returns:
        The mesh. Read ``report.warnings`` before using it. ``groups`` name its parts.

    Raises:
        MeshError: If the file cannot be read, is damaged, or contains no usable mesh; names the file and all
            problems.
        ValueError: If an option is invalid; the message names it.
    """
    if name is not None and (not isinstance(name, str) or not name):
        raise ValueError(f"name must be a non-empty string, got {name!r}")
    options = Options(scale, unit, prim, repair, tolerance, trusted, limits)
    return Mesh._examined(*examined(Path(path), name, options), f"mesh file {str(path)!r}")


@explain_keywords
def examine_file(
    path: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    unit: str | None = None,
    prim: str | None = None,
    repair: RepairRequest = False,
    tolerance: float = CRACK_LIMIT,
    trusted: bool = False,
    limits: Limits | None = None,
    active_faces: FaceChoice = None,
) -> MeshReport:
    """Returns a report on a mesh file, usable or not.

    Args:
        path: The file; it and the options are as for :func:`load_mesh`.
        scale: Factor on all lengths.
        unit: Unit of the file.
        prim: Path of a prim in a USD file.
        repair: Repair steps applied first; the report describes the repaired mesh.
        tolerance: Distance below which ``merge`` joins vertices, relative to the largest dimension.
        trusted: Whether to read the file in this process.
        limits: Limits on memory, time and size.
        active_faces: Active faces of the repaired mesh, as for ``Scene.add_surface``: names of groups, face numbers,
            a mask (F,), or a function of the centroids. Adds their number and area to the report.

    Returns:
        The report. If :func:`load_mesh` would raise an error, ``errors`` gives the reasons.

    Raises:
        MeshError: If there is no file to report on: it is missing, not a regular file, or unreadable.
        ValueError: If an option is invalid, or a face or group does not exist.
    """
    found = examined(Path(path), None, Options(scale, unit, prim, repair, tolerance, trusted, limits))
    return found.complete_report(found.active(active_faces))


@explain_keywords
def plot_file(
    path: str | os.PathLike[str],
    picture: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    unit: str | None = None,
    prim: str | None = None,
    repair: RepairRequest = False,
    tolerance: float = CRACK_LIMIT,
    trusted: bool = False,
    limits: Limits | None = None,
    active_faces: FaceChoice = None,
) -> MeshReport:
    """Draws a mesh file, usable or not, into an .svg or .png file, and returns its report.

    Args:
        path: Mesh file, as for :func:`load_mesh`.
        picture: Picture file to write.
        scale: As for :func:`load_mesh`, like the following arguments.
        unit: Unit of the file.
        prim: Prim of a USD file.
        repair: Repair steps applied first; the result is drawn.
        tolerance: Distance below which ``merge`` joins vertices, relative to the largest dimension.
        trusted: Whether to read without limits.
        limits: Limits of the reader process.
        active_faces: As for :func:`examine_file`; other faces are drawn pale.

    Raises:
        MeshError: If the file cannot be read.
        ValueError: If an option is invalid, no face can be drawn, or the picture cannot be written.
    """
    from warpcontact.meshes.picture import plot_arrays

    check_path(picture)
    options = Options(scale, unit, prim, repair, tolerance, trusted, limits)
    found = examined(Path(path), None, options)
    active = found.active(active_faces)
    plot_arrays(found.vertices, found.faces, found.report, picture, active=active)
    return found.complete_report(active)


class Options:
    """Validated options of loading."""

    def __init__(
        self,
        scale: float,
        unit: str | None,
        prim: str | None,
        repair: RepairRequest,
        tolerance: float,
        trusted: bool,
        limits: Limits | None,
    ) -> None:
        metres(1.0, unit, None)
        if prim is not None and (not isinstance(prim, str) or not prim):
            raise ValueError(f"prim must be the path of a prim, such as '/World/part', got {prim!r}")
        if limits is not None and not isinstance(limits, Limits):
            raise ValueError(f"limits must be a Limits, got {limits!r}")
        self.scale, self.unit, self.prim, self.trusted = positive("scale", scale), unit, prim, trusted
        self.steps, self.tolerance = steps_of(repair), check_tolerance(tolerance)
        self.limits = Limits() if limits is None else limits

    def task(self, path: Path, title: str) -> Task:
        """Returns the task for a file."""
        return Task(
            file=os.path.abspath(path),
            title=title,
            prim=self.prim,
            scale=self.scale,
            unit=self.unit,
            steps=self.steps,
            tolerance=self.tolerance,
            faces=self.limits.faces,
        )


def examined(path: Path, name: str | None, options: Options) -> ExaminedMesh:
    """Reads, repairs and examines a file, in a sandboxed process unless it is trusted."""
    suffix = path.suffix.lower()
    _check_file(path)
    if options.prim is not None and suffix not in USD_SUFFIXES:
        raise ValueError(
            f"prim is for USD files ({', '.join(USD_SUFFIXES)}), got {options.prim!r} for {path.name!r}"
        )
    task = options.task(path, path.stem if name is None else name)
    try:
        if suffix not in SUFFIXES:
            raise Unreadable(f"the extension {path.suffix!r} is not one of {', '.join(SUFFIXES)}")
        if options.trusted:
            return examine_task(task, confined=False)
        return examine_task_sandboxed(task, options.limits)
    except Unreadable as error:
        return unreadable(task.title, error)


def _check_file(path: Path) -> None:
    """Raises ``MeshError`` unless the file can be opened safely, before a reader process opens it."""
    subject = f"mesh file {str(path)!r}"
    try:
        open_file(path).close()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise MeshError(f"{subject} does not exist") from error
    except IsADirectoryError as error:
        raise MeshError(f"{subject} is not a regular file") from error
    except UnsafeFileError as error:
        raise MeshError(f"{subject} {error.strerror}") from error
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        raise MeshError(f"{subject} cannot be read: {getattr(error, 'strerror', None) or error}") from error
