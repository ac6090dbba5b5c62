"""Manifolds of pairs of solids: points with gaps and normals, which ``point_matching.py`` identifies from step to step."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.curved_solids import CURVED
from warpcontact.kernels.body_contact.face_trees import PENDING_NODES
from warpcontact.kernels.body_contact.records import BodyContactSettings, SolidPairs, body_contact_structs
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    PairPose,
    RelativePose,
    SolidPose,
    Solids,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, are_apart, solid_geometry
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.manifolds.candidates import (
    CANDIDATES,
    MAX_PATCHES,
    POINTS,
    Candidate,
    Patch,
    candidate_feature,
    candidate_gap,
    candidate_position,
)
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.convex import NO_REFERENCE, add_vertices_below, convex_manifold
from warpcontact.kernels.manifolds.curved import add_curved_above, curved_manifold
from warpcontact.kernels.manifolds.curved_pairs import curved_pair_manifold
from warpcontact.kernels.manifolds.curved_separation import SUPPORTS, CurvedPair, Support
from warpcontact.kernels.manifolds.face_clipping import CLIPPED_CORNERS, ClippedCorner
from warpcontact.kernels.manifolds.features import Features
from warpcontact.kernels.manifolds.meshes import mesh_manifold
from warpcontact.kernels.manifolds.point_matching import (
    ManifoldPoint,
    choose_all,
    mark_previous_points,
    match_points,
)
from warpcontact.kernels.manifolds.records import ManifoldHistory, ManifoldPairs, manifold_structs
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

double = wp.float64
vec3d = wp.vec3d

# Largest gap of a point: a multiple of the relative displacement in a step, and a fraction of the size of the bodies.
STEP_MARGIN = wp.constant(double(2.0))
SIZE_MARGIN = wp.constant(double(1.0e-3))
# Kinds of pairs.
ON_HALF_SPACE, BOTH_CONVEX, MESHES = (wp.constant(i) for i in range(3))
CURVED_ON_HALF_SPACE, CURVED_ON_FACES, BOTH_CURVED = (wp.constant(i) for i in range(3, 6))
#: Points, candidates and clipped corners of a pair.
MAX_POINTS, ALL_CANDIDATES, CLIP_BUFFER = MAX_PATCHES * POINTS, MAX_PATCHES * CANDIDATES, 2 * CLIPPED_CORNERS


@wp.func
def largest_extent(side: SolidGeometry):
    """Returns the largest edge of the bounding box of a solid [m]."""
    return double(2.0) * wp.max(side.half_extents)


@wp.func
def reach_of_pair(first: SolidGeometry, second: SolidGeometry, are_convex: bool, displacement: double):
    """Returns the ``Reach`` of a pair; ``displacement``: largest relative displacement in a step [m]."""
    result = Reach()
    result.size = largest_extent(first)
    result.depth = double(wp.inf)
    bounded = (second.flags & (HALF_SPACE | HAS_BOUNDARY)) == 0
    if bounded:
        result.size = wp.min(result.size, largest_extent(second))
    if not are_convex:
        # Deeper faces may be on the far side of a part of a body.
        result.depth = wp.min(first.half_extents)
        if bounded:
            result.depth = wp.min(result.depth, wp.min(second.half_extents))
    result.margin = wp.max(displacement, SIZE_MARGIN * result.size)
    return result


@wp.func
def is_within_reach(first: SolidGeometry, second: SolidGeometry, pose: PairPose, margin: double):
    """Returns whether the bounding boxes of two solids are at most ``margin`` apart along the axes of the boxes."""
    if (second.flags & HALF_SPACE) != 0:
        rotation = pose.first_in_second.rotation
        lowest = pose.first_in_second.origin[2]
        for k in range(3):
            lowest += rotation[2, k] * first.center[k] - wp.abs(rotation[2, k]) * first.half_extents[k]
        return lowest <= margin
    return not are_apart(first, second, pose.first_in_second, margin)


@wp.func
def pair_kind(first: SolidGeometry, second: SolidGeometry, are_convex: bool):
    """Returns the kind of a pair, which decides how its points are found."""
    half_space = (second.flags & HALF_SPACE) != 0
    if (first.flags & CURVED) != 0 and (second.flags & CURVED) != 0:
        return BOTH_CURVED
    if ((first.flags | second.flags) & CURVED) != 0:
        return wp.where(half_space, CURVED_ON_HALF_SPACE, CURVED_ON_FACES)
    if half_space:
        return ON_HALF_SPACE
    return wp.where(are_convex, BOTH_CONVEX, MESHES)


@wp.func
def pair_with_curved(first: SolidGeometry, second: SolidGeometry, first_in_second: RelativePose, kappa: double):
    """Returns the ``CurvedPair`` of a polyhedron and a curved solid, in either order."""
    pair = CurvedPair()
    pair.own = second
    pair.other = first
    pair.pose = first_in_second
    pair.second_frame = no_motion()
    pair.kappa = kappa
    pair.own_is_second = True
    if (second.flags & CURVED) != 0:
        pair.own = first
        pair.other = second
        pair.pose = inverse_pose(first_in_second)
        pair.second_frame = first_in_second
        pair.kappa = double(1.0) - kappa
        pair.own_is_second = False
    return pair


@functools.cache
def clear_points_of(real: type) -> wp.Function:
    """Returns the device function that removes the points of a pair from the results of a step."""
    vec3 = structs(real).vec3
    ManifoldPoints = manifold_structs(real).ManifoldPoints
    not_a_number = wp.constant(real(wp.nan))

    @wp.func
    def clear_points(
        history_out: ManifoldHistory, manifold_points: ManifoldPoints, env: int, start: int, end: int
    ):
        for slot in range(start, end):
            history_out.feature_1[env, slot] = 0
            history_out.feature_2[env, slot] = 0
            history_out.position[env, slot] = vec3d()
            history_out.is_closed[env, slot] = 0
            manifold_points.is_present[env, slot] = 0
            manifold_points.gap[env, slot] = not_a_number
            manifold_points.position[env, slot] = vec3(not_a_number, not_a_number, not_a_number)

    return clear_points


@functools.cache
def find_manifolds(
    real: type, has_convex: bool, has_meshes: bool, has_curved: bool, has_curved_pairs: bool
) -> wp.Kernel:
    """Returns the kernel that finds the manifolds of nonsmooth pairs; items: these pairs.

    Args:
        real: Precision of the state.
        has_convex: Whether there are pairs of convex polyhedra.
        has_meshes: Whether there are other pairs of polyhedra, without half-spaces.
        has_curved: Whether there are curved solids on half-spaces.
        has_curved_pairs: Whether there are other pairs with a curved solid.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    ManifoldPoints = manifold_structs(real).ManifoldPoints
    clear_points = clear_points_of(real)
    pair_pose = solid_functions.functions(real).pair_pose
    frame = frame_functions(real)
    to_float64, from_float64 = frame.to_float64, frame.from_float64
    not_a_number = wp.constant(real(wp.nan))

    @wp.func
    def place_of(state: State, env: int, body: int):
        """Returns the center of mass of a body, or the origin for the world, W [m]."""
        if body < 0:
            return vec3d()
        place = to_float64(state.body_position[env, body])
        return place + to_float64(state.body_position_remainder[env, body])

    @wp.func
    def place_of_solid(state: State, env: int, body: int, pose: SolidPose):
        """Returns a point of the body of a solid to which ``radius_of_solid`` refers, W [m]."""
        if body < 0:
            return pose.position
        return place_of(state, env, body)

    @wp.func
    def radius_of_solid(body: int, pose: SolidPose, side: SolidGeometry):
        """Returns the radius of a sphere around ``place_of_solid`` that contains a bounded solid [m]."""
        radius = wp.length(side.center) + wp.length(side.half_extents)
        if body < 0:
            return radius
        return radius + wp.length(pose.position)

    @wp.func
    def relative_displacement(
        model: Model,
        state: State,
        env: int,
        body_1: int,
        body_2: int,
        place: vec3d,
        radius: double,
        step: double,
    ):
        """Returns a bound of the displacement of points of the first solid relative to the second one in a step [m].

        ``place`` and ``radius`` are those of the first solid. Speeds of both bodies are added, because a body may be
        stopped by others.
        """
        speed = double(0.0)
        if body_1 >= 0:
            spin = wp.length(to_float64(state.body_angular_velocity[env, body_1]))
            speed += wp.length(to_float64(state.body_linear_velocity[env, body_1])) + spin * radius
        if body_2 >= 0:
            spin = wp.length(to_float64(state.body_angular_velocity[env, body_2]))
            arm = wp.length(place - place_of(state, env, body_2)) + radius
            speed += wp.length(to_float64(state.body_linear_velocity[env, body_2])) + spin * arm
        return STEP_MARGIN * step * speed + step * step * wp.length(to_float64(model.gravity[env, 0]))

    @wp.func
    def may_touch(
        state: State,
        env: int,
        body_2: int,
        pose_2: SolidPose,
        second: SolidGeometry,
        place: vec3d,
        radius: double,
        margin: double,
    ):
        """Returns whether the first solid may be within ``margin`` of the second one, by their bounding spheres."""
        between = place - place_of_solid(state, env, body_2, pose_2)
        if (second.flags & HALF_SPACE) != 0:
            if body_2 >= 0:
                return True
            normal = wp.quat_rotate(pose_2.orientation, vec3d(double(0.0), double(0.0), double(1.0)))
            return wp.dot(normal, between) <= radius + margin
        reach = radius + radius_of_solid(body_2, pose_2, second) + margin
        return wp.dot(between, between) <= reach * reach

    @wp.func
    def write_points(
        state: State,
        env: int,
        body_1: int,
        pose: PairPose,
        patches: wp.array(dtype=Patch),
        candidates: wp.array(dtype=Candidate),
        points: wp.array(dtype=ManifoldPoint),
        count: int,
        contact_gap: double,
        history_in: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
    ):
        """Writes the points of a pair to their slots."""
        center_of_mass = place_of(state, env, body_1)
        for i in range(count):
            one = candidates[points[i].candidate]
            position = candidate_position(one)
            gap = candidate_gap(one)
            feature = candidate_feature(one)
            slot = points[i].slot
            offset = pose.second_axes.rotation * position
            is_closed = wp.where(gap <= contact_gap, 1, 0)
            was_closed = points[i].is_matched * history_in.is_closed[env, slot]
            history_out.feature_1[env, slot] = feature.first
            history_out.feature_2[env, slot] = feature.second
            history_out.position[env, slot] = position
            history_out.is_closed[env, slot] = is_closed
            manifold_points.is_present[env, slot] = 1
            manifold_points.carries[env, slot] = points[i].is_matched
            manifold_points.is_new[env, slot] = wp.where(is_closed > was_closed, 1, 0)
            manifold_points.gap[env, slot] = real(gap)
            manifold_points.normal[env, slot] = from_float64(
                pose.second_axes.rotation * patches[points[i].patch].normal
            )
            manifold_points.arm_1[env, slot] = from_float64(pose.arm_1 + offset)
            manifold_points.arm_2[env, slot] = from_float64(pose.arm_2 + offset)
            manifold_points.position[env, slot] = from_float64(center_of_mass + pose.arm_1 + offset)

    @unique_kernel()
    def find_manifolds_of_pairs(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        geometries: Geometries,
        features: Features,
        solids: Solids,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        manifold_pairs: ManifoldPairs,
        contact_gap: double,  # gap up to which a point is closed [m]
        history_in: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
        body_contacts: BodyContacts,
    ):
        corners = wp.zeros(shape=(CLIP_BUFFER,), dtype=ClippedCorner)
        patches = wp.zeros(shape=(MAX_PATCHES,), dtype=Patch)
        candidates = wp.zeros(shape=(ALL_CANDIDATES,), dtype=Candidate)
        chosen = wp.zeros(shape=(POINTS,), dtype=wp.int32)
        points = wp.zeros(shape=(MAX_POINTS,), dtype=ManifoldPoint)
        taken = wp.zeros(shape=(MAX_POINTS,), dtype=wp.int32)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
        supports = wp.zeros(shape=(SUPPORTS,), dtype=Support)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            pair = manifold_pairs.item[number]
            start = manifold_pairs.slot_start[number]
            end = manifold_pairs.slot_start[number + 1]
            if history_out.count[env, number] > 0:
                clear_points(history_out, manifold_points, env, start, end)
            for patch in range(MAX_PATCHES):
                patches[patch].count = 0
            patches[0].lost_gap = double(wp.inf)
            setting = settings[env, pair]
            contact_status = wp.int32(OPEN)
            reference = history_in.reference[env, number]
            share = double(0.0)
            count = wp.int32(0)
            deepest = double(wp.inf)
            normal_W = vec3d()
            center_W = vec3d()
            if setting.enabled == 0:
                contact_status = DISABLED
                reference = NO_REFERENCE
            else:
                solid_1 = pairs.first[pair]
                solid_2 = pairs.second[pair]
                body_1 = solids.body[solid_1]
                body_2 = solids.body[solid_2]
                pose_1 = solids.pose[env, solid_1]
                pose_2 = solids.pose[env, solid_2]
                first = solid_geometry(geometries, pose_1)
                second = solid_geometry(geometries, pose_2)
                place = place_of_solid(state, env, body_1, pose_1)
                radius = radius_of_solid(body_1, pose_1, first)
                displacement = relative_displacement(
                    model, state, env, body_1, body_2, place, radius, double(step[env, 0])
                )
                half_space = (second.flags & HALF_SPACE) != 0
                are_convex = features.is_convex[pose_1.geometry] == 1 and features.is_convex[pose_2.geometry] == 1
                reach = reach_of_pair(
                    first, second, are_convex or half_space, wp.max(displacement, setting.margin)
                )
                pose = PairPose()
                near = may_touch(state, env, body_2, pose_2, second, place, radius, reach.margin)
                if near:
                    pose = pair_pose(state, env, solids, solid_1, solid_2)
                    near = is_within_reach(first, second, pose, reach.margin)
                if near:
                    geometry_1 = pose_1.geometry
                    geometry_2 = pose_2.geometry
                    kind = pair_kind(first, second, are_convex)
                    reference_in = reference
                    reference = NO_REFERENCE
                    share = double(wp.nan)
                    if kind == ON_HALF_SPACE:
                        share = double(1.0)
                        add_vertices_below(
                            geometries, features, first, geometry_1, second, pose.first_in_second, setting.kappa,
                            reach, pending, patches, candidates,
                        )  # fmt: skip
                    if wp.static(has_convex):
                        if kind == BOTH_CONVEX:
                            found = convex_manifold(
                                geometries, features, first, geometry_1, second, geometry_2, pose.first_in_second,
                                setting.kappa, reference_in, history_in.likely[env, number], reach, corners, pending, patches, candidates,
                            )  # fmt: skip
                            reference = found.code
                            history_out.likely[env, number] = found.likely
                            share = double(0.5)
                            if reference > 0:
                                share = double(1.0) - double((reference - 1) % 2)
                    if wp.static(has_meshes):
                        if kind == MESHES:
                            mesh_manifold(
                                geometries, features, first, geometry_1, second, geometry_2, pose.first_in_second,
                                setting.kappa, reach, corners, pending, patches, candidates,
                            )  # fmt: skip
                    if wp.static(has_curved):
                        if kind == CURVED_ON_HALF_SPACE:
                            share = double(1.0)
                            add_curved_above(
                                first, second.first_plane, pose.first_in_second, setting.kappa, reach, supports,
                                patches, candidates,
                            )  # fmt: skip
                    if wp.static(has_curved_pairs):
                        if kind == BOTH_CURVED:
                            share = double(0.5)
                            curved_pair_manifold(
                                first, second, pose.first_in_second, setting.kappa, reach, patches, candidates
                            )
                        elif kind == CURVED_ON_FACES:
                            curved_pair = pair_with_curved(first, second, pose.first_in_second, setting.kappa)
                            polyhedron = wp.where(curved_pair.own_is_second, geometry_2, geometry_1)
                            curved_pair.is_convex = features.is_convex[polyhedron] == 1
                            found_curved = curved_manifold(
                                geometries, features, polyhedron, curved_pair, reference_in,
                                history_in.likely[env, number], reach, supports, pending, patches, candidates,
                            )  # fmt: skip
                            reference = found_curved.code
                            history_out.likely[env, number] = found_curved.likely
                    for patch in range(MAX_PATCHES):
                        if patches[patch].count > 0:
                            deepest = wp.min(deepest, patches[patch].gap)
                    if deepest < -setting.max_depth:
                        contact_status = WRONG_SIDE
                    else:
                        mark_previous_points(patches, candidates, history_in, env, start, end)
                        count = choose_all(patches, candidates, reach.size, end - start, chosen, points)
                        if deepest <= contact_gap:
                            contact_status = CONTACT
                    match_points(candidates, points, count, history_in, env, start, end, reach.size, taken)
                    write_points(
                        state, env, body_1, pose, patches, candidates, points, count, contact_gap, history_in,
                        history_out, manifold_points,
                    )  # fmt: skip
                    # Mean of the closed points, until impulses are known.
                    closed = double(0.0)
                    for i in range(count):
                        slot = points[i].slot
                        if history_out.is_closed[env, slot] == 1:
                            closed += double(1.0)
                            center_W += to_float64(manifold_points.position[env, slot])
                            normal_W += to_float64(manifold_points.normal[env, slot])
                    if closed > double(0.0):
                        center_W = center_W / closed
                        normal_W = wp.normalize(normal_W)
            history_out.reference[env, number] = reference
            history_out.count[env, number] = count
            has_lost = wp.where(patches[0].lost_gap <= contact_gap, 1, 0)
            history_out.overflow[env, number] = history_in.overflow[env, number] + has_lost
            is_contact = contact_status == CONTACT
            body_contacts.status[env, pair] = contact_status
            body_contacts.depth[env, pair] = real(wp.max(-deepest, double(0.0)))
            body_contacts.share[env, pair] = real(wp.where(is_contact, share, double(0.0)))
            body_contacts.normal[env, pair] = from_float64(normal_W)
            body_contacts.center[env, pair] = from_float64(center_W)
            # Points have no area.
            body_contacts.area[env, pair] = not_a_number
            body_contacts.volume[env, pair] = not_a_number
            body_contacts.max_pressure[env, pair] = not_a_number

    return find_manifolds_of_pairs


@functools.cache
def accept_manifolds() -> wp.Kernel:
    """Returns the kernel that stores the points of accepted steps; items: nonsmooth pairs."""

    @unique_kernel()
    def accept_points(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        manifold_pairs: ManifoldPairs,
        history_out: ManifoldHistory,
        history: ManifoldHistory,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            history.reference[env, number] = history_out.reference[env, number]
            history.overflow[env, number] = history_out.overflow[env, number]
            history.likely[env, number] = history_out.likely[env, number]
            before = history.count[env, number]
            history.count[env, number] = history_out.count[env, number]
            if before == 0 and history_out.count[env, number] == 0:
                continue
            for slot in range(manifold_pairs.slot_start[number], manifold_pairs.slot_start[number + 1]):
                history.feature_1[env, slot] = history_out.feature_1[env, slot]
                history.feature_2[env, slot] = history_out.feature_2[env, slot]
                history.position[env, slot] = history_out.position[env, slot]
                history.is_closed[env, slot] = history_out.is_closed[env, slot]

    return accept_points


@functools.cache
def reset_manifolds(real: type) -> wp.Kernel:
    """Returns the kernel that removes all points. Launch with dim (env, pair)."""
    ManifoldPoints = manifold_structs(real).ManifoldPoints
    clear_points = clear_points_of(real)

    @unique_kernel(runs_rarely=True)
    def reset_points(
        mask: wp.array(dtype=wp.bool),
        manifold_pairs: ManifoldPairs,
        history: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
    ):
        env, number = wp.tid()
        if not mask[env]:
            return
        start = manifold_pairs.slot_start[number]
        end = manifold_pairs.slot_start[number + 1]
        history.reference[env, number] = 0
        history.overflow[env, number] = 0
        history.likely[env, number] = wp.vec4i()
        history.count[env, number] = 0
        history_out.likely[env, number] = wp.vec4i()
        history_out.count[env, number] = 0
        clear_points(history_out, manifold_points, env, start, end)
        for slot in range(start, end):
            history.feature_1[env, slot] = 0
            history.feature_2[env, slot] = 0
            history.is_closed[env, slot] = 0

    return reset_points
