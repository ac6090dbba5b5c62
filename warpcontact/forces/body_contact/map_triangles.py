"""Triangles of pressure maps: division where the depth of columns varies, and removal of hidden layers."""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array

# Largest difference of depths within a triangle, relative to the largest depth of its pair.
DEPTH_STEP = 1.0 / 6.0
# Largest edge of a triangle next to a place where columns enter, relative to the extent of the area of contact.
CELL = 1.0 / 24.0
# Tests of points against triangles in one block.
_BLOCK = 4_000_000


@dataclass(frozen=True, eq=False)
class MapTriangles:
    """Triangles of a pressure map, without common vertices: [triangle].

    Attributes:
        env: Environments.
        pair: Pairs.
        side: Solid on which the columns stand: 0, the second; 1, the first.
        face: Face on which they stand; −1: a curved surface.
        weight: Weight of the area; negative where columns enter the other solid.
        positions: Vertices relative to the origin of the pair, (n, 3, 3), world axes [m].
        normals: Unit normals out of the second solid at the vertices, (n, 3, 3), world axes.
        depths: Depths of the columns, (n, 3) [m].
        entries: Depths of columns that are subtracted, (n, 3) [m].
        factors: Factors on the pressure, (n, 3), 0 to 1.
    """

    env: NDArray[np.int32]
    pair: NDArray[np.int32]
    side: NDArray[np.int32]
    face: NDArray[np.int32]
    weight: Array
    positions: Array
    normals: Array
    depths: Array
    entries: Array
    factors: Array

    def __len__(self) -> int:
        return len(self.env)

    @property
    def pair_keys(self) -> NDArray[np.int64]:
        """Numbers that are equal for triangles of the same pair in the same environment."""
        return self.env.astype(np.int64) * (int(self.pair.max(initial=0)) + 1) + self.pair

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        """Returns some of the triangles."""
        return replace(self, **{one.name: getattr(self, one.name)[rows] for one in fields(self)})

    def joined(self, *others: "MapTriangles") -> Self:
        """Returns these and other triangles."""
        parts = [self, *others]
        return replace(
            self, **{one.name: np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(self)}
        )

    def halves(self, edge: NDArray[np.intp]) -> Self:
        """Returns both halves of each triangle, divided at the midpoint of edge ``edge`` (n,), from vertex i to i + 1."""
        rows = np.arange(len(self))
        start, end = edge, (edge + 1) % 3
        parts = []
        for replaced in (start, end):
            own = {}
            for name in ("positions", "normals", "depths", "entries", "factors"):
                values = getattr(self, name).copy()
                values[rows, replaced] = 0.5 * (values[rows, start] + values[rows, end])
                if name == "normals":
                    values[rows, replaced] /= np.linalg.norm(values[rows, replaced], axis=-1, keepdims=True)
                own[name] = values
            parts.append(replace(self, **own))
        return parts[0].joined(parts[1])

    def edges(self, values: Array) -> Array:
        """Returns the differences along the edges of values at vertices (n, 3, …), from vertex i to i + 1."""
        return np.roll(values, -1, axis=1) - values


def groups_of(keys: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Returns the order in which equal keys are consecutive, and the start of each group of them."""
    order = np.argsort(keys, kind="stable")
    sorted_keys = keys[order]
    return order, np.flatnonzero(np.concatenate([[True], sorted_keys[1:] != sorted_keys[:-1]]))


def refine(triangles: MapTriangles) -> MapTriangles:
    """Returns triangles in which depths vary by little of the largest depth of their pair."""
    if not len(triangles):
        return triangles
    order, starts = groups_of(triangles.pair_keys)
    largest = np.maximum.reduceat(triangles.depths.max(axis=1)[order], starts)
    limits = np.empty(len(triangles))
    limits[order] = DEPTH_STEP * np.repeat(largest, np.diff([*starts, len(order)]))
    finished, pending = [], triangles
    while len(pending):
        changes = np.abs(pending.edges(pending.depths))
        divided = changes.max(axis=1) > limits
        finished.append(pending.select(~divided))
        pending, limits = pending.select(divided), np.tile(limits[divided], 2)
        pending = pending.halves(changes[divided].argmax(axis=1))
    return finished[0].joined(*finished[1:])


def hide_layers(triangles: MapTriangles, half_spaces: NDArray[np.bool_]) -> MapTriangles:
    """Returns the triangles without those that columns do not reach.

    Columns that stand on a face and pass through a solid that is not convex may cross several of its faces. They end at the first
    exit, where they do not enter before. On a half-space each exit counts, less the entry above it. Faces with entries are
    divided into small triangles, and the center of each decides; other faces are not changed.

    Args:
        triangles: The triangles.
        half_spaces: Whether the second solid of each pair is a half-space, [pair].
    """
    if not (triangles.weight < 0.0).any():
        return triangles
    rows = np.stack([triangles.env, triangles.pair, triangles.side, triangles.face], axis=1)
    keys = np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
    layered = np.zeros(keys.max() + 1, dtype=bool)
    layered[keys[triangles.weight < 0.0]] = True
    parts = [triangles.select(~layered[keys])]
    extents = _extents(triangles)
    order, starts = groups_of(keys)
    for group in np.split(order, starts[1:]):
        if layered[keys[group[0]]]:
            own = triangles.select(group)
            parts.append(_visible(own, bool(half_spaces[own.pair[0]]), CELL * extents[group[0]]))
    return parts[0].joined(*parts[1:])


def _extents(triangles: MapTriangles) -> Array:
    """Returns the extent of the area of contact of each pair, [triangle] [m]."""
    order, starts = groups_of(triangles.pair_keys)
    positions = triangles.positions[order]
    lower, upper = (
        ends.reduceat(values(positions, axis=1), starts)
        for ends, values in ((np.minimum, np.min), (np.maximum, np.max))
    )
    extents = np.empty(len(triangles))
    extents[order] = np.repeat((upper - lower).max(axis=1), np.diff([*starts, len(order)]))
    return extents


def _visible(face: MapTriangles, half_space: bool, largest: float) -> MapTriangles:
    """Returns the visible part of the triangles of one face, divided into triangles with edges up to ``largest`` [m]."""
    cells = face.select(face.weight > 0.0)
    if not len(cells):
        return cells
    normal = cells.normals[0, 0]
    axis = np.eye(3)[int(np.argmin(np.abs(normal)))]
    u = np.cross(normal, axis)
    u /= np.linalg.norm(u)
    axes = np.stack([u, np.cross(normal, u)], axis=1)
    entries = face.select(face.weight < 0.0)
    corners = entries.positions @ axes
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    finished = []
    while len(cells):
        lengths = np.linalg.norm(cells.edges(cells.positions), axis=-1)
        divided = lengths.max(axis=1) > largest
        # Only triangles next to an entry are divided.
        points = cells.positions[divided] @ axes
        low, high = points.min(axis=1)[:, None], points.max(axis=1)[:, None]
        divided[divided] = ((low < upper) & (high > lower)).all(axis=-1).any(axis=1)
        finished.append(cells.select(~divided))
        cells = cells.select(divided)
        cells = cells.halves(lengths[divided].argmax(axis=1))
    cells = finished[0].joined(*finished[1:])
    above = _depths_above(cells.positions @ axes, cells.depths, corners, entries.depths)
    if not half_space:
        return cells.select(np.isinf(above[:, 0]))
    # The deepest entry above each exit.
    deepest = np.where(np.isfinite(above[:, :1]), above, 0.0)
    return replace(cells, entries=np.clip(deepest, 0.0, cells.depths))


def _depths_above(cells: Array, cell_depths: Array, entries: Array, entry_depths: Array) -> Array:
    """Returns the depth of the deepest entry above the center of each cell.

    Args:
        cells: Vertices of the cells in the plane of the face, (n, 3, 2) [m].
        cell_depths: Depths of columns at their vertices, (n, 3) [m].
        entries: Vertices of the triangles at which columns enter, (m, 3, 2) [m].
        entry_depths: Depths at their vertices, (m, 3) [m].

    Returns:
        Depths at the vertices of the cells, (n, 3) [m]; −∞: there is no entry.
    """
    found = np.full((len(cells), 3), -np.inf)
    first, second = entries[:, 1] - entries[:, 0], entries[:, 2] - entries[:, 0]
    twice = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    good = np.abs(twice) > 0.0
    if not good.any():
        return found
    first, second, twice = first[good], second[good], twice[good, None]
    origin, depths = entries[good, 0], entry_depths[good]
    slopes = depths[:, 1:] - depths[:, :1]
    size = max(1, _BLOCK // len(origin))
    for start in range(0, len(cells), size):
        rows = slice(start, start + size)
        # Vertices and center, (cell, entry, 4, 2).
        points = np.concatenate([cells[rows], cells[rows].mean(axis=1, keepdims=True)], axis=1)
        away = points[:, None] - origin[:, None]
        a = (away[..., 0] * second[:, None, 1] - away[..., 1] * second[:, None, 0]) / twice
        b = (first[:, None, 0] * away[..., 1] - first[:, None, 1] * away[..., 0]) / twice
        at = depths[:, :1] + a * slopes[:, :1] + b * slopes[:, 1:]
        inside = (a[..., 3] >= 0.0) & (b[..., 3] >= 0.0) & (a[..., 3] + b[..., 3] <= 1.0)
        # An entry at the base itself counts half, and hides from there on.
        inside &= (at[..., 3] >= 0.0) & (at[..., 3] < cell_depths[rows].mean(axis=1)[:, None])
        center = np.where(inside, at[..., 3], -np.inf)
        best, number = center.argmax(axis=1), np.arange(len(center))
        hit = np.isfinite(center[number, best])[:, None]
        found[rows] = np.where(hit, at[number, best, :3], -np.inf)
    return found
