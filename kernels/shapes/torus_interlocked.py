"""Gap of a torus and a convex body through its hole, for any depth of the core circle in the body.

With c(n) the point of the core circle farthest along n, g(n) = n·c(n) − h_b(n) is the gap across the tube. The
azimuth of n is that of the point, so separations at all points of the torus are a loop of directions around its
axis. The gap is the maximum over all loops of the least g. It is also the minimum over all paths between the poles
of the largest g. Both are a saddle of g, where the normals face each other.

The saddle is located on a grid of directions: cells below a level, stored as bits, connect the poles or do not.
Around the cell that connects them, finer grids separate saddles of similar height. Other cells that would connect
the poles at about the same level are refined likewise; the lowest saddle counts.
"""

import functools
import math
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.shapes import torus_saddles
from warpcontact.kernels.shapes.base import Shape, half, one, real, vec3d, zero
from warpcontact.kernels.shapes.torus_saddles import DirectionSample

#: Number of directions around the axis and between the poles (bits of a word). Finer grids are square.
COLUMNS = 64
ROWS = 32
COLUMN = wp.constant(real(2.0 * math.pi / COLUMNS))
# On average. At the equator 1.4 times this, so that an edge of g through a cell is within this of its center.
ROW = wp.constant(real(math.pi / ROWS))
# Rows are denser at the poles, where the center rotates fast, than at the equator.
POLE_DENSITY = wp.constant(real(0.4))
QUARTER = wp.constant(real(0.5 * math.pi))
BIT = wp.constant(wp.uint32(1))
LAST_BIT = wp.constant(wp.uint32(1 << (ROWS - 1)))
NO_BITS = wp.constant(wp.uint32(0))
# Search radius of the saddle around a cell [rad], its reduction from grid to grid, and maximum number of grids.
SEARCH_RADIUS = wp.constant(real(0.2))
RADIUS_REDUCTION = wp.constant(real(0.25))
MAX_GRIDS = wp.constant(wp.int32(8))
# Maximum number of cells of the global grid that are refined.
MAX_PASSES = wp.constant(wp.int32(4))
# Largest radius of a grid, relative to the distance to a pole: beyond the pole the loop passes again.
POLE_FRACTION = wp.constant(real(0.7))
# Width of a cell of a finer grid, relative to its radius.
CELL_WIDTH = wp.constant(real(2.0 / ROWS))
# Smallest number of cells to the boundary of a grid for a cell to be inside.
INNER_MARGIN = wp.constant(wp.int32(3))
LAST_ROW = wp.constant(wp.int32(ROWS - 1))
# Error of the grid, relative to R: usual and maximum.
GRID_ERROR = wp.constant(real(2.0e-3))
GRID_ERROR_MAX = wp.constant(real(0.02))

BitColumns = wp.types.vector(COLUMNS, wp.uint32)


@wp.struct
class DirectionGrid:
    """Grid of directions: global, or around one direction with columns across the loop."""

    is_global: wp.bool
    middle: vec3d
    e_1: vec3d  # along the loop
    e_2: vec3d  # across the loop
    radius: real


@wp.func
def connects_rows(below: BitColumns, is_global: wp.bool):
    """Returns whether set bits connect the first row to the last; the global grid is periodic around the axis."""
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


class Functions(NamedTuple):
    """Device functions of an interlocked torus; each returns a ``DirectionSample`` and a flag."""

    #: ``(p_a, p_b, x, q, lower_limit, upper_limit)``: the saddle, if its gap is above the lower and not above the
    #: upper limit [m]. If the grid has one that does not converge, ``tangential_offset`` is infinite.
    interlocked_gap: wp.Function
    #: ``(p_a, p_b, x, q, pole, lower_limit, upper_limit)``: the same for a loop around a pole that is too small
    #: for the grid; g is ``lower_limit`` at the pole.
    loop_at_pole: wp.Function


@functools.cache
def functions(B: type[Shape]) -> Functions:
    """Returns the device functions of a torus and a convex body."""
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
        """Returns the value of g in a cell."""
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
        """Returns the cell that connects first and last row at the least level (−1: none), and the level."""
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
        # Bisect the undecided cells by the value of one of them.
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
        """Returns whether a saddle belongs to a direction: facing normals, near n, gap equal to the level."""
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
        """Returns the excluded cells of the global grid, with those covered by a finer grid."""
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
        """Returns the grid around a direction, in which a neighboring loop runs from side to side."""
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
        # Paths begin at a pole: there is no loop of this level, or a small one.
        at_pole = first % rows == 0 or first % rows == LAST_ROW
        found = wp.bool(False)
        # The lowest level found.
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
                # The saddle may be on an edge of g; bisection costs more than another grid.
                if not accepted and (at_pole or count > 0):
                    at = sharp_saddle(p_a, p_b, x, q, n, radius)
                    accepted = is_expected_saddle(p_a, at, n, radius, level, GRID_ERROR, upper_limit)
                # On a flat loop the saddle may be farther, and at a pole there is no finer grid.
                plausible = is_expected_saddle(
                    p_a, at, n, SEARCH_RADIUS, level, wp.where(at_pole, GRID_ERROR_MAX, GRID_ERROR), upper_limit
                )
                if plausible and wp.abs(at.gap - level) < error:
                    error = wp.abs(at.gap - level)
                    fallback = at
                # The lower of two saddles that the first grid does not separate.
                if accepted and (not found or at.gap < best.gap):
                    best = at
                    found = wp.bool(True)
                found_here = found_here or accepted
                count += 1
                # No refinement if the saddle cannot exceed the limit.
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
                # Another cell elsewhere, at about the same level.
                cell, level = find_pass(
                    p_a, p_b, x, q, global_grid, grid_level, lowest + GRID_ERROR * size, excluded
                )
        if not found:
            # No direction of the grid is close enough to a small loop.
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

    return Functions(interlocked_gap=interlocked_gap, loop_at_pole=loop_at_pole)
