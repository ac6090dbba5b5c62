"""Advances the history of shape contacts, once per accepted step."""

import functools

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.shapes.base import WarmStart
from warpcontact.kernels.shapes.records import WarmStarts, shape_contact_structs
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    ENV_ACTIVE,
    UNSOLVED,
    LaunchRange,
    task_count,
    task_env,
    task_item,
)


@functools.cache
def accept(real: type) -> wp.Kernel:
    """Returns the kernel that stores warm starts, entry speeds and failures of accepted steps; items: contacts."""
    ShapeContacts = shape_contact_structs(real).ShapeContacts

    @unique_kernel()
    def accept_shape_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        new_warm_starts: WarmStarts,
        warm_starts: WarmStarts,
        shape_contacts: ShapeContacts,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            contact_status = shape_contacts.status[env, contact]
            if contact_status == CONTACT:
                # At least 0: negative values mean "not in contact".
                speed = wp.max(shape_contacts.approach_speed[env, contact], real(0.0))
                shape_contacts.entry_speed[env, contact] = wp.max(shape_contacts.entry_speed[env, contact], speed)
            else:
                shape_contacts.entry_speed[env, contact] = real(-1.0)
            if contact_status == UNSOLVED:
                shape_contacts.failures[env, contact] = shape_contacts.failures[env, contact] + 1
            if contact_status == UNSOLVED or contact_status == DISABLED:  # noqa: SIM109 - Warp has no ``in``
                warm_starts.warm_start[env, contact] = WarmStart()
            else:
                warm_starts.warm_start[env, contact] = new_warm_starts.warm_start[env, contact]

    return accept_shape_contacts


@functools.cache
def advance(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that copies the history written by the force stage of ``formula``; items: contacts."""
    Array = wp.array2d(dtype=memory_struct(formula, real))

    @unique_kernel()
    def advance_memory(launch: LaunchRange, status: wp.array(dtype=wp.int32), history_out: Array, memory: Array):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = task_item(launch, task)
            if status[env] == ENV_ACTIVE:
                memory[env, contact] = history_out[env, contact]

    return advance_memory


@functools.cache
def reset(real: type) -> wp.Kernel:
    """Returns the kernel that resets the history of contacts. Launch with dim (env, contact)."""
    ShapeContacts = shape_contact_structs(real).ShapeContacts

    @unique_kernel()
    def reset_shape_contacts(
        mask: wp.array(dtype=wp.bool), warm_starts: WarmStarts, shape_contacts: ShapeContacts
    ):
        env, contact = wp.tid()
        if mask[env]:
            warm_starts.warm_start[env, contact] = WarmStart()
            shape_contacts.entry_speed[env, contact] = real(-1.0)
            shape_contacts.failures[env, contact] = 0

    return reset_shape_contacts
