"""Structs of manifolds: pairs of solids, points that persist from step to step, and points of a step."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs

#: Origin of the results of a pair: unknown, a distant pair, a search.
RESULTS_UNKNOWN, RESULTS_DISTANT, RESULTS_SEARCHED = (wp.constant(i) for i in range(3))


@wp.struct
class ManifoldPairs:
    """Nonsmooth pairs of a set of body contacts: [pair] unless stated otherwise."""

    item: wp.array(dtype=wp.int32)  # number of the pair in its set
    slot_start: wp.array(dtype=wp.int32)  # [pair + 1] first of the points that it may have
    # [env, pair] origin of its ``ManifoldPoints`` and ``BodyContacts``: RESULTS_UNKNOWN, …
    results: wp.array2d(dtype=wp.int32)


@wp.struct
class ManifoldHistory:
    """Points of the last step, by which those of the next step are identified."""

    feature_1: wp.array2d(dtype=wp.int32)  # [env, slot] ``features.Feature.first``; 0: no point
    feature_2: wp.array2d(dtype=wp.int32)  # [env, slot] ``features.Feature.second``
    position: wp.array2d(dtype=wp.vec3d)  # [env, slot] in the frame of the second solid [m]
    is_closed: wp.array2d(dtype=wp.int32)  # [env, slot] 1: its gap was closed
    count: wp.array2d(dtype=wp.int32)  # [env, pair] number of points
    reference: wp.array2d(dtype=wp.int32)  # [env, pair] ``convex.reference_code``, 0 or EDGES
    overflow: wp.array2d(dtype=wp.int32)  # [env, pair] number of steps with areas in contact that had no patch
    likely: wp.array2d(dtype=wp.vec4i)  # [env, pair] ``convex.Reference.likely``


class ManifoldStructs(NamedTuple):
    """Structs of manifolds, in one precision."""

    ManifoldPoints: Struct


@functools.cache
def manifold_structs(real: type) -> ManifoldStructs:
    """Returns the structs of manifolds for ``real``."""
    vec3 = structs(real).vec3

    @wp.struct
    class ManifoldPoints:
        """Points of a step: [env, slot]."""

        is_present: wp.array2d(dtype=wp.int32)  # 1: there is a point
        is_new: wp.array2d(dtype=wp.int32)  # 1: it has closed since the last step
        carries: wp.array2d(dtype=wp.int32)  # 1: the point of the last step in this slot is the same
        gap: wp.array2d(dtype=real)  # negative in overlap; NaN without a point [m]
        normal: wp.array2d(dtype=vec3)  # out of the second solid, W
        arm_1: wp.array2d(dtype=vec3)  # from the center of mass of the first body, W [m]
        arm_2: wp.array2d(dtype=vec3)  # from the center of mass of the second body, W [m]
        position: wp.array2d(dtype=vec3)  # W; NaN without a point [m]
        force: wp.array2d(dtype=vec3)  # on the first body, mean over the last step, W [N]

    return ManifoldStructs(ManifoldPoints=ManifoldPoints)
