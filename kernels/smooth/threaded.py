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
from warpcontact.kernels.smooth import saddle
from warpcontact.kernels.smooth.base import Shape, half, one, real, vec3d, zero
from warpcontact.kernels.smooth.saddle import Across

#: Directions around the axis, and between the poles: bits of a word. Finer grids have as many columns as rows.
COLUMNS = 64
ROWS = 32
COLUMN = wp.constant(real(2.0 * math.pi / COLUMNS))
# On average; at the equator 1.4 of it, so that an edge of g through a cell is within this of its middle.
ROW = wp.constant(real(math.pi / ROWS))
# Rows are closer to each other at the poles, where the center turns around, than at the equator.
DENSER = wp.constant(real(0.4))
QUARTER = wp.constant(real(0.5 * math.pi))
BIT = wp.constant(wp.uint32(1))
LAST = wp.constant(wp.uint32(1 << (ROWS - 1)))
NONE = wp.constant(wp.uint32(0))
# How far from the cell the saddle may be [rad], and how much of that from one of a finer grid; number of grids.
REACH = wp.constant(real(0.2))
NEARER = wp.constant(real(0.25))
GRIDS = wp.constant(wp.int32(8))
# Cells of the whole grid that finer ones are about.
PASSES = wp.constant(wp.int32(4))
# Of the distance to a pole: there the center turns around, and beyond it the loop passes once more.
SHORT = wp.constant(real(0.7))
# A cell of a finer grid, over its radius.
WIDE = wp.constant(real(2.0 / ROWS))
# A cell that is nearer to the boundary of a grid is not well inside.
INSIDE = wp.constant(wp.int32(3))
LAST_ROW = wp.constant(wp.int32(ROWS - 1))
# By how much the grid is off, over R: usually, and at most.
SAME = wp.constant(real(2.0e-3))
UNSURE = wp.constant(real(0.02))

Words = wp.types.vector(COLUMNS, wp.uint32)


@wp.struct
class Grid:
    """Directions: all, or those around one, in columns from side to side of the loop."""

    whole: wp.bool
    middle: vec3d
    e_1: vec3d  # along the loop
    e_2: vec3d  # across
    radius: real


@wp.func
def joined(below: Words, whole: wp.bool):
    """Whether the bits hold a path from the first row to the last; the whole grid is closed around the axis."""
    reached = Words()
    columns = wp.where(whole, wp.int32(COLUMNS), wp.int32(ROWS))
    for i in range(columns):
        reached[i] = below[i] & BIT
    going = wp.bool(True)
    while going:
        going = wp.bool(False)
        for i in range(columns):
            word = reached[i]
            if whole or i > 0:
                word = word | reached[(i + columns - 1) % columns]
            if whole or i < columns - 1:
                word = word | reached[(i + 1) % columns]
            word = word & below[i]
            spread = word | ((word << BIT | word >> BIT) & below[i])
            while spread != word:
                word = spread
                spread = word | ((word << BIT | word >> BIT) & below[i])
            if word != reached[i]:
                reached[i] = word
                going = wp.bool(True)
                if (word & LAST) != NONE:
                    return wp.bool(True)
    return wp.bool(False)


@functools.cache
def functions(B: type[Shape]) -> SimpleNamespace:
    """Returns the device functions of a torus and a convex body, each for an ``Across`` and whether there is one.

    - ``threaded(p_a, p_b, x, q, least, most)``: where the largest loop is least, if that is above ``least`` and
      not above ``most`` [m]; where the grid has one that is not found to the last digit, ``off`` is infinite.
    - ``beside_pole(p_a, p_b, x, q, pole, least, most)``: the same of a loop around a pole, where g is ``least``,
      so near that the grid does not see it.
    """
    rows = wp.constant(wp.int32(ROWS))
    of_body = saddle.functions(B)
    height, loop_way, facing = of_body.height, of_body.loop_way, of_body.facing
    smooth, sharp, around_pole = of_body.smooth, of_body.sharp, of_body.around_pole

    @wp.func
    def direction(q: wp.quatd, grid: Grid, cell: wp.int32):
        column = real(cell // rows)
        row = real(cell % rows) + half
        if grid.whole:
            azimuth = column * COLUMN
            up = row * ROW / QUARTER - one
            latitude = QUARTER * up * (one + DENSER * (one - up * up))
            level = wp.cos(latitude)
            return wp.quat_rotate(q, vec3d(level * wp.cos(azimuth), level * wp.sin(azimuth), wp.sin(latitude)))
        along = grid.radius * (WIDE * (column + half) - one)
        aside = grid.radius * (WIDE * row - one)
        return wp.normalize(grid.middle + along * grid.e_1 + aside * grid.e_2)

    @wp.func
    def value(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, grid: Grid, cell: wp.int32):
        """The value of g in a cell."""
        within = wp.where(grid.whole, real(ROW), WIDE * grid.radius)
        return height(p_a, p_b, x, q, direction(q, grid, cell), within)

    @wp.func
    def joining(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, grid: Grid, floor: real, ceiling: real, closed: Words):
        """The cell that joins the first row to the last at the least level between two, or −1; that."""
        columns = wp.where(grid.whole, wp.int32(COLUMNS), wp.int32(ROWS))
        level = floor
        below = Words()
        open = Words()
        count = wp.int32(0)
        for i in range(columns):
            for j in range(rows):
                bit = BIT << wp.uint32(j)
                if grid.whole:
                    g = value(p_a, p_b, x, q, grid, i * rows + j)
                    if (closed[i] & bit) != NONE:
                        g = real(wp.inf)
                    if g < floor:
                        below[i] = below[i] | bit
                    elif g < ceiling:
                        open[i] = open[i] | bit
                        count += 1
                else:
                    open[i] = open[i] | bit
                    count += 1
        pass_at = wp.int32(-1)
        if joined(below, grid.whole):
            count = wp.int32(0)
        # Open cells are halved by the value of one of them.
        while count > 0 and pass_at < 0:
            skip = count // 2
            pivot = wp.int32(-1)
            for i in range(columns):
                for j in range(rows):
                    if pivot < 0 and (open[i] >> wp.uint32(j) & BIT) != NONE:
                        if skip == 0:
                            pivot = i * rows + j
                        skip -= 1
            level = value(p_a, p_b, x, q, grid, pivot)
            lower = Words()
            lower_count = wp.int32(0)
            trial = Words()
            for i in range(columns):
                trial[i] = below[i]
                for j in range(rows):
                    cell = i * rows + j
                    if (open[i] >> wp.uint32(j) & BIT) != NONE and cell != pivot:  # noqa: SIM102  Warp computes both
                        if value(p_a, p_b, x, q, grid, cell) < level:
                            lower[i] = lower[i] | (BIT << wp.uint32(j))
                            lower_count += 1
                trial[i] = trial[i] | lower[i]
            if joined(trial, grid.whole):
                open = lower
                count = lower_count
            else:
                own = BIT << wp.uint32(pivot % rows)
                trial[pivot // rows] = trial[pivot // rows] | own
                if joined(trial, grid.whole):
                    pass_at = pivot
                below = trial
                for i in range(columns):
                    open[i] = open[i] & ~trial[i]
                count -= lower_count + 1
        return pass_at, level

    @wp.func
    def suits(p_a: Any, at: Across, n: vec3d, radius: real, level: real, off: real, most: real):
        """Whether that is the saddle next to a direction that is as high as the level: others are elsewhere."""
        same = wp.abs(at.gap - level) <= off * p_a.major_radius and at.gap <= most
        return same and facing(p_a, at) and wp.length(at.normal - n) <= radius

    @wp.func
    def beside_pole(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, pole: vec3d, least: real, most: real):
        at, there = around_pole(p_a, p_b, x, q, pole)
        near = at.gap > least and at.gap <= wp.min(most, least + UNSURE * p_a.major_radius)
        return at, there and near and facing(p_a, at)

    @wp.func
    def looked_at(q: wp.quatd, grid: Grid, closed: Words):
        """The cells of the whole grid that are, with those that a finer one is about."""
        whole = Grid()
        whole.whole = wp.bool(True)
        columns = wp.int32(COLUMNS)
        cells = Words()
        for i in range(columns):
            cells[i] = closed[i]
            for j in range(rows):
                if wp.length(direction(q, whole, i * rows + j) - grid.middle) <= grid.radius:
                    cells[i] = cells[i] | (BIT << wp.uint32(j))
        return cells

    @wp.func
    def finer(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, n: vec3d, radius: real):
        """The grid around a direction, in which a loop next to it runs from side to side."""
        n_A = wp.quat_rotate_inv(q, n)
        grid = Grid()
        grid.radius = wp.min(radius, SHORT * wp.length(vec3d(n_A[0], n_A[1], zero)))
        grid.middle = n
        grid.e_1 = loop_way(p_a, p_b, x, q, n, grid.radius)
        grid.e_2 = wp.cross(n, grid.e_1)
        return grid

    @wp.func
    def threaded(p_a: Any, p_b: Any, x: vec3d, q: wp.quatd, least: real, most: real):
        size = p_a.major_radius
        best = Across()
        closed = Words()
        whole = Grid()
        whole.whole = wp.bool(True)
        first, rough = joining(p_a, p_b, x, q, whole, least - UNSURE * size, real(wp.inf), closed)
        if first < 0:
            return best, wp.bool(False)
        # From there paths begin: no loop is as high, or a small one.
        at_pole = first % rows == 0 or first % rows == LAST_ROW
        found = wp.bool(False)
        # The lowest of those looked at.
        lowest = real(wp.inf)
        cell = first
        level = rough
        passes = wp.int32(0)
        while cell >= 0:
            n = direction(q, whole, cell)
            radius = REACH
            known = wp.bool(False)
            spare = Across()
            error = real(wp.inf)
            count = wp.int32(0)
            going = wp.bool(True)
            while going:
                at = smooth(p_a, p_b, x, q, n)
                hit = suits(p_a, at, n, radius, level, SAME, most)
                # Of an edge; bisection costs more than another grid.
                if not hit and (at_pole or count > 0):
                    at = sharp(p_a, p_b, x, q, n, radius)
                    hit = suits(p_a, at, n, radius, level, SAME, most)
                # Along a flat loop it may be farther off, and at a pole there is no finer grid.
                likely = suits(p_a, at, n, REACH, level, wp.where(at_pole, UNSURE, SAME), most)
                if likely and wp.abs(at.gap - level) < error:
                    error = wp.abs(at.gap - level)
                    spare = at
                # The lower of two that the first grid does not tell apart.
                if hit and (not found or at.gap < best.gap):
                    best = at
                    found = wp.bool(True)
                known = known or hit
                count += 1
                # Where it is no better it is not missed.
                lower = level <= least - SAME * size and rough <= least
                going = not at_pole and not lower and count < GRIDS and (not known or count < 2)
                if going:
                    grid = finer(p_a, p_b, x, q, n, radius)
                    if count == 1:
                        closed = looked_at(q, grid, closed)
                    at_cell, at_level = joining(p_a, p_b, x, q, grid, zero, zero, closed)
                    level = at_level
                    n = direction(q, grid, at_cell)
                    row = at_cell % rows
                    column = at_cell // rows
                    if wp.min(row, LAST_ROW - row) >= INSIDE and wp.min(column, LAST_ROW - column) >= INSIDE:
                        radius = NEARER * grid.radius
            if not known and error < real(wp.inf) and (not found or spare.gap < best.gap):
                best = spare
                found = wp.bool(True)
            lowest = wp.min(lowest, level)
            if found:
                lowest = wp.min(lowest, best.gap)
            passes += 1
            cell = wp.int32(-1)
            if passes < PASSES and count > 1:
                # Another that is elsewhere, but about as high.
                cell, level = joining(p_a, p_b, x, q, whole, rough, lowest + SAME * size, closed)
        if not found:
            # No direction of the grid is near enough to a small loop.
            pole = wp.quat_rotate(q, vec3d(zero, zero, wp.where(2 * (first % rows) > LAST_ROW, one, -one)))
            at, there = around_pole(p_a, p_b, x, q, pole)
            same = wp.abs(at.gap - rough) <= UNSURE * size and at.gap <= most
            if there and same and facing(p_a, at):
                best = at
                found = wp.bool(True)
        if not found:
            best.off = vec3d(real(wp.inf))
            return best, rough > least
        return best, best.gap > least

    return SimpleNamespace(threaded=threaded, beside_pole=beside_pole)
