"""Choice of the points of all patches of a pair, and their slots.

A point keeps its slot, and with it its impulse, if its features are the same, or else if it is the nearest point within a
tenth of the size of its patch.
"""

import warp as wp
from warpcontact.kernels.manifolds.candidates import (
    CANDIDATES,
    Candidate,
    Patch,
    candidate_feature,
    candidate_position,
    choose_points,
)
from warpcontact.kernels.manifolds.records import ManifoldHistory

double = wp.float64

# Distance, relative to the size of a patch, up to which a point is the nearest one of the last step.
NEAREST = wp.constant(double(0.1))


@wp.struct
class ManifoldPoint:
    """A point of a manifold while it is identified, in the frame of the second solid."""

    candidate: wp.int32
    patch: wp.int32
    slot: wp.int32  # −1: not found yet
    is_matched: wp.int32  # 1: the slot has the same point of the last step


@wp.func
def mark_previous_points(
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    history: ManifoldHistory,
    env: int,
    start: int,
    end: int,
):
    """Marks the candidates that are points of the last step, which are in slots ``start`` to ``end``."""
    for patch in range(patches.shape[0]):
        for i in range(CANDIDATES * patch, CANDIDATES * patch + patches[patch].count):
            one = candidates[i]
            feature = candidate_feature(one)
            one[6] = double(0.0)
            for slot in range(start, end):
                same = history.feature_1[env, slot] == feature.first
                if same and history.feature_2[env, slot] == feature.second:
                    one[6] = double(1.0)
            candidates[i] = one


@wp.func
def choose_all(
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
    size: double,
    capacity: int,
    chosen: wp.array(dtype=wp.int32),
    points: wp.array(dtype=ManifoldPoint),
):
    """Writes the points of all patches to ``points``; returns their number, at most ``capacity``."""
    count = wp.int32(0)
    for patch in range(patches.shape[0]):
        found = choose_points(patches[patch], candidates, CANDIDATES * patch, size, chosen)
        for i in range(found):
            if count < capacity:
                points[count].candidate = chosen[i]
                points[count].patch = patch
                points[count].slot = -1
                points[count].is_matched = 0
                count += 1
    return count


@wp.func
def patch_size(
    candidates: wp.array(dtype=Candidate),
    points: wp.array(dtype=ManifoldPoint),
    count: int,
    patch: int,
    size: double,
):
    """Returns the largest distance of two points of a patch, or ``size`` if there is only one [m]."""
    largest = double(0.0)
    for i in range(count):
        for k in range(i):
            if points[i].patch == patch and points[k].patch == patch:
                position = candidate_position(candidates[points[i].candidate])
                difference = position - candidate_position(candidates[points[k].candidate])
                largest = wp.max(largest, wp.length(difference))
    return wp.where(largest > double(0.0), largest, size)


@wp.func
def match_points(
    candidates: wp.array(dtype=Candidate),
    points: wp.array(dtype=ManifoldPoint),
    count: int,
    history: ManifoldHistory,
    env: int,
    start: int,
    end: int,
    size: double,
    taken: wp.array(dtype=wp.int32),
):
    """Assigns a slot to each point: that of the same point of the last step, or else a free one."""
    for k in range(end - start):
        taken[k] = 0
    for i in range(count):
        feature = candidate_feature(candidates[points[i].candidate])
        for slot in range(start, end):
            if taken[slot - start] == 0 and points[i].slot < 0:
                same = history.feature_1[env, slot] == feature.first
                if same and history.feature_2[env, slot] == feature.second:
                    taken[slot - start] = 1
                    points[i].slot = slot
                    points[i].is_matched = 1
    for i in range(count):
        if points[i].slot >= 0:
            continue
        position = candidate_position(candidates[points[i].candidate])
        nearest = NEAREST * patch_size(candidates, points, count, points[i].patch, size)
        best = wp.int32(-1)
        for slot in range(start, end):
            if taken[slot - start] == 0 and history.feature_1[env, slot] != 0:
                distance = wp.length(history.position[env, slot] - position)
                if distance < nearest:
                    nearest = distance
                    best = slot
        if best >= 0:
            taken[best - start] = 1
            points[i].slot = best
            points[i].is_matched = 1
    # New points take slots without a point first.
    for used in range(2):
        for slot in range(start, end):
            if taken[slot - start] == 1 or (used == 0 and history.feature_1[env, slot] != 0):
                continue
            for i in range(count):
                if points[i].slot < 0 and taken[slot - start] == 0:
                    taken[slot - start] = 1
                    points[i].slot = slot
