"""Advances the memory of the contacts, once per accepted step and nowhere else.

The record belongs to the pair of point and surface, not to a triangle: a point that slides over a mesh edge does
not enter anew.
"""

import functools

import warp as wp
from warpcontact.kernels.formula import Formula
from warpcontact.kernels.memory import memory_struct
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, structs


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that takes ``contacts`` into ``history``. Launch with dim (env, contact)."""
    t = structs(real)
    Contacts, History = t.Contacts, t.History

    @wp.kernel(module="unique", enable_backward=False)
    def advance_history(status: wp.array(dtype=wp.int32), contacts: Contacts, history: History):
        env, contact = wp.tid()
        if status[env] != ENV_ACTIVE:
            return
        history.armed[env, contact] = contacts.armed[env, contact]
        if contacts.status[env, contact] == CONTACT:
            # Not below 0, which says "not touching".
            speed = wp.max(contacts.approach_speed[env, contact], real(0.0))
            history.entry_speed[env, contact] = wp.max(history.entry_speed[env, contact], speed)
        else:
            history.entry_speed[env, contact] = real(-1.0)

    return advance_history


@functools.cache
def memory_kernel(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that takes what the force stage kept into the memory of ``formula``.

    Launch with dim (env, contact of the group).
    """
    Array = wp.array2d(dtype=memory_struct(formula, real))

    @wp.kernel(module="unique", enable_backward=False)
    def advance_memory(status: wp.array(dtype=wp.int32), kept: Array, memory: Array):
        env, member = wp.tid()
        if status[env] == ENV_ACTIVE:
            memory[env, member] = kept[env, member]

    return advance_memory
