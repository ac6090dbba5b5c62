"""History of body contacts: stored after accepted steps, and cleared by resets."""

import functools

import warp as wp
from warpcontact.kernels.body_contact.patches import PATCH_COUNT
from warpcontact.kernels.body_contact.records import Patches, body_contact_structs
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs, history_precision
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, LaunchRange, task_count, task_env, task_item


@functools.cache
def patch_acceptance(formula: type[Formula], real: type, precision: type) -> wp.Function:
    """Returns the device function that stores the history variables of a law or friction model at one patch.

    Its arguments are (is_open, was_open, step, history_out, memory, env, patch): whether the pair is open after the step and was before,
    and the length of the step [s].

    Args:
        formula: Class of the law or friction model.
        real: Precision of the model.
        precision: Scalar type of the history variables.
    """
    Memory = memory_struct(formula, precision)

    @wp.func
    def accept_patch(
        is_open: bool,
        was_open: bool,
        step: real,
        history_out: wp.array2d(dtype=Memory),
        memory: wp.array2d(dtype=Memory),
        env: int,
        patch: int,
    ):
        if not is_open:
            memory[env, patch] = history_out[env, patch]
        elif was_open:
            # A patch may slip, and a law advance, over the step in which it begins.
            memory[env, patch].elapsed = precision(step)
        else:
            cleared = Memory()
            cleared.elapsed = precision(step)
            memory[env, patch] = cleared

    return accept_patch


@functools.cache
def accept_contacts(contact_model: ContactModel, real: type) -> wp.Kernel:
    """Returns the kernel that stores entry speeds, patches and the history variables of law and friction; items: pairs."""
    BodyContacts = body_contact_structs(real).BodyContacts
    _, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    has_patches, has_law_history = contact_model.acts_per_patch, bool(contact_model.law.memories)
    has_friction_history = bool(contact_model.friction.memories)
    accept_law, accept_friction = (
        patch_acceptance(formula, real, history_precision(part, formula, real, per_patch=True))
        for part, formula in (("law", contact_model.law), ("friction", contact_model.friction))
    )

    @unique_kernel()
    def accept_body_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] length of the step [s]
        body_contacts: BodyContacts,
        patches_out: Patches,
        patches: Patches,
        history_out: MaterialHistory,
        memory: MaterialHistory,
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
                    elif not was_open:
                        patches.normal[env, patch] = wp.vec3d()
                    if wp.static(has_law_history):
                        speed_at_entry = wp.where(is_open, wp.float64(-1.0), patches_out.entry_speed[env, patch])
                        patches.entry_speed[env, patch] = speed_at_entry
                        accept_law(is_open, was_open, step[env, 0], history_out.law, memory.law, env, patch)
                    if wp.static(has_friction_history):
                        accept_friction(
                            is_open, was_open, step[env, 0], history_out.friction, memory.friction, env, patch
                        )

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
def reset_patches(has_law_history: bool) -> wp.Kernel:
    """Returns the kernel that removes all patches. Launch with dim (env, patch of all pairs)."""

    @unique_kernel(runs_rarely=True)
    def reset_body_contact_patches(mask: wp.array(dtype=wp.bool), patches: Patches):
        env, patch = wp.tid()
        if mask[env]:
            patches.normal[env, patch] = wp.vec3d()
            if wp.static(has_law_history):
                patches.entry_speed[env, patch] = wp.float64(-1.0)

    return reset_body_contact_patches
