"""Derivatives of friction by slip velocity and displacement, for the step limit of explicit schemes."""

import functools

import warp as wp
from warpcontact.kernels.catalogue import history_variables
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import structs

# Displacement for the stiffness of a spring [m], and range of slip speeds for the slope of a dashpot [m/s].
DISPLACEMENT = 1.0e-9
SLOWEST, GROWTH, SPEEDS = 1.0e-9, 1.5, 64


@functools.cache
def kernel(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel of the derivatives of ``formula``. Launch with dim (env, contact of the group)."""
    t = structs(real)
    vec3, TangentialState = t.vec3, t.TangentialState
    Coefficients = coefficient_struct(formula, real)
    Memory = history_variables.memory_struct(formula, real)
    model_force = formula.force
    if formula.memories:
        advance = formula.advance

        @wp.func
        def force_at_speed(p: Coefficients, tangential_state: TangentialState, speed: real, elapsed: real):
            """Returns the magnitude of the force at ``speed``, after ``elapsed`` from rest [N]."""
            tangential_state.velocity = speed * tangential_state.axis
            tangential_state.speed = speed
            m = Memory()
            m.elapsed = elapsed
            return wp.length(model_force(p, tangential_state, advance(p, tangential_state, m)))
    else:

        @wp.func
        def force_at_speed(p: Coefficients, tangential_state: TangentialState, speed: real, elapsed: real):
            tangential_state.velocity = speed * tangential_state.axis
            tangential_state.speed = speed
            return wp.length(model_force(p, tangential_state))

    @unique_kernel(runs_rarely=True)
    def friction_jacobian(
        coefficients: wp.array2d(dtype=Coefficients),
        load: wp.array2d(dtype=real),  # [env, contact] N [N]
        patch_radius: wp.array2d(dtype=real),  # [env, contact] [m]
        dashpot: wp.array2d(dtype=real),  # [env, contact] largest |dF/dv| [N·s/m]
        spring: wp.array2d(dtype=real),  # [env, contact] dF/dx at rest [N/m]
    ):
        env, member = wp.tid()
        p = coefficients[env, member]
        tangential_state = TangentialState()
        tangential_state.normal = vec3(real(0.0), real(0.0), real(1.0))
        tangential_state.axis = vec3(real(1.0), real(0.0), real(0.0))
        tangential_state.normal_force = load[env, member]
        tangential_state.patch_radius = patch_radius[env, member]
        zero = real(0.0)
        # Displacement within one second at that speed, minus the force due to the speed alone.
        speed_part = force_at_speed(p, tangential_state, real(DISPLACEMENT), zero)
        spring[env, member] = (
            force_at_speed(p, tangential_state, real(DISPLACEMENT), real(1.0)) - speed_part
        ) / real(DISPLACEMENT)
        steepest = real(0.0)
        previous_force, speed_before = real(0.0), real(0.0)
        speed = real(SLOWEST)
        for _ in range(wp.static(SPEEDS)):
            force = force_at_speed(p, tangential_state, speed, zero)
            steepest = wp.max(steepest, wp.abs(force - previous_force) / (speed - speed_before))
            previous_force = force
            speed_before = speed
            speed = speed * real(GROWTH)
        dashpot[env, member] = steepest

    return friction_jacobian
