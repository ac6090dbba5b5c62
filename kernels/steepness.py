"""How steeply a friction rises with slip and with displacement: what a step of an explicit scheme must resolve."""

import functools

import warp as wp
from warpcontact.kernels import memory
from warpcontact.kernels.formula import Formula, coefficient_struct
from warpcontact.kernels.types import structs
from warpcontact.kernels.unique import unique_kernel

# Displacement in which a spring shows its stiffness [m], and slip speeds between which a dashpot does [m/s].
DISPLACEMENT = 1.0e-9
SLOWEST, GROWTH, SPEEDS = 1.0e-9, 1.5, 64


@functools.cache
def kernel(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that measures the friction ``formula``. Launch with dim (env, contact of the group)."""
    t = structs(real)
    vec3, Slip = t.vec3, t.Slip
    Coefficients = coefficient_struct(formula, real)
    Memory = memory.memory_struct(formula, real)
    force = formula.force
    if formula.memories:
        advance = formula.advance

        @wp.func
        def answer(p: Coefficients, slip: Slip, speed: real, elapsed: real):
            """Size of the force at ``speed``, after ``elapsed`` of it from rest."""
            slip.velocity = speed * slip.axis
            slip.speed = speed
            m = Memory()
            m.elapsed = elapsed
            return wp.length(force(p, slip, advance(p, slip, m)))
    else:

        @wp.func
        def answer(p: Coefficients, slip: Slip, speed: real, elapsed: real):
            slip.velocity = speed * slip.axis
            slip.speed = speed
            return wp.length(force(p, slip))

    @unique_kernel()
    def steepness(
        coefficients: wp.array2d(dtype=Coefficients),
        load: wp.array2d(dtype=real),  # [env, contact] N [N]
        patch_radius: wp.array2d(dtype=real),  # [env, contact] [m]
        dashpot: wp.array2d(dtype=real),  # [env, contact] greatest |dF/dv| [N·s/m]
        spring: wp.array2d(dtype=real),  # [env, contact] dF/dx at rest [N/m]
    ):
        env, member = wp.tid()
        p = coefficients[env, member]
        slip = Slip()
        slip.normal = vec3(real(0.0), real(0.0), real(1.0))
        slip.axis = vec3(real(1.0), real(0.0), real(0.0))
        slip.normal_force = load[env, member]
        slip.patch_radius = patch_radius[env, member]
        zero = real(0.0)
        # Over one second at that many metres per second, less what the speed alone does.
        at_once = answer(p, slip, real(DISPLACEMENT), zero)
        spring[env, member] = (answer(p, slip, real(DISPLACEMENT), real(1.0)) - at_once) / real(DISPLACEMENT)
        steepest = real(0.0)
        before, speed_before = real(0.0), real(0.0)
        speed = real(SLOWEST)
        for _ in range(wp.static(SPEEDS)):
            after = answer(p, slip, speed, zero)
            steepest = wp.max(steepest, wp.abs(after - before) / (speed - speed_before))
            before = after
            speed_before = speed
            speed = speed * real(GROWTH)
        dashpot[env, member] = steepest

    return steepness
