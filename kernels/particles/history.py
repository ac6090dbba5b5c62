"""Advances the history of particle contacts, once per accepted step."""

import functools

import warp as wp
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.lowlevel.warps import lowest_set_bit
from warpcontact.kernels.particles import base
from warpcontact.kernels.particles.base import BATCH_SIZE, IN_CONTACT, WAS_IN_CONTACT, particle_structs
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, task_count, task_env, task_item


@functools.cache
def copy_memory(parts: ContactModel, real: type) -> wp.Function:
    """Returns ``(source, source_slot, target, target_slot, env)``, which copies the history of a pair."""
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
def accept(parts: ContactModel, real: type, nonsmooth: bool = False) -> wp.Kernel:
    """Returns the kernel that advances the history; items: particles. ``nonsmooth``: see ``force.kernel``."""
    p = particle_structs(real)
    _, Memory = group_structs(parts, real)
    copy, records_with_flags = copy_memory(parts, real), base.records_with_flags(real)

    @wp.func
    def accept_record(pair_records: p.PairRecords, history_out: Memory, memory: Memory, env: int, slot: int):
        flags = pair_records.flags[env, slot]
        if (flags & IN_CONTACT) == 0:
            pair_records.flags[env, slot] = 0
            return
        speed = wp.max(pair_records.approach_speed[env, slot], real(0.0))
        if flags == IN_CONTACT:
            pair_records.flags[env, slot] = IN_CONTACT | WAS_IN_CONTACT
            pair_records.entry_speed[env, slot] = speed
        elif speed > pair_records.entry_speed[env, slot]:
            pair_records.entry_speed[env, slot] = speed
        if wp.static(not nonsmooth):
            copy(history_out, slot, memory, slot, env)

    @unique_kernel()
    def accept_particle_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        pair_records: p.PairRecords,
        history_out: Memory,
        memory: Memory,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE or pair_records.particle_flags[env, particle] == 0:
                continue
            start = particles.slot_start[particle]
            owned = neighbor_lists.owned[env, particle]
            for first in range(start, start + owned, wp.static(BATCH_SIZE)):
                count = wp.min(start + owned - first, wp.static(BATCH_SIZE))
                selected = records_with_flags(pair_records, env, first, count, IN_CONTACT | WAS_IN_CONTACT)
                while selected != 0:
                    accept_record(pair_records, history_out, memory, env, first + lowest_set_bit(selected))
                    selected = selected & (selected - 1)

    return accept_particle_contacts


@functools.cache
def reset() -> wp.Kernel:
    """Returns the kernel that clears the history of masked environments. Launch with dim (env, slot or particle)."""

    @unique_kernel(runs_rarely=True)
    def reset_particle_contacts(
        mask: wp.array(dtype=wp.bool),
        flags: wp.array2d(dtype=wp.int32),
        particle_flags: wp.array2d(dtype=wp.int32),
        valid: wp.array(dtype=wp.int32),
        build_count: wp.array(dtype=wp.int32),
        overflow: wp.array(dtype=wp.int32),
    ):
        env, slot = wp.tid()
        if mask[env]:
            if slot < flags.shape[1]:
                flags[env, slot] = 0
            if slot < particle_flags.shape[1]:
                particle_flags[env, slot] = 0
            if slot == 0:
                valid[env] = 0
                build_count[env] = 0
                overflow[env] = 0

    return reset_particle_contacts
