"""Plain closest-point query of Warp for every point: the reference in speed benchmarks."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel


@functools.cache
def kernel() -> wp.Kernel:
    """Returns the kernel that finds the nearest face of every point."""

    @unique_kernel()
    def bare_query(mesh: wp.uint64, points: wp.array(dtype=wp.vec3f), found: wp.array(dtype=wp.int32)):
        i = wp.tid()
        query = wp.mesh_query_point_no_sign(mesh, points[i], wp.float32(wp.inf))
        found[i] = query.face

    return bare_query
