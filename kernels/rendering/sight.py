"""Visibility of points from an eye."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.rendering.rays import is_unoccluded
from warpcontact.kernels.rendering.world import World


@functools.cache
def kernel() -> wp.Kernel:
    """Returns the kernel that tests the visibility of points, one per thread."""

    @unique_kernel()
    def test_points(
        world: World,
        eye: wp.vec3,
        points: wp.array(dtype=wp.vec3),  # W
        radii: wp.array(dtype=wp.float32),  # surfaces nearer to a point than this do not hide it
        visible: wp.array(dtype=wp.uint8),  # 1: visible
    ):
        i = wp.tid()
        offset = points[i] - eye
        distance = wp.length(offset)
        visible[i] = wp.uint8(0)
        if distance <= radii[i] or is_unoccluded(world, eye, offset / distance, distance - radii[i]):
            visible[i] = wp.uint8(1)

    return test_points
