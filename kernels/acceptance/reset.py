"""Resets environments to their initial state and clears histories and caches."""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, NO_CAUSE, structs


@functools.cache
def environments(real: type) -> wp.Kernel:
    """Returns the kernel that resets selected environments. Launch with dim env."""
    t = structs(real)
    vec3, State, History, Cache, ActiveContacts, Wrenches = (
        t.vec3,
        t.State,
        t.History,
        t.Cache,
        t.ActiveContacts,
        t.Wrenches,
    )
    copy_body = frames.functions(real).copy_body

    @unique_kernel(runs_rarely=True)
    def reset_environments(
        mask: wp.array(dtype=wp.bool),
        bodies: wp.int32,
        contacts: wp.int32,
        clusters: wp.int32,
        sets: wp.int32,
        initial: State,
        status: wp.array(dtype=wp.int32),
        cause: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),
        state: State,
        history: History,
        cache: Cache,
        active_contacts: ActiveContacts,
        wrenches: Wrenches,
    ):
        env = wp.tid()
        if not mask[env]:
            return
        status[env] = ENV_ACTIVE
        cause[env] = NO_CAUSE
        time[env] = wp.float64(0.0)
        for body in range(bodies):
            copy_body(initial, state, env, body)
            # Wrenches may be read before the next evaluation; those of a failed state could be non-finite.
            wrenches.force[env, body] = vec3()
            wrenches.torque[env, body] = vec3()
        for contact in range(contacts):
            history.entry_speed[env, contact] = real(-1.0)
            history.armed[env, contact] = 0
            history.face[env, contact] = -1
            history.crossings[env, contact] = 0
            history.crossing_time[env, contact] = real(wp.nan)
            cache.safe_travel[env, contact] = real(0.0)
            cache.face_count[env, contact] = 0
            active_contacts.needs_history[env, contact] = 0
        for cluster in range(clusters):
            cache.cluster_safe_travel[env, cluster] = real(0.0)
            cache.cluster_probe_travel[env, cluster] = real(0.0)
            cache.cluster_inactive[env, cluster] = 0
        for number in range(sets):
            cache.set_safe_travel[env, number] = real(0.0)
            cache.set_travel[env, number] = real(0.0)

    return reset_environments


@functools.cache
def memory(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that clears the history of ``formula``. Launch with dim (env, contact of the group)."""
    Struct = memory_struct(formula, real)

    @unique_kernel(runs_rarely=True)
    def reset_memory(mask: wp.array(dtype=wp.bool), memory: wp.array2d(dtype=Struct)):
        env, member = wp.tid()
        if mask[env]:
            memory[env, member] = Struct()

    return reset_memory
