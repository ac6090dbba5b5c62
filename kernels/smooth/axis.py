"""What shapes about the z axis have in common."""

import warp as wp
from warpcontact.kernels.smooth.base import ON_AXIS, Expansion, one, real, vec3d, zero


@wp.func
def outward(x: vec3d):
    """The distance of a place from the axis, and the unit vector across that leads to it; on the axis, x."""
    across = wp.sqrt(x[0] * x[0] + x[1] * x[1])
    out = vec3d(one, zero, zero)
    if across > zero:
        out = vec3d(x[0] / across, x[1] / across, zero)
    return across, out


@wp.func
def disc(radius: real, n: vec3d):
    """The ``Expansion`` of a flat disc in the plane z = 0, its middle at the origin."""
    found = Expansion()
    across = wp.sqrt(n[0] * n[0] + n[1] * n[1])
    found.disc = radius
    if across > ON_AXIS:
        found.disc = zero
        found.point = vec3d(radius * (n[0] / across), radius * (n[1] / across), zero)
        around = vec3d(-n[1] / across, n[0] / across, zero)
        found.hessian = (radius / across) * wp.outer(around, around)
    return found
