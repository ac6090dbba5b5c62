"""Boxes around solids in world axes, and bounds of their motion, by which distant pairs are rejected."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.columns import ramp_height
from warpcontact.kernels.body_contact.solids import HALF_SPACE, HAS_BOUNDARY, Geometries, Solids
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    BoundingBox,
    SolidBoxes,
    SolidMotion,
    bounding_box,
    largest_extent,
    solid_geometry,
)
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item


@functools.cache
def solid_boxes(real: type) -> wp.Kernel:
    """Returns the kernel that computes the boxes around solids, and bounds of their motion; items: solids."""
    State = structs(real).State
    to_float64 = frame_functions(real).to_float64
    pose_in_world = solid_functions.functions(real).pose_in_world

    @unique_kernel()
    def body_contact_solid_boxes(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        state: State,
        geometries: Geometries,
        solids: Solids,
        boxes: SolidBoxes,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            own = solids.pose[env, number]
            body = solids.body[number]
            solid = solid_geometry(geometries, own)
            pose = pose_in_world(state, env, solids, number)
            box = BoundingBox()
            box.upper = wp.vec3d(INFINITE, INFINITE, INFINITE)
            box.lower = -box.upper
            motion = SolidMotion()
            motion.extent = INFINITE
            if (solid.flags & HALF_SPACE) == 0:
                # The ramp of coplanar walls reaches beyond the solid.
                box = bounding_box(solid, pose, ramp_height(solid))
                motion.radius = wp.length(solid.center) + wp.length(solid.half_extents)
                if (solid.flags & HAS_BOUNDARY) == 0:
                    motion.extent = largest_extent(solid)
            else:
                motion.normal = wp.vec3d(pose.rotation[0, 2], pose.rotation[1, 2], pose.rotation[2, 2])
                motion.offset = wp.dot(motion.normal, pose.origin)
            motion.place = own.position
            if body >= 0:
                motion.place = to_float64(state.body_position[env, body])
                motion.place += to_float64(state.body_position_remainder[env, body])
                motion.radius += wp.length(own.position)
                motion.speed = wp.length(to_float64(state.body_linear_velocity[env, body]))
                motion.spin = wp.length(to_float64(state.body_angular_velocity[env, body]))
            boxes.box[env, number] = box
            boxes.motion[env, number] = motion

    return body_contact_solid_boxes
