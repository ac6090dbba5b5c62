"""Advances what shape contacts remember, once per accepted step and nowhere else."""

import functools

import warp as wp
from warpcontact.kernels.formula import Formula
from warpcontact.kernels.memory import memory_struct
from warpcontact.kernels.smooth.base import Seed
from warpcontact.kernels.smooth.records import Seeds, contact_structs
from warpcontact.kernels.types import CONTACT, DISABLED, ENV_ACTIVE, UNSOLVED, Work, env_of, item_of, task_count
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def remember(real: type) -> wp.Kernel:
    """Returns the kernel that takes over what an accepted step led to; items: contacts."""
    Smooth = contact_structs(real).Smooth

    @unique_kernel()
    def remember_contacts(work: Work, status: wp.array(dtype=wp.int32), found: Seeds, held: Seeds, smooth: Smooth):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            contact = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            touching = smooth.status[env, contact]
            if touching == CONTACT:
                # Not below 0, which says "not touching".
                speed = wp.max(smooth.approach_speed[env, contact], real(0.0))
                smooth.entry_speed[env, contact] = wp.max(smooth.entry_speed[env, contact], speed)
            else:
                smooth.entry_speed[env, contact] = real(-1.0)
            if touching == UNSOLVED:
                smooth.failures[env, contact] = smooth.failures[env, contact] + 1
            if touching == UNSOLVED or touching == DISABLED:  # noqa: SIM109 - Warp has no ``in``
                held.seed[env, contact] = Seed()
            else:
                held.seed[env, contact] = found.seed[env, contact]

    return remember_contacts


@functools.cache
def advance(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that takes what the force stage kept into the memory of ``formula``; items: contacts."""
    Array = wp.array2d(dtype=memory_struct(formula, real))

    @unique_kernel()
    def advance_memory(work: Work, status: wp.array(dtype=wp.int32), kept: Array, memory: Array):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            contact = item_of(work, task)
            if status[env] == ENV_ACTIVE:
                memory[env, contact] = kept[env, contact]

    return advance_memory


@functools.cache
def forget(real: type) -> wp.Kernel:
    """Returns the kernel that starts contacts anew. Launch with dim (env, contact)."""
    Smooth = contact_structs(real).Smooth

    @unique_kernel()
    def forget_contacts(mask: wp.array(dtype=wp.bool), held: Seeds, smooth: Smooth):
        env, contact = wp.tid()
        if mask[env]:
            held.seed[env, contact] = Seed()
            smooth.entry_speed[env, contact] = real(-1.0)
            smooth.failures[env, contact] = 0

    return forget_contacts
