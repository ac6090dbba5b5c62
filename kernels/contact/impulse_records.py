"""What nonsmooth contacts are given, and what they remember from step to step."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import structs


@functools.cache
def record_structs(real: type) -> SimpleNamespace:
    """Returns the structs for ``real``, ``wp.float32`` or ``wp.float64``."""
    vec3 = structs(real).vec3

    @wp.struct
    class NonsmoothMaterial:
        """Of a contact, or of all pairs of a particle contact."""

        restitution: real  # Newton's coefficient e
        mu_static: real  # coefficient of friction where it stuck, or was open
        mu_dynamic: real  # where it slipped in the last step
        rolling: real  # coefficient of the resistance to rolling
        spinning: real  # and to spinning about the normal

    @wp.struct
    class StoredImpulse:
        """Of the last step in which a contact was closed; ``stamp`` tells which that was."""

        impulse: vec3  # on the first body, W [N·s]
        couple: vec3  # of rolling and spinning on it, W [N·m·s]
        normal: vec3  # W
        approach_speed: real  # at K, at the end of the step [m/s]
        slip_speed: real  # likewise [m/s]
        mode: wp.int32  # MODE_*
        stamp: wp.int32  # that step

    @wp.struct
    class StepStatistics:
        """Of an environment since reset."""

        step: wp.array(dtype=wp.int32)  # [env] number of the last step, from 1; what has another stamp is open
        failures: wp.array(dtype=wp.int32)  # [env] steps without convergence
        largest_residual: wp.array(dtype=real)  # [env] of these steps
        unchanged_steps: wp.array(dtype=wp.int32)  # [env] last steps in which nothing moved or changed, at most 2
        restitution_limited: wp.array(dtype=wp.int32)  # [env] steps in which restitution was lowered
        friction_dissipation: wp.array(dtype=wp.float64)  # [env] energy that friction took [J]
        impact_dissipation: wp.array(dtype=wp.float64)  # [env] energy that impacts took [J]

    @wp.struct
    class RestitutionLimit:
        """How much of the restitution is left in an environment in which impacts would bring energy."""

        status: wp.array(dtype=wp.int32)  # [env] ENV_ACTIVE: to be solved again
        factor: wp.array(dtype=real)  # [env] of the solve, 0 to 1
        feasible_factor: wp.array(dtype=real)  # [env] the largest that is known to bring none
        infeasible_factor: wp.array(dtype=real)  # [env] the smallest that is known to bring some
        lost: wp.array(dtype=real)  # [env] twice the energy that impulses take at ``kept`` [J]
        gained: wp.array(dtype=real)  # [env] twice the energy that they bring at ``gains`` [J]

    @wp.struct
    class DisplayedImpulses:
        """What sensors show of the last step."""

        impulse: wp.array2d(dtype=vec3)  # [env, contact] on the first body, W [N·s]
        mode: wp.array2d(dtype=wp.int32)  # [env, contact] MODE_*

    return SimpleNamespace(
        NonsmoothMaterial=NonsmoothMaterial,
        StoredImpulse=StoredImpulse,
        StoredImpulses=wp.array2d(dtype=StoredImpulse),
        StepStatistics=StepStatistics,
        RestitutionLimit=RestitutionLimit,
        DisplayedImpulses=DisplayedImpulses,
    )
