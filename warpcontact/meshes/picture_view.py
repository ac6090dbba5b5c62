"""Orthographic view of a surface: choice of the direction, projection, rasterization and visibility."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpcontact.validation.checks import Array

Index = npt.NDArray[np.int64]

# Candidate elevations [°], number of azimuths, and first azimuth [°], which is not along an axis.
ELEVATIONS, AROUND, OFFSET = (30.0, 55.0, -30.0), 8, -65.0
# Bonus for views from above, as a fraction of the visible area.
FROM_ABOVE = 0.03
# Fraction of the picture filled by the surface, and its upward shift, which leaves space for axes and scale bar.
FILLED, RAISED = 0.82, 0.045
# Depth behind the surface up to which a line on it is visible, as a fraction of the picture size.
TOLERANCE = 4.0e-3
# Number of scan lines, or pixels, processed per block.
AT_ONCE = 2_000_000


@dataclass(frozen=True)
class View:
    """Direction of view and mapping to picture coordinates.

    Attributes:
        direction: Unit vector to the camera.
        right, up: Unit vectors in the plane of the picture.
        centre: Point at the center of the picture [m].
        scale: Pixels per meter.
        size: Numbers of rows and columns of pixels.
    """

    direction: Array
    right: Array
    up: Array
    centre: Array
    scale: float
    size: tuple[int, int]

    @classmethod
    def towards(cls, direction: Array, points: Array, size: tuple[int, int]) -> "View":
        """Returns the view from ``direction`` (3,) that shows all ``points`` (n, 3) in a picture of ``size``."""
        eye = direction / np.linalg.norm(direction)
        # z is up; in views along z, y is up.
        upright = np.array([0.0, 1.0, 0.0]) if abs(eye[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
        right = np.cross(upright, eye)
        right /= np.linalg.norm(right)
        up = np.cross(eye, right)
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        flat = (points - middle) @ np.stack([right, up], axis=1)
        low, high = flat.min(axis=0), flat.max(axis=0)
        # Limit the extent from below, for surfaces seen edge-on or of zero size.
        extent = np.maximum(high - low, 1e-3 * (np.ptp(points, axis=0).max() or 1.0))
        scale = FILLED * min(size[1] / extent[0], size[0] / extent[1])
        offset = 0.5 * (low + high) - (0.0, RAISED * size[0] / scale)
        return cls(eye, right, up, middle + offset[0] * right + offset[1] * up, float(scale), size)

    def project(self, points: Array) -> Array:
        """Returns column, row and depth of points (…, 3), all in pixels."""
        local = points - self.centre
        column = 0.5 * self.size[1] + self.scale * (local @ self.right)
        row = 0.5 * self.size[0] - self.scale * (local @ self.up)
        return np.stack([column, row, -self.scale * (local @ self.direction)], axis=-1)

    def visible(self, places: Array, depth: Array) -> npt.NDArray[np.bool_]:
        """Returns which of the projected points (n, 3) are not hidden.

        Args:
            places: Result of ``project``, (n, 3).
            depth: Depth in each pixel; infinite where there is no surface.
        """
        rows, columns = self.size
        column, row = places[:, 0].astype(np.int64), places[:, 1].astype(np.int64)
        farthest = np.full(len(places), -np.inf)
        # Compare with the neighboring pixels too: on slopes and at boundaries their depth differs.
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                near = depth[np.clip(row + i, 0, rows - 1), np.clip(column + j, 0, columns - 1)]
                farthest = np.maximum(farthest, near)
        return places[:, 2] <= farthest + TOLERANCE * max(self.size)


def best_direction(cross: Array) -> Array:
    """Returns the candidate direction from which most of the outer side is visible.

    Args:
        cross: Face normals with twice the areas as lengths, (F, 3).
    """
    candidates = np.array(
        [
            (np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e))
            for e in np.radians(ELEVATIONS)
            for a in np.radians(OFFSET + np.arange(AROUND) * 360.0 / AROUND)
        ]
    )
    total = np.linalg.norm(cross, axis=1).sum() or 1.0
    seen = np.array([np.maximum(cross @ direction, 0.0).sum() for direction in candidates]) / total
    # Round, so that the first of equally good directions is chosen.
    worth = np.round(seen + FROM_ABOVE * (candidates[:, 2] > 0.0), 6)
    return candidates[int(worth.argmax())]


def direction_text(direction: Array) -> str:
    """Returns a direction as text: azimuth from x towards y, elevation above the x–y plane."""
    elevation = np.degrees(np.arcsin(np.clip(direction[2], -1.0, 1.0)))
    if abs(elevation) > 89.0:
        return "from above, +z" if elevation > 0.0 else "from below, −z"
    azimuth = round(np.degrees(np.arctan2(direction[1], direction[0])))
    where = "above" if elevation >= 0.0 else "below"
    return f"from azimuth {str(azimuth).replace('-', '−')}°, {abs(elevation):.0f}° {where}"


def paint(corners: Array, size: tuple[int, int]) -> tuple[Index, Array]:
    """Returns the triangle visible in each pixel, −1 if there is none, and its depth, infinite if there is none.

    A pixel belongs to the triangle that contains its center, and adjacent triangles leave no gap. At equal depth, the
    triangle with the highest index is visible. Scan lines of many triangles are filled in one vectorized operation.

    Args:
        corners: Vertices of each triangle in the picture, (F, 3, 3): column, row and depth. The pixel in column i
            and row j has its center at (i + ½, j + ½). Smaller depths are nearer.
        size: Numbers of rows and columns.
    """
    height, width = size
    depth = np.full(height * width, np.inf)
    seen = np.full(height * width, -1, dtype=np.int64)
    # Sort vertices by row: both triangles at an edge then compute identical points on it.
    order = np.lexsort((corners[..., 0], corners[..., 1]), axis=1)
    corners = np.take_along_axis(corners, order[..., None], axis=1)
    first = np.clip(np.ceil(corners[:, 0, 1] - 0.5), 0, height).astype(np.int64)
    last = np.clip(np.ceil(corners[:, 2, 1] - 0.5), 0, height).astype(np.int64)
    for face, row in _ranges(np.arange(len(corners)), first, last):
        left, right, start, end = _ends(corners[face], row.astype(np.float64) + 0.5)
        begin = np.clip(np.ceil(left - 0.5), 0, width).astype(np.int64)
        stop = np.clip(np.ceil(right - 0.5), 0, width).astype(np.int64)
        slope = (end - start) / np.maximum(right - left, 1e-300)
        for span, column in _ranges(np.arange(len(face)), begin, stop):
            pixel = row[span] * width + column
            z = start[span] + slope[span] * (column + 0.5 - left[span])
            np.minimum.at(depth, pixel, z)
            front = z == depth[pixel]
            seen[pixel[front]] = face[span[front]]
    return seen.reshape(size), depth.reshape(size)


def _ends(corners: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Returns the ends of scan lines in triangles: left and right column, and the depths there.

    Args:
        corners: Vertices sorted by row, (n, 3, 3).
        y: Row of each line, between the first and the last vertex, (n,).
    """
    low, middle, high = corners.swapaxes(0, 1)
    x_long, z_long = _along(low, high, y)
    below = y <= middle[:, 1]
    x_low, z_low = _along(low, middle, y)
    x_high, z_high = _along(middle, high, y)
    x_short, z_short = np.where(below, x_low, x_high), np.where(below, z_low, z_high)
    swap = x_short < x_long
    left, right = np.where(swap, x_short, x_long), np.where(swap, x_long, x_short)
    start, end = np.where(swap, z_short, z_long), np.where(swap, z_long, z_short)
    return left, right, start, end


def _along(a: Array, b: Array, y: Array) -> tuple[Array, Array]:
    """Returns column and depth of the points on edges a–b in row ``y``."""
    run = b[:, 1] - a[:, 1]
    part = np.where(run > 0.0, (y - a[:, 1]) / np.where(run > 0.0, run, 1.0), 0.0)
    return a[:, 0] + part * (b[:, 0] - a[:, 0]), a[:, 2] + part * (b[:, 2] - a[:, 2])


def _ranges(items: Index, begin: Index, stop: Index) -> Iterator[tuple[Index, Index]]:
    """Iterates over blocks of all pairs of an item and a number from its ``begin`` up to, excluding, its ``stop``."""
    counts = np.maximum(stop - begin, 0)
    ends = np.cumsum(counts)
    start = 0
    while start < len(items):
        before = ends[start - 1] if start else 0
        # At least one item per block, however long it is.
        after = max(start + 1, int(np.searchsorted(ends, before + AT_ONCE, side="right")))
        part = slice(start, after)
        item = np.repeat(items[part], counts[part])
        within = np.arange(len(item)) - np.repeat(ends[part] - counts[part] - before, counts[part])
        if len(item):
            yield item, np.repeat(begin[part], counts[part]) + within
        start = after
