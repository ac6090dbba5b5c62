"""Rows of the points of manifolds, and their impulses as sensors of body contacts.

A point with a gap g has a row, too: its separation speed after the step is at least −g/h, so that it does not pass through the
surface. With restitution e, a point that closes within the step separates with e times its approach speed.
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.body_contact.records import SolidPairs, body_contact_structs
from warpcontact.kernels.body_contact.solids import Solids
from warpcontact.kernels.contact.impulse_records import acting_impulse, record_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.manifolds.records import RESULTS_UNKNOWN, ManifoldHistory, ManifoldPairs, manifold_structs
from warpcontact.kernels.nonsmooth.build_rows import add_row
from warpcontact.kernels.nonsmooth.rows import row_structs
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    MODE_OPEN,
    LaunchRange,
    first_env,
    structs,
    task_count,
    task_env,
    task_item,
)


@functools.cache
def manifold_rows(real: type) -> wp.Kernel:
    """Returns the kernel that adds the points of manifolds as rows; items: 1."""
    t = structs(real)
    State = t.State
    ManifoldPoints = manifold_structs(real).ManifoldPoints
    r, records = row_structs(real), record_structs(real)
    acting = acting_impulse(real)
    add = add_row(real)
    velocity_at = frames.functions(real).velocity_at
    zero = wp.constant(real(0.0))

    @wp.func
    def is_changed(
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        history: ManifoldHistory,
        manifold_points: ManifoldPoints,
        env: int,
        start: int,
        end: int,
        first: int,
    ):
        """Returns whether a point of a pair has closed or a loaded one has gone since the last step."""
        for slot in range(start, end):
            if manifold_points.is_present[env, slot] == 1:
                if manifold_points.is_new[env, slot] == 1:
                    return True
            elif history.feature_1[env, slot] != 0:
                if acting(stored_impulses, statistics, env, first + slot).mode != MODE_OPEN:
                    return True
        return False

    @wp.func
    def height_of_patch(manifold_points: ManifoldPoints, env: int, start: int, end: int, slot: int):
        """Returns the distance along the normal from a point to the deepest point of its patch [m].

        It is 0 if the distance exceeds the difference of their gaps, as on curved patches.
        """
        normal = manifold_points.normal[env, slot]
        gap = manifold_points.gap[env, slot]
        deepest = wp.int32(slot)
        for other in range(start, end):
            if manifold_points.is_present[env, other] == 1 and manifold_points.normal[env, other] == normal:
                if manifold_points.gap[env, other] < manifold_points.gap[env, deepest]:
                    deepest = other
        height = wp.dot(normal, manifold_points.arm_1[env, deepest] - manifold_points.arm_1[env, slot])
        return wp.where(wp.abs(height) <= gap - manifold_points.gap[env, deepest], height, zero)

    @wp.func
    def gap_of_pair(
        stored_impulses: records.StoredImpulses, statistics: records.StepStatistics, env: int, first: int, end: int
    ):
        """Returns the largest gap that closed points of a pair held in the last step, −∞ without any [m].

        New points hold it as well, because a rolling body changes its points.
        """
        largest = -real(wp.inf)
        for contact in range(first, end):
            stored = stored_impulses[env, contact]
            if stored.stamp == statistics.step[env] and (stored.mode != MODE_OPEN or stored.held_gap < zero):
                largest = wp.max(largest, stored.held_gap)
        return largest

    @unique_kernel()
    def add_manifold_rows(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        state: State,
        solids: Solids,
        pairs: SolidPairs,
        manifold_pairs: ManifoldPairs,
        pair_count: wp.int32,
        contact_gap: real,  # gap up to which a point is closed [m]
        history: ManifoldHistory,
        history_out: ManifoldHistory,
        manifold_points: ManifoldPoints,
        first: wp.int32,  # contact index of the first slot
        first_material: wp.int32,  # index of the material of the first pair
        recovery: real,  # [1/s]
        material: wp.array2d(dtype=records.NonsmoothMaterial),
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        rows: r.Rows,
        solve_result: r.SolveResult,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            for number in range(pair_count):
                if history_out.count[env, number] == 0:
                    continue
                start = manifold_pairs.slot_start[number]
                end = manifold_pairs.slot_start[number + 1]
                pair = manifold_pairs.item[number]
                body_1 = solids.body[pairs.first[pair]]
                body_2 = solids.body[pairs.second[pair]]
                changed = is_changed(stored_impulses, statistics, history, manifold_points, env, start, end, first)
                held_gap = gap_of_pair(stored_impulses, statistics, env, first + start, first + end)
                for slot in range(start, end):
                    if manifold_points.is_present[env, slot] == 0:
                        continue
                    gap = manifold_points.gap[env, slot]
                    normal = manifold_points.normal[env, slot]
                    arm_1 = manifold_points.arm_1[env, slot]
                    arm_2 = manifold_points.arm_2[env, slot]
                    if gap > contact_gap:
                        # A rigid body cannot stick at points of different heights while one of them closes.
                        shift = height_of_patch(manifold_points, env, start, end, slot) * normal
                        arm_1 += shift
                        arm_2 += shift
                    add(
                        state, rows, solve_result, stored_impulses, statistics, env, first + slot,
                        material[env, first_material + number], body_1, body_2, arm_1, arm_2, normal, gap, held_gap,
                        recovery, zero, zero,
                    )  # fmt: skip
                    row = solve_result.count[env] - 1
                    if manifold_points.carries[env, slot] == 0:
                        # The stored impulse is that of another point.
                        rows[env, row].impulse = t.vec3()
                        rows[env, row].mu = material[env, first_material + number].mu_static
                    rows[env, row].is_new = wp.where(changed, 1, 0)
                    if gap > contact_gap:
                        approach = velocity_at(state, env, body_2, arm_2) - velocity_at(state, env, body_1, arm_1)
                        closes = wp.dot(approach, normal) * step[env, 0] > gap
                        if rows[env, row].restitution_speed <= zero or not closes:
                            rows[env, row].restitution_speed = zero
                            rows[env, row].restitution = zero
                            # Half the gap of a closed point is left, so that rounding does not open it.
                            rows[env, row].recovery = (real(0.5) * contact_gap - gap) / step[env, 0]

    return add_manifold_rows


@functools.cache
def display_manifolds(real: type) -> wp.Kernel:
    """Returns the kernel that writes the impulses of the last step to the sensors of body contacts; items: pairs."""
    vec3 = structs(real).vec3
    BodyContacts = body_contact_structs(real).BodyContacts
    ManifoldPoints = manifold_structs(real).ManifoldPoints
    acting = acting_impulse(real)
    records = record_structs(real)
    zero = wp.constant(real(0.0))

    @unique_kernel()
    def show_manifolds(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        manifold_pairs: ManifoldPairs,
        manifold_points: ManifoldPoints,
        first: wp.int32,  # contact index of the first slot
        stored_impulses: records.StoredImpulses,
        statistics: records.StepStatistics,
        body_contacts: BodyContacts,
        contact_gap: real,  # gap up to which a point is closed [m]
        load_ratio: wp.array2d(dtype=real),  # [env, pair] largest over mean normal force of its closed points
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            pair = manifold_pairs.item[number]
            per_second = real(1.0) / step[env, 0]
            total = vec3()
            friction = vec3()
            torque = vec3()
            normal_force = zero
            largest = zero
            closed = zero
            located = zero
            approach_speed = zero
            center = vec3()
            normals = vec3()
            for slot in range(manifold_pairs.slot_start[number], manifold_pairs.slot_start[number + 1]):
                stored = acting(stored_impulses, statistics, env, first + slot)
                force = per_second * stored.impulse
                if stored.mode != MODE_OPEN:
                    normal = stored.normal
                    along = wp.dot(force, normal)
                    total += force
                    friction += force - along * normal
                    torque += wp.cross(manifold_points.arm_1[env, slot], force)
                    normal_force += along
                    largest = wp.max(largest, along)
                    approach_speed += along * stored.approach_speed
                    normals += along * normal
                    if manifold_points.is_present[env, slot] == 1:
                        located += along
                        center += along * manifold_points.position[env, slot]
                is_closed = (
                    manifold_points.is_present[env, slot] == 1 and manifold_points.gap[env, slot] <= contact_gap
                )
                if is_closed or wp.length_sq(force) > zero:
                    closed += real(1.0)
                manifold_points.force[env, slot] = force
            ratio = zero
            if normal_force > zero:
                ratio = largest * closed / normal_force
                approach_speed = approach_speed / normal_force
                # They are not those of a distant pair, which a step would not write again.
                manifold_pairs.results[env, number] = RESULTS_UNKNOWN
                body_contacts.normal[env, pair] = wp.normalize(normals)
                if located > zero:
                    body_contacts.center[env, pair] = center / located
            load_ratio[env, number] = ratio
            body_contacts.approach_speed[env, pair] = approach_speed
            body_contacts.normal_force[env, pair] = normal_force
            body_contacts.friction_force[env, pair] = friction
            body_contacts.force[env, pair] = total
            body_contacts.torque[env, pair] = torque

    return show_manifolds
