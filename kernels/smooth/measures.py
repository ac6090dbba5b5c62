"""Places, curvatures and derivatives of shape contacts, in float64 in any case: of what was found last."""

import functools
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.smooth import detect
from warpcontact.kernels.smooth.base import Shape
from warpcontact.kernels.smooth.derivatives import Row12, Rows12, growth
from warpcontact.kernels.smooth.derivatives import gradients as gradients_of
from warpcontact.kernels.smooth.records import Members, Mount, Seeds, Settings, contact_structs, shapes_struct
from warpcontact.kernels.types import DISABLED, MET, structs
from warpcontact.kernels.unique import unique_kernel


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


@wp.struct
class Gradients:
    """Derivatives by positions and rotations of what carries the shapes, about centres of mass; W.

    Of a shape of the world about its origin. Not a number where the points are not determined.
    """

    gap_by_position_a: wp.array2d(dtype=wp.vec3d)  # [env, contact] [-]
    gap_by_rotation_a: wp.array2d(dtype=wp.vec3d)  # [env, contact] [m]
    gap_by_position_b: wp.array2d(dtype=wp.vec3d)
    gap_by_rotation_b: wp.array2d(dtype=wp.vec3d)
    normal_by_position_a: wp.array2d(dtype=wp.mat33d)  # [env, contact] a column for each axis [1/m]
    normal_by_rotation_a: wp.array2d(dtype=wp.mat33d)  # [env, contact] [-]
    normal_by_position_b: wp.array2d(dtype=wp.mat33d)
    normal_by_rotation_b: wp.array2d(dtype=wp.mat33d)
    point_a_by_position_a: wp.array2d(dtype=wp.mat33d)  # [env, contact] [-]
    point_a_by_rotation_a: wp.array2d(dtype=wp.mat33d)  # [env, contact] [m]
    point_a_by_position_b: wp.array2d(dtype=wp.mat33d)
    point_a_by_rotation_b: wp.array2d(dtype=wp.mat33d)
    point_b_by_position_a: wp.array2d(dtype=wp.mat33d)
    point_b_by_rotation_a: wp.array2d(dtype=wp.mat33d)
    point_b_by_position_b: wp.array2d(dtype=wp.mat33d)
    point_b_by_rotation_b: wp.array2d(dtype=wp.mat33d)
    gap_by_sizes_a: wp.array2d(dtype=wp.vec4d)  # [env, contact] one after the other [-]
    gap_by_sizes_b: wp.array2d(dtype=wp.vec4d)


@functools.cache
def points(real: type) -> wp.Kernel:
    """Returns the kernel that places contacts. Launch with dim (env, contact of the range)."""
    t = structs(real)
    State, Smooth = t.State, contact_structs(real).Smooth
    wide = frames.functions(real).wide

    @unique_kernel()
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

    @unique_kernel()
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
            bend = bent(env, contact, members, shapes_a, shapes_b, pose, meeting)
            measured.curvature_1[env, offset + contact] = bend.relative.k_1
            measured.curvature_2[env, offset + contact] = bend.relative.k_2

    return measure_curvatures


@wp.func
def three(row: Row12, first: int):
    """Three of twelve numbers."""
    return wp.vec3d(row[first], row[first + 1], row[first + 2])


@wp.func
def nine(rows: Rows12, first: int):
    """Three columns of twelve."""
    found = wp.mat33d()
    for i in range(3):
        for j in range(3):
            found[i, j] = rows[i, first + j]
    return found


@functools.cache
def sizes(kind: type[Shape]) -> wp.Function:
    """Returns ``(p, point, n)``: the derivatives of the gap by up to four sizes of a shape; see ``growth``."""
    grown = growth(kind)
    if grown is None:

        @wp.func
        def none(p: Any, point: wp.vec3d, n: wp.vec3d):
            return wp.vec4d()

        return none
    by_sizes = grown[1]
    count = size_count(kind)

    @wp.func
    def by_size(p: Any, point: wp.vec3d, n: wp.vec3d):
        rates = by_sizes(p, point, n)
        found = wp.vec4d()
        for i in range(wp.static(count)):
            found[i] = -rates[i]
        return found

    return by_size


def size_count(kind: type[Shape]) -> int:
    """Returns how many numbers the sizes are by which the gap of a shape is derived."""
    grown = growth(kind)
    return 0 if grown is None else sum(width for _, width in size_widths(kind))


def size_widths(kind: type[Shape]) -> list[tuple[str, int]]:
    """Returns the sizes by which the gap of a shape is derived, each with how many numbers it is."""
    grown = growth(kind)
    return [] if grown is None else [(name, int(np.prod(kind.limits(name)["shape"]))) for name in grown[0]]


@functools.cache
def gradients(kind_a: type[Shape], kind_b: type[Shape], real: type) -> wp.Kernel:
    """Returns the kernel of the derivatives of a contact. Launch with dim (env, contact of the range)."""
    State = structs(real).State
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    pair, bent = detect.seen(kind_a, kind_b, real), detect.bending(kind_a, kind_b).bent
    pose_of, meeting_of = pair.pair, pair.meeting
    by_sizes_a, by_sizes_b = sizes(kind_a), sizes(kind_b)

    @unique_kernel()
    def measure_gradients(
        state: State,
        first: wp.int32,  # contact of the set
        offset: wp.int32,  # of the set among all
        members: Members,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        held: Seeds,
        measured: Gradients,
    ):
        env, number = wp.tid()
        contact = first + number
        own = offset + contact
        pose = pose_of(state, env, contact, members, shapes_a, shapes_b)
        meeting = meeting_of(env, contact, members, shapes_a, shapes_b, pose, held.seed[env, contact])
        bend = bent(env, contact, members, shapes_a, shapes_b, pose, meeting)
        curved_a = bend.a
        curved_b = bend.b
        curved_a.direction = wp.quat_rotate(pose.q_W, curved_a.direction)
        curved_b.direction = wp.quat_rotate(pose.q_W, curved_b.direction)
        # In the axes of W, from the origin of the frame of b.
        origin_b = -pose.offset
        rates = gradients_of(
            wp.quat_rotate(pose.q_W, meeting.normal),
            meeting.gap,
            wp.quat_rotate(pose.q_W, meeting.point_a),
            wp.quat_rotate(pose.q_W, meeting.point_b),
            curved_a,
            curved_b,
            origin_b + pose.bodies,
            origin_b,
        )
        measured.gap_by_position_a[env, own] = three(rates.gap, 0)
        measured.gap_by_rotation_a[env, own] = three(rates.gap, 3)
        measured.gap_by_position_b[env, own] = three(rates.gap, 6)
        measured.gap_by_rotation_b[env, own] = three(rates.gap, 9)
        measured.normal_by_position_a[env, own] = nine(rates.normal, 0)
        measured.normal_by_rotation_a[env, own] = nine(rates.normal, 3)
        measured.normal_by_position_b[env, own] = nine(rates.normal, 6)
        measured.normal_by_rotation_b[env, own] = nine(rates.normal, 9)
        measured.point_a_by_position_a[env, own] = nine(rates.point_a, 0)
        measured.point_a_by_rotation_a[env, own] = nine(rates.point_a, 3)
        measured.point_a_by_position_b[env, own] = nine(rates.point_a, 6)
        measured.point_a_by_rotation_b[env, own] = nine(rates.point_a, 9)
        measured.point_b_by_position_a[env, own] = nine(rates.point_b, 0)
        measured.point_b_by_rotation_a[env, own] = nine(rates.point_b, 3)
        measured.point_b_by_position_b[env, own] = nine(rates.point_b, 6)
        measured.point_b_by_rotation_b[env, own] = nine(rates.point_b, 9)
        p_a = shapes_a.coefficients[env, members.shape_a[contact]]
        p_b = shapes_b.coefficients[env, members.shape_b[contact]]
        n_a = wp.quat_rotate_inv(pose.q, -meeting.normal)
        point_a = wp.quat_rotate_inv(pose.q, meeting.point_a - pose.x)
        measured.gap_by_sizes_a[env, own] = by_sizes_a(p_a, point_a, n_a)
        measured.gap_by_sizes_b[env, own] = by_sizes_b(p_b, meeting.point_b, meeting.normal)

    return measure_gradients
