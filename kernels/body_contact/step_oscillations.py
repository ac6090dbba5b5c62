"""Detection of time steps that are too long for compliant body contact.

Explicit steps that are too long for stiffness or damping reverse the velocity of a contact in each step, and it grows. Motion that
steps resolve reverses it once per half period. So the rate of penetration of a pair that has changed its sign in several successive
steps without decay is an error of the time step, for any law.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.body_contact.records import body_contact_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, LaunchRange, Struct, task_count, task_env, task_item

# Successive changes of sign from which a step counts as unstable. A vibration that steps resolve has no two.
REVERSALS = wp.constant(wp.int32(3))
# Smallest ratio of successive rates: with a smaller one, oscillations decay to a thousandth in 66 steps.
DECAY = wp.constant(wp.float64(0.9))
# Smallest change of the depth in a step, relative to the depth. Rounding errors of bodies at rest are smaller.
DEPTH_CHANGE = wp.constant(wp.float64(1.0e-3))


class OscillationStructs(NamedTuple):
    """Struct of oscillations, in one precision."""

    StepOscillations: Struct


@functools.cache
def oscillation_structs(real: type) -> OscillationStructs:
    """Returns the struct of oscillations in one precision."""

    @wp.struct
    class StepOscillations:
        approach_speed: wp.array2d(dtype=real)  # [env, pair] in the last step; 0: not in contact [m/s]
        reversals: wp.array2d(dtype=wp.int32)  # [env, pair] number of successive changes of its sign without decay
        unstable_steps: wp.array2d(dtype=wp.int32)  # [env, pair] number of steps with at least ``REVERSALS``

    return OscillationStructs(StepOscillations=StepOscillations)


@functools.cache
def count_oscillations(real: type) -> wp.Kernel:
    """Returns the kernel that counts unstable steps after accepted steps; items: pairs."""
    BodyContacts = body_contact_structs(real).BodyContacts
    StepOscillations = oscillation_structs(real).StepOscillations

    @unique_kernel()
    def count_step_oscillations(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] length of the step [s]
        first_pair: wp.int32,  # pair of the first item
        body_contacts: BodyContacts,
        oscillations: StepOscillations,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            pair = first_pair + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            before = oscillations.approach_speed[env, pair]
            if body_contacts.status[env, pair] != CONTACT:
                if before != real(0.0):
                    oscillations.approach_speed[env, pair] = real(0.0)
                    oscillations.reversals[env, pair] = 0
                continue
            speed = body_contacts.approach_speed[env, pair]
            reversals = wp.int32(0)
            if (
                speed * before < real(0.0)
                and wp.abs(speed) > real(DECAY) * wp.abs(before)
                and wp.abs(speed) * step[env, 0] > real(DEPTH_CHANGE) * body_contacts.depth[env, pair]
            ):
                reversals = oscillations.reversals[env, pair] + 1
                if reversals >= REVERSALS:
                    oscillations.unstable_steps[env, pair] = oscillations.unstable_steps[env, pair] + 1
            oscillations.reversals[env, pair] = reversals
            oscillations.approach_speed[env, pair] = speed

    return count_step_oscillations


@functools.cache
def reset_oscillations(real: type) -> wp.Kernel:
    """Returns the kernel that clears oscillations. Launch with dim (env, pair)."""
    StepOscillations = oscillation_structs(real).StepOscillations

    @unique_kernel(runs_rarely=True)
    def reset_step_oscillations(mask: wp.array(dtype=wp.bool), oscillations: StepOscillations):
        env, pair = wp.tid()
        if mask[env]:
            oscillations.approach_speed[env, pair] = real(0.0)
            oscillations.reversals[env, pair] = 0
            oscillations.unstable_steps[env, pair] = 0

    return reset_step_oscillations
