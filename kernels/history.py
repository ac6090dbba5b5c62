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
def kernel(real: type, follows: bool) -> wp.Kernel:
    """Returns the kernel that takes ``contacts`` into ``history``. Launch with dim (env, contact).

    ``follows``: whether any contact stays with the face that it touched, or crossed.
    """
    t = structs(real)
    Contacts, History = t.Contacts, t.History

    @wp.kernel(module="unique", enable_backward=False)
    def advance_history(
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] at the end of the step [s]
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        contacts: Contacts,
        history: History,
    ):
        env, contact = wp.tid()
        if status[env] != ENV_ACTIVE:
            return
        history.armed[env, contact] = contacts.armed[env, contact]
        touching = contacts.status[env, contact] == CONTACT
        if touching:
            # Not below 0, which says "not touching".
            speed = wp.max(contacts.approach_speed[env, contact], real(0.0))
            history.entry_speed[env, contact] = wp.max(history.entry_speed[env, contact], speed)
        else:
            history.entry_speed[env, contact] = real(-1.0)
        if wp.static(follows):
            face = wp.where(touching, contacts.face[env, contact], -1)
            crossed = contacts.crossed_face[env, contact]
            if crossed >= 0:
                face = crossed
                if history.crossings[env, contact] == 0:
                    left = (real(1.0) - contacts.crossed_at[env, contact]) * step[env, 0]
                    history.crossing_time[env, contact] = real(time[env] - wp.float64(left))
                history.crossings[env, contact] = history.crossings[env, contact] + 1
            history.face[env, contact] = face

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
