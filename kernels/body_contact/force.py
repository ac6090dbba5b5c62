"""Force and torque of body contacts: the pressure of columns, and its friction, integrated over the overlap.

One kernel for each kind of pair, by the number of its curved solids. The beginning and the end of a pair are the same for all of
them; columns are those of ``polyhedron_force.py``, ``curved_force.py`` or ``curved_pair_force.py``.
"""

import functools

import warp as wp
from warpcontact.kernels.body_contact import curved_force, curved_pair_force, polyhedron_force
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.column_sums import pair_of
from warpcontact.kernels.body_contact.curved_sections import MAX_BREAKS, MAX_LIMITS
from warpcontact.kernels.body_contact.curved_solids import CURVED
from warpcontact.kernels.body_contact.face_trees import PENDING_NODES
from warpcontact.kernels.body_contact.overlap import LEAST_DEPTHS
from warpcontact.kernels.body_contact.pair_results import store_function
from warpcontact.kernels.body_contact.patches import (
    DEPTH_SUMS,
    PATCH_COUNT,
    PATCH_SUMS,
    start_depths,
    start_patches,
)
from warpcontact.kernels.body_contact.polygons import CORNER_ROWS
from warpcontact.kernels.body_contact.records import (
    BodyContactSettings,
    Patches,
    SolidPairs,
    body_contact_structs,
)
from warpcontact.kernels.body_contact.solids import MAX_PLANES, Geometries, Solids
from warpcontact.kernels.body_contact.surface_queries import (
    SolidBoxes,
    SolidGeometry,
    are_boxes_apart,
    solid_geometry,
)
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    DISABLED,
    ENV_ACTIVE,
    OPEN,
    LaunchRange,
    structs,
    task_count,
    task_of_item,
)

double = wp.float64

# Modules of the columns, by number of curved solids of a pair.
_KINDS = (polyhedron_force, curved_force, curved_pair_force)


@wp.func
def curved_solids_of(first: SolidGeometry, second: SolidGeometry):
    """Returns the number of curved solids of a pair."""
    count = wp.int32(0)
    if (first.flags & CURVED) != 0:
        count += 1
    if (second.flags & CURVED) != 0:
        count += 1
    return count


@functools.cache
def contact_forces(
    contact_model: ContactModel, real: type, per_area: bool, has_joints: bool, curved_count: int
) -> wp.Kernel:
    """Returns the force kernel of body contacts with one contact model; items: pairs.

    Args:
        contact_model: Classes of law and friction models. If the law has history variables, both act once per patch. Otherwise
            the law acts at each point of the area, and so does a friction model without history variables.
        real: Precision of state, law and friction. Geometry is in float64.
        per_area: Whether the law is a pressure; otherwise its mean over the area of the columns is the normal force.
        has_joints: Whether the effective mass includes the joints of bodies.
        curved_count: Number of curved solids of the pairs that it computes, 0 to 2; it skips others.
    """
    t = structs(real)
    Model, State, EndWrenches = t.Model, t.State, t.EndWrenches
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    has_patches, has_law_history = contact_model.acts_per_patch, bool(contact_model.law.memories)
    second_fraction = contact_model.law.second_fraction
    columns_of_pair = _KINDS[curved_count].pair_columns(contact_model, real, per_area, has_joints)
    store_result = store_function(contact_model, real, per_area, has_joints)
    pair_pose = solid_functions.functions(real).pair_pose
    # Lengths of the arrays of a thread that only some kernels use. They are cleared once per thread, not per pair.
    sum_count = PATCH_SUMS + DEPTH_SUMS if has_law_history else PATCH_SUMS
    plane_rows, depth_count = (MAX_PLANES, LEAST_DEPTHS) if curved_count == 0 else (1, 1)
    break_rows, limit_count = (MAX_BREAKS, MAX_LIMITS) if curved_count == 1 else (1, 1)

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
        planes = wp.zeros(shape=(plane_rows, 4), dtype=double)
        exits = wp.zeros(shape=(plane_rows, 2), dtype=double)
        least_depths = wp.zeros(shape=(depth_count,), dtype=double)
        breaks = wp.zeros(shape=(break_rows, 3), dtype=double)
        limits = wp.zeros(shape=(limit_count,), dtype=double)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
        normals = wp.zeros(shape=(PATCH_COUNT, 3), dtype=double)
        patch_rows = wp.zeros(shape=(PATCH_COUNT, sum_count), dtype=double)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env, item = task_of_item(launch, task)
            number = first_pair + item
            if status[env] != ENV_ACTIVE:
                continue
            setting = settings[env, number]
            solid_1 = pairs.first[number]
            solid_2 = pairs.second[number]
            contact_status = wp.where(setting.enabled == 0, DISABLED, OPEN)
            is_near = setting.enabled != 0 and not are_boxes_apart(
                boxes.box[env, solid_1], boxes.box[env, solid_2]
            )
            if not is_near and body_contacts.status[env, number] == contact_status:
                # Readings and wrenches are zero already.
                continue
            first = solid_geometry(geometries, solids.pose[env, solid_1])
            second = solid_geometry(geometries, solids.pose[env, solid_2])
            if curved_solids_of(first, second) != wp.static(curved_count):
                continue
            pose = pair_pose(state, env, solids, solid_1, solid_2)
            pair = pair_of(pose, solids, solid_1, solid_2, number)
            if wp.static(has_patches):
                start_patches(normals, patch_rows, patches_in, env, number)
            if wp.static(has_law_history):
                start_depths(patch_rows)
            kappa = setting.kappa
            if wp.static(second_fraction is not None):
                kappa = double(second_fraction(coefficients.law[env, number]))
            sums = columns_of_pair(
                model, state, env, step[env, 0], pair, pose, geometries, first, second, setting, kappa, contact_status,
                is_near, corners, planes, exits, least_depths, breaks, limits, pending, coefficients, history_in,
                history_out, body_contacts, normals, patch_rows,
            )  # fmt: skip
            store_result(
                model, state, env, step[env, 0], pair, sums, setting, coefficients, history_in, history_out, patches_in,
                patches_out, body_contacts, ends, first_end + 2 * number, patch_rows,
            )  # fmt: skip

    return body_contact_forces
