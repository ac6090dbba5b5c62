"""How far a ring and a convex body that it is threaded on are apart, however deep its core runs in the body.

With c(n) the point of the core circle that is farthest along n,

    g(n) = n·c(n) − h_b(n)

is the width of the gap across the tube there, on the side of the hole. The azimuth of n is that of the place, so
ways out of the body for all places of the ring are a loop of directions around its axis. The gap is the least g on
the loop where that is largest: by no shorter move does the ring come off the body around it. By that it does where
the hole has room on the other side; a body that is too thick for it, or too much askew, then overlaps there. It is
as well the largest g on the path from one pole to the other where that is least: both meet in a saddle of g, where
the points have facing normals.

That saddle is looked for on a grid of directions: those below a level, as bits, hold a path between the poles or
do not. Next to the cell that joins them there may be several that are about as high: a finer grid around it, from
side to side of the loop, tells them apart, and a finer one in that, as often as needed. Cells elsewhere that would
join the poles at a level no higher than the grid tells are looked at likewise: the lowest of these saddles counts.
"""

import functools
import math
from types import SimpleNamespace
from typing import Any

import warp as wp
from warpcontact.kernels.shapes import torus_saddles
from warpcontact.kernels.shapes.base import Shape, half, one, real, vec3d, zero
from warpcontact.kernels.shapes.torus_saddles import DirectionSample

#: Directions around the axis, and between the poles: bits of a word. Finer grids have as many columns as rows.
COLUMNS = 64
ROWS = 32
COLUMN = wp.constant(real(2.0 * math.pi / COLUMNS))
# On average; at the equator 1.4 of it, so that an edge of g through a cell is within this of its middle.
ROW = wp.constant(real(math.pi / ROWS))
# Rows are closer to each other at the poles, where the center turns around, than at the equator.
POLE_DENSITY = wp.constant(real(0.4))
QUARTER = wp.constant(real(0.5 * math.pi))
BIT = wp.constant(wp.uint32(1))
LAST_BIT = wp.constant(wp.uint32(1 << (ROWS - 1)))
NO_BITS = wp.constant(wp.uint32(0))
# How far from the cell the saddle may be [rad], and how much of that from one of a finer grid; number of grids.
SEARCH_RADIUS = wp.constant(real(0.2))
RADIUS_REDUCTION = wp.constant(real(0.25))
MAX_GRIDS = wp.constant(wp.int32(8))
# Cells of the whole grid that finer ones are about.
MAX_PASSES = wp.constant(wp.int32(4))
# Of the distance to a pole: there the center turns around, and beyond it the loop passes once more.
POLE_FRACTION = wp.constant(real(0.7))
# A cell of a finer grid, over its radius.
CELL_WIDTH = wp.constant(real(2.0 / ROWS))
# A cell that is nearer to the boundary of a grid is not well inside.
INNER_MARGIN = wp.constant(wp.int32(3))
LAST_ROW = wp.constant(wp.int32(ROWS - 1))
# By how much the grid is off, over R: usually, and at most.
GRID_ERROR = wp.constant(real(2.0e-3))
GRID_ERROR_MAX = wp.constant(real(0.02))

BitColumns = wp.types.vector(COLUMNS, wp.uint32)


@wp.struct
class DirectionGrid:
    """Directions: all, or those around one, in columns from side to side of the loop."""

    is_global: wp.bool
    middle: vec3d
    e_1: vec3d  # along the loop
    e_2: vec3d  # across
    radius: real


@wp.func
def connects_rows(below: BitColumns, is_global: wp.bool):
    """Whether the bits hold a path from the first row to the last; the whole grid is closed around the axis."""
    reached = BitColumns()
    columns = wp.where(is_global, wp.int32(COLUMNS), wp.int32(ROWS))
    for i in range(columns):
        reached[i] = below[i] & BIT
    refining = wp.bool(True)
    while refining:
        refining = wp.bool(False)
        for i in range(columns):
            word = reached[i]
            if is_global or i > 0:
                word = word | reached[(i + columns - 1) % columns]
            if is_global or i < columns - 1:
                word = word | reached[(i + 1) % columns]
            word = word & below[i]
            spread = word | ((word << BIT | word >> BIT) & below[i])
            while spread != word:
                word = spread
                spread = word | ((word << BIT | word >> BIT) & below[i])
            if word != reached[i]:
                reached[i] = word
                refining = wp.bool(True)
                if (word & LAST_BIT) != NO_BITS:
                    return wp.bool(True)
    return wp.bool(False)


@functools.cache
def functions(B: type[Shape]) -> SimpleNamespace:
    """Returns the device functions of a torus and a convex body, each for a ``DirectionSample`` and if one exists.

    - ``interlocked_gap(p_a, p_b, x, q, lower_limit, upper_limit)``: where the largest loop is least,
      if that is above the first and not above the second [m]; where the grid has one that is not
      found to the last digit, ``tangential_offset`` is infinite.
    - ``loop_at_pole(p_a, p_b, x, q, pole, lower_limit, upper_limit)``: the same of a loop around a pole, where
      g is ``lower_limit``, so near that the grid does not see it.
    """
    rows = wp.constant(wp.int32(ROWS))
    saddles = torus_saddles.functions(B)
    ridge_value, loop_direction, normals_face = saddles.ridge_value, saddles.loop_direction, saddles.normals_face
    smooth_saddle, sharp_saddle, saddle_around_pole = (
        saddles.smooth_saddle,
        saddles.sharp_saddle,
        saddles.saddle_around_pole,
    )

    @wp.func
    def direction(q: wp.quatd, grid: DirectionGrid, cell: wp.int32):
        column = real(cell // rows)
        row = real(cell % rows) + half
        if grid.is_global:
            azimuth = column * COLUMN
            up = row * ROW / QUARTER - one
            latitude = QUARTER * up * (one + POLE_DENSITY * (one - up * up))
            level = wp.cos(latitude)
            return wp.quat_rotate(q, vec3d(level * wp.cos(azimuth), level * wp.sin(azimuth), wp.sin(latitude)))
        along = grid.radius * (CELL_WIDTH * (column + half) - one)
        aside = grid.radius * (CELL_WIDTH * row - one)
        return wp.normalize(grid.middle + along * grid.e_1 + aside * grid.e_2)

    @wp.func
    def value(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, grid: DirectionGrid, cell: wp.int32):
        """The value of g in a cell."""
        within = wp.where(grid.is_global, real(ROW), CELL_WIDTH * grid.radius)
        return ridge_value(p_a, p_b, x, q, direction(q, grid, cell), within)

    @wp.func
    def find_pass(
        p_a: Any,
        p_b: Any,
        x: vec3d,
        q: wp.quatd,
        grid: DirectionGrid,
        floor: real,
        ceiling: real,
        excluded: BitColumns,
    ):
        """The cell that joins the first row to the last at the least level between two, or −1; that."""
        columns = wp.where(grid.is_global, wp.int32(COLUMNS), wp.int32(ROWS))
        level = floor
        below = BitColumns()
        undecided = BitColumns()
        count = wp.int32(0)
        for i in range(columns):
            for j in range(rows):
                bit = BIT << wp.uint32(j)
                if grid.is_global:
                    g = value(p_a, p_b, x, q, grid, i * rows + j)
                    if (excluded[i] & bit) != NO_BITS:
                        g = real(wp.inf)
                    if g < floor:
                        below[i] = below[i] | bit
                    elif g < ceiling:
                        undecided[i] = undecided[i] | bit
                        count += 1
                else:
                    undecided[i] = undecided[i] | bit
                    count += 1
        pass_at = wp.int32(-1)
        if connects_rows(below, grid.is_global):
            count = wp.int32(0)
        # Open cells are halved by the value of one of them.
        while count > 0 and pass_at < 0:
            skip = count // 2
            pivot = wp.int32(-1)
            for i in range(columns):
                for j in range(rows):
                    if pivot < 0 and (undecided[i] >> wp.uint32(j) & BIT) != NO_BITS:
                        if skip == 0:
                            pivot = i * rows + j
                        skip -= 1
            level = value(p_a, p_b, x, q, grid, pivot)
            lower = BitColumns()
            lower_count = wp.int32(0)
            trial = BitColumns()
            for i in range(columns):
                trial[i] = below[i]
                for j in range(rows):
                    cell = i * rows + j
                    if (undecided[i] >> wp.uint32(j) & BIT) != NO_BITS and cell != pivot:
                        if value(p_a, p_b, x, q, grid, cell) < level:
                            lower[i] = lower[i] | (BIT << wp.uint32(j))
                            lower_count += 1
                trial[i] = trial[i] | lower[i]
            if connects_rows(trial, grid.is_global):
                undecided = lower
                count = lower_count
            else:
                own = BIT << wp.uint32(pivot % rows)
                trial[pivot // rows] = trial[pivot // rows] | own
                if connects_rows(trial, grid.is_global):
                    pass_at = pivot
                below = trial
                for i in range(columns):
                    undecided[i] = undecided[i] & ~trial[i]
                count -= lower_count + 1
        return pass_at, level

    @wp.func
    def is_expected_saddle(
        p_a: Any,
        at: DirectionSample,
        n: vec3d,
        radius: real,
        level: real,
        tangential_offset: real,
        upper_limit: real,
    ):
        """Whether that is the saddle next to a direction that is as high as the level: others are elsewhere."""
        level_matches = wp.abs(at.gap - level) <= tangential_offset * p_a.major_radius and at.gap <= upper_limit
        return level_matches and normals_face(p_a, at) and wp.length(at.normal - n) <= radius

    @wp.func
    def loop_at_pole(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d, lower_limit: real, upper_limit: real):
        at, exists = saddle_around_pole(p_a, p_b, x, q, pole)
        in_range = at.gap > lower_limit and at.gap <= wp.min(
            upper_limit, lower_limit + GRID_ERROR_MAX * p_a.major_radius
        )
        return at, exists and in_range and normals_face(p_a, at)

    @wp.func
    def mark_covered(q: wp.quatd, grid: DirectionGrid, excluded: BitColumns):
        """The cells of the whole grid that are, with those that a finer one is about."""
        global_grid = DirectionGrid()
        global_grid.is_global = wp.bool(True)
        columns = wp.int32(COLUMNS)
        cells = BitColumns()
        for i in range(columns):
            cells[i] = excluded[i]
            for j in range(rows):
                if wp.length(direction(q, global_grid, i * rows + j) - grid.middle) <= grid.radius:
                    cells[i] = cells[i] | (BIT << wp.uint32(j))
        return cells

    @wp.func
    def refined_grid(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, radius: real):
        """The grid around a direction, in which a loop next to it runs from side to side."""
        n_A = wp.quat_rotate_inv(q, n)
        grid = DirectionGrid()
        grid.radius = wp.min(radius, POLE_FRACTION * wp.length(vec3d(n_A[0], n_A[1], zero)))
        grid.middle = n
        grid.e_1 = loop_direction(p_a, p_b, x, q, n, grid.radius)
        grid.e_2 = wp.cross(n, grid.e_1)
        return grid

    @wp.func
    def interlocked_gap(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, lower_limit: real, upper_limit: real):
        size = p_a.major_radius
        best = DirectionSample()
        excluded = BitColumns()
        global_grid = DirectionGrid()
        global_grid.is_global = wp.bool(True)
        first, grid_level = find_pass(
            p_a, p_b, x, q, global_grid, lower_limit - GRID_ERROR_MAX * size, real(wp.inf), excluded
        )
        if first < 0:
            return best, wp.bool(False)
        # From there paths begin: no loop is as high, or a small one.
        at_pole = first % rows == 0 or first % rows == LAST_ROW
        found = wp.bool(False)
        # The lowest of those looked at.
        lowest = real(wp.inf)
        cell = first
        level = grid_level
        passes = wp.int32(0)
        while cell >= 0:
            n = direction(q, global_grid, cell)
            radius = SEARCH_RADIUS
            found_here = wp.bool(False)
            fallback = DirectionSample()
            error = real(wp.inf)
            count = wp.int32(0)
            refining = wp.bool(True)
            while refining:
                at = smooth_saddle(p_a, p_b, x, q, n)
                accepted = is_expected_saddle(p_a, at, n, radius, level, GRID_ERROR, upper_limit)
                # Of an edge; bisection costs more than another grid.
                if not accepted and (at_pole or count > 0):
                    at = sharp_saddle(p_a, p_b, x, q, n, radius)
                    accepted = is_expected_saddle(p_a, at, n, radius, level, GRID_ERROR, upper_limit)
                # Along a flat loop it may be farther off, and at a pole there is no finer grid.
                plausible = is_expected_saddle(
                    p_a, at, n, SEARCH_RADIUS, level, wp.where(at_pole, GRID_ERROR_MAX, GRID_ERROR), upper_limit
                )
                if plausible and wp.abs(at.gap - level) < error:
                    error = wp.abs(at.gap - level)
                    fallback = at
                # The lower of two that the first grid does not tell apart.
                if accepted and (not found or at.gap < best.gap):
                    best = at
                    found = wp.bool(True)
                found_here = found_here or accepted
                count += 1
                # Where it is no better it is not missed.
                lower = level <= lower_limit - GRID_ERROR * size and grid_level <= lower_limit
                refining = not at_pole and not lower and count < MAX_GRIDS and (not found_here or count < 2)
                if refining:
                    grid = refined_grid(p_a, p_b, x, q, n, radius)
                    if count == 1:
                        excluded = mark_covered(q, grid, excluded)
                    at_cell, at_level = find_pass(p_a, p_b, x, q, grid, zero, zero, excluded)
                    level = at_level
                    n = direction(q, grid, at_cell)
                    row = at_cell % rows
                    column = at_cell // rows
                    if (
                        wp.min(row, LAST_ROW - row) >= INNER_MARGIN
                        and wp.min(column, LAST_ROW - column) >= INNER_MARGIN
                    ):
                        radius = RADIUS_REDUCTION * grid.radius
            if not found_here and error < real(wp.inf) and (not found or fallback.gap < best.gap):
                best = fallback
                found = wp.bool(True)
            lowest = wp.min(lowest, level)
            if found:
                lowest = wp.min(lowest, best.gap)
            passes += 1
            cell = wp.int32(-1)
            if passes < MAX_PASSES and count > 1:
                # Another that is elsewhere, but about as high.
                cell, level = find_pass(
                    p_a, p_b, x, q, global_grid, grid_level, lowest + GRID_ERROR * size, excluded
                )
        if not found:
            # No direction of the grid is near enough to a small loop.
            pole = wp.quat_rotate(q, vec3d(zero, zero, wp.where(2 * (first % rows) > LAST_ROW, one, -one)))
            at, exists = saddle_around_pole(p_a, p_b, x, q, pole)
            level_matches = wp.abs(at.gap - grid_level) <= GRID_ERROR_MAX * size and at.gap <= upper_limit
            if exists and level_matches and normals_face(p_a, at):
                best = at
                found = wp.bool(True)
        if not found:
            best.tangential_offset = vec3d(real(wp.inf))
            return best, grid_level > lower_limit
        return best, best.gap > lower_limit

    return SimpleNamespace(interlocked_gap=interlocked_gap, loop_at_pole=loop_at_pole)
