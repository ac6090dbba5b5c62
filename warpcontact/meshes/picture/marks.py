"""Marks drawn over the surface: lines and symbols at its defects, axes, and a scale bar."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.picture.defects import Defects
from warpcontact.meshes.picture.view import View

Array = npt.NDArray[np.float64]

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
