"""Closest point of a triangle, and which feature of it is hit: the face, an edge or a corner.

Voronoi regions as in C. Ericson, Real-Time Collision Detection, 5.1.5, with the feature kept: the pseudonormal
of the feature, not of the face that a query happened to return, decides sign and direction.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import structs


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3 = t.vec3

    @wp.struct
    class Hit:
        point: vec3  # closest point
        feature: wp.int32  # column of the feature tables: 0 face, 1–3 edges, 4–6 corners

    @wp.func
    def closest_on_triangle(p: vec3, a: vec3, b: vec3, c: vec3):
        """Returns the point of triangle ``abc`` closest to ``p`` and its feature."""
        hit = Hit()
        ab = b - a
        ac = c - a
        ap = p - a
        d1 = wp.dot(ab, ap)
        d2 = wp.dot(ac, ap)
        if d1 <= real(0.0) and d2 <= real(0.0):
            hit.point = a
            hit.feature = 4
            return hit
        bp = p - b
        d3 = wp.dot(ab, bp)
        d4 = wp.dot(ac, bp)
        if d3 >= real(0.0) and d4 <= d3:
            hit.point = b
            hit.feature = 5
            return hit
        vc = d1 * d4 - d3 * d2
        if vc <= real(0.0) and d1 >= real(0.0) and d3 <= real(0.0):
            hit.point = a + (d1 / (d1 - d3)) * ab
            hit.feature = 1
            return hit
        cp = p - c
        d5 = wp.dot(ab, cp)
        d6 = wp.dot(ac, cp)
        if d6 >= real(0.0) and d5 <= d6:
            hit.point = c
            hit.feature = 6
            return hit
        vb = d5 * d2 - d1 * d6
        if vb <= real(0.0) and d2 >= real(0.0) and d6 <= real(0.0):
            hit.point = a + (d2 / (d2 - d6)) * ac
            hit.feature = 3
            return hit
        va = d3 * d6 - d5 * d4
        if va <= real(0.0) and d4 - d3 >= real(0.0) and d5 - d6 >= real(0.0):
            hit.point = b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b)
            hit.feature = 2
            return hit
        inverse = real(1.0) / (va + vb + vc)
        hit.point = a + (vb * inverse) * ab + (vc * inverse) * ac
        hit.feature = 0
        return hit

    return SimpleNamespace(Hit=Hit, closest_on_triangle=closest_on_triangle)
