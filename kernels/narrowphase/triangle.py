"""Point of a triangle closest to the origin, and its feature: the face, an edge or a vertex.

Sign and direction of a contact follow from the pseudonormal of the feature, not of the face that a query returned.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs


class Functions(NamedTuple):
    """Struct and device function of the closest point of a triangle."""

    Hit: Struct  # closest point and its feature
    closest_to_origin: wp.Function  # point of a triangle closest to the origin, and its feature


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3 = t.vec3
    level = wp.constant(real(1.0 + 8.0 * t.epsilon))

    @wp.struct
    class Hit:
        point: vec3  # closest point
        feature: wp.int32  # column of the feature tables: 0 face, 1–3 edges, 4–6 vertices

    @wp.func
    def along(u: vec3, e: vec3):
        """Returns the position along the edge ``e`` from ``u`` of the point nearest to the origin, 0 to 1."""
        return wp.clamp(-wp.dot(u, e) / wp.dot(e, e), real(0.0), real(1.0))

    @wp.func
    def closest_to_origin(a: vec3, b: vec3, c: vec3, n: vec3):
        """Returns the point of triangle ``abc`` with unit normal ``n`` closest to the origin, and its feature.

        The usual test by barycentric areas subtracts products of lengths and loses all digits in thin triangles.
        Here only lengths are compared, so errors are of the order of rounding.
        """
        hit = Hit()
        ab = b - a
        bc = c - b
        ca = a - c
        if (
            wp.dot(wp.cross(n, ab), a) < real(0.0)
            and wp.dot(wp.cross(n, bc), b) < real(0.0)
            and wp.dot(wp.cross(n, ca), c) < real(0.0)
        ):
            hit.point = wp.dot(a, n) * n
            hit.feature = 0
            return hit
        # Nearest edge. Among equally near points, a point inside an edge is preferred to a vertex.
        t = along(a, ab)
        hit.point = a + t * ab
        hit.feature = 1
        if t == real(0.0):
            hit.feature = 4
        elif t == real(1.0):
            hit.point = b
            hit.feature = 5
        best = wp.length_sq(hit.point)
        t = along(b, bc)
        q = b + t * bc
        feature = wp.int32(2)
        if t == real(0.0):
            feature = 5
        elif t == real(1.0):
            q = c
            feature = 6
        d = wp.length_sq(q)
        if d < best or (feature < 4 and hit.feature > 3 and d <= best * level):
            best = d
            hit.point = q
            hit.feature = feature
        t = along(c, ca)
        q = c + t * ca
        feature = 3
        if t == real(0.0):
            feature = 6
        elif t == real(1.0):
            q = a
            feature = 4
        d = wp.length_sq(q)
        if d < best or (feature < 4 and hit.feature > 3 and d <= best * level):
            hit.point = q
            hit.feature = feature
        return hit

    return Functions(Hit=Hit, closest_to_origin=closest_to_origin)
