"""Boxes around solids in world axes, by which distant pairs are rejected."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.columns import ramp_height
from warpcontact.kernels.body_contact.solids import HALF_SPACE, Geometries, Solids
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    BoundingBox,
    SolidBoxes,
    bounding_box,
    solid_geometry,
)
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item


@functools.cache
def solid_boxes(real: type) -> wp.Kernel:
    """Returns the kernel that computes the boxes around solids; items: solids."""
    State = structs(real).State
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
            solid = solid_geometry(geometries, solids.pose[env, number])
            box = BoundingBox()
            box.upper = wp.vec3d(INFINITE, INFINITE, INFINITE)
            box.lower = -box.upper
            if (solid.flags & HALF_SPACE) == 0:
                # The ramp of coplanar walls reaches beyond the solid.
                box = bounding_box(solid, pose_in_world(state, env, solids, number), ramp_height(solid))
            boxes.box[env, number] = box

    return body_contact_solid_boxes
