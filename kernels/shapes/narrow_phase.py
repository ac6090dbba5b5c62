"""Narrow phase of shape contacts: relative pose, gap, normal and arms of each pair.

All computations are in float64, independent of the precision of the model.
"""

import functools
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.shapes.base import Curvature, Shape, ShapeContactPoint, WarmStart, one, vec3d, zero
from warpcontact.kernels.shapes.records import (
    ContactShapes,
    ShapeContactSettings,
    ShapePose,
    WarmStarts,
    shape_contact_structs,
    shapes_struct,
)
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    ENV_ACTIVE,
    INACTIVE,
    NOT_CONVERGED,
    OPEN,
    OUTSIDE,
    UNSOLVED,
    WRONG_SIDE,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)

# Bounding radius of unbounded shapes [m].
UNBOUNDED_RADIUS = wp.constant(wp.float64(1.0e6))


@wp.struct
class RelativePose:
    """Pose of shape a relative to shape b.

    The carrier of a shape is its body or, for a shape fixed to the world, the origin of the shape itself.
    """

    x: vec3d  # origin of a in the frame of b [m]
    q: wp.quatd  # a → b
    q_W: wp.quatd  # b → W
    body_offset: vec3d  # from the carrier of b to the carrier of a, W [m]
    offset: vec3d  # origin of b from its carrier, W [m]


@functools.cache
def pose_function(real: type) -> wp.Function:
    """Returns the device function of the ``RelativePose`` of two shapes, for states of precision ``real``."""
    State = structs(real).State
    to_float64 = frames.functions(real).to_float64

    @wp.func
    def body_rotation(state: State, env: int, body: int):
        """Returns the rotation B → W of ``body`` (WORLD: identity), normalized in float64."""
        if body < 0:
            return wp.quatd(zero, zero, zero, wp.float64(1.0))
        q = state.body_orientation[env, body]
        return wp.normalize(wp.quatd(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]), wp.float64(q[3])))

    @wp.func
    def pose(state: State, env: int, body_a: int, shape_pose_a: ShapePose, body_b: int, shape_pose_b: ShapePose):
        """Returns the pose of the shape on ``body_a`` relative to the shape on ``body_b``.

        A shape fixed to the world is its own carrier, so that large positions are subtracted before small offsets
        are added.
        """
        found = RelativePose()
        q_Wa = body_rotation(state, env, body_a) * shape_pose_a.orientation
        found.q_W = body_rotation(state, env, body_b) * shape_pose_b.orientation
        found.q = wp.quat_inverse(found.q_W) * q_Wa
        offset_a = vec3d()
        carrier_a = shape_pose_a.position
        remainder = vec3d()
        if body_a >= 0:
            offset_a = wp.quat_rotate(body_rotation(state, env, body_a), shape_pose_a.position)
            carrier_a = to_float64(state.body_position[env, body_a])
            remainder = to_float64(state.body_position_remainder[env, body_a])
        carrier_b = shape_pose_b.position
        if body_b >= 0:
            found.offset = wp.quat_rotate(body_rotation(state, env, body_b), shape_pose_b.position)
            carrier_b = to_float64(state.body_position[env, body_b])
            remainder -= to_float64(state.body_position_remainder[env, body_b])
        found.body_offset = (carrier_a - carrier_b) + remainder
        found.x = wp.quat_rotate_inv(found.q_W, found.body_offset + (offset_a - found.offset))
        return found

    return pose


class PairFunctions(NamedTuple):
    """Device functions of the contact of a pair of shape classes."""

    #: ``(state, env, contact, contact_shapes, shapes_a, shapes_b)``: the ``RelativePose``.
    relative_pose: wp.Function
    #: ``(env, contact, contact_shapes, shapes_a, shapes_b, pose, warm_start)``: the ``ShapeContactPoint``.
    find_contact: wp.Function


@functools.cache
def pair_functions(kind_a: type[Shape], kind_b: type[Shape], real: type) -> PairFunctions:
    """Returns the device functions of a pair of shape classes."""
    from warpcontact.kernels.shapes.pair_dispatch import (
        pair_function,  # imports the solvers, which only shape contacts need
    )

    State = structs(real).State
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    solve_pair = pair_function(kind_a, kind_b)
    pose_of = pose_function(real)

    @wp.func
    def relative_pose(
        state: State, env: int, contact: int, contact_shapes: ContactShapes, shapes_a: ShapesA, shapes_b: ShapesB
    ):
        return pose_of(
            state,
            env,
            contact_shapes.body_a[contact],
            shapes_a.pose[env, contact_shapes.shape_a[contact]],
            contact_shapes.body_b[contact],
            shapes_b.pose[env, contact_shapes.shape_b[contact]],
        )

    @wp.func
    def find_contact(
        env: int,
        contact: int,
        contact_shapes: ContactShapes,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        pose: RelativePose,
        warm_start: WarmStart,
    ):
        p_a = shapes_a.coefficients[env, contact_shapes.shape_a[contact]]
        p_b = shapes_b.coefficients[env, contact_shapes.shape_b[contact]]
        return solve_pair(p_a, p_b, pose.x, pose.q, warm_start)

    return PairFunctions(relative_pose=relative_pose, find_contact=find_contact)


class CurvatureFunctions(NamedTuple):
    """Device functions of the curvatures of a pair of shape classes."""

    #: ``(env, contact, contact_shapes, shapes_a, shapes_b, pose, contact_point)``: the ``PairCurvature``.
    curvature: wp.Function
    #: ``(env, contact, contact_shapes, shapes_a, shapes_b, relative)``: radius of rolling and of the contact
    #: patch: 1/κ₂ of the gap, at most the smaller bounding radius [m].
    radius: wp.Function


@functools.cache
def curvature_functions(kind_a: type[Shape], kind_b: type[Shape]) -> CurvatureFunctions:
    """Returns the device functions for the curvatures of a pair of shape classes.

    Raises:
        TypeError: If a shape has no curvature function.
    """
    from warpcontact.kernels.shapes.curvature import pair_curvature

    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    relative_of = pair_curvature(kind_a, kind_b)
    size_a, size_b = bounding_radius(kind_a), bounding_radius(kind_b)

    @wp.func
    def curvature(
        env: int,
        contact: int,
        contact_shapes: ContactShapes,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        pose: RelativePose,
        contact_point: ShapeContactPoint,
    ):
        p_a = shapes_a.coefficients[env, contact_shapes.shape_a[contact]]
        p_b = shapes_b.coefficients[env, contact_shapes.shape_b[contact]]
        return relative_of(p_a, p_b, pose.x, pose.q, contact_point)

    @wp.func
    def radius(
        env: int,
        contact: int,
        contact_shapes: ContactShapes,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        relative: Curvature,
    ):
        largest = wp.min(
            size_a(shapes_a.coefficients[env, contact_shapes.shape_a[contact]]),
            size_b(shapes_b.coefficients[env, contact_shapes.shape_b[contact]]),
        )
        if relative.k_2 * largest > one:
            return one / relative.k_2
        return largest

    return CurvatureFunctions(curvature=curvature, radius=radius)


def bounding_radius(kind: type[Shape]) -> wp.Function:
    """Returns the device function of the bounding radius of a shape; ``UNBOUNDED_RADIUS`` for unbounded shapes."""
    if not isinstance(getattr(kind, "extents", None), wp.Function):

        @wp.func
        def unbounded(p: Any):
            return UNBOUNDED_RADIUS

        return unbounded
    extents = kind.extents

    @wp.func
    def size(p: Any):
        return wp.length(extents(p))

    return size


@functools.cache
def kernel(
    kind_a: type[Shape], kind_b: type[Shape], real: type, needs_curvature: bool, oriented: bool
) -> wp.Kernel:
    """Returns the narrow-phase kernel for two shape classes; items: contacts.

    Args:
        kind_a: Class of the first shapes.
        kind_b: Class of the second shapes, out of which normals point.
        real: Precision.
        needs_curvature: Whether laws or friction models read curvatures.
        oriented: Whether they read the orientation of the second shape.
    """
    t = structs(real)
    State, ShapeContacts = t.State, shape_contact_structs(real).ShapeContacts
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    pair = pair_functions(kind_a, kind_b, real)
    relative_pose, find_contact = pair.relative_pose, pair.find_contact
    curvature = radius_of = None
    if needs_curvature:
        curvature_of = curvature_functions(kind_a, kind_b)
        curvature, radius_of = curvature_of.curvature, curvature_of.radius
    from_float64 = frames.functions(real).from_float64
    quat = t.quat

    @unique_kernel()
    def detect_shape_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        state: State,
        first: wp.int32,  # contact
        contact_shapes: ContactShapes,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        settings: wp.array2d(dtype=ShapeContactSettings),
        warm_starts: WarmStarts,
        new_warm_starts: WarmStarts,
        shape_contacts: ShapeContacts,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = first + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            setting = settings[env, contact]
            shape_contacts.penetration[env, contact] = real(0.0)
            if setting.enabled == 0:
                shape_contacts.gap[env, contact] = real(wp.nan)
                shape_contacts.normal[env, contact] = t.vec3()
                shape_contacts.status[env, contact] = DISABLED
                continue
            pose = relative_pose(state, env, contact, contact_shapes, shapes_a, shapes_b)
            contact_point = find_contact(
                env, contact, contact_shapes, shapes_a, shapes_b, pose, warm_starts.warm_start[env, contact]
            )
            new_warm_starts.warm_start[env, contact] = contact_point.warm_start

            contact_status = wp.int32(OPEN)
            if contact_point.status == NOT_CONVERGED:
                contact_status = UNSOLVED
            elif contact_point.status == OUTSIDE:
                contact_status = INACTIVE
            elif contact_point.gap < setting.contact_tolerance:
                contact_status = CONTACT
                if -contact_point.gap > setting.max_depth:
                    contact_status = WRONG_SIDE
            if contact_status == CONTACT:
                shape_contacts.penetration[env, contact] = real(wp.max(-contact_point.gap, zero))
            to_contact = contact_point.point_b + setting.kappa * (contact_point.point_a - contact_point.point_b)
            arm_b = pose.offset + wp.quat_rotate(pose.q_W, to_contact)
            shape_contacts.gap[env, contact] = real(contact_point.gap)
            shape_contacts.normal[env, contact] = from_float64(wp.quat_rotate(pose.q_W, contact_point.normal))
            shape_contacts.arm_a[env, contact] = from_float64(arm_b - pose.body_offset)
            shape_contacts.arm_b[env, contact] = from_float64(arm_b)
            shape_contacts.status[env, contact] = contact_status
            shape_contacts.converged[env, contact] = wp.where(contact_point.status == NOT_CONVERGED, 0, 1)
            shape_contacts.iterations[env, contact] = contact_point.iterations
            shape_contacts.residual[env, contact] = real(contact_point.residual)
            if wp.static(needs_curvature):
                pair_curvature = curvature(env, contact, contact_shapes, shapes_a, shapes_b, pose, contact_point)
                relative = pair_curvature.relative
                shape_contacts.curvature_1[env, contact] = real(relative.k_1)
                shape_contacts.curvature_2[env, contact] = real(relative.k_2)
                shape_contacts.radius[env, contact] = real(
                    radius_of(env, contact, contact_shapes, shapes_a, shapes_b, relative)
                )
            if wp.static(oriented):
                q = pose.q_W
                shape_contacts.orientation[env, contact] = quat(real(q[0]), real(q[1]), real(q[2]), real(q[3]))

    return detect_shape_contacts
