"""All directions, searched for one along which two bodies in overlap come apart by less than a given way.

The set of all differences of points of the two bodies contains every difference c of two points that planes with
one normal touch. So the overlap along any other direction n is at least −n·c, and over a cell of directions at
least the least of its corners. Cells that this does not rule out are divided; the few that are left in the end are
where to look. Six faces of a cube are the cells to begin with.
"""

import functools

import warp as wp
from warpcontact.kernels.formula import coefficient_struct
from warpcontact.kernels.smooth.base import Shape

real = wp.float64
vec3d = wp.vec3d
mat33d = wp.mat33d

#: How often a cell is divided into four, and how many cells of the finest a face of the cube has along an edge.
LEVELS = 6
EDGE = 1 << LEVELS
#: Index of the first cell that is not one.
END = 6 * EDGE * EDGE

one = wp.constant(real(1.0))
zero = wp.constant(real(0.0))


@wp.func
def every_other_bit(code: int):
    """The number of the even bits of ``code``."""
    number = wp.int32(0)
    for i in range(LEVELS):
        number += ((code >> (2 * i)) & 1) << i
    return number


@wp.func
def onto_cube(face: int, u: real, v: real):
    """A point of the cube with half sides of 1."""
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


@functools.cache
def function(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function ``next_direction`` of a pair."""
    Of_a, Of_b = coefficient_struct(A, real), coefficient_struct(B, real)

    @wp.func
    def next_direction(
        p_a: Of_a, p_b: Of_b, x: vec3d, R: mat33d, apart: vec3d, inner: real, depth: real, first: int
    ):
        """Goes on from cell ``first`` to the next where the overlap may be less than ``depth``.

        ``inner`` is the sum of the radii of two spheres inside the bodies, whose centres are ``apart``. Returns
        the middle of the cell, whether there is one, and where to go on.
        """
        n = vec3d()
        cell = first
        level = wp.int32(-1)
        left = wp.bool(False)
        while cell < END and not left:
            if level < 0:
                # The largest cell that begins here.
                level = LEVELS
                while level > 0 and cell & ((1 << (2 * (LEVELS - level + 1))) - 1) == 0:
                    level -= 1
            face = cell >> (2 * LEVELS)
            code = cell & (EDGE * EDGE - 1)
            half = real(1 << (LEVELS - level)) / real(EDGE)
            u = real(2 * every_other_bit(code)) / real(EDGE) - one + half
            v = real(2 * every_other_bit(code >> 1)) / real(EDGE) - one + half
            n = wp.normalize(onto_cube(face, u, v))
            corner_1 = wp.normalize(onto_cube(face, u - half, v - half))
            corner_2 = wp.normalize(onto_cube(face, u + half, v - half))
            corner_3 = wp.normalize(onto_cube(face, u - half, v + half))
            corner_4 = wp.normalize(onto_cube(face, u + half, v + half))
            # All within the cell are sums of the corners, times no more than 1/cos in all.
            cosine = wp.min(
                wp.min(wp.dot(n, corner_1), wp.dot(n, corner_2)), wp.min(wp.dot(n, corner_3), wp.dot(n, corner_4))
            )
            farthest = wp.max(
                wp.max(wp.dot(corner_1, apart), wp.dot(corner_2, apart)),
                wp.max(wp.dot(corner_3, apart), wp.dot(corner_4, apart)),
            )
            spare = inner - depth
            allowed = wp.where(spare > zero, spare * cosine, spare)
            left = farthest > allowed
            if left:
                c = x + R * A.support(p_a, -(n * R)) - B.support(p_b, n)
                farthest = wp.max(
                    wp.max(wp.dot(corner_1, c), wp.dot(corner_2, c)),
                    wp.max(wp.dot(corner_3, c), wp.dot(corner_4, c)),
                )
                left = farthest > -depth
            if left and level < LEVELS:
                level += 1
                left = False
            else:
                cell += 1 << (2 * (LEVELS - level))
                level = -1
        return n, left, cell

    return next_direction
