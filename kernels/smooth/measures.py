"""Places and curvatures of smooth contacts, in float64 whatever the precision: of what was found last."""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.smooth import detect
from warpcontact.kernels.smooth.base import Shape
from warpcontact.kernels.smooth.records import Members, Mount, Seeds, Settings, contact_structs, shapes_struct
from warpcontact.kernels.types import DISABLED, MET, structs


@wp.struct
class Points:
    """Where surfaces meet; NaN of a contact that is not enabled."""

    point: wp.array2d(dtype=wp.vec3d)  # [env, contact] K, where the force acts, W [m]
    point_a: wp.array2d(dtype=wp.vec3d)  # [env, contact] on the first shape, W [m]
    point_b: wp.array2d(dtype=wp.vec3d)  # [env, contact] on the second, W [m]


@wp.struct
class Curvatures:
    """Principal curvatures of the gap between two surfaces where they meet; NaN where that was not found."""

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


@functools.cache
def curvatures(kind_a: type[Shape], kind_b: type[Shape], real: type) -> wp.Kernel:
    """Returns the kernel that tells the curvatures of the gap. Launch with dim (env, contact of the range).

    It looks for where the shapes meet again: in float64, as small angles decide on which side of an edge that is.
    """
    State = structs(real).State
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    pair, bent = detect.seen(kind_a, kind_b, real), detect.bending(kind_a, kind_b).bent
    pose_of, meeting_of = pair.pair, pair.meeting

    @wp.kernel(module="unique", enable_backward=False)
    def measure_curvatures(
        state: State,
        first: wp.int32,  # contact of the set
        offset: wp.int32,  # of the set among all
        members: Members,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        held: Seeds,
        measured: Curvatures,
    ):
        env, number = wp.tid()
        contact = first + number
        pose = pose_of(state, env, contact, members, shapes_a, shapes_b)
        meeting = meeting_of(env, contact, members, shapes_a, shapes_b, pose, held.seed[env, contact])
        measured.curvature_1[env, offset + contact] = wp.float64(wp.nan)
        measured.curvature_2[env, offset + contact] = wp.float64(wp.nan)
        if meeting.status == MET:
            relative = bent(env, contact, members, shapes_a, shapes_b, pose, meeting)
            measured.curvature_1[env, offset + contact] = relative.k_1
            measured.curvature_2[env, offset + contact] = relative.k_2

    return measure_curvatures
