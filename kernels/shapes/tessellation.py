"""Evaluates points of shapes for drawing."""

import functools

import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.shapes.base import Shape


@functools.cache
def support_points(kind: type[Shape]) -> wp.Kernel:
    """Returns the kernel of the support points of a convex shape along unit vectors. Launch with dim vector."""
    Coefficients = coefficient_struct(kind, wp.float64)
    support = kind.support

    @unique_kernel()
    def farthest_points(
        coefficients: wp.array2d(dtype=Coefficients),
        normals: wp.array(dtype=wp.vec3d),
        points: wp.array(dtype=wp.vec3d),
    ):
        number = wp.tid()
        points[number] = support(coefficients[0, 0], normals[number])

    return farthest_points


@functools.cache
def patch_points(kind: type[Shape]) -> wp.Kernel:
    """Returns the kernel of points of a parametric surface at given parameters. Launch with dim point."""
    Coefficients = coefficient_struct(kind, wp.float64)
    position = kind.position

    @unique_kernel()
    def points_of_patch(
        coefficients: wp.array2d(dtype=Coefficients),
        parameters: wp.array(dtype=wp.vec2d),
        points: wp.array(dtype=wp.vec3d),
    ):
        number = wp.tid()
        u = parameters[number]
        points[number] = position(coefficients[0, 0], u[0], u[1])

    return points_of_patch
