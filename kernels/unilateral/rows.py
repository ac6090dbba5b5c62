"""What solvers of hard contact read and write: the contacts of a step, one row each, and the bodies they hold.

Impulses and velocities of a row are in world axes. A cone is looked at in the local axes of its row: the normal,
then two tangents that ``cone.basis`` makes of it.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import structs


@functools.cache
def row_structs(real: type) -> SimpleNamespace:
    """Returns the structs for ``real``, ``wp.float32`` or ``wp.float64``."""
    vec3, mat33 = structs(real).vec3, structs(real).mat33

    @wp.struct
    class Rows:
        """Contacts that are closed in a step; what they are beyond ``count`` is not to be looked at."""

        contact: wp.array2d(dtype=wp.int32)  # [env, row] number of the contact among all that are hard
        body_1: wp.array2d(dtype=wp.int32)  # [env, row] or WORLD
        body_2: wp.array2d(dtype=wp.int32)  # [env, row] or WORLD
        arm_1: wp.array2d(dtype=vec3)  # [env, row] to K from the centre of mass of the first, W [m]
        arm_2: wp.array2d(dtype=vec3)  # [env, row] to K from that of the second, W [m]
        normal: wp.array2d(dtype=vec3)  # [env, row] unit, out of the second, towards the first, W
        mu: wp.array2d(dtype=real)  # [env, row] coefficient of friction
        rolling: wp.array2d(dtype=real)  # [env, row] couple against rolling over the normal impulse [m]
        spinning: wp.array2d(dtype=real)  # [env, row] likewise against spinning about the normal [m]
        bounce: wp.array2d(dtype=real)  # [env, row] speed at which it is to part, e × that of approach, ≥ 0 [m/s]
        recovery: wp.array2d(dtype=real)  # [env, row] speed at which overlap is taken back, ≥ 0 [m/s]
        impulse: wp.array2d(dtype=vec3)  # [env, row] on the first; before a solve the guess, W [N·s]
        couple: wp.array2d(dtype=vec3)  # [env, row] of rolling and spinning, on the first, likewise [N·m·s]

    @wp.struct
    class Moving:
        """Bodies under impulses: Δv = A P + B L, Δω = Bᵀ P + C L of an impulse P and an angular impulse L.

        Of a free body A = 1/m and B = 0; what a body may not do its motion takes out of A, B and C.
        """

        linear: wp.array2d(dtype=vec3)  # [env, body] velocity of the centre of mass; in: without contact, W [m/s]
        angular: wp.array2d(dtype=vec3)  # [env, body] W [rad/s]
        inverse_mass: wp.array2d(dtype=real)  # [env, body] if all bodies are free [1/kg]
        by_force: wp.array2d(dtype=mat33)  # [env, body] A, W [1/kg]; only if not all are free
        across: wp.array2d(dtype=mat33)  # [env, body] B, W [1/(kg·m)]; only if not all are free
        by_torque: wp.array2d(dtype=mat33)  # [env, body] C, W [1/(kg·m²)]

    @wp.struct
    class Outcome:
        """How a solve went."""

        count: wp.array(dtype=wp.int32)  # [env] rows
        slack: wp.array(dtype=real)  # [env] overlap that is left as it is [m]
        residual: wp.array(dtype=real)  # [env] of ``cone.residual``, over the largest impulse that b asks for
        iterations: wp.array(dtype=wp.int32)  # [env]
        converged: wp.array(dtype=wp.int32)  # [env] 1: to the tolerance

    return SimpleNamespace(Rows=Rows, Moving=Moving, Outcome=Outcome)
