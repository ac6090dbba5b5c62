"""Largest gap of the points of a pair, and whether its solids are farther apart than that.

Distant pairs are rejected by the boxes around both solids in world axes, which are computed once per step. Their results are
written when a pair becomes distant, and not again while it is.
"""

import functools

import warp as wp
from warpcontact.kernels.body_contact.records import BodyContactSettings, SolidPairs, body_contact_structs
from warpcontact.kernels.body_contact.surface_queries import BoundingBox, SolidBoxes, SolidMotion
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.lowlevel.task_lists import TASKS_PER_LANE, TaskList
from warpcontact.kernels.lowlevel.warps import ballot, lane, lane_count, popcount
from warpcontact.kernels.manifolds.records import (
    RESULTS_DISTANT,
    ManifoldHistory,
    ManifoldPairs,
    manifold_structs,
)
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_of_item

double = wp.float64
vec3d = wp.vec3d

# Largest gap of a point: a multiple of the relative displacement in a step, and a fraction of the size of the bodies.
STEP_MARGIN = wp.constant(double(2.0))
SIZE_MARGIN = wp.constant(double(1.0e-3))


@wp.func
def size_of_pair(first: SolidMotion, second: SolidMotion):
    """Returns the largest edge of the bounding box of the smaller solid [m]."""
    return wp.min(first.extent, second.extent)


@wp.func
def margin_of_pair(first: SolidMotion, second: SolidMotion, least: double, step: double, gravity: double):
    """Returns the largest gap of a point of a pair [m].

    It is at least the displacement of points of the first solid relative to the second one in a step. Speeds of both bodies are
    added, because a body may be stopped by others.

    Args:
        first: Motion of the first solid, which is bounded.
        second: Motion of the second solid.
        least: Smallest margin that the user set [m].
        step: Step length [s].
        gravity: Magnitude of gravity [m/s²].
    """
    speed = first.speed + first.spin * first.radius
    arm = wp.length(first.place - second.place) + first.radius
    speed += second.speed + second.spin * arm
    displacement = STEP_MARGIN * step * speed + step * step * gravity
    return wp.max(wp.max(displacement, least), SIZE_MARGIN * size_of_pair(first, second))


@wp.func
def are_distant(
    first_box: BoundingBox, first: SolidMotion, second_box: BoundingBox, second: SolidMotion, margin: double
):
    """Returns whether two solids are farther apart than ``margin``, by the boxes and spheres around them.

    The second solid may be a half-space, which has no sphere.
    """
    gap = wp.max(first_box.lower - second_box.upper, second_box.lower - first_box.upper)
    if wp.max(gap) > margin:
        return True
    if wp.length_sq(second.normal) == double(0.0):
        reach = first.radius + second.radius + margin
        return wp.length_sq(first.place - second.place) > reach * reach
    center = double(0.5) * (first_box.upper + first_box.lower)
    half = double(0.5) * (first_box.upper - first_box.lower)
    lowest = wp.dot(second.normal, center) - wp.dot(wp.abs(second.normal), half)
    return lowest - second.offset > margin


@wp.struct
class PairCulling:
    """Whether a pair may touch, and the lengths on which this depends."""

    needs_results: wp.bool  # no: it is distant as in the last step
    is_enabled: wp.bool
    is_distant: wp.bool  # by the boxes around both solids
    size: double  # of the smaller solid [m]
    margin: double  # largest gap of a point [m]


@functools.cache
def culling_functions(real: type) -> tuple[wp.Function, wp.Function]:
    """Returns the device functions of the ``PairCulling`` of a pair, and of the ``TaskList`` of a warp.

    Their arguments are those of the kernel of manifolds, the first one also has the environment and the pair.
    """
    Model = structs(real).Model
    to_float64 = frame_functions(real).to_float64

    @wp.func
    def cull_pair(
        status: wp.array(dtype=wp.int32),
        model: Model,
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        boxes: SolidBoxes,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        manifold_pairs: ManifoldPairs,
        env: int,
        number: int,
    ):
        culling = PairCulling()
        culling.needs_results = status[env] == ENV_ACTIVE
        if not culling.needs_results:
            return culling
        pair = manifold_pairs.item[number]
        culling.is_enabled = settings[env, pair].enabled != 0
        if not culling.is_enabled:
            return culling
        first = pairs.first[pair]
        second = pairs.second[pair]
        motion_1 = boxes.motion[env, first]
        motion_2 = boxes.motion[env, second]
        gravity = wp.length(to_float64(model.gravity[env, 0]))
        culling.size = size_of_pair(motion_1, motion_2)
        culling.margin = margin_of_pair(
            motion_1, motion_2, settings[env, pair].margin, double(step[env, 0]), gravity
        )
        culling.is_distant = are_distant(
            boxes.box[env, first], motion_1, boxes.box[env, second], motion_2, culling.margin
        )
        if culling.is_distant:
            culling.needs_results = manifold_pairs.results[env, number] != RESULTS_DISTANT
        return culling

    @wp.func
    def near_tasks(
        thread: int,
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        boxes: SolidBoxes,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        manifold_pairs: ManifoldPairs,
    ):
        tasks = TaskList()
        tasks.first = (thread // lane_count()) * lane_count() * TASKS_PER_LANE
        for part in range(TASKS_PER_LANE):
            task = tasks.first + part * lane_count() + lane()
            needs_results = wp.bool(False)
            if task < task_count(launch):
                env, number = task_of_item(launch, task)
                culling = cull_pair(status, model, step, boxes, pairs, settings, manifold_pairs, env, number)
                needs_results = culling.needs_results
            lanes = ballot(needs_results)
            tasks.lanes[part] = lanes
            tasks.count += popcount(lanes)
        return tasks

    return cull_pair, near_tasks


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
def write_results_of(real: type) -> wp.Function:
    """Returns the device function that writes the results of a pair that impulses do not change.

    Its arguments are (body_contacts, env, pair, status, depth, share, normal, center), in the order of ``BodyContacts``.
    """
    vec3 = structs(real).vec3
    BodyContacts = body_contact_structs(real).BodyContacts
    not_a_number = wp.constant(real(wp.nan))

    @wp.func
    def write_results(
        body_contacts: BodyContacts,
        env: int,
        pair: int,
        status: int,
        depth: real,
        share: real,
        normal: vec3,
        center: vec3,
    ):
        body_contacts.status[env, pair] = status
        body_contacts.depth[env, pair] = depth
        body_contacts.share[env, pair] = share
        body_contacts.normal[env, pair] = normal
        body_contacts.center[env, pair] = center
        # Points have no area.
        body_contacts.area[env, pair] = not_a_number
        body_contacts.volume[env, pair] = not_a_number
        body_contacts.max_pressure[env, pair] = not_a_number

    return write_results
