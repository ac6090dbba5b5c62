"""Branch and bound over directions: finds a direction with an overlap below a given depth.

The difference c of two points on supporting planes with a common normal belongs to the Minkowski difference of the
bodies, and so does every segment between two such differences. Hence the overlap along any direction n is at least
−n·c, and over a cell of directions at least the minimum over its corners. Cells that are not excluded are divided
until the overlap at a cell center is below the depth, or no cell is left. The error of the bound is quadratic in
the cell size and within rounding for the finest cells. The initial cells are the faces of a cube.
"""

import functools

import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes.base import Shape, mat33d, one, real, vec3d, zero
from warpcontact.kernels.shapes.spheres import Sphere
from warpcontact.kernels.shapes.superellipsoid import Superellipsoid

#: Maximum number of divisions of a cell by four; level of starting cells if there is no bound.
LEVELS = 20
START_LEVEL = 6
#: Maximum number of evaluated cells finer than ``START_LEVEL``: overlaps that are equal along a curve exclude
#: none.
MAX_FINE_CELLS = 4000

EDGE = 1 << LEVELS
# Number of finest cells; mask and number of bits of the index within a cube face.
CELL_COUNT = wp.constant(wp.int64(6 * EDGE * EDGE))
FACE_MASK = wp.constant(wp.int64(EDGE * EDGE - 1))
FACE_BITS = wp.constant(wp.int64(2 * LEVELS))
# Side of the finest cells; depth if there is no bound.
CELL_SIZE = wp.constant(real(2.0 / EDGE))
INFINITY = wp.constant(real(wp.inf))
BIT = wp.constant(wp.int64(1))
# Masks of every other bit, pair of bits, and so on.
MASKS = tuple(
    wp.constant(wp.int64(sum(((1 << width) - 1) << (2 * width * i) for i in range(32 // width)) & (2**63 - 1)))
    for width in (1, 2, 4, 8, 16, 32)
)
MASK_1, MASK_2, MASK_4, MASK_8, MASK_16, MASK_32 = MASKS


@wp.struct
class SearchState:
    """Progress of a search."""

    cell: wp.int64  # index of the first finest cell not yet covered
    level: wp.int32  # level of the current cell; −1: the largest that begins at ``cell``
    fine_count: wp.int32  # number of evaluated fine cells


@wp.func
def deinterleave(code: wp.int64):
    """Returns the number in the even bits of ``code``."""
    number = code & MASK_1
    number = (number | (number >> wp.int64(1))) & MASK_2
    number = (number | (number >> wp.int64(2))) & MASK_4
    number = (number | (number >> wp.int64(4))) & MASK_8
    number = (number | (number >> wp.int64(8))) & MASK_16
    return real((number | (number >> wp.int64(16))) & MASK_32)


@wp.func
def cell_length(level: int):
    """Returns the number of finest cells in a cell of a level; their indices are consecutive."""
    return BIT << wp.int64(2 * (LEVELS - level))


@wp.func
def cube_point(face: int, u: real, v: real):
    """Returns a point of the cube with half sides of 1."""
    if face == 0:
        return vec3d(one, u, v)
    if face == 1:
        return vec3d(-one, u, v)
    if face == 2:
        return vec3d(u, one, v)
    if face == 3:
        return vec3d(u, -one, v)
    if face == 4:
        return vec3d(u, v, one)
    return vec3d(u, v, -one)


@wp.func
def excludes_segment(at: wp.vec4d, to: wp.vec4d, limit: real):
    """Returns whether no t in [0, 1] satisfies at + t to ≤ limit in all components."""
    first = real(0.0)
    last = real(1.0)
    for i in range(4):
        slack = limit - at[i]
        if to[i] < zero:
            first = wp.max(first, slack / to[i])
        elif to[i] > zero:
            last = wp.min(last, slack / to[i])
        elif slack < zero:
            first = real(2.0)
    return first > last


def shares_symmetry(A: type[Shape], B: type[Shape]) -> bool:
    """Returns whether the overlap is smallest in the octant of B, by its symmetry planes, with the center of A."""
    return A is Sphere and B is Superellipsoid


@functools.cache
def direction_search(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function ``next_direction`` of a pair."""
    CoefficientsA, CoefficientsB = coefficient_struct(A, real), coefficient_struct(B, real)
    one_octant = shares_symmetry(A, B)

    @wp.func
    def next_direction(
        p_a: CoefficientsA,
        p_b: CoefficientsB,
        x: vec3d,
        R: mat33d,
        center_offset: vec3d,
        inscribed_radius: real,
        depth: real,
        end: vec3d,
        explore: wp.bool,
        search_state: SearchState,
    ):
        """Continues the search to the next direction along which the overlap is less than ``depth``.

        If ``depth`` is infinite, or the fine cells are used up and ``explore`` is true, returns the next direction
        along which it may be less. ``inscribed_radius`` is the sum of the radii of two inscribed spheres,
        ``center_offset`` the difference of their centers, ``end`` the difference of the points at the end of the
        best ascent. Returns the direction, 0 if there is none, and the state of the search.
        """
        n = vec3d()
        cell = search_state.cell
        level = search_state.level
        fine_count = search_state.fine_count
        found = wp.bool(False)
        while cell < CELL_COUNT and not found:
            if level < 0:
                # The largest cell that begins here.
                level = LEVELS
                while level > 0 and cell & (cell_length(level - 1) - BIT) == wp.int64(0):
                    level -= 1
            code = cell & FACE_MASK
            face = wp.int32(cell >> FACE_BITS)
            half = one / real(1 << level)
            u = deinterleave(code) * CELL_SIZE - one + half
            v = deinterleave(code >> BIT) * CELL_SIZE - one + half
            n = wp.normalize(cube_point(face, u, v))
            corner_1 = wp.normalize(cube_point(face, u - half, v - half))
            corner_2 = wp.normalize(cube_point(face, u + half, v - half))
            corner_3 = wp.normalize(cube_point(face, u - half, v + half))
            corner_4 = wp.normalize(cube_point(face, u + half, v + half))
            # Directions of the cell are nonnegative combinations of its corners; the weights sum to at most 1/cos.
            cosine = wp.min(
                wp.min(wp.dot(n, corner_1), wp.dot(n, corner_2)), wp.min(wp.dot(n, corner_3), wp.dot(n, corner_4))
            )
            farthest = wp.max(
                wp.max(wp.dot(corner_1, center_offset), wp.dot(corner_2, center_offset)),
                wp.max(wp.dot(corner_3, center_offset), wp.dot(corner_4, center_offset)),
            )
            slack = inscribed_radius - depth
            allowed = wp.where(slack > zero, slack * cosine, slack)
            possible = farthest > allowed
            if wp.static(one_octant):
                for k in range(3):
                    possible = possible and (level == 0 or n[k] * center_offset[k] >= zero)
            if possible:
                c = x + R * A.support(p_a, -(n * R)) - B.support(p_b, n)
                at = wp.vec4d(wp.dot(corner_1, c), wp.dot(corner_2, c), wp.dot(corner_3, c), wp.dot(corner_4, c))
                possible = wp.max(at) > -depth
                has_depth = depth < INFINITY
                found = possible and has_depth and wp.dot(n, c) > -depth
                # No bound, or too many equal cells: return a direction to start from.
                found = found or (
                    possible
                    and level == START_LEVEL
                    and (not has_depth or (explore and fine_count >= MAX_FINE_CELLS))
                )
                if possible and not found:
                    # One difference on the segment from c to ``end`` that excludes the cell is enough.
                    e = end - c
                    to = wp.vec4d(
                        wp.dot(corner_1, e), wp.dot(corner_2, e), wp.dot(corner_3, e), wp.dot(corner_4, e)
                    )
                    possible = excludes_segment(at, to, -depth)
                if possible and not found:
                    # c jumps across an edge: the same with the difference at the corner of the cell with the worst bound.
                    worst = corner_1
                    if at[1] == wp.max(at):
                        worst = corner_2
                    if at[2] == wp.max(at):
                        worst = corner_3
                    if at[3] == wp.max(at):
                        worst = corner_4
                    e = x + R * A.support(p_a, -(worst * R)) - B.support(p_b, worst) - c
                    to = wp.vec4d(
                        wp.dot(corner_1, e), wp.dot(corner_2, e), wp.dot(corner_3, e), wp.dot(corner_4, e)
                    )
                    possible = excludes_segment(at, to, -depth)
                if level > START_LEVEL:
                    fine_count += 1
            if possible and level < wp.where(fine_count < MAX_FINE_CELLS, LEVELS, START_LEVEL):
                level += 1
            else:
                cell += cell_length(level)
                level = -1
        if not found:
            n = vec3d()
        search_state.cell = cell
        search_state.level = level
        search_state.fine_count = fine_count
        return n, search_state

    return next_direction
