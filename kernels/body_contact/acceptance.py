"""History of body contacts: stored after accepted steps, and cleared by resets."""

import functools

import warp as wp
from warpcontact.kernels.body_contact.patches import PATCH_COUNT
from warpcontact.kernels.body_contact.records import Patches, body_contact_structs
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, LaunchRange, task_count, task_env, task_item


@functools.cache
def accept_contacts(friction: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that stores entry speeds, patches and the history of their friction; items: pairs."""
    BodyContacts = body_contact_structs(real).BodyContacts
    Memory = memory_struct(friction, real)
    has_patches = bool(friction.memories)

    @unique_kernel()
    def accept_body_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] length of the step [s]
        body_contacts: BodyContacts,
        patches_out: Patches,
        patches: Patches,
        history_out: wp.array2d(dtype=Memory),
        memory: wp.array2d(dtype=Memory),
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            pair = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            was_open = body_contacts.entry_speed[env, pair] < real(0.0)
            is_open = body_contacts.status[env, pair] != CONTACT
            if not is_open:
                # At least 0: negative values mean "not in contact".
                speed = wp.max(body_contacts.approach_speed[env, pair], real(0.0))
                body_contacts.entry_speed[env, pair] = wp.max(body_contacts.entry_speed[env, pair], speed)
            elif not was_open:
                body_contacts.entry_speed[env, pair] = real(-1.0)
            if wp.static(has_patches):
                for patch in range(PATCH_COUNT * pair, PATCH_COUNT * (pair + 1)):
                    if not is_open:
                        patches.normal[env, patch] = patches_out.normal[env, patch]
                        memory[env, patch] = history_out[env, patch]
                    elif was_open:
                        # A patch may slip over the step in which it begins.
                        memory[env, patch].elapsed = step[env, 0]
                    else:
                        patches.normal[env, patch] = wp.vec3d()
                        cleared = Memory()
                        cleared.elapsed = step[env, 0]
                        memory[env, patch] = cleared

    return accept_body_contacts


@functools.cache
def reset_contacts(real: type) -> wp.Kernel:
    """Returns the kernel that resets the history of contacts. Launch with dim (env, pair)."""
    BodyContacts = body_contact_structs(real).BodyContacts

    @unique_kernel(runs_rarely=True)
    def reset_body_contacts(mask: wp.array(dtype=wp.bool), body_contacts: BodyContacts):
        env, pair = wp.tid()
        if mask[env]:
            body_contacts.entry_speed[env, pair] = real(-1.0)

    return reset_body_contacts


@functools.cache
def reset_patches() -> wp.Kernel:
    """Returns the kernel that removes all patches. Launch with dim (env, patch of all pairs)."""

    @unique_kernel(runs_rarely=True)
    def reset_body_contact_patches(mask: wp.array(dtype=wp.bool), patches: Patches):
        env, patch = wp.tid()
        if mask[env]:
            patches.normal[env, patch] = wp.vec3d()

    return reset_body_contact_patches
