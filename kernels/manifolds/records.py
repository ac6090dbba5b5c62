"""Structs of manifolds: pairs of solids, points that persist from step to step, and points of a step."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs

#: Origin of the results of a pair: unknown, a distant pair, a search, an earlier search.
RESULTS_UNKNOWN, RESULTS_DISTANT, RESULTS_SEARCHED, RESULTS_REUSED = (wp.constant(i) for i in range(4))


@wp.struct
class ManifoldPairs:
    """Nonsmooth pairs of a set of body contacts: [pair] unless stated otherwise."""

    item: wp.array(dtype=wp.int32)  # number of the pair in its set
    slot_start: wp.array(dtype=wp.int32)  # [pair + 1] first of the points that it may have
    # [env, pair] origin of its ``ManifoldPoints`` and ``BodyContacts``: RESULTS_UNKNOWN, …
    results: wp.array2d(dtype=wp.int32)


@wp.struct
class PairSearch:
    """The last search of the points of a pair, and the values that they depend on."""

    origin: wp.vec3d  # of the first solid in the frame of the second one [m]
    rotation: wp.mat33d  # first solid → second solid
    scale_1: wp.vec3d  # of the solids [m per unit]
    scale_2: wp.vec3d
    margin: wp.float64  # largest gap of a point [m]
    kappa: wp.float64  # of the settings [-]
    share: wp.float64  # result for ``BodyContacts.share``
    excess: wp.float64  # smallest gap of the points less that of all candidates [m]
    # Radius of curvature of a solid that may roll on faces of the other one: positive for the first solid, negative for the
    # second, 0 for two polyhedra [m]
    roll: wp.float64
    geometry_1: wp.int32
    geometry_2: wp.int32
    normal_on_first: wp.int32  # 1: normals are fixed to the first solid, not to the second
    is_nearest: wp.int32  # 1: the only point is between the nearest points of both solids
    is_valid: wp.int32  # 1: the points may be reused


@wp.struct
class ManifoldHistory:
    """Points of the last step, by which those of the next step are identified, or from which they follow."""

    feature_1: wp.array2d(dtype=wp.int32)  # [env, slot] ``features.Feature.first``; 0: no point
    feature_2: wp.array2d(dtype=wp.int32)  # [env, slot] ``features.Feature.second``
    # At their search, in the frame of the second solid:
    position: wp.array2d(dtype=wp.vec3d)  # [env, slot] [m]
    gap: wp.array2d(dtype=wp.float64)  # [env, slot] [m]
    normal: wp.array2d(dtype=wp.vec3d)  # [env, slot] out of the second solid
    gradient: wp.array2d(dtype=wp.vec3d)  # [env, slot] of the gap over displacements of the first solid
    is_closed: wp.array2d(dtype=wp.int32)  # [env, slot] 1: its gap was closed
    count: wp.array2d(dtype=wp.int32)  # [env, pair] number of points
    reference: wp.array2d(dtype=wp.int32)  # [env, pair] ``convex.reference_code``, 0 or EDGES
    overflow: wp.array2d(dtype=wp.int32)  # [env, pair] number of steps with areas in contact that had no patch
    likely: wp.array2d(dtype=wp.vec4i)  # [env, pair] ``convex.Reference.likely``
    search: wp.array2d(dtype=PairSearch)  # [env, pair]


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
