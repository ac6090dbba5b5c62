"""Sums over the columns of a pair: law and friction at each column.

The columns of each kind of pair are added with ``add_column``. If only the law acts at each column, the sums over whole polygons are
added with ``add_piece``. Forces of patches, and the results of a pair, are in ``pair_results.py``.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.body_contact.patches import (
    PatchDepths,
    add_depths_to_patch,
    add_moments_to_patch,
    row_vector,
    set_row,
)
from warpcontact.kernels.body_contact.records import BodyContactSettings, body_contact_structs
from warpcontact.kernels.body_contact.solids import PairPose, Solids
from warpcontact.kernels.contact.contact_evaluation import (
    ContactModel,
    functions,
    group_structs,
    kinematics_structs,
)
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.types import CONTACT, OPEN, WRONG_SIDE, structs

vec3d = wp.vec3d
double = wp.float64


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
def status_at_depth(depth: double, setting: BodyContactSettings):
    """Returns the status of an enabled pair whose overlap has this depth; 0: there is none."""
    if depth > setting.max_depth:
        return wp.int32(WRONG_SIDE)
    if depth > double(0.0):
        return wp.int32(CONTACT)
    return wp.int32(OPEN)


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


@functools.cache
def column_functions(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> Functions:
    """Returns the device functions for one contact model.

    Args:
        contact_model: Classes of law and friction models. If the law has history variables, both act once per patch. Otherwise
            the law acts at each column, and so does a friction model without history variables.
        real: Precision of state, law and friction. Geometry is in float64.
        per_area: Whether the law is a pressure; otherwise its mean over the area of the columns is the normal force.
        has_joints: Whether the effective mass includes the joints of bodies.
    """
    t = structs(real)
    vec3, quat, Model, State = t.vec3, t.quat, t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    ContactKinematics = kinematics_structs(real).ContactKinematics
    has_patches, has_law_history = contact_model.acts_per_patch, bool(contact_model.law.memories)
    evaluation = functions(contact_model, real, has_joints, has_friction=not has_patches)
    evaluate_contact, force_of_law = evaluation.evaluate_contact, evaluation.force_of_law
    NormalState = t.NormalState
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
    def add_depth_of_column(
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
        """Adds a column to the sums of a law with history, which acts at the end, once per patch."""
        arm_1 = pair.arm_1 + column.position
        arm_2 = pair.arm_2 + column.position
        velocity = velocity_at(state, env, pair.body_2, from_float64(arm_2)) - velocity_at(
            state, env, pair.body_1, from_float64(arm_1)
        )
        sums.area += column.weight
        sums.volume += column.weight * column.depth
        sums.gross_area += wp.abs(column.weight)
        sums.approach += column.weight * wp.dot(to_float64(velocity), column.normal)
        if wp.length_sq(row_vector(normals, column.patch)) == double(0.0):
            set_row(normals, column.patch, pair.to_axes * column.normal)
        volume = column.weight * column.depth
        second = volume * wp.outer(arm_1, arm_1)
        add_moments_to_patch(patch_rows, column.patch, volume, volume * arm_1, second, column.normal)
        depths = PatchDepths()
        depths.area = column.weight
        depths.gross_area = wp.abs(column.weight)
        depths.squares = volume * column.depth
        depths.turning = volume * wp.cross(arm_1, column.normal)
        depths.largest = column.fraction * column.depth
        add_depths_to_patch(patch_rows, column.patch, depths)
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
    def depth_as_pressure(
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
        """Returns the depth: a law with history acts at the end, and its pressure is proportional to depths."""
        return depth

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
        sums.gross_area += piece.gross_area
        sums.approach += piece.approach
        if wp.static(not has_law_history):
            sums.pressure += piece.pressure
            sums.max_pressure = wp.max(sums.max_pressure, piece.max_pressure)
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
        if wp.static(has_law_history):
            depths = PatchDepths()
            depths.area = piece.area
            depths.gross_area = piece.gross_area
            depths.squares = piece.depth_moment
            depths.turning = wp.cross(moment_1, normal)
            depths.largest = piece.max_pressure
            add_depths_to_patch(patch_rows, patch, depths)
        return sums

    if has_law_history:
        return Functions(add_depth_of_column, relative_motion, depth_as_pressure, add_piece)
    return Functions(add_column, relative_motion, pressure, add_piece)
