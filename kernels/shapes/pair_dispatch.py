"""Selects the contact algorithm of a pair of shapes when a model is built."""

import functools

import warp as wp
from warpcontact.kernels.shapes import closed_form_pairs, convex
from warpcontact.kernels.shapes.base import Shape
from warpcontact.kernels.shapes.capsule import Capsule
from warpcontact.kernels.shapes.plane import Plane
from warpcontact.kernels.shapes.sphere import Sphere


@functools.cache
def pair_function(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function ``(p_a, p_b, x, q, warm_start)`` → ``ShapeContactPoint`` of a pair of shapes.

    ``p_a`` and ``p_b`` are the ``coefficient_struct`` of both in float64, ``x`` [m] is the origin of a in the
    frame of b and ``q`` the rotation a → b. The contact points are the pair of points with antiparallel normals
    along their connecting line that has the largest gap.

    If two faces or edges lie on each other, the contact points are common points of both, displaced from the
    middle of each in proportion to its size.

    Raises:
        TypeError: If both are planes.
    """
    if issubclass(A, Plane) and issubclass(B, Plane):
        raise TypeError("two planes have no contact point; at most one shape of a pair may be a plane")
    if not (A.convex and B.convex):
        from warpcontact.kernels.shapes import nonconvex_pairs

        return nonconvex_pairs.pair_function(A, B)
    if issubclass(B, Plane):
        return closed_form_pairs.with_plane(A, B)
    if issubclass(A, Plane):
        return closed_form_pairs.swapped_pair(closed_form_pairs.with_plane(B, A), B, A)
    if issubclass(A, Sphere) and hasattr(B, "signed_distance"):
        return closed_form_pairs.with_sphere(A, B)
    if issubclass(B, Sphere) and hasattr(A, "signed_distance"):
        return closed_form_pairs.swapped_pair(closed_form_pairs.with_sphere(B, A), B, A)
    if issubclass(A, Capsule) and issubclass(B, Capsule):
        return closed_form_pairs.capsule_pair(A, B)
    return convex.pair_function(A, B)
