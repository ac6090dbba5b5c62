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
    Solids,
    inverse_pose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import SolidBoxes, SolidGeometry, are_apart, solid_geometry
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.lowlevel.task_lists import TaskList, listed_task
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.lowlevel.warps import lane, lane_count
from warpcontact.kernels.manifolds.candidates import (
    CANDIDATES,
    POINTS,
    Candidate,
    Patch,
    candidate_feature,
    candidate_gap,
    candidate_position,
)
from warpcontact.kernels.manifolds.collect import Reach
from warpcontact.kernels.manifolds.convex import NO_REFERENCE, add_vertices_below, convex_manifold
from warpcontact.kernels.manifolds.culling import clear_points_of, culling_functions, write_results_of
from warpcontact.kernels.manifolds.curved import add_curved_above, curved_manifold
from warpcontact.kernels.manifolds.curved_pairs import curved_pair_manifold
from warpcontact.kernels.manifolds.curved_separation import SUPPORTS, CurvedPair, Support
from warpcontact.kernels.manifolds.face_clipping import ClippedCorner, clip_buffer_size
from warpcontact.kernels.manifolds.features import Feature, Features
from warpcontact.kernels.manifolds.meshes import mesh_manifold
from warpcontact.kernels.manifolds.point_matching import (
    ManifoldPoint,
    choose_all,
    mark_previous_points,
    match_points,
)
from warpcontact.kernels.manifolds.records import (
    RESULTS_DISTANT,
    RESULTS_REUSED,
    RESULTS_SEARCHED,
    ManifoldHistory,
    ManifoldPairs,
    PairSearch,
    manifold_structs,
)
from warpcontact.kernels.manifolds.reuse import (
    MovedPoint,
    are_on_faces,
    gap_gradient,
    is_nearest_point,
    is_reusable,
    motion_of_nearest,
    moved_nearest,
    moved_point,
    roll_radius,
)
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    OPEN,
    WRONG_SIDE,
    LaunchRange,
    structs,
    task_count,
    task_of_item,
)

double = wp.float64
vec3d = wp.vec3d

# Kinds of pairs.
ON_HALF_SPACE, BOTH_CONVEX, MESHES = (wp.constant(i) for i in range(3))
CURVED_ON_HALF_SPACE, CURVED_ON_FACES, BOTH_CURVED = (wp.constant(i) for i in range(3, 6))


@wp.func
def reach_of_pair(first: SolidGeometry, second: SolidGeometry, are_convex: bool, size: double, margin: double):
    """Returns the ``Reach`` of a pair with a size and a margin [m]."""
    result = Reach()
    result.size = size
    result.margin = margin
    result.depth = double(wp.inf)
    if not are_convex:
        # Deeper faces may be on the far side of a part of a body.
        result.depth = wp.min(first.half_extents)
        if (second.flags & (HALF_SPACE | HAS_BOUNDARY)) == 0:
            result.depth = wp.min(result.depth, wp.min(second.half_extents))
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
def find_manifolds(
    real: type,
    has_convex: bool,
    has_meshes: bool,
    has_curved: bool,
    has_curved_pairs: bool,
    patch_count: int,
    outline_corners: int,
) -> wp.Kernel:
    """Returns the kernel that finds the manifolds of nonsmooth pairs; items: these pairs.

    Args:
        real: Precision of the state.
        has_convex: Whether there are pairs of convex polyhedra.
        has_meshes: Whether there are other pairs of polyhedra, without half-spaces.
        has_curved: Whether there are curved solids on half-spaces.
        has_curved_pairs: Whether there are other pairs with a curved solid.
        patch_count: Largest number of patches of a pair.
        outline_corners: Largest number of corners of an outline.
    """
    point_count, candidate_count = patch_count * POINTS, patch_count * CANDIDATES
    clipped_count = clip_buffer_size(outline_corners)
    t = structs(real)
    Model, State = t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    ManifoldPoints = manifold_structs(real).ManifoldPoints
    clear_points, write_results = clear_points_of(real), write_results_of(real)
    cull_pair, near_tasks = culling_functions(real)
    pair_pose = solid_functions.functions(real).pair_pose
    frame = frame_functions(real)
    to_float64, from_float64 = frame.to_float64, frame.from_float64

    @wp.func
    def place_of(state: State, env: int, body: int):
        """Returns the center of mass of a body, or the origin for the world, W [m]."""
        if body < 0:
            return vec3d()
        place = to_float64(state.body_position[env, body])
        return place + to_float64(state.body_position_remainder[env, body])

    @wp.func
    def write_point(
        center_of_mass: vec3d,
        pose: PairPose,
        point: MovedPoint,
        carries: int,
        contact_gap: double,
        env: int,
        slot: int,
        history_in: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
    ):
        """Writes a point to its slot; ``carries``: 1 if the slot has the same point of the last step."""
        offset = pose.second_axes.rotation * point.position
        is_closed = wp.where(point.gap <= contact_gap, 1, 0)
        was_closed = carries * history_in.is_closed[env, slot]
        history_out.is_closed[env, slot] = is_closed
        manifold_points.is_present[env, slot] = 1
        manifold_points.carries[env, slot] = carries
        manifold_points.is_new[env, slot] = wp.where(is_closed > was_closed, 1, 0)
        manifold_points.gap[env, slot] = real(point.gap)
        manifold_points.normal[env, slot] = from_float64(pose.second_axes.rotation * point.normal)
        manifold_points.arm_1[env, slot] = from_float64(pose.arm_1 + offset)
        manifold_points.arm_2[env, slot] = from_float64(pose.arm_2 + offset)
        manifold_points.position[env, slot] = from_float64(center_of_mass + pose.arm_1 + offset)

    @wp.func
    def write_points(
        geometries: Geometries,
        features: Features,
        first: SolidGeometry,
        second: SolidGeometry,
        center_of_mass: vec3d,
        pose: PairPose,
        patches: wp.array(dtype=Patch),
        candidates: wp.array(dtype=Candidate),
        points: wp.array(dtype=ManifoldPoint),
        count: int,
        are_polyhedra: bool,
        contact_gap: double,
        env: int,
        history_in: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
    ):
        """Writes the points of a pair to their slots; returns their smallest gap, infinite without any [m]."""
        least = double(wp.inf)
        for i in range(count):
            one = candidates[points[i].candidate]
            position = candidate_position(one)
            gap = candidate_gap(one)
            feature = candidate_feature(one)
            slot = points[i].slot
            point = MovedPoint()
            point.position = position
            point.normal = patches[points[i].patch].normal
            point.gap = gap
            least = wp.min(least, gap)
            gradient = point.normal
            if are_polyhedra:
                gradient = gap_gradient(
                    geometries, features, first, second, pose.first_in_second, feature, point.normal
                )
            history_out.feature_1[env, slot] = feature.first
            history_out.feature_2[env, slot] = feature.second
            history_out.position[env, slot] = position
            history_out.gap[env, slot] = gap
            history_out.normal[env, slot] = point.normal
            history_out.gradient[env, slot] = gradient
            write_point(
                center_of_mass, pose, point, points[i].is_matched, contact_gap, env, slot, history_in, history_out,
                manifold_points,
            )  # fmt: skip
        return least

    @wp.func
    def reuse_points(
        geometries: Geometries,
        features: Features,
        first: SolidGeometry,
        second: SolidGeometry,
        search: PairSearch,
        center_of_mass: vec3d,
        pose: PairPose,
        contact_gap: double,
        env: int,
        start: int,
        end: int,
        history_in: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
    ):
        """Writes the points of an earlier search at the present pose; returns their smallest gap, infinite without any [m]."""
        least = double(wp.inf)
        for slot in range(start, end):
            feature = Feature()
            feature.first = history_in.feature_1[env, slot]
            feature.second = history_in.feature_2[env, slot]
            if feature.first != 0:
                point = MovedPoint()
                point.position = history_in.position[env, slot]
                point.normal = history_in.normal[env, slot]
                point.gap = history_in.gap[env, slot]
                if search.is_nearest == 1:
                    if wp.static(has_curved_pairs):
                        point = moved_nearest(
                            geometries, features, search, first, second, pose.first_in_second, point, feature
                        )
                else:
                    gradient = history_in.gradient[env, slot]
                    point = moved_point(search, pose.first_in_second, point, gradient, feature.first)
                least = wp.min(least, point.gap)
                write_point(
                    center_of_mass,
                    pose,
                    point,
                    1,
                    contact_gap,
                    env,
                    slot,
                    history_in,
                    history_out,
                    manifold_points,
                )
            else:
                history_out.is_closed[env, slot] = 0
                if manifold_points.is_present[env, slot] != 0:
                    clear_points(history_out, manifold_points, env, slot, slot + 1)
        return least

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
        boxes: SolidBoxes,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        manifold_pairs: ManifoldPairs,
        contact_gap: double,  # gap up to which a point is closed [m]
        history_in: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
        body_contacts: BodyContacts,
    ):
        corners = wp.zeros(shape=(clipped_count,), dtype=ClippedCorner)
        patches = wp.zeros(shape=(patch_count,), dtype=Patch)
        candidates = wp.zeros(shape=(candidate_count,), dtype=Candidate)
        chosen = wp.zeros(shape=(POINTS,), dtype=wp.int32)
        points = wp.zeros(shape=(point_count,), dtype=ManifoldPoint)
        taken = wp.zeros(shape=(point_count,), dtype=wp.int32)
        pending = wp.zeros(shape=(PENDING_NODES,), dtype=wp.int32)
        supports = wp.zeros(shape=(SUPPORTS,), dtype=Support)
        tasks = TaskList()
        count_of_tasks = task_count(launch)
        if lane_count() > 1:
            tasks = near_tasks(wp.tid(), launch, status, model, step, boxes, pairs, settings, manifold_pairs)
            count_of_tasks = tasks.count
        for index in range(lane(), count_of_tasks, lane_count()):
            task = index
            if lane_count() > 1:
                task = listed_task(tasks, index)
            env, number = task_of_item(launch, task)
            culling = cull_pair(status, model, step, boxes, pairs, settings, manifold_pairs, env, number)
            if not culling.needs_results:
                continue
            pair = manifold_pairs.item[number]
            solid_1 = pairs.first[pair]
            solid_2 = pairs.second[pair]
            is_enabled = culling.is_enabled
            is_distant = culling.is_distant
            size = culling.size
            margin = culling.margin
            start = manifold_pairs.slot_start[number]
            end = manifold_pairs.slot_start[number + 1]
            setting = settings[env, pair]
            pose = PairPose()
            first = SolidGeometry()
            second = SolidGeometry()
            reach = Reach()
            geometry_1 = wp.int32(0)
            geometry_2 = wp.int32(0)
            are_convex = wp.bool(False)
            is_reused = wp.bool(False)
            search = PairSearch()
            if is_enabled and not is_distant:
                pose_1 = solids.pose[env, solid_1]
                pose_2 = solids.pose[env, solid_2]
                geometry_1 = pose_1.geometry
                geometry_2 = pose_2.geometry
                first = solid_geometry(geometries, pose_1)
                second = solid_geometry(geometries, pose_2)
                half_space = (second.flags & HALF_SPACE) != 0
                are_convex = features.is_convex[geometry_1] == 1 and features.is_convex[geometry_2] == 1
                reach = reach_of_pair(first, second, are_convex or half_space, size, margin)
                pose = pair_pose(state, env, solids, solid_1, solid_2)
                search = history_in.search[env, number]
                is_reused = is_reusable(
                    search,
                    geometry_1,
                    geometry_2,
                    first,
                    second,
                    pose.first_in_second,
                    setting.kappa,
                    margin,
                    size,
                )
                if not is_reused:
                    is_distant = not is_within_reach(first, second, pose, reach.margin)
                    if is_distant and manifold_pairs.results[env, number] == RESULTS_DISTANT:
                        continue
                    search = PairSearch()
            contact_status = wp.int32(OPEN)
            reference = history_in.reference[env, number]
            share = double(0.0)
            count = wp.int32(0)
            deepest = double(wp.inf)
            has_lost = wp.int32(0)
            center_of_mass = place_of(state, env, solids.body[solid_1])
            history_out.likely[env, number] = history_in.likely[env, number]
            if is_reused:
                count = history_in.count[env, number]
                share = search.share
                deepest = -search.excess
                deepest += reuse_points(
                    geometries,
                    features,
                    first,
                    second,
                    search,
                    center_of_mass,
                    pose,
                    contact_gap,
                    env,
                    start,
                    end,
                    history_in,
                    history_out,
                    manifold_points,
                )
                if deepest < -setting.max_depth:
                    contact_status = WRONG_SIDE
                    clear_points(history_out, manifold_points, env, start, end)
                    count = 0
                    search.is_valid = 0
                elif deepest <= contact_gap:
                    contact_status = CONTACT
            else:
                if history_out.count[env, number] > 0:
                    clear_points(history_out, manifold_points, env, start, end)
                if not is_enabled:
                    contact_status = DISABLED
                    reference = NO_REFERENCE
                elif not is_distant:
                    for patch in range(patch_count):
                        patches[patch].count = 0
                    patches[0].lost_gap = double(wp.inf)
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
                    for patch in range(patch_count):
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
                    roll = roll_radius(first, second)
                    least = write_points(
                        geometries, features, first, second, center_of_mass, pose, patches, candidates, points, count,
                        roll == double(0.0), contact_gap, env, history_in, history_out, manifold_points,
                    )  # fmt: skip
                    has_lost = wp.where(patches[0].lost_gap <= contact_gap, 1, 0)
                    search.origin = pose.first_in_second.origin
                    search.rotation = pose.first_in_second.rotation
                    search.scale_1 = first.scale
                    search.scale_2 = second.scale
                    search.margin = margin
                    search.kappa = setting.kappa
                    search.share = share
                    search.roll = roll
                    search.geometry_1 = geometry_1
                    search.geometry_2 = geometry_2
                    is_valid = contact_status != WRONG_SIDE and patches[0].lost_gap == double(wp.inf)
                    if count > 0:
                        search.excess = least - deepest
                        search.normal_on_first = wp.where(share == double(0.0) or roll < double(0.0), 1, 0)
                        is_known = roll == double(0.0) and kind != BOTH_CURVED
                        if kind == CURVED_ON_HALF_SPACE or kind == CURVED_ON_FACES:  # noqa: SIM109 - Warp has no ``in``
                            is_known = not wp.isnan(roll) and are_on_faces(patches, candidates)
                        if wp.static(has_curved_pairs):
                            one = candidates[points[0].candidate]
                            if count == 1 and is_nearest_point(candidate_feature(one)):
                                search.is_nearest = 1
                                nearest = MovedPoint()
                                nearest.position = candidate_position(one)
                                nearest.normal = patches[points[0].patch].normal
                                nearest.gap = candidate_gap(one)
                                motion = motion_of_nearest(
                                    geometries, features, search, first, second, pose.first_in_second, nearest,
                                    candidate_feature(one),
                                )  # fmt: skip
                                is_known = motion.is_known
                        is_valid = is_valid and is_known
                    search.is_valid = wp.where(is_valid, 1, 0)
            # Mean of the closed points, until impulses are known.
            normal_W = vec3d()
            center_W = vec3d()
            closed = double(0.0)
            if count > 0:
                for slot in range(start, end):
                    if history_out.is_closed[env, slot] == 1:
                        closed += double(1.0)
                        center_W += to_float64(manifold_points.position[env, slot])
                        normal_W += to_float64(manifold_points.normal[env, slot])
                if closed > double(0.0):
                    center_W = center_W / closed
                    normal_W = wp.normalize(normal_W)
            history_out.count[env, number] = count
            results = wp.int32(RESULTS_REUSED)
            if search.is_valid == 0 or not is_reused:
                history_out.reference[env, number] = reference
                history_out.overflow[env, number] = history_in.overflow[env, number] + has_lost
                history_out.search[env, number] = search
                results = wp.where(is_distant, RESULTS_DISTANT, RESULTS_SEARCHED)
            is_contact = contact_status == CONTACT
            write_results(
                body_contacts, env, pair, contact_status, real(wp.max(-deepest, double(0.0))),
                real(wp.where(is_contact, share, double(0.0))), from_float64(normal_W), from_float64(center_W),
            )  # fmt: skip
            manifold_pairs.results[env, number] = results

    return find_manifolds_of_pairs
