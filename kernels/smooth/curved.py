"""Where two shapes meet if one of them is not convex: tori and patches."""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.smooth import closed, ring, sheet
from warpcontact.kernels.smooth.base import Seed, Shape, vec3d
from warpcontact.kernels.smooth.patch import ParametricSurface
from warpcontact.kernels.smooth.sphere import Sphere
from warpcontact.kernels.smooth.torus import Torus


@functools.cache
def meet(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function of a pair, see ``meet.py``.

    The seed is not needed: all of the surface is looked at every time, so that no step follows a contact that is
    no longer the deepest, and a state that is loaded again gives the same bits.

    Raises:
        TypeError: If both are patches.
    """
    if issubclass(A, ParametricSurface) and issubclass(B, ParametricSurface):
        raise TypeError(
            f"two patches, {A.__name__} and {B.__name__}, cannot touch: each is open, and one of a pair must be a "
            "closed shape"
        )
    if issubclass(B, ParametricSurface):
        return sheet.meet(A, B)
    if issubclass(A, ParametricSurface):
        return _exchanged(sheet.meet(B, A))
    if A is Sphere:
        # The torus knows the point nearest to the centre.
        return closed.on_sphere(A, B)
    if B is Sphere:
        return closed.swapped(closed.on_sphere(B, A), B, A)
    if A is Torus:
        return ring.meet(A, B)
    return _exchanged(ring.meet(B, A))


def _exchanged(of_pair: wp.Function) -> wp.Function:
    """Returns the function of a pair from that of the same two the other way round."""

    @wp.func
    def met_by(p_a: Any, p_b: Any, x: vec3d, rotation: wp.quatd, seed: Seed):
        q = wp.normalize(rotation)
        met = of_pair(p_b, p_a, wp.quat_rotate_inv(q, -x), wp.quat_inverse(q), Seed())
        point_b = x + wp.quat_rotate(q, met.point_a)
        met.point_a = x + wp.quat_rotate(q, met.point_b)
        met.point_b = point_b
        met.normal = -wp.quat_rotate(q, met.normal)
        met.seed.normal = met.normal
        met.seed.u = wp.vec4d(met.seed.u[2], met.seed.u[3], met.seed.u[0], met.seed.u[1])
        return met

    return met_by
