"""Advances the history of contacts at all local minima, once per accepted step; variant of ``history.py``."""

import functools

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact.minima_records import minima_structs, slot_count
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item


@functools.cache
def advance(real: type, room: int) -> wp.Kernel:
    """Returns the kernel that stores the minima of active contacts after an accepted step; items: clusters of the group."""
    t = structs(real)
    Model, ActiveContacts = t.Model, t.ActiveContacts
    _, MinimaHistory, MinimaResults = minima_structs(real)
    slots = slot_count(room)

    @unique_kernel()
    def advance_minima(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        active_contacts: ActiveContacts,
        first_cluster: wp.int32,
        first_contact: wp.int32,
        results: MinimaResults,
        minima: MinimaHistory,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = first_cluster + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            start = assume_nonnegative(model.cluster_start[cluster])
            for index in range(start, start + active_contacts.count[env, cluster]):
                item = active_contacts.contact[env, index] - first_contact
                if results.count[env, item] > wp.static(room):
                    minima.overflow[env, item] = minima.overflow[env, item] + 1
                for slot in range(wp.static(slots)):
                    member = item * wp.static(slots) + slot
                    speed = real(-1.0)
                    if results.touching[env, member] != 0:
                        # At least 0, because negative values mean "no minimum".
                        speed = wp.max(results.approach_speed[env, member], real(0.0))
                        speed = wp.max(minima.entry_speed[env, member], speed)
                        minima.last_normal[env, member] = results.normal_S[env, member]
                        minima.last_position[env, member] = results.position[env, member]
                    minima.entry_speed[env, member] = speed

    return advance_minima


@functools.cache
def advance_material_history(formula: type[Formula], real: type, room: int) -> wp.Kernel:
    """Returns the kernel that copies the history variables of ``formula`` after an accepted step.

    Items: clusters of the group.
    """
    t = structs(real)
    Model, ActiveContacts = t.Model, t.ActiveContacts
    Array = wp.array2d(dtype=memory_struct(formula, real))
    slots = slot_count(room)

    @unique_kernel()
    def advance_material_history_of_minima(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        active_contacts: ActiveContacts,
        first_cluster: wp.int32,
        first_contact: wp.int32,
        history_out: Array,
        history_in: Array,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = first_cluster + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            start = assume_nonnegative(model.cluster_start[cluster])
            for index in range(start, start + active_contacts.count[env, cluster]):
                first = wp.static(slots) * (active_contacts.contact[env, index] - first_contact)
                for slot in range(wp.static(slots)):
                    history_in[env, first + slot] = history_out[env, first + slot]

    return advance_material_history_of_minima


@functools.cache
def reset(real: type, room: int) -> wp.Kernel:
    """Returns the kernel that removes the minima of selected environments. Launch with dim (env, contact of the group)."""
    _, MinimaHistory, MinimaResults = minima_structs(real)
    vec3 = structs(real).vec3
    slots = slot_count(room)

    @unique_kernel(runs_rarely=True)
    def reset_minima(mask: wp.array(dtype=wp.bool), minima: MinimaHistory, results: MinimaResults):
        env, item = wp.tid()
        if not mask[env]:
            return
        minima.overflow[env, item] = 0
        results.count[env, item] = 0
        results.force[env, item] = vec3()
        results.center[env, item] = wp.vec3d()
        for slot in range(wp.static(slots)):
            member = item * wp.static(slots) + slot
            minima.entry_speed[env, member] = real(-1.0)
            results.touching[env, member] = 0
            results.penetration[env, member] = real(0.0)
            results.normal[env, member] = vec3()
            results.normal_force[env, member] = real(0.0)

    return reset_minima
