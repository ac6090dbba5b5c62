"""Rasterization of triangles with a depth buffer: visible triangle and depth of each pixel.

Scan lines of many triangles are filled in one vectorized operation. A pixel belongs to the triangle that contains its center, and adjacent
triangles leave no gap.
"""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

# Number of scan lines, or pixels, processed per block.
AT_ONCE = 2_000_000

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]


def paint(corners: Array, size: tuple[int, int]) -> tuple[Index, Array]:
    """Returns the triangle visible in each pixel, −1 if there is none, and its depth, infinite if there is none.

    At equal depth, the triangle with the highest index is visible.

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
