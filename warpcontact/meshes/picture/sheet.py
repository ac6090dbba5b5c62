"""Picture of a mesh: shaded views from two opposite sides, with marked defects and a legend."""

from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.files.picture_file import check_path, save
from warpcontact.meshes.picture.defects import Defects, find_defects
from warpcontact.meshes.picture.marks import draw_marks, length_unit, line_kinds, spot_kinds
from warpcontact.meshes.picture.view import View, best_direction, direction_text, paint
from warpcontact.meshes.report import MeshReport
from warpcontact.meshes.topology import area_vectors

Array = npt.NDArray[np.float64]

# Pixels of each view, and number of rasterized pixels per picture pixel along each axis.
ROWS, COLUMNS, FINE = 560, 640, 2
DPI = 120
# Colors of faces: red, green and blue.
OUTER, INNER = (0.52, 0.66, 0.82), (0.93, 0.62, 0.35)
IDLE_OUTER, IDLE_INNER = (0.80, 0.80, 0.80), (0.90, 0.82, 0.72)
DUPLICATE, INWARD, CUTTING = (0.95, 0.85, 0.20), (0.66, 0.45, 0.80), (0.90, 0.35, 0.35)
# Direction to the light, in the picture: right, up, towards the camera.
LIGHT = np.array([-0.40, 0.45, 0.80])
SHADE = 0.48
COLUMNS_OF_LEGEND = 4
# Edges are drawn if faces have more pixels than this, on average.
LARGE = 250
# Brightness of edges of large faces and of creases, and cosine of the smallest crease angle (40°).
EDGE, CREASE, CREASE_COSINE = 0.80, 0.72, 0.77


def plot_arrays(
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    report: MeshReport,
    path: str | PathLike[str],
    *,
    active: npt.NDArray[np.bool_] | None = None,
    direction: npt.ArrayLike | None = None,
) -> None:
    """Draws triangles, usable as a mesh or not, into an .svg or .png file.

    Args:
        vertices: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3).
        report: Report on the triangles.
        path: Picture file to write.
        active: Mask (F,) of the active faces; ``None``: all, without a legend entry.
        direction: Direction from the surface to the camera in the left view, (3,); the right view is opposite.
            ``None``: the direction from which most of the outer side is visible.

    Raises:
        ValueError: If no face can be drawn, or an argument is invalid.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    file = check_path(path)
    v, f = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    defects = None
    if v.ndim == f.ndim == 2 and v.size and f.size:
        # Skip the slow search if the report counts no intersections.
        defects = find_defects(v, f, cuts=bool(report.self_intersection_count))
    if defects is None or not defects.drawable.any():
        raise ValueError(f"{report.name!r} has no face that can be drawn")
    shown = np.flatnonzero(defects.drawable)
    corners = v[f[shown]]
    cross = area_vectors(corners)
    front = best_direction(cross) if direction is None else _direction(direction)

    figure = Figure(figsize=(2 * COLUMNS / DPI + 0.3, ROWS / DPI + 1.75), dpi=DPI)
    FigureCanvasAgg(figure)
    height = float(figure.get_figheight()) * DPI
    for i, eye in enumerate((front, -front)):
        left = (0.1 * DPI + i * (COLUMNS + 0.1 * DPI)) / (2 * COLUMNS + 0.3 * DPI)
        box = (left, 0.95 * DPI / height, COLUMNS / (2 * COLUMNS + 0.3 * DPI), ROWS / height)
        axes = figure.add_axes(box)
        view = View.towards(eye, corners.reshape(-1, 3), (FINE * ROWS, FINE * COLUMNS))
        depth = _draw_surface(axes, view, corners, cross, shown, defects, active)
        draw_marks(axes, view, depth, v, f, defects)
        axes.set_title(direction_text(eye), fontsize="medium")
    figure.suptitle(
        _heading(report, corners), fontsize="large", y=1.0 - 0.1 * DPI / height, va="top", parse_math=False
    )
    _legend(figure, report, defects, active, shown)
    save(figure, file)


def _draw_surface(
    axes: Any,
    view: View,
    corners: Array,
    cross: Array,
    shown: npt.NDArray[np.intp],
    defects: Defects,
    active: npt.NDArray[np.bool_] | None,
) -> Array:
    """Draws the faces, and returns the depth in each pixel."""
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    normal = cross / np.maximum(length, 1e-300)
    outer = normal @ view.direction > 0.0
    # Paint outer sides last, so that they are visible where two faces coincide.
    order = np.argsort(outer, kind="stable")
    face_in_pixel, depth = paint(view.project(corners)[order], view.size)
    empty = face_in_pixel < 0
    face_in_pixel = order[np.where(empty, 0, face_in_pixel)]

    color = np.where(outer[:, None], OUTER, INNER)
    if active is not None:
        idle = np.where(outer[:, None], IDLE_OUTER, IDLE_INNER)
        color = np.where(active[shown][:, None], color, idle)
    color[defects.inward[shown]] = INWARD
    color[defects.cutting[shown]] = CUTTING
    color[defects.duplicate[shown]] = DUPLICATE
    towards = normal * np.where(outer, 1.0, -1.0)[:, None]
    frame = np.stack([view.right, view.up, view.direction])
    light = np.clip(towards @ (LIGHT @ frame) / np.linalg.norm(LIGHT), 0.0, 1.0)
    color *= (SHADE + (1.0 - SHADE) * light)[:, None]

    image = color[face_in_pixel]
    image *= _lines(face_in_pixel, empty, towards)[..., None]
    image[empty] = 1.0
    rows, columns = view.size
    image = image.reshape(rows // FINE, FINE, columns // FINE, FINE, 3).mean(axis=(1, 3))
    axes.imshow(np.clip(image, 0.0, 1.0), extent=(0, columns, rows, 0), interpolation="none")
    axes.set(xlim=(0, columns), ylim=(rows, 0), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_color("0.8")
    return depth


def _lines(face_in_pixel: npt.NDArray[np.intp], empty: npt.NDArray[np.bool_], towards: Array) -> Array:
    """Returns the brightness factor of each pixel: below 1 at creases, and at edges between large faces."""
    count = len(np.unique(face_in_pixel[~empty])) or 1
    large = (~empty).sum() / count > LARGE
    bright = np.ones(face_in_pixel.shape)
    for axis in (0, 1):
        here = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        there = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        differ = (face_in_pixel[here] != face_in_pixel[there]) & ~empty[here] & ~empty[there]
        a, b = face_in_pixel[here][differ], face_in_pixel[there][differ]
        crease = np.einsum("ij,ij->i", towards[a], towards[b]) < CREASE_COSINE
        line = np.where(crease, CREASE, EDGE if large else 1.0)
        bright[here][differ] = np.minimum(bright[here][differ], line)
    return bright


def _heading(report: MeshReport, corners: Array) -> str:
    size = np.ptp(corners.reshape(-1, 3), axis=0)
    unit, factor = length_unit(float(size.max()))
    lengths = " × ".join(f"{length / factor:.4g}" for length in size)
    return f"{report.name}:  {lengths} {unit} (x, y, z),  {report.face_count:,} faces"


def _legend(
    figure: Any,
    report: MeshReport,
    defects: Defects,
    active: npt.NDArray[np.bool_] | None,
    shown: npt.NDArray[np.intp],
) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    word = "" if active is None else ", active"
    entries: list[Any] = [
        Patch(color=OUTER, label=f"outer side{word}"),
        Patch(color=INNER, label=f"inner side{word}"),
    ]
    if active is not None:
        idle = len(shown) - int(active[shown].sum())
        entries.append(Patch(color=IDLE_OUTER, label=f"not active: {_count(idle, 'face')}"))
    for mask, color, what in (
        (defects.inward, INWARD, "closed parts oriented inward"),
        (defects.cutting, CUTTING, "intersecting or overlapping"),
        (defects.duplicate, DUPLICATE, "duplicate"),
    ):
        if mask.any():
            entries.append(Patch(color=color, label=f"{what}: {_count(int(mask.sum()), 'face')}"))
    marks = line_kinds(defects)
    for kind in marks:
        entries.append(
            Line2D([], [], color=kind.color, lw=2.0, label=f"{kind.what}: {_count(kind.count, kind.noun)}")
        )
    spots = spot_kinds(defects)
    for spot in spots:
        label = f"{spot.what}: {len(spot.vertices):,} {'vertex' if len(spot.vertices) == 1 else 'vertices'}"
        entries.append(Line2D([], [], color=spot.color, lw=0.0, marker="D", markeredgecolor="white", label=label))
    figure.legend(
        handles=entries,
        loc="lower center",
        ncols=min(len(entries), COLUMNS_OF_LEGEND) if len(entries) > 5 else len(entries),
        frameon=False,
        fontsize="medium",
    )
    notes = []
    if marks or spots:
        notes.append("marks hidden by the surface are faint")
    elif not (defects.inward.any() or defects.duplicate.any() or defects.cutting.any()):
        notes.append("no open boundary, no defects")
    if report.self_intersection_count is None:
        notes.append("self-intersections not examined")
    if omitted := report.face_count - len(shown):
        notes.append(f"{_count(omitted, 'face')} without finite vertices not shown")
    y = 0.62 / figure.get_figheight()
    figure.text(0.5, y, "; ".join(notes), ha="center", fontsize="small", color="0.3")


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _direction(value: npt.ArrayLike) -> Array:
    try:
        direction = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise ValueError(f"direction must be 3 numbers that are not all 0, got {value!r}")
    return direction / np.linalg.norm(direction)
