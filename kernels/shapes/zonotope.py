"""Projection onto a zonotope in the plane: the set of all sums Σ tᵢ kᵢ with −1 ≤ tᵢ ≤ 1.

``separation_newton.py`` uses it: active edges absorb the tangential offset of two bodies, the remainder turns the
normal.
"""

import functools

import warp as wp
from warpcontact.kernels.shapes.base import one, real, zero

vec2d = wp.vec2d

# Sine of the angle below which two edges are parallel.
PARALLEL = wp.constant(real(1.0e-12))


@functools.cache
def zonotope_projection(count: int) -> wp.Function:
    """Returns the device function for ``count`` vectors.

    Loop bounds are in variables, so that Warp does not unroll: unrolled, compilation for GPUs takes minutes.
    """
    Row = wp.types.vector(count, real)
    Flat = wp.types.matrix((count, 2), real)

    @wp.func
    def side(edges: Flat, mask: int, i: int, r: vec2d):
        """Returns middle, half length and outward normal of the side of the zonotope along edge i that faces r."""
        along = vec2d(edges[i, 0], edges[i, 1])
        length = wp.length(along)
        out = vec2d(-along[1], along[0]) / length
        if wp.dot(out, r) < zero:
            out = -out
        middle = vec2d()
        reach = vec2d()
        total = wp.int32(count)
        for j in range(total):
            if (mask >> j) & 1 == 1:
                other = vec2d(edges[j, 0], edges[j, 1])
                rise = wp.dot(out, other)
                if wp.abs(rise) <= PARALLEL * wp.length(other):
                    reach += wp.sign(wp.dot(along, other)) * other
                else:
                    middle += wp.sign(rise) * other
        return middle, reach, out

    @wp.func
    def distribute(edges: Flat, mask: int, signs: Row, r: vec2d):
        """Distributes r over the edges in ``mask``.

        Returns the factors of all edges, the remainder of r, the edge that the remainder is normal to (−1: none),
        and r relative to the boundary in its direction. This ratio is 0 if r is outside or the zonotope has no
        interior. If r is inside, the largest factor is as small as possible.
        """
        best = wp.int32(0)
        nearest = real(wp.inf)
        inside = wp.bool(True)
        ratio = real(0.0)
        facing_edge = wp.int32(0)
        largest_width = real(0.0)
        total = wp.int32(count)
        for i in range(total):
            if (mask >> i) & 1 == 1:
                middle, reach, out = side(edges, mask, i, r)
                height = wp.dot(middle, out)
                target_height = wp.dot(r, out)
                largest_width = wp.max(largest_width, height / wp.length(reach))
                inside = inside and target_height <= height
                if target_height > ratio * height and height > zero:
                    ratio = target_height / height
                    facing_edge = i
                t = wp.clamp(wp.dot(r - middle, reach) / wp.length_sq(reach), -one, one)
                distance_squared = wp.length_sq(r - middle - t * reach)
                if distance_squared < nearest:
                    nearest = distance_squared
                    best = i
        is_inside = inside and largest_width > PARALLEL
        scale = one
        target = r
        if is_inside:
            scale = ratio
            best = facing_edge
            if ratio > zero:
                target = r / ratio
        middle, reach, out = side(edges, mask, best, r)
        t = wp.dot(target - middle, reach) / wp.length_sq(reach)
        edge = wp.int32(-1)
        if wp.abs(t) <= one and not is_inside:
            edge = best
        t = wp.clamp(t, -one, one)
        along = vec2d(edges[best, 0], edges[best, 1])
        for j in range(count):
            if (mask >> j) & 1 == 1:
                other = vec2d(edges[j, 0], edges[j, 1])
                rise = wp.dot(out, other)
                if wp.abs(rise) <= PARALLEL * wp.length(other):
                    signs[j] = scale * t * wp.sign(wp.dot(along, other))
                else:
                    signs[j] = scale * wp.sign(rise)
        remainder = r - middle - t * reach
        if is_inside:
            return signs, vec2d(), -1, ratio
        return signs, remainder, edge, zero

    return distribute
