"""Places and curvatures of smooth contacts, in float64 whatever the precision: of what was found last."""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.smooth.records import Members, Mount, Settings, contact_structs
from warpcontact.kernels.types import DISABLED, structs


@wp.struct
class Points:
    """Where surfaces meet; NaN of a contact that is not enabled."""

    point: wp.array2d(dtype=wp.vec3d)  # [env, contact] K, where the force acts, W [m]
    point_a: wp.array2d(dtype=wp.vec3d)  # [env, contact] on the first shape, W [m]
    point_b: wp.array2d(dtype=wp.vec3d)  # [env, contact] on the second, W [m]


@wp.struct
class Curvatures:
    """Principal curvatures of the gap between two surfaces where they meet."""

    curvature_1: wp.array2d(dtype=wp.float64)  # [env, contact] the smaller [1/m]
    curvature_2: wp.array2d(dtype=wp.float64)  # [env, contact] the larger [1/m]


@functools.cache
def points(real: type) -> wp.Kernel:
    """Returns the kernel that places contacts. Launch with dim (env, contact of the range)."""
    t = structs(real)
    State, Smooth = t.State, contact_structs(real).Smooth
    wide = frames.functions(real).wide

    @wp.kernel(module="unique", enable_backward=False)
    def place_contacts(
        state: State,
        first: wp.int32,  # contact of the set
        offset: wp.int32,  # of the set among all
        members: Members,
        mounts_b: wp.array2d(dtype=Mount),
        settings: wp.array2d(dtype=Settings),
        smooth: Smooth,
        measured: Points,
    ):
        env, number = wp.tid()
        contact = first + number
        body = members.body_b[contact]
        origin = mounts_b[env, members.shape_b[contact]].position
        if body >= 0:
            origin = wide(state.body_position[env, body]) + wide(state.body_position_remainder[env, body])
        point = origin + wide(smooth.arm_b[env, contact])
        across = wp.float64(smooth.gap[env, contact]) * wide(smooth.normal[env, contact])
        if smooth.status[env, contact] == DISABLED:
            point = wp.vec3d(wp.nan, wp.nan, wp.nan)
        kappa = settings[env, contact].kappa
        measured.point[env, offset + contact] = point
        measured.point_a[env, offset + contact] = point + (wp.float64(1.0) - kappa) * across
        measured.point_b[env, offset + contact] = point - kappa * across

    return place_contacts
