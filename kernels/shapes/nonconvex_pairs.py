"""Selects the contact algorithm of pairs with a nonconvex shape: tori and parametric surfaces."""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.shapes import closed_form_pairs, parametric_contact, torus_contact
from warpcontact.kernels.shapes.base import Shape, WarmStart, vec3d
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.sphere import Sphere
from warpcontact.kernels.shapes.torus import Torus


@functools.cache
def pair_function(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of a pair; arguments as in ``pair_dispatch.py``.

    The warm start is not used: the whole surface is searched each time. So a step never follows a contact that is
    no longer the deepest, and a restored state gives bitwise identical results.

    Raises:
        TypeError: If both are parametric surfaces.
    """
    if issubclass(A, ParametricSurface) and issubclass(B, ParametricSurface):
        raise TypeError(
            f"two parametric surfaces, {A.__name__} and {B.__name__}, cannot be in contact: one shape of a pair "
            "must be closed"
        )
    if issubclass(B, ParametricSurface):
        return parametric_contact.pair_function(A, B)
    if issubclass(A, ParametricSurface):
        return _swapped(parametric_contact.pair_function(B, A))
    if A is Sphere:
        # The torus has ``signed_distance`` for the center of the sphere.
        return closed_form_pairs.with_sphere(A, B)
    if B is Sphere:
        return closed_form_pairs.swapped_pair(closed_form_pairs.with_sphere(B, A), B, A)
    if A is Torus:
        return torus_contact.pair_function(A, B)
    return _swapped(torus_contact.pair_function(B, A))


def _swapped(pair_contact: wp.Function) -> wp.Function:
    """Returns the device function for (B, A) from that for (A, B)."""

    @wp.func
    def find_contact(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, warm_start: WarmStart):
        q = wp.normalize(rotation)
        contact = pair_contact(p_b, p_a, wp.quat_rotate_inv(q, -x), wp.quat_inverse(q), WarmStart())
        point_b = x + wp.quat_rotate(q, contact.point_a)
        contact.point_a = x + wp.quat_rotate(q, contact.point_b)
        contact.point_b = point_b
        contact.normal = -wp.quat_rotate(q, contact.normal)
        contact.warm_start.normal = contact.normal
        contact.warm_start.u = wp.vec4d(
            contact.warm_start.u[2], contact.warm_start.u[3], contact.warm_start.u[0], contact.warm_start.u[1]
        )
        return contact

    return find_contact
