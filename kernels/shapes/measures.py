"""Kernels that evaluate contact points, curvatures and derivatives of shape contacts, in float64.

They use the results of the last narrow phase: stored gaps, normals and arms, or its warm starts.
"""

import functools
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.shapes import narrow_phase
from warpcontact.kernels.shapes.base import Shape
from warpcontact.kernels.shapes.derivatives import Row12, Rows12, size_gradient
from warpcontact.kernels.shapes.derivatives import gradients as gradients_of
from warpcontact.kernels.shapes.records import (
    ContactShapes,
    ShapeContactSettings,
    ShapePose,
    WarmStarts,
    shape_contact_structs,
    shapes_struct,
)
from warpcontact.kernels.types import DISABLED, MET, structs


@wp.struct
class Points:
    """Contact points; NaN for disabled contacts."""

    point: wp.array2d(dtype=wp.vec3d)  # [env, contact] K, the point where the force acts, W [m]
    point_a: wp.array2d(dtype=wp.vec3d)  # [env, contact] on the first shape, W [m]
    point_b: wp.array2d(dtype=wp.vec3d)  # [env, contact] on the second, W [m]


@wp.struct
class Curvatures:
    """Principal curvatures of the gap at the contact point; NaN if the solver did not converge."""

    curvature_1: wp.array2d(dtype=wp.float64)  # [env, contact] the smaller [1/m]
    curvature_2: wp.array2d(dtype=wp.float64)  # [env, contact] the larger [1/m]


@wp.struct
class Gradients:
    """Derivatives with respect to translations and rotations of the bodies about their centers of mass; W.

    For a shape fixed to the world, rotations are about the origin of the shape. NaN if contact points are not
    unique.
    """

    gap_by_position_a: wp.array2d(dtype=wp.vec3d)  # [env, contact] [-]
    gap_by_rotation_a: wp.array2d(dtype=wp.vec3d)  # [env, contact] [m]
    gap_by_position_b: wp.array2d(dtype=wp.vec3d)
    gap_by_rotation_b: wp.array2d(dtype=wp.vec3d)
    normal_by_position_a: wp.array2d(dtype=wp.mat33d)  # [env, contact] one column per axis [1/m]
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
    gap_by_sizes_a: wp.array2d(dtype=wp.vec4d)  # [env, contact] up to four sizes, in order [-]
    gap_by_sizes_b: wp.array2d(dtype=wp.vec4d)


@functools.cache
def points(real: type) -> wp.Kernel:
    """Returns the kernel that computes contact points. Launch with dim (env, contact of the range)."""
    t = structs(real)
    State, ShapeContacts = t.State, shape_contact_structs(real).ShapeContacts
    to_float64 = frames.functions(real).to_float64

    @unique_kernel()
    def compute_contact_points(
        state: State,
        first: wp.int32,  # contact of the set
        contact_shapes: ContactShapes,
        shape_poses_b: wp.array2d(dtype=ShapePose),
        settings: wp.array2d(dtype=ShapeContactSettings),
        shape_contacts: ShapeContacts,
        measured: Points,
    ):
        env, offset_in_range = wp.tid()
        contact = first + offset_in_range
        body = contact_shapes.body_b[contact]
        origin = shape_poses_b[env, contact_shapes.shape_b[contact]].position
        if body >= 0:
            origin = to_float64(state.body_position[env, body]) + to_float64(
                state.body_position_remainder[env, body]
            )
        point = origin + to_float64(shape_contacts.arm_b[env, contact])
        gap_vector = wp.float64(shape_contacts.gap[env, contact]) * to_float64(shape_contacts.normal[env, contact])
        if shape_contacts.status[env, contact] == DISABLED:
            point = wp.vec3d(wp.nan, wp.nan, wp.nan)
        kappa = settings[env, contact].kappa
        measured.point[env, contact] = point
        measured.point_a[env, contact] = point + (wp.float64(1.0) - kappa) * gap_vector
        measured.point_b[env, contact] = point - kappa * gap_vector

    return compute_contact_points


@functools.cache
def curvatures(kind_a: type[Shape], kind_b: type[Shape], real: type) -> wp.Kernel:
    """Returns the kernel that computes the curvatures of the gap. Launch with dim (env, contact of the range).

    It solves the contact again in float64, because small angles decide on which side of an edge the contact is.
    """
    State = structs(real).State
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    pair, curvature = (
        narrow_phase.pair_functions(kind_a, kind_b, real),
        narrow_phase.curvature_functions(kind_a, kind_b).curvature,
    )
    relative_pose, find_contact = pair.relative_pose, pair.find_contact

    @unique_kernel()
    def measure_curvatures(
        state: State,
        first: wp.int32,  # contact of the set
        contact_shapes: ContactShapes,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        warm_starts: WarmStarts,
        measured: Curvatures,
    ):
        env, offset_in_range = wp.tid()
        contact = first + offset_in_range
        pose = relative_pose(state, env, contact, contact_shapes, shapes_a, shapes_b)
        contact_point = find_contact(
            env, contact, contact_shapes, shapes_a, shapes_b, pose, warm_starts.warm_start[env, contact]
        )
        measured.curvature_1[env, contact] = wp.float64(wp.nan)
        measured.curvature_2[env, contact] = wp.float64(wp.nan)
        if contact_point.status == MET:
            pair_curvature = curvature(env, contact, contact_shapes, shapes_a, shapes_b, pose, contact_point)
            measured.curvature_1[env, contact] = pair_curvature.relative.k_1
            measured.curvature_2[env, contact] = pair_curvature.relative.k_2

    return measure_curvatures


@wp.func
def vector_of(row: Row12, first: int):
    """Returns three of twelve entries."""
    return wp.vec3d(row[first], row[first + 1], row[first + 2])


@wp.func
def matrix_of(rows: Rows12, first: int):
    """Returns three of twelve columns."""
    found = wp.mat33d()
    for i in range(3):
        for j in range(3):
            found[i, j] = rows[i, first + j]
    return found


@functools.cache
def size_gradients(kind: type[Shape]) -> wp.Function:
    """Returns ``(p, point, n)``: derivatives of the gap by up to four sizes; see ``size_gradient``."""
    gradient = size_gradient(kind)
    if gradient is None:

        @wp.func
        def no_sizes(p: Any, point: wp.vec3d, n: wp.vec3d):
            return wp.vec4d()

        return no_sizes
    by_sizes = gradient[1]
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
    """Returns the number of scalar sizes with a gap derivative."""
    gradient = size_gradient(kind)
    return 0 if gradient is None else sum(width for _, width in size_widths(kind))


def size_widths(kind: type[Shape]) -> list[tuple[str, int]]:
    """Returns the sizes with a gap derivative, each with its number of components."""
    gradient = size_gradient(kind)
    return [] if gradient is None else [(name, int(np.prod(kind.limits(name)["shape"]))) for name in gradient[0]]


@functools.cache
def gradients(kind_a: type[Shape], kind_b: type[Shape], real: type) -> wp.Kernel:
    """Returns the kernel of the derivatives of a contact. Launch with dim (env, contact of the range)."""
    State = structs(real).State
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    pair, curvature = (
        narrow_phase.pair_functions(kind_a, kind_b, real),
        narrow_phase.curvature_functions(kind_a, kind_b).curvature,
    )
    relative_pose, find_contact = pair.relative_pose, pair.find_contact
    by_sizes_a, by_sizes_b = size_gradients(kind_a), size_gradients(kind_b)

    @unique_kernel()
    def measure_gradients(
        state: State,
        first: wp.int32,  # contact of the set
        contact_shapes: ContactShapes,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        warm_starts: WarmStarts,
        measured: Gradients,
    ):
        env, offset_in_range = wp.tid()
        contact = first + offset_in_range
        pose = relative_pose(state, env, contact, contact_shapes, shapes_a, shapes_b)
        contact_point = find_contact(
            env, contact, contact_shapes, shapes_a, shapes_b, pose, warm_starts.warm_start[env, contact]
        )
        pair_curvature = curvature(env, contact, contact_shapes, shapes_a, shapes_b, pose, contact_point)
        curvature_a = pair_curvature.a
        curvature_b = pair_curvature.b
        curvature_a.direction = wp.quat_rotate(pose.q_W, curvature_a.direction)
        curvature_b.direction = wp.quat_rotate(pose.q_W, curvature_b.direction)
        # In the axes of W; the origin is that of frame b.
        origin_b = -pose.offset
        rates = gradients_of(
            wp.quat_rotate(pose.q_W, contact_point.normal),
            contact_point.gap,
            wp.quat_rotate(pose.q_W, contact_point.point_a),
            wp.quat_rotate(pose.q_W, contact_point.point_b),
            curvature_a,
            curvature_b,
            origin_b + pose.body_offset,
            origin_b,
        )
        measured.gap_by_position_a[env, contact] = vector_of(rates.gap, 0)
        measured.gap_by_rotation_a[env, contact] = vector_of(rates.gap, 3)
        measured.gap_by_position_b[env, contact] = vector_of(rates.gap, 6)
        measured.gap_by_rotation_b[env, contact] = vector_of(rates.gap, 9)
        measured.normal_by_position_a[env, contact] = matrix_of(rates.normal, 0)
        measured.normal_by_rotation_a[env, contact] = matrix_of(rates.normal, 3)
        measured.normal_by_position_b[env, contact] = matrix_of(rates.normal, 6)
        measured.normal_by_rotation_b[env, contact] = matrix_of(rates.normal, 9)
        measured.point_a_by_position_a[env, contact] = matrix_of(rates.point_a, 0)
        measured.point_a_by_rotation_a[env, contact] = matrix_of(rates.point_a, 3)
        measured.point_a_by_position_b[env, contact] = matrix_of(rates.point_a, 6)
        measured.point_a_by_rotation_b[env, contact] = matrix_of(rates.point_a, 9)
        measured.point_b_by_position_a[env, contact] = matrix_of(rates.point_b, 0)
        measured.point_b_by_rotation_a[env, contact] = matrix_of(rates.point_b, 3)
        measured.point_b_by_position_b[env, contact] = matrix_of(rates.point_b, 6)
        measured.point_b_by_rotation_b[env, contact] = matrix_of(rates.point_b, 9)
        p_a = shapes_a.coefficients[env, contact_shapes.shape_a[contact]]
        p_b = shapes_b.coefficients[env, contact_shapes.shape_b[contact]]
        n_a = wp.quat_rotate_inv(pose.q, -contact_point.normal)
        point_a = wp.quat_rotate_inv(pose.q, contact_point.point_a - pose.x)
        measured.gap_by_sizes_a[env, contact] = by_sizes_a(p_a, point_a, n_a)
        measured.gap_by_sizes_b[env, contact] = by_sizes_b(p_b, contact_point.point_b, contact_point.normal)

    return measure_gradients
