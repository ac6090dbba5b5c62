"""Force and torque of body contacts: the pressure of columns, and its friction, integrated over the overlap."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.columns import (
    column_polygon,
    convex_polygon,
    face_frame,
    is_apart,
    is_exit,
    plane_rows,
    planes_from_face,
    position_on_face,
    ramp_height,
)
from warpcontact.kernels.body_contact.overlap import FULL_WEIGHT, NO_WEIGHT, Overlap, column_weight, overlap_of
from warpcontact.kernels.body_contact.patches import (
    PATCH_COUNT,
    Patches,
    patch_normals,
    patch_of,
    patch_sums,
    shape_of_patch,
    with_column,
    with_patch,
)
from warpcontact.kernels.body_contact.patches import functions as patch_functions
from warpcontact.kernels.body_contact.polygons import (
    RULE_SIZE,
    Polygon,
    centroid,
    corner,
    quadrature_point,
    signed_area,
)
from warpcontact.kernels.body_contact.records import BodyContactSettings, SolidPairs, body_contact_structs
from warpcontact.kernels.body_contact.solids import (
    FEW_PLANES,
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    Solids,
    inverse_pose,
)
from warpcontact.kernels.body_contact.surface_queries import INFINITE, OFFSET, first_crossing, solid_geometry
from warpcontact.kernels.contact.contact_evaluation import (
    ContactModel,
    functions,
    group_structs,
    kinematics_structs,
)
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.friction import Frictionless
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
# Area of the columns, relative to the sum of the magnitudes of its parts, below which it counts as zero.
CANCELLED = wp.constant(double(1.0e-9))


@wp.struct
class ColumnSums:
    """Sums over the columns of a pair; W."""

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
    quat, Model, State, EndWrenches = t.quat, t.Model, t.State, t.EndWrenches
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    ContactKinematics = kinematics_structs(real).ContactKinematics
    has_patches = bool(contact_model.friction.memories)
    # Triangles around the center of area make the result independent of the first corner, if the quadrature is not exact.
    is_exact = contact_model.law.bilinear and (has_patches or contact_model.friction is Frictionless)
    evaluate_contact = functions(contact_model, real, has_joints, has_friction=not has_patches).evaluate_contact
    friction = patch_functions(contact_model.friction, real)
    friction_of_patch, clear_history = friction.friction, friction.clear_history
    pair_pose = solid_functions.functions(real).pair_pose
    frame = frame_functions(real)
    to_float64, from_float64 = frame.to_float64, frame.from_float64

    @unique_kernel()
    def body_contact_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        step: wp.array2d(dtype=real),  # [env, 0] duration over which the force acts [s]; 0: instantaneous force
        first_end: wp.int32,
        geometries: Geometries,
        solids: Solids,
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
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            pair = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            setting = settings[env, pair]
            solid_1 = pairs.first[pair]
            solid_2 = pairs.second[pair]
            first = solid_geometry(geometries, solids.pose[env, solid_1])
            second = solid_geometry(geometries, solids.pose[env, solid_2])
            pose = pair_pose(state, env, solids, solid_1, solid_2)

            overlap = Overlap()
            contact_status = wp.int32(OPEN)
            if setting.enabled == 0:
                contact_status = DISABLED
            else:
                between = (
                    pose.first_in_second.origin + pose.first_in_second.rotation * first.center - second.center
                )
                reach = wp.length(first.half_extents) + wp.length(second.half_extents)
                if (second.flags & HALF_SPACE) != 0 or wp.dot(between, between) < reach * reach:
                    overlap = overlap_of(geometries, first, second, pose.first_in_second)
                    if setting.reference >= double(0.0) and (second.flags & (HALF_SPACE | HAS_BOUNDARY)) == 0:
                        overlap.share = setting.reference
                if overlap.depth > double(0.0):
                    contact_status = CONTACT
                    if overlap.depth > setting.max_depth:
                        contact_status = WRONG_SIDE

            sums = ColumnSums()
            sums_of_patches = patch_sums()
            normals = patch_normals()
            if wp.static(has_patches):
                for patch in range(PATCH_COUNT):
                    normal = patches_in.normal[env, PATCH_COUNT * pair + patch]
                    for i in range(3):
                        normals[patch, i] = normal[i]
            second_is_reference = (second.flags & (HALF_SPACE | HAS_BOUNDARY)) != 0
            half_space = (second.flags & HALF_SPACE) != 0
            part_count = wp.where(half_space, 1, 2)
            sides = wp.int32(0)
            q = pose.orientation
            q_WS = quat(real(q[0]), real(q[1]), real(q[2]), real(q[3]))
            if contact_status == CONTACT:
                sides = wp.where(second_is_reference, 1, 2)
            for side in range(sides):
                share = overlap.share
                kappa = setting.kappa
                own = second
                other = first
                own_pose = pose.first_in_second
                rotation = pose.rotation
                origin = vec3d()
                if side == 1:
                    share = double(1.0) - overlap.share
                    kappa = double(1.0) - setting.kappa
                    own = first
                    other = second
                    own_pose = inverse_pose(pose.first_in_second)
                    rotation = pose.rotation * pose.first_in_second.rotation
                    origin = pose.rotation * pose.first_in_second.origin
                if share == double(0.0):
                    continue
                for face in range(own.first_face, own.end_face):
                    face_plane = face_frame(geometries, own, other, own_pose, face)
                    if is_apart(face_plane, other):
                        continue
                    # Out of the second solid.
                    normal_W = rotation * face_plane.normal
                    if side == 1:
                        normal_W = -normal_W
                    patch = wp.int32(0)
                    if wp.static(has_patches):
                        normal_2 = wp.transpose(pose.rotation) * normal_W
                        patch = patch_of(normals, normal_2)
                    by_planes = (other.flags & FEW_PLANES) != 0 and not half_space
                    first_part = other.first_face
                    end_part = other.end_face
                    planes = plane_rows()
                    if by_planes:
                        planes = planes_from_face(geometries, face_plane, other)
                        first_part = 0
                        end_part = other.end_plane - other.first_plane
                    for number in range(first_part, end_part):
                        is_entry = wp.bool(False)
                        if not by_planes:
                            is_entry = not is_exit(geometries, face_plane, number)
                        # The weight is a polynomial below and above FULL_WEIGHT × D.
                        for part in range(part_count):
                            shallowest = double(0.0)
                            if is_entry and not half_space:
                                shallowest = -ramp_height(other)
                            deepest = FULL_WEIGHT * overlap.depth
                            if half_space:
                                deepest = INFINITE
                            elif part == 1:
                                shallowest = deepest
                                deepest = NO_WEIGHT * overlap.depth
                            piece = Polygon()
                            if by_planes:
                                piece = convex_polygon(face_plane, other, planes, number, shallowest, deepest)
                            else:
                                piece = column_polygon(geometries, face_plane, other, number, shallowest, deepest)
                            if piece.count == 0:
                                continue
                            triangles = piece.count
                            center = corner(piece, 0)
                            if wp.static(is_exact):
                                triangles -= 2
                            else:
                                center = centroid(piece)
                            sign = wp.where(is_entry, -share, share) * piece.weight
                            for sample in range(RULE_SIZE * triangles):
                                edge = sample // RULE_SIZE
                                if wp.static(is_exact):
                                    edge += 1
                                corner_1 = corner(piece, edge)
                                corner_2 = corner(piece, (edge + 1) % piece.count)
                                point = quadrature_point(center, corner_1, corner_2, sample % RULE_SIZE)
                                area = sign * point.weight * wp.abs(signed_area(center, corner_1, corner_2))
                                base = position_on_face(face_plane, point.u, point.v)
                                depth = point.depth
                                if is_entry and not half_space:
                                    # Columns of the next exit do not reach it.
                                    to_other = wp.transpose(own_pose.rotation)
                                    direction = -(to_other * face_plane.normal)
                                    start = to_other * (base - depth * face_plane.normal - own_pose.origin)
                                    start += OFFSET * wp.length(other.half_extents) * direction
                                    depth += first_crossing(geometries, other, start, direction, True).distance
                                weight = area * column_weight(depth, overlap, half_space)
                                # Rounding can make the depth at the boundary of a piece negative.
                                if weight == double(0.0) or depth <= double(0.0):
                                    continue
                                acting = base - kappa * depth * face_plane.normal
                                offset = origin + rotation * acting
                                arm_1 = pose.arm_1 + offset
                                arm_2 = pose.arm_2 + offset
                                kinematics = ContactKinematics()
                                kinematics.body_1 = solids.body[solid_1]
                                kinematics.body_2 = solids.body[solid_2]
                                kinematics.arm_1 = from_float64(arm_1)
                                kinematics.arm_2 = from_float64(arm_2)
                                kinematics.normal = from_float64(normal_W)
                                kinematics.penetration = real(depth)
                                result = evaluate_contact(
                                    model, state, env, kinematics, body_contacts.entry_speed[env, pair], step[env, 0],
                                    coefficients, history_in, history_out, pair, real(0.0), q_WS,
                                )  # fmt: skip
                                pressure = double(result.normal_force)
                                normal_force = weight * pressure
                                friction_W = weight * to_float64(result.friction_force)
                                force_W = normal_force * normal_W + friction_W
                                sums.area += weight
                                sums.volume += weight * depth
                                sums.pressure += normal_force
                                sums.max_pressure = wp.max(sums.max_pressure, pressure)
                                sums.gross_area += wp.abs(weight)
                                sums.approach += weight * double(result.approach_speed)
                                sums.friction += friction_W
                                sums.force += force_W
                                sums.torque_1 += wp.cross(arm_1, force_W)
                                sums.torque_2 -= wp.cross(arm_2, force_W)
                                sums.moment += normal_force * arm_1
                                if wp.static(has_patches):
                                    normals = with_patch(normals, patch, normal_2)
                                    sums_of_patches = with_column(
                                        sums_of_patches, patch, normal_force, arm_1, normal_W
                                    )

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
                if body_contacts.entry_speed[env, pair] < real(0.0) and approach_speed > double(0.0):
                    max_elapsed = real(overlap.depth / approach_speed)
                for patch in range(PATCH_COUNT):
                    member = PATCH_COUNT * pair + patch
                    patch_shape = shape_of_patch(sums_of_patches, patch)
                    if patch_shape.normal_force <= double(0.0):
                        patches_out.normal[env, member] = vec3d()
                        clear_history(history_out.friction, env, member, step[env, 0])
                        continue
                    patches_out.normal[env, member] = wp.transpose(pose.rotation) * patch_shape.normal
                    # The sums are per area, or per contact; the force of the contact is ``scale`` times that.
                    patch_shape.normal_force = patch_shape.normal_force * unscaled
                    wrench = friction_of_patch(
                        state, env, solids.body[solid_1], solids.body[solid_2], patch_shape.center,
                        patch_shape.center - pose.arm_1 + pose.arm_2, patch_shape,
                        coefficients.friction[env, pair], history_in.friction, history_out.friction, member,
                        max_elapsed, step[env, 0], q_WS,
                    )  # fmt: skip
                    friction_W = wrench.force / unscaled
                    torque_W = wrench.torque / unscaled
                    sums.friction += friction_W
                    sums.force += friction_W
                    sums.torque_1 += wp.cross(patch_shape.center, friction_W) + torque_W
                    sums.torque_2 -= wp.cross(patch_shape.center - pose.arm_1 + pose.arm_2, friction_W) + torque_W
            total_force_W = from_float64(scale * sums.force)
            total_torque_W = from_float64(scale * sums.torque_1)
            center_W = vec3d()
            mean_normal_W = vec3d()
            if sums.pressure > double(0.0):
                center_W = sums.moment / sums.pressure
                mean_normal_W = wp.normalize(sums.force - sums.friction)
            body_1 = solids.body[solid_1]
            if body_1 >= 0:
                center_W += to_float64(state.body_position[env, body_1])
                center_W += to_float64(state.body_position_remainder[env, body_1])
            body_contacts.status[env, pair] = contact_status
            body_contacts.depth[env, pair] = real(overlap.depth)
            body_contacts.share[env, pair] = real(wp.where(contact_status == CONTACT, overlap.share, double(0.0)))
            body_contacts.area[env, pair] = real(sums.area)
            body_contacts.volume[env, pair] = real(sums.volume)
            body_contacts.normal[env, pair] = from_float64(mean_normal_W)
            body_contacts.center[env, pair] = from_float64(wp.where(contact_status == CONTACT, center_W, vec3d()))
            body_contacts.max_pressure[env, pair] = real(scale * sums.max_pressure)
            body_contacts.approach_speed[env, pair] = real(approach_speed)
            body_contacts.normal_force[env, pair] = real(scale * sums.pressure)
            body_contacts.friction_force[env, pair] = from_float64(scale * sums.friction)
            body_contacts.force[env, pair] = total_force_W
            body_contacts.torque[env, pair] = total_torque_W
            end = first_end + 2 * pair
            ends.force[env, end] = total_force_W
            ends.torque[env, end] = total_torque_W
            ends.force[env, end + 1] = -total_force_W
            ends.torque[env, end + 1] = from_float64(scale * sums.torque_2)

    return body_contact_forces


@functools.cache
def accept_patches() -> wp.Kernel:
    """Returns the kernel that stores the patches of accepted steps; items: patches of all pairs."""

    @unique_kernel()
    def accept_body_contact_patches(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), patches_out: Patches, patches: Patches
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            patch = task_item(launch, task)
            if status[env] == ENV_ACTIVE:
                patches.normal[env, patch] = patches_out.normal[env, patch]

    return accept_body_contact_patches


@functools.cache
def reset_patches() -> wp.Kernel:
    """Returns the kernel that removes all patches. Launch with dim (env, patch of all pairs)."""

    @unique_kernel(runs_rarely=True)
    def reset_body_contact_patches(mask: wp.array(dtype=wp.bool), patches: Patches):
        env, patch = wp.tid()
        if mask[env]:
            patches.normal[env, patch] = vec3d()

    return reset_body_contact_patches


@functools.cache
def accept_contacts(real: type) -> wp.Kernel:
    """Returns the kernel that stores the entry speeds of accepted steps; items: pairs."""
    BodyContacts = body_contact_structs(real).BodyContacts

    @unique_kernel()
    def accept_body_contacts(launch: LaunchRange, status: wp.array(dtype=wp.int32), body_contacts: BodyContacts):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            pair = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            entry_speed = real(-1.0)
            if body_contacts.status[env, pair] == CONTACT:
                # At least 0: negative values mean "not in contact".
                speed = wp.max(body_contacts.approach_speed[env, pair], real(0.0))
                entry_speed = wp.max(body_contacts.entry_speed[env, pair], speed)
            body_contacts.entry_speed[env, pair] = entry_speed

    return accept_body_contacts


@functools.cache
def reset_contacts(real: type) -> wp.Kernel:
    """Returns the kernel that resets the history of contacts. Launch with dim (env, pair)."""
    BodyContacts = body_contact_structs(real).BodyContacts

    @unique_kernel(runs_rarely=True)
    def reset_body_contacts(mask: wp.array(dtype=wp.bool), body_contacts: BodyContacts):
        env, pair = wp.tid()
        if mask[env]:
            body_contacts.entry_speed[env, pair] = real(-1.0)

    return reset_body_contacts
