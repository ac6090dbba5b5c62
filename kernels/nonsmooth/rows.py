"""What solvers of nonsmooth contact read and write: the contacts of a step, one row each, and the bodies they hold.

Impulses and velocities of a row are in world axes. A cone is looked at in the local axes of its row: the normal,
then two tangents that ``cone.basis`` makes of it.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import structs


@functools.cache
def row_structs(real: type) -> SimpleNamespace:
    """Returns the structs for ``real``, ``wp.float32`` or ``wp.float64``.

    ``Rows`` is the type of an array of rows [env, row]; what lies beyond their ``count`` is not to be looked at.
    """
    vec3 = structs(real).vec3

    @wp.struct
    class Row:
        """A contact that is closed in a step."""

        contact: wp.int32  # its number among all that are hard
        body_1: wp.int32  # or WORLD
        body_2: wp.int32  # or WORLD
        arm_1: vec3  # to K from the centre of mass of the first, W [m]
        arm_2: vec3  # to K from that of the second, W [m]
        normal: vec3  # unit, out of the second, towards the first, W
        mu: real  # coefficient of friction
        rolling: real  # couple against rolling over the normal impulse [m]
        spinning: real  # likewise against spinning about the normal [m]
        restitution: real  # Newton's coefficient e
        restitution_speed: (
            real  # speed at which it is to part, ≥ 0 [m/s]: e × that of approach, or by ``sequence``
        )
        recovery: real  # speed at which overlap is taken back, ≥ 0 [m/s]
        impulse: vec3  # on the first; before a solve the guess, W [N·s]
        couple: vec3  # of rolling and spinning, on the first, likewise [N·m·s]

    @wp.struct
    class SolveResult:
        """How a solve went."""

        count: wp.array(dtype=wp.int32)  # [env] rows
        slack: wp.array(dtype=real)  # [env] overlap that is left as it is [m]
        residual: wp.array(dtype=real)  # [env] of ``cone.residual``, over the largest impulse that b asks for
        iterations: wp.array(dtype=wp.int32)  # [env]
        converged: wp.array(dtype=wp.int32)  # [env] 1: to the tolerance

    return SimpleNamespace(Row=Row, Rows=wp.array2d(dtype=Row), SolveResult=SolveResult)


@functools.cache
def body_response_struct(real: type, moves: bool) -> type:
    """Returns the struct of a body under impulses, for ``real``; with ``moves`` not all bodies are free."""
    vec3, mat33 = structs(real).vec3, structs(real).mat33

    @wp.struct
    class BodyResponse:
        """A body under impulses: Δv = A P + B L, Δω = Bᵀ P + C L of an impulse P and an angular impulse L.

        Of a free body A = 1/m and B = 0; what a body may not do its motion takes out of A, B and C.
        """

        linear: vec3  # velocity of the centre of mass; in: without contact, W [m/s]
        angular: vec3  # W [rad/s]
        inverse_inertia: mat33  # C, W [1/(kg·m²)]
        if moves:
            inverse_mass_matrix: mat33  # A, W [1/kg]
            inverse_mass_coupling: mat33  # B, W [1/(kg·m)]
        else:
            inverse_mass: real  # [1/kg]
            at_rest: wp.int32  # 1: it did not move before the step

    return BodyResponse
