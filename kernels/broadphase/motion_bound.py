"""Bounds the motion of point sets relative to their surface.

``Cache.set_travel`` accumulates, per set, an upper bound on the displacement of its points, as in conservative
advancement (Mirtich 1996). A point whose clearance exceeded the travel since then cannot be in contact.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item

# Rounding error of a position, in units of epsilon times the sum of its terms.
ROUNDING = 32.0


class Functions(NamedTuple):
    """Device functions of the motion bounds of point sets."""

    set_pose: wp.Function  # pose of a set relative to its surface
    displacement_bound: wp.Function  # bound on the displacement of its points since the last accumulation [m]
    accumulate_travel: wp.Function  # adds the displacement of a set to its travel; travel plus rounding [m]
    is_culled: wp.Function  # whether no point of a set can be in contact


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, quat, Model, State, Cache = t.vec3, t.quat, t.Model, t.State, t.Cache
    frame = frames.functions(real)
    offset_between, rotate_to_world, orientation_to_world = (
        frame.offset_between,
        frame.rotate_to_world,
        frame.orientation_to_world,
    )
    epsilon = wp.constant(real(t.epsilon))
    rounding = wp.constant(real(t.epsilon * ROUNDING))

    @wp.struct
    class SetPose:
        """Pose of a point set relative to its surface."""

        position: vec3  # center of the set, S [m]
        orientation: quat  # B → S, if the set has an extent
        margin: real  # rounding of a position [m]

    @wp.func
    def one_norm(v: vec3):
        """Returns the sum of absolute components, between 1 and √3 times the length."""
        return wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])

    @wp.func
    def set_pose(model: Model, state: State, env: int, set_index: int):
        contact = assume_nonnegative(model.set_contact[set_index])
        surface = assume_nonnegative(
            model.query_mesh_surface[assume_nonnegative(model.contact_query_mesh[contact])]
        )
        carrier = model.surface_body[surface]
        o_B = model.surface_position[env, surface]
        q_WS = orientation_to_world(state, env, carrier, model.surface_orientation[env, surface])
        point = assume_nonnegative(model.contact_point[contact])
        body = model.point_body[point]
        c_B = model.set_center[env, set_index]
        between = offset_between(model, state, env, point, surface)
        c_W = between + rotate_to_world(state, env, body, c_B) - rotate_to_world(state, env, carrier, o_B)
        pose = SetPose()
        pose.position = wp.quat_rotate_inv(q_WS, c_W)
        extent = model.set_extent[env, set_index]
        # The orientation does not affect a single point.
        if extent > real(0.0):
            pose.orientation = wp.quat_inverse(q_WS)
            if body >= 0:
                pose.orientation = pose.orientation * state.body_orientation[env, body]
        pose.margin = rounding * (one_norm(between) + one_norm(c_B) + one_norm(o_B) + extent)
        return pose

    @wp.func
    def displacement_bound(model: Model, cache: Cache, env: int, set_index: int, pose: SetPose):
        """Returns an upper bound on the displacement of any point of the set since the last accumulation [m]."""
        displacement = wp.length(pose.position - cache.set_position[env, set_index])
        extent = model.set_extent[env, set_index]
        if extent > real(0.0):
            # Unit quaternions q, q' move a point at distance 1 from the center to places at most 2 |q − q'| apart.
            last = cache.set_orientation[env, set_index]
            displacement += (
                real(2.0) * extent * wp.min(wp.length(pose.orientation - last), wp.length(pose.orientation + last))
            )
        return displacement * (real(1.0) + real(8.0) * epsilon)

    @wp.func
    def accumulate_travel(model: Model, state: State, cache: Cache, env: int, set_index: int):
        """Adds the displacement of a set to its travel; returns the travel plus the rounding of positions [m]."""
        pose = set_pose(model, state, env, set_index)
        displacement = displacement_bound(model, cache, env, set_index, pose)
        previous_travel = cache.set_travel[env, set_index]
        travel = previous_travel + displacement + epsilon * previous_travel
        cache.set_position[env, set_index] = pose.position
        cache.set_orientation[env, set_index] = pose.orientation
        cache.set_travel[env, set_index] = travel
        cache.set_step_travel[env, set_index] = displacement
        cache.set_margin[env, set_index] = pose.margin
        return travel + pose.margin

    @wp.func
    def is_culled(model: Model, cache: Cache, env: int, set_index: int, max_travel: real):
        """Returns whether no point of a set can be in contact."""
        safe_travel = cache.set_safe_travel[env, set_index]
        if max_travel < safe_travel:
            return True
        # Safe travels of the clusters may have grown since.
        safe_travel = real(wp.inf)
        cluster = assume_nonnegative(model.set_cluster_start[set_index])
        stop = model.set_cluster_start[set_index + 1]
        while cluster < stop:
            safe_travel = wp.min(safe_travel, cache.cluster_safe_travel[env, cluster])
            cluster = assume_nonnegative(cluster + 1)
        cache.set_safe_travel[env, set_index] = safe_travel
        return max_travel < safe_travel

    return Functions(
        set_pose=set_pose,
        displacement_bound=displacement_bound,
        accumulate_travel=accumulate_travel,
        is_culled=is_culled,
    )


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that accumulates the travel of every set; items: sets.

    Motion is measured relative to the surface, which may move as well. Setting the pose of a body counts as
    motion.
    """
    t = structs(real)
    Model, State, Cache = t.Model, t.State, t.Cache
    accumulate_travel, is_culled = functions(real).accumulate_travel, functions(real).is_culled

    @unique_kernel()
    def add_travel(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), model: Model, state: State, cache: Cache
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            set_index = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            max_travel = accumulate_travel(model, state, cache, env, set_index)
            culled = is_culled(model, cache, env, set_index, max_travel)
            cache.set_culled[env, set_index] = wp.where(culled, 1, 0)

    return add_travel
