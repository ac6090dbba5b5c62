"""Force and torque of body contacts: the pressure of columns, and its friction, integrated over the overlap."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import face_columns
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.column_sums import ColumnSums, RelativeMotion, column_functions, pair_of
from warpcontact.kernels.body_contact.columns import ramp_height
from warpcontact.kernels.body_contact.convex_columns import store_planes
from warpcontact.kernels.body_contact.curved_solids import CURVED
from warpcontact.kernels.body_contact.face_columns import column_side, other_box
from warpcontact.kernels.body_contact.face_trees import PENDING_NODES, next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.overlap import (
    LEAST_DEPTHS,
    NO_WEIGHT,
    Overlap,
    least_depth_of_face,
    overlap_of,
)
from warpcontact.kernels.body_contact.patches import PATCH_COUNT, PATCH_SUMS, start_patches
from warpcontact.kernels.body_contact.polygons import CORNER_ROWS
from warpcontact.kernels.body_contact.records import (
    BodyContactSettings,
    Patches,
    SolidPairs,
    body_contact_structs,
)
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    HAS_BOUNDARY,
    MAX_PLANES,
    Geometries,
    Solids,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import (
    SolidBoxes,
    are_apart,
    are_boxes_apart,
    is_face_outside,
    solid_geometry,
)
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
def contact_forces(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Kernel:
    """Returns the force kernel of body contacts with one contact model; items: pairs.

    Args:
        contact_model: Classes of law and friction models. The law has no history variables. A friction model with history
            variables acts once per patch, another one at each point of the area.
        real: Precision of state, law and friction. Geometry is in float64.
        per_area: Whether the law is a pressure; otherwise its mean over the area of the columns is the normal force.
        has_joints: Whether the effective mass includes the joints of bodies.
    """
    t = structs(real)
    Model, State, EndWrenches = t.Model, t.State, t.EndWrenches
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    has_patches = bool(contact_model.friction.memories)
    second_fraction = contact_model.law.second_fraction
    columns = column_functions(contact_model, real, per_area, has_joints)
    relative_motion, store_result = columns.relative_motion, columns.store_result
    add_face = face_columns.add_face(contact_model, real, per_area, has_joints)
    pair_pose = solid_functions.functions(real).pair_pose

    @unique_kernel()
    def body_contact_forces(
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
        corners = wp.zeros(shape=(CORNER_ROWS, 3), dtype=double)
        planes = wp.zeros(shape=(MAX_PLANES, 4), dtype=double)
        exits = wp.zeros(shape=(MAX_PLANES, 2), dtype=double)
        least_depths = wp.zeros(shape=(LEAST_DEPTHS,), dtype=double)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
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
            contact_status = wp.int32(OPEN)
            if setting.enabled == 0:
                contact_status = DISABLED
            is_near = contact_status == OPEN and not are_boxes_apart(
                boxes.box[env, solid_1], boxes.box[env, solid_2]
            )
            if not is_near and body_contacts.status[env, number] == contact_status:
                # Readings and wrenches are zero already.
                continue
            first = solid_geometry(geometries, solids.pose[env, solid_1])
            second = solid_geometry(geometries, solids.pose[env, solid_2])
            if ((first.flags | second.flags) & CURVED) != 0:
                continue
            pose = pair_pose(state, env, solids, solid_1, solid_2)
            pair = pair_of(pose, solids, solid_1, solid_2, number)
            half_space = (second.flags & HALF_SPACE) != 0
            second_is_reference = (second.flags & (HALF_SPACE | HAS_BOUNDARY)) != 0
            overlap = Overlap()
            if is_near and not half_space:
                is_near = not are_apart(
                    first, second, pose.first_in_second, ramp_height(first) + ramp_height(second)
                )
            if is_near:
                overlap = overlap_of(
                    corners, planes, exits, least_depths, pending, geometries, first, second, pose.first_in_second
                )
                if setting.reference >= double(0.0) and not second_is_reference:
                    overlap.share = setting.reference
                if overlap.depth > double(0.0):
                    contact_status = CONTACT
                    if overlap.depth > setting.max_depth:
                        contact_status = WRONG_SIDE

            sums = ColumnSums()
            if wp.static(has_patches):
                start_patches(normals, patch_rows, patches_in, env, number)
            sides = wp.int32(0)
            motion = RelativeMotion()
            if contact_status == CONTACT:
                motion = relative_motion(state, env, pair)
                sides = wp.where(second_is_reference, 1, 2)
            for number_of_side in range(sides):
                kappa = setting.kappa
                if wp.static(second_fraction is not None):
                    kappa = double(second_fraction(coefficients.law[env, number]))
                side = column_side(first, second, pose, overlap, kappa, number_of_side)
                if side.share == double(0.0):
                    continue
                if side.by_planes:
                    store_planes(planes, geometries, side.other)
                box = other_box(side)
                top = start_traversal(pending, 0, side.own)
                while top > 0:
                    leaf = next_leaf_in_box(pending, 0, top, geometries, side.own, no_motion(), box)
                    top = leaf.top
                    for face in range(leaf.first_face, leaf.end_face):
                        if not half_space:
                            least = least_depth_of_face(least_depths, number_of_side, face - side.own.first_face)
                            if least >= NO_WEIGHT * overlap.depth or is_face_outside(
                                geometries, side.own, face, box
                            ):
                                continue
                        sums = add_face(
                            model, state, env, step[env, 0], pair, motion, geometries, side, overlap, face, corners,
                            planes, exits, pending, top, coefficients, history_in, history_out, body_contacts, sums, normals,
                            patch_rows,
                        )  # fmt: skip
            if half_space:
                # Parts wholly below the plane have columns that cancel: the area is that of the exits.
                sums.area = double(0.5) * (sums.area + sums.gross_area)
            store_result(
                state, env, step[env, 0], pair, contact_status, overlap.depth, overlap.share, setting, coefficients,
                history_in, history_out, patches_out, body_contacts, ends, first_end + 2 * number, sums, patch_rows,
            )  # fmt: skip

    return body_contact_forces
