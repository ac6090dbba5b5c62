"""Forces of the patches of a pair of body contact, and its results: sensor values, and the wrenches of both bodies."""

import functools

import warp as wp
from warpcontact.kernels.body_contact.column_sums import ColumnSums, Pair
from warpcontact.kernels.body_contact.patches import (
    PATCH_COUNT,
    PatchDepths,
    PatchShape,
    depths_of_patch,
    shape_of_patch,
)
from warpcontact.kernels.body_contact.patches import functions as patch_functions
from warpcontact.kernels.body_contact.records import BodyContactSettings, Patches, body_contact_structs
from warpcontact.kernels.catalogue import history_variables
from warpcontact.kernels.contact.contact_evaluation import ContactModel, functions, group_structs
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.types import CONTACT, structs

vec3d = wp.vec3d
double = wp.float64
# Area of the columns, relative to the sum of the magnitudes of its parts, below which it counts as zero.
CANCELLED = wp.constant(double(1.0e-9))


@functools.cache
def store_function(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Function:
    """Returns the device function that adds the forces of patches to the sums of a pair, and stores its results.

    Its arguments are (model, state, env, dt, pair, sums, setting, coefficients, history_in, history_out, patches_in, patches_out,
    body_contacts, ends, end, patch_rows). For those of the factory, see ``force.contact_forces``.
    """
    t = structs(real)
    quat, Model, State, EndWrenches = t.quat, t.Model, t.State, t.EndWrenches
    NormalState = t.NormalState
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    has_patches, has_law_history = contact_model.acts_per_patch, bool(contact_model.law.memories)
    needs_mass = contact_model.law.needs_mass
    evaluation = functions(contact_model, real, has_joints, has_friction=not has_patches)
    force_of_law, mobility = evaluation.force_of_law, evaluation.mobility
    clear_law_history = history_variables.functions(contact_model.law, real).clear_history
    friction = patch_functions(contact_model.friction, real)
    friction_of_patch, clear_history = friction.friction, friction.clear_history
    frame = frame_functions(real)
    to_float64, from_float64, velocity_at = frame.to_float64, frame.from_float64, frame.velocity_at

    @wp.func
    def axes_of(pair: Pair):
        return quat(real(pair.q_WS[0]), real(pair.q_WS[1]), real(pair.q_WS[2]), real(pair.q_WS[3]))

    @wp.func
    def pressure_of_patch(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        shape: PatchShape,
        depths: PatchDepths,
        entry_speed: double,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        member: int,
    ):
        """Returns the pressure of a law with history at a patch over the depth, and the approach speed of the patch.

        ``shape`` has the volume of the columns as normal force. [Pa/m] or [N/m], [m/s].
        """
        arm_1 = from_float64(shape.center)
        arm_2 = from_float64(shape.center - pair.arm_1 + pair.arm_2)
        n_W = from_float64(shape.normal)
        depth = wp.sqrt(depths.squares / depths.area)
        velocity = velocity_at(state, env, pair.body_2, arm_2) - velocity_at(state, env, pair.body_1, arm_1)
        normal_state = NormalState()
        normal_state.delta = real(depth)
        # Rate of the root mean square of depths: ∫ t ṫ dS/(S δ).
        normal_state.delta_dot = wp.dot(velocity, n_W) * real(shape.normal_force / (depths.area * depth))
        normal_state.entry_speed = wp.max(wp.max(real(entry_speed), normal_state.delta_dot), real(0.0))
        normal_state.dt = dt
        if wp.static(needs_mass):
            normal_state.inverse_mass = mobility(model, state, env, pair.body_1, arm_1, n_W) + mobility(
                model, state, env, pair.body_2, arm_2, n_W
            )
            normal_state.mass = real(1.0) / normal_state.inverse_mass
        is_new = entry_speed < double(0.0)
        # A new patch has not been in contact for longer than it took to reach this depth.
        max_elapsed = real(wp.inf)
        if is_new and normal_state.delta_dot > real(0.0):
            max_elapsed = normal_state.delta / normal_state.delta_dot
        force = force_of_law(
            coefficients.law[env, pair.number], normal_state, is_new, history_in.law, history_out.law, env, member,
            max_elapsed, dt, axes_of(pair), n_W,
        )  # fmt: skip
        return double(force) / depth, double(normal_state.delta_dot)

    @wp.func
    def store_result(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        sums: ColumnSums,
        setting: BodyContactSettings,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        patches_in: Patches,
        patches_out: Patches,
        body_contacts: BodyContacts,
        ends: EndWrenches,
        end: int,
        patch_rows: wp.array2d(dtype=double),
    ):
        is_contact = sums.status == CONTACT
        # Factor from sums over the area to the force of the contact, without and with ``force_scale``.
        unscaled = double(1.0)
        approach_speed = double(0.0)
        # Columns that cancel leave rounding errors, which have no mean.
        if sums.area > CANCELLED * sums.gross_area:
            approach_speed = sums.approach / sums.area
            if wp.static(not per_area):
                unscaled = double(1.0) / sums.area
        elif wp.static(not per_area):
            unscaled = double(0.0)
        scale = unscaled * setting.force_scale
        if wp.static(has_patches):
            # A new patch cannot have slipped for longer than it took to reach this depth.
            max_elapsed = real(wp.inf)
            if body_contacts.entry_speed[env, pair.number] < real(0.0) and approach_speed > double(0.0):
                max_elapsed = real(sums.depth / approach_speed)
            # Not a constant, so that the loop is not unrolled.
            patch_count = wp.int32(PATCH_COUNT)
            loads = wp.vec4d()
            for patch in range(patch_count):
                member = PATCH_COUNT * pair.number + patch
                patch_shape = shape_of_patch(patch_rows, patch)
                is_present = patch_shape.normal_force > double(0.0) and unscaled != double(0.0)
                if wp.static(has_law_history):
                    depths = depths_of_patch(patch_rows, patch)
                    # Columns that cancel leave rounding errors, which have no mean.
                    is_present = is_present and depths.area > CANCELLED * depths.gross_area
                    is_present = is_present and depths.squares > double(0.0)
                if not is_present:
                    patches_out.normal[env, member] = vec3d()
                    clear_history(history_out.friction, env, member, dt)
                    if wp.static(has_law_history):
                        patches_out.entry_speed[env, member] = double(-1.0)
                        clear_law_history(history_out.law, env, member, dt)
                    continue
                patches_out.normal[env, member] = pair.to_axes * patch_shape.normal
                if wp.static(has_law_history):
                    entry_speed = patches_in.entry_speed[env, member]
                    factor, speed = pressure_of_patch(
                        model, state, env, dt, pair, patch_shape, depths, entry_speed, coefficients, history_in,
                        history_out, member,
                    )  # fmt: skip
                    # At least 0: negative values mean "no patch".
                    patches_out.entry_speed[env, member] = wp.max(wp.max(entry_speed, speed), double(0.0))
                    patch_shape.normal_force = factor * patch_shape.normal_force
                    force_W = factor * vec3d(patch_rows[patch, 10], patch_rows[patch, 11], patch_rows[patch, 12])
                    sums.pressure += patch_shape.normal_force
                    sums.max_pressure = wp.max(sums.max_pressure, factor * depths.largest)
                    sums.moment += patch_shape.normal_force * patch_shape.center
                    sums.force += force_W
                    sums.torque_1 += factor * depths.turning
                    sums.torque_2 -= factor * depths.turning + wp.cross(pair.arm_2 - pair.arm_1, force_W)
                loads[patch] = wp.max(patch_shape.normal_force, double(0.0))
                if loads[patch] == double(0.0):
                    clear_history(history_out.friction, env, member, dt)
            load = loads[0] + loads[1] + loads[2] + loads[3]
            for patch in range(patch_count):
                if loads[patch] == double(0.0):
                    continue
                member = PATCH_COUNT * pair.number + patch
                patch_shape = shape_of_patch(patch_rows, patch)
                # Friction of the load of all patches, of which a patch has its fraction: otherwise one with a tiny load would
                # have the damping of the whole contact at small slip. The sums are per area, or per contact; the force of
                # the contact is ``scale`` times that.
                load_fraction = loads[patch] / load
                patch_shape.normal_force = load * unscaled
                arm_2 = patch_shape.center - pair.arm_1 + pair.arm_2
                wrench = friction_of_patch(
                    state, env, pair.body_1, pair.body_2, patch_shape.center, arm_2, patch_shape,
                    coefficients.friction[env, pair.number], history_in.friction, history_out.friction, member,
                    max_elapsed, dt, pair.q_WS,
                )  # fmt: skip
                friction_W = load_fraction * wrench.force / unscaled
                torque_W = load_fraction * wrench.torque / unscaled
                sums.friction += friction_W
                sums.force += friction_W
                sums.torque_1 += wp.cross(patch_shape.center, friction_W) + torque_W
                sums.torque_2 -= wp.cross(arm_2, friction_W) + torque_W
        total_force_W = from_float64(scale * sums.force)
        total_torque_W = from_float64(scale * sums.torque_1)
        center_W = vec3d()
        mean_normal_W = vec3d()
        if sums.pressure > double(0.0):
            center_W = sums.moment / sums.pressure
            mean_normal_W = wp.normalize(sums.force - sums.friction)
        if pair.body_1 >= 0:
            center_W += to_float64(state.body_position[env, pair.body_1])
            center_W += to_float64(state.body_position_remainder[env, pair.body_1])
        number = pair.number
        body_contacts.status[env, number] = sums.status
        body_contacts.depth[env, number] = real(sums.depth)
        body_contacts.share[env, number] = real(wp.where(is_contact, sums.share, double(0.0)))
        body_contacts.area[env, number] = real(sums.area)
        body_contacts.volume[env, number] = real(sums.volume)
        body_contacts.normal[env, number] = from_float64(mean_normal_W)
        body_contacts.center[env, number] = from_float64(wp.where(is_contact, center_W, vec3d()))
        body_contacts.max_pressure[env, number] = real(scale * sums.max_pressure)
        body_contacts.approach_speed[env, number] = real(approach_speed)
        body_contacts.normal_force[env, number] = real(scale * sums.pressure)
        body_contacts.friction_force[env, number] = from_float64(scale * sums.friction)
        body_contacts.force[env, number] = total_force_W
        body_contacts.torque[env, number] = total_torque_W
        ends.force[env, end] = total_force_W
        ends.torque[env, end] = total_torque_W
        ends.force[env, end + 1] = -total_force_W
        ends.torque[env, end + 1] = from_float64(scale * sums.torque_2)

    return store_result
