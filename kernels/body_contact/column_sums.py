"""Sums over the columns of a pair: law and friction at each column, and force, torque and readings of the pair.

The columns of each kind of pair are added with ``add_column``, and ``store_result`` stores the result. If only the law acts at each
column, the sums over whole polygons are added with ``add_piece``.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.body_contact.patches import (
    PATCH_COUNT,
    add_moments_to_patch,
    row_vector,
    set_row,
    shape_of_patch,
)
from warpcontact.kernels.body_contact.patches import functions as patch_functions
from warpcontact.kernels.body_contact.records import BodyContactSettings, Patches, body_contact_structs
from warpcontact.kernels.body_contact.solids import PairPose, Solids
from warpcontact.kernels.contact.contact_evaluation import (
    ContactModel,
    functions,
    group_structs,
    kinematics_structs,
)
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.types import CONTACT, WRONG_SIDE, structs

vec3d = wp.vec3d
double = wp.float64
# Area of the columns, relative to the sum of the magnitudes of its parts, below which it counts as zero.
CANCELLED = wp.constant(double(1.0e-9))


@wp.struct
class Pair:
    """A pair of solids."""

    number: wp.int32
    body_1: wp.int32  # or WORLD
    body_2: wp.int32
    # From the centers of mass to the origin of the frame in which columns are found, W [m]
    arm_1: vec3d
    arm_2: vec3d
    to_axes: wp.mat33d  # W → axes that rotate with the second solid
    q_WS: wp.quatd  # the inverse


@wp.struct
class Column:
    """A column of the overlap."""

    depth: double  # t [m]
    weight: double  # of its area in the integral, negative if it is subtracted [m²]
    fraction: double  # w: part of the pressure that acts, 0 to 1 [-]
    position: vec3d  # where its force acts, relative to the origin of the pair, W [m]
    normal: vec3d  # unit, out of the second solid, W
    patch: wp.int32


@wp.struct
class ColumnSums:
    """Overlap of a pair, and sums over its columns, which are zero unless it is in contact; W."""

    status: wp.int32  # OPEN, CONTACT, WRONG_SIDE or DISABLED
    depth: double  # D of the overlap, 0 without [m]
    share: double  # weight of the columns on the second solid
    area: double  # [m²]
    volume: double  # [m³]
    pressure: double  # integral of the normal force per area [N]
    max_pressure: double  # [Pa]
    gross_area: double  # sum of the magnitudes of the parts of ``area`` [m²]
    approach: double  # integral of the approach speed over the area [m³/s]
    friction: vec3d  # on the first body [N]
    force: vec3d  # on the first body [N]
    torque_1: vec3d  # on the first body, about its center of mass [N·m]
    torque_2: vec3d  # on the second body, about its center of mass [N·m]
    moment: vec3d  # of pressure, from the center of mass of the first body [N·m]


@wp.struct
class RelativeMotion:
    """Motion of the second body relative to the first; W."""

    velocity: vec3d  # at the origin of the pair [m/s]
    angular_velocity: vec3d  # [rad/s]


@wp.struct
class PieceSums:
    """Sums over the columns of a polygon, in the coordinates of its corners."""

    area: double  # [m²]
    gross_area: double  # [m²]
    volume: double  # [m³]
    approach: double  # integral of the approach speed over the area [m³/s]
    pressure: double  # integral of the normal force per area [N]
    max_pressure: double  # [Pa]
    depth_moment: double  # integral of pressure times depth [N·m]
    moment: vec3d  # integral of pressure times coordinates
    second_moment: wp.mat33d  # integral of pressure times products of coordinates


@wp.func
def with_sample(
    piece: PieceSums,
    pressure: double,
    weight: double,
    fraction: double,
    depth: double,
    approach: double,
    position: vec3d,
):
    """Returns the sums over a polygon with a sample of area ``weight`` added; a part ``fraction`` of its pressure acts."""
    normal_force = weight * pressure
    piece.area += weight
    piece.gross_area += wp.abs(weight)
    piece.volume += weight * depth
    piece.approach += weight * approach
    piece.pressure += normal_force
    piece.max_pressure = wp.max(piece.max_pressure, fraction * pressure)
    piece.depth_moment += normal_force * depth
    piece.moment += normal_force * position
    piece.second_moment += normal_force * wp.outer(position, position)
    return piece


@wp.func
def with_depth(sums: ColumnSums, depth: double, setting: BodyContactSettings):
    """Returns the sums of a pair with the depth of the overlap, and the status that follows from it."""
    sums.depth = depth
    if depth > double(0.0):
        sums.status = CONTACT
        if depth > setting.max_depth:
            sums.status = WRONG_SIDE
    return sums


@wp.func
def pair_of(pose: PairPose, solids: Solids, solid_1: int, solid_2: int, number: int):
    """Returns the ``Pair`` of two solids, whose columns are found in the frame of the second one."""
    pair = Pair()
    pair.number = number
    pair.body_1 = solids.body[solid_1]
    pair.body_2 = solids.body[solid_2]
    pair.arm_1 = pose.arm_1
    pair.arm_2 = pose.arm_2
    pair.to_axes = wp.transpose(pose.second_axes.rotation)
    pair.q_WS = pose.orientation
    return pair


class Functions(NamedTuple):
    """Device functions of the columns of a pair."""

    #: ``(model, state, env, dt, pair, column, coefficients, history_in, history_out, body_contacts, sums, normals,
    #: patch_rows)``: returns the ``ColumnSums`` with a column added. ``normals`` and ``patch_rows`` are those of the patches,
    #: see ``patches.py``.
    add_column: wp.Function
    #: ``(state, env, pair)``: returns the ``RelativeMotion`` of a pair.
    relative_motion: wp.Function
    #: ``(env, dt, pair, depth, approach, coefficients, history_in, history_out, body_contacts)``: returns the normal force of
    #: the law at a column. It depends on depth and approach speed only: the law has no history and needs no mass.
    pressure: wp.Function
    #: ``(pair, piece, to_W, origin, into_own, kappa, normal, patch, sums, normals, patch_rows)``: returns the ``ColumnSums``
    #: with a polygon added, whose corners are at to_W · coordinates + origin. Friction acts on patches, or is absent.
    add_piece: wp.Function
    #: ``(state, env, dt, pair, sums, setting, coefficients, history_in, history_out, patches_out, body_contacts, ends, end,
    #: patch_rows)``: adds the friction of patches to the ``ColumnSums``, and stores readings and wrenches.
    store_result: wp.Function


@functools.cache
def column_functions(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> Functions:
    """Returns the device functions for one contact model.

    Args:
        contact_model: Classes of law and friction models. The law has no history variables. A friction model with history
            variables acts once per patch, another one at each column.
        real: Precision of state, law and friction. Geometry is in float64.
        per_area: Whether the law is a pressure; otherwise its mean over the area of the columns is the normal force.
        has_joints: Whether the effective mass includes the joints of bodies.
    """
    t = structs(real)
    vec3, quat, Model, State, EndWrenches = t.vec3, t.quat, t.Model, t.State, t.EndWrenches
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    ContactKinematics = kinematics_structs(real).ContactKinematics
    has_patches = bool(contact_model.friction.memories)
    evaluation = functions(contact_model, real, has_joints, has_friction=not has_patches)
    evaluate_contact, force_of_law = evaluation.evaluate_contact, evaluation.force_of_law
    NormalState = t.NormalState
    friction = patch_functions(contact_model.friction, real)
    friction_of_patch, clear_history = friction.friction, friction.clear_history
    frame = frame_functions(real)
    to_float64, from_float64, velocity_at = frame.to_float64, frame.from_float64, frame.velocity_at

    @wp.func
    def axes_of(pair: Pair):
        return quat(real(pair.q_WS[0]), real(pair.q_WS[1]), real(pair.q_WS[2]), real(pair.q_WS[3]))

    @wp.func
    def add_column(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        column: Column,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
        sums: ColumnSums,
        normals: wp.array2d(dtype=double),
        patch_rows: wp.array2d(dtype=double),
    ):
        arm_1 = pair.arm_1 + column.position
        arm_2 = pair.arm_2 + column.position
        kinematics = ContactKinematics()
        kinematics.body_1 = pair.body_1
        kinematics.body_2 = pair.body_2
        kinematics.arm_1 = from_float64(arm_1)
        kinematics.arm_2 = from_float64(arm_2)
        kinematics.normal = from_float64(column.normal)
        kinematics.penetration = real(column.depth)
        result = evaluate_contact(
            model, state, env, kinematics, body_contacts.entry_speed[env, pair.number], dt,
            coefficients, history_in, history_out, pair.number, real(0.0), axes_of(pair),
        )  # fmt: skip
        pressure = double(result.normal_force)
        normal_force = column.weight * pressure
        friction_W = column.weight * to_float64(result.friction_force)
        force_W = normal_force * column.normal + friction_W
        sums.area += column.weight
        sums.volume += column.weight * column.depth
        sums.pressure += normal_force
        sums.max_pressure = wp.max(sums.max_pressure, column.fraction * pressure)
        sums.gross_area += wp.abs(column.weight)
        sums.approach += column.weight * double(result.approach_speed)
        sums.friction += friction_W
        sums.force += force_W
        sums.torque_1 += wp.cross(arm_1, force_W)
        sums.torque_2 -= wp.cross(arm_2, force_W)
        sums.moment += normal_force * arm_1
        if wp.static(has_patches):
            if wp.length_sq(row_vector(normals, column.patch)) == double(0.0):
                set_row(normals, column.patch, pair.to_axes * column.normal)
            second = normal_force * wp.outer(arm_1, arm_1)
            add_moments_to_patch(
                patch_rows, column.patch, normal_force, normal_force * arm_1, second, column.normal
            )
        return sums

    @wp.func
    def angular_velocity(state: State, env: int, body: int):
        if body < 0:
            return vec3d()
        return to_float64(state.body_angular_velocity[env, body])

    @wp.func
    def relative_motion(state: State, env: int, pair: Pair):
        motion = RelativeMotion()
        velocity_1 = to_float64(velocity_at(state, env, pair.body_1, from_float64(pair.arm_1)))
        velocity_2 = to_float64(velocity_at(state, env, pair.body_2, from_float64(pair.arm_2)))
        motion.velocity = velocity_2 - velocity_1
        motion.angular_velocity = angular_velocity(state, env, pair.body_2) - angular_velocity(
            state, env, pair.body_1
        )
        return motion

    @wp.func
    def pressure(
        env: int,
        dt: real,
        pair: Pair,
        depth: double,
        approach: double,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
    ):
        entry_speed = body_contacts.entry_speed[env, pair.number]
        normal_state = NormalState()
        normal_state.delta = real(depth)
        normal_state.delta_dot = real(approach)
        normal_state.entry_speed = wp.max(wp.max(entry_speed, normal_state.delta_dot), real(0.0))
        normal_state.dt = dt
        is_new = entry_speed < real(0.0)
        p = coefficients.law[env, pair.number]
        return double(
            force_of_law(
                p, normal_state, is_new, history_in.law, history_out.law, env, pair.number, real(0.0), dt,
                axes_of(pair), vec3(),
            )
        )  # fmt: skip

    @wp.func
    def add_piece(
        pair: Pair,
        piece: PieceSums,
        to_W: wp.mat33d,
        origin: vec3d,
        into_own: vec3d,
        kappa: double,
        normal: vec3d,
        patch: int,
        sums: ColumnSums,
        normals: wp.array2d(dtype=double),
        patch_rows: wp.array2d(dtype=double),
    ):
        # First moment of pressure, from the origin of the pair and from the first center of mass.
        moment = to_W * piece.moment + piece.pressure * origin + (kappa * piece.depth_moment) * into_own
        moment_1 = moment + piece.pressure * pair.arm_1
        sums.area += piece.area
        sums.volume += piece.volume
        sums.pressure += piece.pressure
        sums.max_pressure = wp.max(sums.max_pressure, piece.max_pressure)
        sums.gross_area += piece.gross_area
        sums.approach += piece.approach
        sums.force += piece.pressure * normal
        sums.torque_1 += wp.cross(moment_1, normal)
        sums.torque_2 -= wp.cross(moment + piece.pressure * pair.arm_2, normal)
        sums.moment += moment_1
        if wp.static(has_patches):
            if wp.length_sq(row_vector(normals, patch)) == double(0.0):
                set_row(normals, patch, pair.to_axes * normal)
            # Second moment of the bases of columns: their length is small against the extent of the patch.
            center = moment_1
            if piece.pressure != double(0.0):
                center = moment_1 / piece.pressure
            mean = double(1.0) / wp.where(piece.pressure == double(0.0), double(1.0), piece.pressure)
            second = (
                to_W * (piece.second_moment - mean * wp.outer(piece.moment, piece.moment)) * wp.transpose(to_W)
            )
            second += piece.pressure * wp.outer(center, center)
            add_moments_to_patch(patch_rows, patch, piece.pressure, moment_1, second, normal)
        return sums

    @wp.func
    def store_result(
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        sums: ColumnSums,
        setting: BodyContactSettings,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
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
            for patch in range(patch_count):
                member = PATCH_COUNT * pair.number + patch
                patch_shape = shape_of_patch(patch_rows, patch)
                if patch_shape.normal_force <= double(0.0) or unscaled == double(0.0):
                    patches_out.normal[env, member] = vec3d()
                    clear_history(history_out.friction, env, member, dt)
                    continue
                patches_out.normal[env, member] = pair.to_axes * patch_shape.normal
                # The sums are per area, or per contact; the force of the contact is ``scale`` times that.
                patch_shape.normal_force = patch_shape.normal_force * unscaled
                arm_2 = patch_shape.center - pair.arm_1 + pair.arm_2
                wrench = friction_of_patch(
                    state, env, pair.body_1, pair.body_2, patch_shape.center, arm_2, patch_shape,
                    coefficients.friction[env, pair.number], history_in.friction, history_out.friction, member,
                    max_elapsed, dt, axes_of(pair),
                )  # fmt: skip
                friction_W = wrench.force / unscaled
                torque_W = wrench.torque / unscaled
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

    return Functions(add_column, relative_motion, pressure, add_piece, store_result)
