"""Device functions shared by shapes of revolution about the z axis."""

import warp as wp
from warpcontact.kernels.shapes.base import AXIS_TOLERANCE, SupportExpansion, one, real, vec3d, zero


@wp.func
def radial(x: vec3d):
    """Returns the distance of a point from the z axis and the radial unit vector; on the axis, the x axis."""
    radial_distance = wp.sqrt(x[0] * x[0] + x[1] * x[1])
    out = vec3d(one, zero, zero)
    if radial_distance > zero:
        out = vec3d(x[0] / radial_distance, x[1] / radial_distance, zero)
    return radial_distance, out


@wp.func
def disc_expansion(radius: real, n: vec3d):
    """Returns the ``SupportExpansion`` of a flat disc in the plane z = 0, centered at the origin."""
    found = SupportExpansion()
    radial_distance = wp.sqrt(n[0] * n[0] + n[1] * n[1])
    found.disc_radius = radius
    if radial_distance > AXIS_TOLERANCE:
        found.disc_radius = zero
        found.point = vec3d(radius * (n[0] / radial_distance), radius * (n[1] / radial_distance), zero)
        around = vec3d(-n[1] / radial_distance, n[0] / radial_distance, zero)
        found.hessian = (radius / radial_distance) * wp.outer(around, around)
    return found
