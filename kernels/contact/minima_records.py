"""Structs of contacts at all local minima of the distance: settings, history and results.

A contact has ``slot_count`` slots for minima. A minimum keeps its slot, and with it its history, from step to step.
Arrays of slots are indexed [env, slot_count × contact of the group + slot].
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs


def slot_count(room: int) -> int:
    """Returns the number of slots of a contact with up to ``room`` minima.

    A new minimum never takes a slot that another one had in the last step, whose history would be read.
    """
    return 2 * room


class MinimaStructs(NamedTuple):
    """Structs of contacts at all minima, in one precision."""

    MinimaSettings: Struct  # parameters of a contact
    MinimaHistory: Struct  # minima of the last accepted step
    MinimaResults: Struct  # minima of the current step


@functools.cache
def minima_structs(real: type) -> MinimaStructs:
    """Returns the structs of contacts at all minima in one precision."""
    vec3 = structs(real).vec3

    @wp.struct
    class MinimaSettings:
        """Parameters of a contact."""

        cosine_one: real  # of the angle between normals up to which minima act as one
        cosine_none: real  # of the angle from which on they act in full; 1: always

    @wp.struct
    class MinimaHistory:
        """Minima of the last accepted step."""

        entry_speed: wp.array2d(dtype=real)  # [env, slot] approach speed at entry [m/s]; < 0: no minimum
        last_normal: wp.array2d(dtype=vec3)  # [env, slot] unit, out of the surface, axes of the surface
        last_position: wp.array2d(dtype=vec3)  # [env, slot] position on the surface, S [mesh unit]
        overflow: wp.array2d(dtype=wp.int32)  # [env, contact] number of steps with more minima than room

    @wp.struct
    class MinimaResults:
        """Minima of the current step. Without contact: 0."""

        touching: wp.array2d(dtype=wp.int32)  # [env, slot] 1: a minimum in contact
        approach_speed: wp.array2d(dtype=real)  # [env, slot] dδ/dt at K [m/s]
        normal_S: wp.array2d(dtype=vec3)  # [env, slot] unit, out of the surface, axes of the surface
        position: wp.array2d(dtype=vec3)  # [env, slot] position on the surface, S [mesh unit]
        arm: wp.array2d(dtype=vec3)  # [env, slot] from the origin of the point's body to K, W [m]
        penetration: wp.array2d(dtype=real)  # [env, slot] [m]
        normal: wp.array2d(dtype=vec3)  # [env, slot] unit, out of the surface, W
        normal_force: wp.array2d(dtype=real)  # [env, slot] with its share [N]
        count: wp.array2d(dtype=wp.int32)  # [env, contact] number of minima within reach, with those without room
        force: wp.array2d(dtype=vec3)  # [env, contact] total, on the point's body, W [N]
        center: wp.array2d(dtype=wp.vec3d)  # [env, contact] mean of the points K, weighted by normal force, W [m]

    return MinimaStructs(MinimaSettings=MinimaSettings, MinimaHistory=MinimaHistory, MinimaResults=MinimaResults)
