"""Pull-off force of a law with tension: that of the law, or its tension at first touch and at rest."""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.catalogue import history_variables
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import structs

# Penetration at which the tension is evaluated [m].
DEPTH = 1.0e-9


@functools.cache
def function(law: type[Formula], real: type) -> Any:
    """Returns the device function ``(p, c)`` of the pull-off force of ``law`` [N], which may be negative."""
    if law.pull_off is not None:
        return law.pull_off
    NormalState = structs(real).NormalState
    law_start_force = history_variables.functions(law, real).start_force

    @wp.func
    def pull_off(p: Any, c: NormalState):
        """Returns the tension at first touch and at rest [N]."""
        c.delta = c.delta * real(1.0e-6)
        c.delta_dot = real(0.0)
        return -law_start_force(p, c)

    return pull_off


@functools.cache
def kernel(law: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that computes it at first touch. Launch with dim (env, contact of the group)."""
    NormalState = structs(real).NormalState
    Coefficients = coefficient_struct(law, real)
    pull_off = function(law, real)

    @unique_kernel()
    def pull_off_force(
        coefficients: wp.array2d(dtype=Coefficients),
        mass: wp.array2d(dtype=real),  # [env, contact] effective, along the normal [kg]
        radius: wp.array2d(dtype=real),  # [env, contact] of a sphere on a flat surface; 0: a point [m]
        tension: wp.array2d(dtype=real),  # [env, contact] at least 0 [N]
    ):
        env, member = wp.tid()
        normal_state = NormalState()
        normal_state.delta = real(DEPTH)
        normal_state.mass = mass[env, member]
        normal_state.inverse_mass = real(1.0) / normal_state.mass
        if radius[env, member] > real(0.0):
            normal_state.curvature_1 = real(1.0) / radius[env, member]
            normal_state.curvature_2 = normal_state.curvature_1
        tension[env, member] = wp.max(pull_off(coefficients[env, member], normal_state), real(0.0))

    return pull_off_force
