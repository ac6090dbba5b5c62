"""The pull-off force of a law that pulls: what the law states, or its tension at first touch and at rest."""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels import memory
from warpcontact.kernels.formula import Formula, coefficient_struct
from warpcontact.kernels.types import structs
from warpcontact.kernels.unique import unique_kernel

# Penetration at which it is measured [m].
DEPTH = 1.0e-9


@functools.cache
def function(law: type[Formula], real: type) -> Any:
    """Returns the device function ``(p, c)`` of the pull-off force of ``law`` [N], which may be below 0."""
    if law.pull_off is not None:
        return law.pull_off
    Touch = structs(real).Touch
    law_begins = memory.functions(law, real).begin

    @wp.func
    def pull_off(p: Any, c: Touch):
        """Tension at first touch and at rest."""
        c.delta = c.delta * real(1.0e-6)
        c.delta_dot = real(0.0)
        return -law_begins(p, c)

    return pull_off


@functools.cache
def kernel(law: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that measures it at first touch. Launch with dim (env, contact of the group)."""
    Touch = structs(real).Touch
    Coefficients = coefficient_struct(law, real)
    pull_off = function(law, real)

    @unique_kernel()
    def pull_off_force(
        coefficients: wp.array2d(dtype=Coefficients),
        mass: wp.array2d(dtype=real),  # [env, contact] effective, along the normal [kg]
        radius: wp.array2d(dtype=real),  # [env, contact] of a sphere on a flat surface, or 0 [m]
        tension: wp.array2d(dtype=real),  # [env, contact] at least 0 [N]
    ):
        env, member = wp.tid()
        touch = Touch()
        touch.delta = real(DEPTH)
        touch.mass = mass[env, member]
        touch.inverse_mass = real(1.0) / touch.mass
        if radius[env, member] > real(0.0):
            touch.curvature_1 = real(1.0) / radius[env, member]
            touch.curvature_2 = touch.curvature_1
        tension[env, member] = wp.max(pull_off(coefficients[env, member], touch), real(0.0))

    return pull_off_force
