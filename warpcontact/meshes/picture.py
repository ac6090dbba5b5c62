"""Picture of a mesh: shaded views from two opposite sides, with marked defects, axes, scale bars and a legend."""

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.files.picture_file import check_path, save
from warpcontact.meshes.examine import COORDINATE_LIMIT, SLIVER_LIMIT, intersections
from warpcontact.meshes.picture_view import View, best_direction, direction_text, paint
from warpcontact.meshes.report import MeshReport
from warpcontact.meshes.topology import (
    CRACK_LIMIT,
    Edges,
    area_vectors,
    has_near_neighbor,
    representatives,
    slenderness,
    volumes_of,
)
from warpcontact.validation.checks import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Defects:
    """Defects: faces as masks over all faces, (F,); edges as vertex indices, (n, 2); and vertices, (n,).

    Topology is that of the report: of the welded surface and its valid faces.
    """

    drawable: Mask  # all vertices exist, are finite and near
    degenerate: Mask
    duplicate: Mask
    inward: Mask  # faces of closed parts with inward orientation
    cutting: Mask  # faces that intersect others, or overlap them in a plane
    boundary: npt.NDArray[np.int64]
    non_manifold: npt.NDArray[np.int64]
    inconsistent: npt.NDArray[np.int64]
    pinched: npt.NDArray[np.int64]  # vertices at which parts of the surface meet in a single point
    cracks: npt.NDArray[np.int64]  # boundary vertices that nearly coincide with another one


def find_defects(vertices: npt.NDArray[np.float64], faces: npt.NDArray[Any], *, cuts: bool = True) -> Defects:
    """Returns the defects of any arrays (V, 3) and (F, 3), usable as a mesh or not.

    ``cuts``: whether to search for intersecting faces, the slowest part.
    """
    near: Mask = np.all(np.abs(vertices) <= COORDINATE_LIMIT, axis=1)  # false for NaN
    in_range: Mask = np.all((faces >= 0) & (faces < len(vertices)), axis=1)
    index = np.where(in_range[:, None], faces, 0).astype(np.int64)
    drawable: Mask = in_range & np.all(near[index], axis=1)
    degenerate = np.zeros(len(faces), dtype=bool)
    degenerate[drawable] = slenderness(vertices[index[drawable]]) < SLIVER_LIMIT

    corners = representatives(vertices)[index]
    valid_faces = np.flatnonzero(drawable & (corners != corners[:, [1, 2, 0]]).all(axis=1))
    duplicate = np.zeros(len(faces), dtype=bool)
    first = representatives(np.sort(corners[valid_faces], axis=1))
    duplicate[valid_faces] = np.bincount(first, minlength=len(valid_faces))[first] > 1
    # A copy in the opposite direction counts as a separate face, as in the report.
    rotated = (corners[valid_faces].argmin(axis=1)[:, None] + np.arange(3)) % 3
    valid_faces = valid_faces[
        representatives(np.take_along_axis(corners[valid_faces], rotated, axis=1)) == np.arange(len(valid_faces))
    ]

    ends = np.stack((corners[valid_faces], corners[valid_faces][:, [1, 2, 0]]), axis=2).reshape(-1, 2)
    edge = representatives(np.sort(ends, axis=1))
    count = np.bincount(edge, minlength=len(edge))
    balance = np.bincount(edge, np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0), len(edge))
    inward = np.zeros(len(faces), dtype=bool)
    inward[valid_faces] = _inward(vertices, corners[valid_faces], edge, (count % 2 == 1) | (balance != 0.0))
    boundary, seamed = ends[count == 1], np.zeros(0, dtype=np.int64)
    pinched, cutting = seamed, np.zeros(len(faces), dtype=bool)
    if len(valid_faces):
        boundary_vertices = np.unique(boundary)
        size = float(np.ptp(vertices[corners[valid_faces]], axis=(0, 1)).max())
        seamed = boundary_vertices[has_near_neighbor(vertices[boundary_vertices], CRACK_LIMIT * size)]
        pinched = np.flatnonzero(Edges(corners[valid_faces]).fans(corners[valid_faces]) > 1)
        proper_faces = valid_faces[~degenerate[valid_faces]]
        pairs = intersections(vertices, corners[proper_faces]) if cuts else None
        if pairs is not None:
            cutting[proper_faces[np.unique(pairs)]] = True
    return Defects(
        drawable=drawable,
        degenerate=degenerate,
        duplicate=duplicate,
        inward=inward,
        cutting=cutting,
        boundary=boundary,
        non_manifold=ends[count > 2],
        inconsistent=ends[(count == 2) & (balance != 0.0)],
        pinched=pinched,
        cracks=seamed,
    )


def _inward(
    vertices: npt.NDArray[np.float64],
    corners: npt.NDArray[np.int64],
    edge: npt.NDArray[np.intp],
    open_edge: Mask,
) -> Mask:
    """Returns the faces of connected parts that are closed and have a negative volume.

    Args:
        vertices: Positions, (V, 3).
        corners: Vertices of each face, (F, 3).
        edge: First half-edge of the same edge, for each half-edge, (3 F,).
        open_edge: Whether an edge is a boundary or inconsistent, by its first half-edge, (3 F,).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(corners):
        return np.zeros(0, dtype=bool)
    half = np.arange(len(edge))
    links = coo_array((np.ones(len(edge), dtype=bool), (half // 3, edge // 3)), shape=(len(corners),) * 2)
    parts, part = connected_components(links, directed=False)
    _, volume, zero_volume = volumes_of(vertices, corners, part, parts)
    bounding = np.ones(parts, dtype=bool)
    bounding[part[half[open_edge[edge]] // 3]] = False
    return (bounding & (volume < -zero_volume))[part]


# Line widths of visible and hidden lines [pt], and opacity of hidden ones.
SEEN, HIDDEN, FAINT = 2.0, 1.2, 0.4
# Connected lines smaller than this get a ring, because they are easily overlooked [rasterized pixels].
SMALL = 24.0
# Smallest distance between rings [pixels].
RING = 24.0
# Distance between points along a line at which visibility is tested [pixels], and largest number of them per line.
STEP, MOST = 4.0, 400
# Largest length of the scale bar, as a fraction of the width of a view.
BAR = 0.25


@dataclass(frozen=True)
class Kind:
    """Kind of defect that is drawn as lines."""

    what: str
    noun: str  # singular
    color: Any
    ends: npt.NDArray[np.int64]  # (n, 2) vertices
    count: int


def line_kinds(defects: Defects, faces: npt.NDArray[Any] | None = None) -> list[Kind]:
    """Returns the line defects of a mesh; with ``faces``, degenerate faces get lines as well."""
    slivers = np.zeros((0, 2), dtype=np.int64)
    if faces is not None:
        corners = faces[defects.degenerate].astype(np.int64)
        slivers = np.stack((corners, corners[:, [1, 2, 0]]), axis=2).reshape(-1, 2)
    boundary, several, clash = (
        (edges, len(np.unique(np.sort(edges, axis=1), axis=0)))
        for edges in (defects.boundary, defects.non_manifold, defects.inconsistent)
    )
    found = (
        Kind("open boundary", "edge", (0.85, 0.08, 0.08), *boundary),
        Kind("non-manifold", "edge", (0.85, 0.0, 0.75), *several),
        Kind("wound inconsistently", "edge", (0.0, 0.5, 0.15), *clash),
        Kind("degenerate", "face", (0.0, 0.0, 0.0), slivers, int(defects.degenerate.sum())),
    )
    return [kind for kind in found if kind.count]


@dataclass(frozen=True)
class Spots:
    """Kind of defect that is drawn as vertices."""

    what: str
    color: Any
    vertices: npt.NDArray[np.int64]  # (n,)


def spot_kinds(defects: Defects) -> list[Spots]:
    """Returns the vertex defects of a mesh."""
    found = (
        Spots("touching in a point only", (0.55, 0.0, 0.65), defects.pinched),
        Spots("cracks", (0.75, 0.35, 0.0), defects.cracks),
    )
    return [kind for kind in found if len(kind.vertices)]


def draw_marks(
    axes: Any, view: View, depth: Array, vertices: Array, faces: npt.NDArray[Any], defects: Defects
) -> None:
    """Draws the line and vertex defects, the axes and the scale bar over a view."""
    from matplotlib.collections import LineCollection

    for kind in line_kinds(defects, faces):
        edges = np.unique(np.sort(kind.ends, axis=1), axis=0)
        places = view.project(vertices[edges])
        seen, hidden = _split_by_visibility(places, view, depth)
        for lines, width, strength in ((hidden, HIDDEN, FAINT), (seen, SEEN, 1.0)):
            axes.add_collection(
                LineCollection(lines, colors=[kind.color], linewidths=width, alpha=strength, capstyle="round")
            )
        spots = _small(places, edges)
        clear = view.visible(spots, depth)
        for chosen, strength in ((~clear, FAINT), (clear, 1.0)):
            at = _thin_out(spots[chosen, :2])
            axes.scatter(*at.T, s=70.0, facecolors="none", edgecolors=[kind.color], linewidths=1.1, alpha=strength)
    for spot in spot_kinds(defects):
        places = view.project(vertices[spot.vertices])
        clear = view.visible(places, depth)
        for chosen, strength in ((~clear, FAINT), (clear, 1.0)):
            at = _thin_out(places[chosen, :2])
            axes.scatter(*at.T, s=34.0, color=[spot.color], marker="D", edgecolors="white", alpha=strength)
    _draw_axes(axes, view)
    _draw_bar(axes, view)


def _split_by_visibility(places: Array, view: View, depth: Array) -> tuple[list[Array], list[Array]]:
    """Splits lines (n, 2, 3) into visible and hidden parts, each as points (2, 2)."""
    length = np.linalg.norm(places[:, 1, :2] - places[:, 0, :2], axis=1)
    counts = np.clip(np.ceil(length / STEP), 1, MOST).astype(np.int64)
    line = np.repeat(np.arange(len(places)), counts)
    step = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
    start, run = places[line, 0], places[line, 1] - places[line, 0]
    size = counts[line][:, None]
    middle = start + run * ((step[:, None] + 0.5) / size)
    visible = view.visible(middle, depth)
    # Merge consecutive pieces of equal visibility.
    new = np.ones(len(line), dtype=bool)
    new[1:] = (line[1:] != line[:-1]) | (visible[1:] != visible[:-1])
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(line)) - 1
    begin = (start + run * (step[:, None] / size))[first, :2]
    end = (start + run * ((step[:, None] + 1.0) / size))[last, :2]
    parts = np.stack([begin, end], axis=1)
    return list(parts[visible[first]]), list(parts[~visible[first]])


def _small(places: Array, edges: npt.NDArray[np.int64]) -> Array:
    """Returns the centers (m, 3) of groups of connected lines that are smaller than ``SMALL``."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    used, link = np.unique(edges, return_inverse=True)
    link = link.reshape(-1, 2)
    graph = coo_array((np.ones(len(link), dtype=bool), link.T), shape=(len(used),) * 2)
    parts, part = connected_components(graph, directed=False)
    of_line = part[link[:, 0]]
    low, high = np.full((parts, 3), np.inf), np.full((parts, 3), -np.inf)
    np.minimum.at(low, of_line, places.min(axis=1))
    np.maximum.at(high, of_line, places.max(axis=1))
    small = (high - low)[:, :2].max(axis=1) < SMALL
    return 0.5 * (low + high)[small]


def _thin_out(spots: Array) -> Array:
    """Returns ``spots`` (n, 2) reduced to one per cell of a coarse grid."""
    _, first = np.unique(np.round(spots / RING), axis=0, return_index=True)
    return spots[np.sort(first)]


def _draw_axes(axes: Any, view: View) -> None:
    rows, columns = view.size
    origin, length = np.array([0.095 * columns, 0.90 * rows]), 0.055 * columns
    for name, color, axis in zip("xyz", ("#b00000", "#007000", "#0000b0"), np.eye(3), strict=True):
        arrow = length * np.array([axis @ view.right, -(axis @ view.up)])
        if np.linalg.norm(arrow) < 0.1 * length:
            continue
        tip = origin + arrow
        axes.annotate("", tip, origin, arrowprops={"arrowstyle": "->", "color": color, "lw": 1.4})
        axes.text(*(origin + 1.28 * arrow), name, color=color, ha="center", va="center", fontsize="medium")


def length_unit(length: float) -> tuple[str, float]:
    """Returns the unit in which ``length`` [m] is at least 1, and its size [m]."""
    for unit, factor in (("km", 1e3), ("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if length >= factor:
            return unit, factor
    return "nm", 1e-9


def _draw_bar(axes: Any, view: View) -> None:
    rows, columns = view.size
    longest = BAR * columns / view.scale
    decade = 10.0 ** np.floor(np.log10(longest))
    length = decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= longest)
    unit, factor = length_unit(float(length) * (1.0 + 1e-9))
    right, y = 0.95 * columns, 0.94 * rows
    left, tick = right - length * view.scale, 0.008 * rows
    axes.plot(
        [left, left, left, right, right, right], [y - tick, y + tick, y, y, y - tick, y + tick], "k-", lw=1.4
    )
    axes.text(0.5 * (left + right), y - 1.5 * tick, f"{length / factor:g} {unit}", ha="center", va="bottom")


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
