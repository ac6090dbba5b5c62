"""Points of manifolds as history: stored after accepted steps, and removed by resets."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.manifolds.culling import clear_points_of
from warpcontact.kernels.manifolds.records import (
    RESULTS_DISTANT,
    RESULTS_REUSED,
    RESULTS_UNKNOWN,
    ManifoldHistory,
    ManifoldPairs,
    manifold_structs,
)
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, task_count, task_env, task_item


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
            before = history.count[env, number]
            results = manifold_pairs.results[env, number]
            if results == RESULTS_DISTANT:
                if before > 0:
                    history.count[env, number] = 0
                    history.search[env, number].is_valid = 0
                    for slot in range(manifold_pairs.slot_start[number], manifold_pairs.slot_start[number + 1]):
                        history.feature_1[env, slot] = 0
                        history.feature_2[env, slot] = 0
                        history.is_closed[env, slot] = 0
                continue
            if results == RESULTS_REUSED:
                for slot in range(manifold_pairs.slot_start[number], manifold_pairs.slot_start[number + 1]):
                    history.is_closed[env, slot] = history_out.is_closed[env, slot]
                continue
            history.reference[env, number] = history_out.reference[env, number]
            history.overflow[env, number] = history_out.overflow[env, number]
            history.likely[env, number] = history_out.likely[env, number]
            history.search[env, number] = history_out.search[env, number]
            history.count[env, number] = history_out.count[env, number]
            if before == 0 and history_out.count[env, number] == 0:
                continue
            for slot in range(manifold_pairs.slot_start[number], manifold_pairs.slot_start[number + 1]):
                history.feature_1[env, slot] = history_out.feature_1[env, slot]
                history.feature_2[env, slot] = history_out.feature_2[env, slot]
                history.position[env, slot] = history_out.position[env, slot]
                history.gap[env, slot] = history_out.gap[env, slot]
                history.normal[env, slot] = history_out.normal[env, slot]
                history.gradient[env, slot] = history_out.gradient[env, slot]
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
        history.search[env, number].is_valid = 0
        manifold_pairs.results[env, number] = RESULTS_UNKNOWN
        history.count[env, number] = 0
        history_out.count[env, number] = 0
        clear_points(history_out, manifold_points, env, start, end)
        for slot in range(start, end):
            history.feature_1[env, slot] = 0
            history.feature_2[env, slot] = 0
            history.is_closed[env, slot] = 0

    return reset_points
