"""Structs of nonsmooth contact that persist across steps: materials, stored impulses, statistics."""

import functools
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.types import MODE_OPEN, Struct, structs


class RecordStructs(NamedTuple):
    """Structs of nonsmooth contact that persist across steps, in one precision."""

    NonsmoothMaterial: Struct  # parameters of a contact, or of all pairs of a particle contact
    StoredImpulse: Struct  # impulse of the last step in which a contact was active
    StoredImpulses: Any  # type of an array of stored impulses [env, contact]
    StepStatistics: Struct  # statistics of each environment since reset
    RestitutionLimit: Struct  # search for the largest restitution that adds no energy to an environment
    DisplayedImpulses: Struct  # impulses of the last step, for sensors


@functools.cache
def record_structs(real: type) -> RecordStructs:
    """Returns the structs for ``real``, ``wp.float32`` or ``wp.float64``."""
    vec3 = structs(real).vec3

    @wp.struct
    class NonsmoothMaterial:
        """Parameters of a contact, or of all pairs of a particle contact."""

        restitution: real  # Newton's coefficient e
        mu_static: real  # coefficient of friction if the contact stuck or was open in the last step
        mu_dynamic: real  # if it slipped in the last step
        rolling: real  # coefficient of rolling resistance
        spinning: real  # coefficient of resistance to spinning about the normal
        compliance: real  # along the normal [m/N]

    @wp.struct
    class StoredImpulse:
        """Impulse of the last step in which a contact was active; ``stamp`` is the number of that step."""

        impulse: vec3  # on the first body, W [N·s]
        couple: vec3  # rolling and spinning couple on the first body, W [N·m·s]
        normal: vec3  # W
        approach_speed: real  # at K, at the end of the step [m/s]
        slip_speed: real  # likewise [m/s]
        held_gap: real  # largest gap since the contact became active, at most 0 [m]
        mode: wp.int32  # MODE_*
        stamp: wp.int32  # number of that step

    @wp.struct
    class StepStatistics:
        """Statistics of each environment since reset."""

        step: wp.array(dtype=wp.int32)  # [env] number of the last step, from 1; other stamps mean open
        failures: wp.array(dtype=wp.int32)  # [env] steps without convergence
        largest_residual: wp.array(dtype=real)  # [env] largest residual of these steps
        unchanged_steps: wp.array(dtype=wp.int32)  # [env] last steps in which nothing moved or changed, at most 2
        restitution_limited: wp.array(dtype=wp.int32)  # [env] steps in which restitution was lowered
        friction_dissipation: wp.array(dtype=wp.float64)  # [env] energy dissipated by friction [J]
        impact_dissipation: wp.array(dtype=wp.float64)  # [env] energy dissipated by impacts [J]

    @wp.struct
    class RestitutionLimit:
        """Search for the largest restitution that adds no energy to an environment."""

        status: wp.array(dtype=wp.int32)  # [env] ENV_ACTIVE: to be solved again
        factor: wp.array(dtype=real)  # [env] factor on restitution of the last solve, 0 to 1
        feasible_factor: wp.array(dtype=real)  # [env] largest factor found that adds no energy
        infeasible_factor: wp.array(dtype=real)  # [env] smallest factor found that adds energy
        lost: wp.array(dtype=real)  # [env] twice the energy that impulses remove at ``feasible_factor`` [J]
        gained: wp.array(dtype=real)  # [env] twice the energy that they add at ``infeasible_factor`` [J]

    @wp.struct
    class DisplayedImpulses:
        """Impulses of the last step, for sensors."""

        impulse: wp.array2d(dtype=vec3)  # [env, contact] on the first body, W [N·s]
        mode: wp.array2d(dtype=wp.int32)  # [env, contact] MODE_*

    return RecordStructs(
        NonsmoothMaterial=NonsmoothMaterial,
        StoredImpulse=StoredImpulse,
        StoredImpulses=wp.array2d(dtype=StoredImpulse),
        StepStatistics=StepStatistics,
        RestitutionLimit=RestitutionLimit,
        DisplayedImpulses=DisplayedImpulses,
    )


@functools.cache
def acting_impulse(real: type) -> wp.Function:
    """Returns the device function ``(stored_impulses, statistics, env, contact)`` of the impulse of a contact in the last step.

    It returns a ``StoredImpulse``, which is zero with the mode MODE_OPEN if the contact was not active.
    """
    records = record_structs(real)
    StoredImpulse = records.StoredImpulse

    @wp.func
    def impulse_in_last_step(
        stored_impulses: records.StoredImpulses, statistics: records.StepStatistics, env: int, contact: int
    ):
        if stored_impulses[env, contact].stamp == statistics.step[env]:
            if stored_impulses[env, contact].mode != MODE_OPEN:
                return stored_impulses[env, contact]
        result = StoredImpulse()
        result.mode = wp.int32(MODE_OPEN)
        return result

    return impulse_in_last_step
