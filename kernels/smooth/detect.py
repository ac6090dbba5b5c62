"""Where two shapes of an environment meet: pose of one in the frame of the other, gap, normal and arms.

In float64 whatever the precision of the model.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.smooth.base import Curvature, Meeting, Seed, Shape, one, vec3d, zero
from warpcontact.kernels.smooth.records import Members, Mount, Seeds, Settings, contact_structs, shapes_struct
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
    Work,
    env_of,
    item_of,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel

# Size of what has no end [m].
endless_size = wp.constant(wp.float64(1.0e6))


@wp.struct
class Pose:
    """One shape seen from another, and both from their bodies."""

    x: vec3d  # origin of a in the frame of b [m]
    q: wp.quatd  # a → b
    q_W: wp.quatd  # b → W
    bodies: vec3d  # from what carries b to what carries a, W [m]
    offset: vec3d  # of b from what carries it, W [m]


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    State = structs(real).State
    wide = frames.functions(real).wide

    @wp.func
    def turn(state: State, env: int, body: int):
        """Rotation B → W of ``body`` (WORLD: none), of length 1 in float64."""
        if body < 0:
            return wp.quatd(zero, zero, zero, wp.float64(1.0))
        q = state.body_orientation[env, body]
        return wp.normalize(wp.quatd(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]), wp.float64(q[3])))

    @wp.func
    def pose(state: State, env: int, body_a: int, mount_a: Mount, body_b: int, mount_b: Mount):
        """Pose of the shape mounted on ``body_a`` from that on ``body_b``.

        What is fixed to the world is carried by its own origin, so that places that cancel are subtracted first.
        """
        found = Pose()
        q_Wa = turn(state, env, body_a) * mount_a.orientation
        found.q_W = turn(state, env, body_b) * mount_b.orientation
        found.q = wp.quat_inverse(found.q_W) * q_Wa
        offset_a = vec3d()
        place_a = mount_a.position
        remainder = vec3d()
        if body_a >= 0:
            offset_a = wp.quat_rotate(turn(state, env, body_a), mount_a.position)
            place_a = wide(state.body_position[env, body_a])
            remainder = wide(state.body_position_remainder[env, body_a])
        place_b = mount_b.position
        if body_b >= 0:
            found.offset = wp.quat_rotate(turn(state, env, body_b), mount_b.position)
            place_b = wide(state.body_position[env, body_b])
            remainder -= wide(state.body_position_remainder[env, body_b])
        found.bodies = (place_a - place_b) + remainder
        found.x = wp.quat_rotate_inv(found.q_W, found.bodies + (offset_a - found.offset))
        return found

    return SimpleNamespace(turn=turn, pose=pose)


@functools.cache
def seen(kind_a: type[Shape], kind_b: type[Shape], real: type) -> SimpleNamespace:
    """Returns the device functions of a pair of kinds.

    ``pair`` takes ``(state, env, contact, members, shapes_a, shapes_b)`` and returns the ``Pose``; ``meeting`` the
    same arguments, that pose and a seed, and returns where the shapes meet.
    """
    from warpcontact.kernels.smooth.meet import meet  # with its solvers, which only shape contacts need

    State = structs(real).State
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    met = meet(kind_a, kind_b)
    pose_of = functions(real).pose

    @wp.func
    def pair(state: State, env: int, contact: int, members: Members, shapes_a: ShapesA, shapes_b: ShapesB):
        return pose_of(
            state,
            env,
            members.body_a[contact],
            shapes_a.mount[env, members.shape_a[contact]],
            members.body_b[contact],
            shapes_b.mount[env, members.shape_b[contact]],
        )

    @wp.func
    def meeting(
        env: int, contact: int, members: Members, shapes_a: ShapesA, shapes_b: ShapesB, pose: Pose, seed: Seed
    ):
        p_a = shapes_a.coefficients[env, members.shape_a[contact]]
        p_b = shapes_b.coefficients[env, members.shape_b[contact]]
        return met(p_a, p_b, pose.x, pose.q, seed)

    return SimpleNamespace(pair=pair, meeting=meeting)


@functools.cache
def bending(kind_a: type[Shape], kind_b: type[Shape]) -> SimpleNamespace:
    """Returns the device functions of the curvatures of a pair of kinds.

    ``bent`` takes ``(env, contact, members, shapes_a, shapes_b, pose, meeting)`` and returns both curvatures and
    the relative one; ``radius`` these arguments without pose and meeting, and the latter: the radius of rolling
    and of a patch of contact, that of the most curved section of the gap, and no more than the shapes are large.

    Raises:
        TypeError: If the curvature of one is not known.
    """
    from warpcontact.kernels.smooth.curvature import relative

    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    relative_of = relative(kind_a, kind_b)
    size_a, size_b = size_of(kind_a), size_of(kind_b)

    @wp.func
    def bent(
        env: int,
        contact: int,
        members: Members,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        pose: Pose,
        meeting: Meeting,
    ):
        p_a = shapes_a.coefficients[env, members.shape_a[contact]]
        p_b = shapes_b.coefficients[env, members.shape_b[contact]]
        return relative_of(p_a, p_b, pose.x, pose.q, meeting)

    @wp.func
    def radius(
        env: int, contact: int, members: Members, shapes_a: ShapesA, shapes_b: ShapesB, relative: Curvature
    ):
        largest = wp.min(
            size_a(shapes_a.coefficients[env, members.shape_a[contact]]),
            size_b(shapes_b.coefficients[env, members.shape_b[contact]]),
        )
        if relative.k_2 * largest > one:
            return one / relative.k_2
        return largest

    return SimpleNamespace(bent=bent, radius=radius)


def size_of(kind: type[Shape]) -> wp.Function:
    """Returns the device function of the radius of a ball that holds a shape; very large of one without end."""
    if not isinstance(getattr(kind, "extents", None), wp.Function):

        @wp.func
        def endless(p: Any):
            return endless_size

        return endless
    extents = kind.extents

    @wp.func
    def size(p: Any):
        return wp.length(extents(p))

    return size


@functools.cache
def kernel(kind_a: type[Shape], kind_b: type[Shape], real: type, curved: bool, oriented: bool) -> wp.Kernel:
    """Returns the kernel that finds where shapes of two kinds meet; items: contacts.

    Args:
        kind_a: Of the first shapes.
        kind_b: Of the second, out of which normals point.
        real: Precision.
        curved: Whether laws or friction models look at curvatures.
        oriented: Whether they look at directions that turn with the second shape.
    """
    t = structs(real)
    State, Smooth = t.State, contact_structs(real).Smooth
    ShapesA, ShapesB = shapes_struct(kind_a), shapes_struct(kind_b)
    pair = seen(kind_a, kind_b, real)
    pose_of, meeting_of = pair.pair, pair.meeting
    bent = radius_of = None
    if curved:
        bends = bending(kind_a, kind_b)
        bent, radius_of = bends.bent, bends.radius
    narrow = frames.functions(real).narrow
    quat = t.quat

    @unique_kernel()
    def detect(
        work: Work,
        status: wp.array(dtype=wp.int32),
        state: State,
        first: wp.int32,  # contact
        members: Members,
        shapes_a: ShapesA,
        shapes_b: ShapesB,
        settings: wp.array2d(dtype=Settings),
        held: Seeds,
        found: Seeds,
        smooth: Smooth,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            contact = first + item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            own = settings[env, contact]
            smooth.penetration[env, contact] = real(0.0)
            if own.enabled == 0:
                smooth.gap[env, contact] = real(wp.nan)
                smooth.normal[env, contact] = t.vec3()
                smooth.status[env, contact] = DISABLED
                continue
            pose = pose_of(state, env, contact, members, shapes_a, shapes_b)
            meeting = meeting_of(env, contact, members, shapes_a, shapes_b, pose, held.seed[env, contact])
            found.seed[env, contact] = meeting.seed

            touching = wp.int32(OPEN)
            if meeting.status == NOT_CONVERGED:
                touching = UNSOLVED
            elif meeting.status == OUTSIDE:
                touching = INACTIVE
            elif meeting.gap < own.closed:
                touching = CONTACT
                if -meeting.gap > own.max_depth:
                    touching = WRONG_SIDE
            if touching == CONTACT:
                smooth.penetration[env, contact] = real(wp.max(-meeting.gap, zero))
            to_contact = meeting.point_b + own.kappa * (meeting.point_a - meeting.point_b)
            arm_b = pose.offset + wp.quat_rotate(pose.q_W, to_contact)
            smooth.gap[env, contact] = real(meeting.gap)
            smooth.normal[env, contact] = narrow(wp.quat_rotate(pose.q_W, meeting.normal))
            smooth.arm_a[env, contact] = narrow(arm_b - pose.bodies)
            smooth.arm_b[env, contact] = narrow(arm_b)
            smooth.status[env, contact] = touching
            smooth.converged[env, contact] = wp.where(meeting.status == NOT_CONVERGED, 0, 1)
            smooth.iterations[env, contact] = meeting.iterations
            smooth.residual[env, contact] = real(meeting.residual)
            if wp.static(curved):
                bend = bent(env, contact, members, shapes_a, shapes_b, pose, meeting)
                relative = bend.relative
                smooth.curvature_1[env, contact] = real(relative.k_1)
                smooth.curvature_2[env, contact] = real(relative.k_2)
                smooth.radius[env, contact] = real(radius_of(env, contact, members, shapes_a, shapes_b, relative))
            if wp.static(oriented):
                q = pose.q_W
                smooth.orientation[env, contact] = quat(real(q[0]), real(q[1]), real(q[2]), real(q[3]))

    return detect
