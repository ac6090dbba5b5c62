"""Force and torque of body contacts of two curved solids: columns along the normal of their common plane."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.column_sums import Column, ColumnSums, column_functions, pair_of
from warpcontact.kernels.body_contact.curved_pairs import (
    ANGLE_STEP,
    DIRECTIONS,
    RADIAL_POINTS,
    RADII,
    RADIUS_WEIGHTS,
    CommonPlane,
    CurvedPair,
    boundary_distance,
    common_interval,
    common_plane,
    direction_of,
)
from warpcontact.kernels.body_contact.curved_solids import CURVED
from warpcontact.kernels.body_contact.patches import PATCH_COUNT, PATCH_SUMS, patch_of, start_patches
from warpcontact.kernels.body_contact.records import (
    BodyContactSettings,
    Patches,
    SolidPairs,
    body_contact_structs,
)
from warpcontact.kernels.body_contact.solids import Geometries, Solids
from warpcontact.kernels.body_contact.surface_queries import SolidBoxes, are_apart, are_boxes_apart, solid_geometry
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    ENV_ACTIVE,
    OPEN,
    WRONG_SIDE,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)

vec3d = wp.vec3d
double = wp.float64


@functools.cache
def curved_pair_forces(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Kernel:
    """Returns the force kernel of body contacts of two curved solids; items: pairs.

    The arguments are those of ``force.contact_forces``.
    """
    t = structs(real)
    Model, State, EndWrenches = t.Model, t.State, t.EndWrenches
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    has_patches = bool(contact_model.friction.memories)
    second_fraction = contact_model.law.second_fraction
    columns = column_functions(contact_model, real, per_area, has_joints)
    add_column, store_result = columns.add_column, columns.store_result
    pair_pose = solid_functions.functions(real).pair_pose

    @unique_kernel()
    def curved_pair_contact_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        step: wp.array2d(dtype=real),  # [env, 0] duration over which the force acts [s]; 0: instantaneous force
        first_pair: wp.int32,  # pair of the first item
        first_end: wp.int32,
        geometries: Geometries,
        solids: Solids,
        boxes: SolidBoxes,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        patches_in: Patches,
        patches_out: Patches,
        body_contacts: BodyContacts,
        ends: EndWrenches,
    ):
        normals = wp.zeros(shape=(PATCH_COUNT, 3), dtype=double)
        patch_rows = wp.zeros(shape=(PATCH_COUNT, PATCH_SUMS), dtype=double)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = first_pair + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            setting = settings[env, number]
            solid_1 = pairs.first[number]
            solid_2 = pairs.second[number]
            solids_of_pair = CurvedPair()
            solids_of_pair.first = solid_geometry(geometries, solids.pose[env, solid_1])
            solids_of_pair.second = solid_geometry(geometries, solids.pose[env, solid_2])
            if (solids_of_pair.first.flags & CURVED) == 0 or (solids_of_pair.second.flags & CURVED) == 0:
                continue
            contact_status = wp.int32(OPEN)
            if setting.enabled == 0:
                contact_status = DISABLED
            is_near = contact_status == OPEN and not are_boxes_apart(
                boxes.box[env, solid_1], boxes.box[env, solid_2]
            )
            if not is_near and body_contacts.status[env, number] == contact_status:
                # Readings and wrenches are zero already.
                continue
            pose = pair_pose(state, env, solids, solid_1, solid_2)
            pair = pair_of(pose, solids, solid_1, solid_2, number)
            solids_of_pair.pose = pose.first_in_second
            solids_of_pair.size = wp.length(solids_of_pair.first.half_extents)
            solids_of_pair.size += wp.length(solids_of_pair.second.half_extents)
            kappa = setting.kappa
            if wp.static(second_fraction is not None):
                kappa = double(second_fraction(coefficients.law[env, number]))
            plane = CommonPlane()
            if is_near:
                is_near = not are_apart(
                    solids_of_pair.first, solids_of_pair.second, pose.first_in_second, double(0.0)
                )
            if is_near:
                plane = common_plane(solids_of_pair)
            if plane.is_found:
                contact_status = CONTACT
                if plane.largest_depth > setting.max_depth:
                    contact_status = WRONG_SIDE

            sums = ColumnSums()
            if wp.static(has_patches):
                start_patches(normals, patch_rows, patches_in, env, number)
            directions = wp.int32(0)
            if contact_status == CONTACT:
                directions = DIRECTIONS
            rotation = pose.second_axes.rotation
            column = Column()
            column.normal = rotation * plane.normal
            if wp.static(has_patches):
                column.patch = patch_of(normals, pair.to_axes * column.normal)
            unit_area = ANGLE_STEP * wp.length(plane.u_axis) * wp.length(plane.v_axis)
            limit = double(1.0)
            for number_of_direction in range(directions):
                direction = direction_of(plane, number_of_direction)
                limit = boundary_distance(solids_of_pair, plane, direction, limit)
                for i in range(RADIAL_POINTS):
                    base = plane.center + (limit * RADII[i]) * direction
                    interval = common_interval(solids_of_pair, base, plane.normal)
                    column.depth = interval[1] - interval[0]
                    if column.depth <= double(0.0):
                        continue
                    column.fraction = double(1.0)
                    column.weight = unit_area * RADIUS_WEIGHTS[i] * RADII[i] * limit * limit
                    # Columns stand on the second solid.
                    column.position = rotation * (base + (interval[1] - kappa * column.depth) * plane.normal)
                    sums = add_column(
                        model, state, env, step[env, 0], pair, column, coefficients, history_in, history_out,
                        body_contacts, sums, normals, patch_rows,
                    )  # fmt: skip
            store_result(
                state, env, step[env, 0], pair, contact_status, plane.largest_depth, double(0.5), setting, coefficients,
                history_in, history_out, patches_out, body_contacts, ends, first_end + 2 * number, sums, patch_rows,
            )  # fmt: skip

    return curved_pair_contact_forces
