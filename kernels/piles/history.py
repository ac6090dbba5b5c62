"""Advances what a pile remembers of its touches, once per accepted step and nowhere else."""

import functools

import warp as wp
from warpcontact.kernels.piles import base
from warpcontact.kernels.piles.base import AT_ONCE, TOUCHED, TOUCHES, pile_structs
from warpcontact.kernels.touch import Parts, group_structs
from warpcontact.kernels.types import ENV_ACTIVE, Work, env_of, item_of, task_count
from warpcontact.kernels.unique import unique_kernel
from warpcontact.kernels.warps import first_of


@functools.cache
def copy_memory(parts: Parts, real: type) -> wp.Function:
    """Returns ``(source, source_slot, target, target_slot, env)``, which copies what a pair remembers."""
    _, Memory = group_structs(parts, real)
    law, friction, rolling, torsion = (bool(part.memories) for part in parts)

    @wp.func
    def copy(source: Memory, source_slot: int, target: Memory, target_slot: int, env: int):
        if wp.static(law):
            target.law[env, target_slot] = source.law[env, source_slot]
        if wp.static(friction):
            target.friction[env, target_slot] = source.friction[env, source_slot]
        if wp.static(rolling):
            target.rolling[env, target_slot] = source.rolling[env, source_slot]
        if wp.static(torsion):
            target.torsion[env, target_slot] = source.torsion[env, source_slot]

    return copy


@functools.cache
def advance(parts: Parts, real: type, hard: bool = False) -> wp.Kernel:
    """Returns the kernel that takes touches into the history; items: shapes. ``hard``: see ``force.kernel``."""
    p = pile_structs(real)
    Shapes, Lists, Touches = p.Shapes, p.Lists, p.Touches
    _, Memory = group_structs(parts, real)
    copy, marked = copy_memory(parts, real), base.marked(real)

    @wp.func
    def take(touches: Touches, kept: Memory, memory: Memory, env: int, slot: int):
        bits = touches.bits[env, slot]
        if (bits & TOUCHES) == 0:
            touches.bits[env, slot] = 0
            return
        speed = wp.max(touches.approach_speed[env, slot], real(0.0))
        if bits == TOUCHES:
            touches.bits[env, slot] = TOUCHES | TOUCHED
            touches.entry_speed[env, slot] = speed
        elif speed > touches.entry_speed[env, slot]:
            touches.entry_speed[env, slot] = speed
        if wp.static(not hard):
            copy(kept, slot, memory, slot, env)

    @unique_kernel()
    def advance_pile(
        work: Work,
        status: wp.array(dtype=wp.int32),
        shapes: Shapes,
        lists: Lists,
        touches: Touches,
        kept: Memory,
        memory: Memory,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE or touches.busy[env, shape] == 0:
                continue
            start = shapes.slot_start[shape]
            owned = lists.owned[env, shape]
            for first in range(start, start + owned, wp.static(AT_ONCE)):
                count = wp.min(start + owned - first, wp.static(AT_ONCE))
                those = marked(touches, env, first, count, TOUCHES | TOUCHED)
                while those != 0:
                    take(touches, kept, memory, env, first + first_of(those))
                    those = those & (those - 1)

    return advance_pile


@functools.cache
def forget() -> wp.Kernel:
    """Returns the kernel that empties the history of chosen environments. Launch with dim (env, slot or shape)."""

    @unique_kernel()
    def forget_pile(
        mask: wp.array(dtype=wp.bool),
        bits: wp.array2d(dtype=wp.int32),
        busy: wp.array2d(dtype=wp.int32),
        known: wp.array(dtype=wp.int32),
        made: wp.array(dtype=wp.int32),
        missing: wp.array(dtype=wp.int32),
    ):
        env, slot = wp.tid()
        if mask[env]:
            if slot < bits.shape[1]:
                bits[env, slot] = 0
            if slot < busy.shape[1]:
                busy[env, slot] = 0
            if slot == 0:
                known[env] = 0
                made[env] = 0
                missing[env] = 0

    return forget_pile
