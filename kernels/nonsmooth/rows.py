"""Structs of the contact problem of a step: one row per active contact, the response of bodies, the result.

Impulses and velocities of a row are in world axes. Cones are evaluated in the local axes of the row: the normal,
then two tangents computed from it by ``cone.basis``.
"""

import functools
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs


class RowStructs(NamedTuple):
    """Structs of the contact problem of a step, in one precision."""

    Row: Struct  # a contact that is active in a step
    Rows: Any  # type of an array of rows [env, row]; those from ``SolveResult.count`` on are not valid
    SolveResult: Struct  # number of rows, and result of a solve


@functools.cache
def row_structs(real: type) -> RowStructs:
    """Returns the structs for ``real``, ``wp.float32`` or ``wp.float64``."""
    vec3 = structs(real).vec3

    @wp.struct
    class Row:
        """A contact that is active in a step."""

        contact: wp.int32  # its index among all nonsmooth contacts
        body_1: wp.int32  # or WORLD
        body_2: wp.int32  # or WORLD
        arm_1: vec3  # to K from the center of mass of the first, W [m]
        arm_2: vec3  # to K from the center of mass of the second, W [m]
        normal: vec3  # unit, out of the second, towards the first, W
        mu: real  # coefficient of friction
        rolling: real  # limit of the rolling couple over the normal impulse [m]
        spinning: real  # limit of the spinning couple over the normal impulse [m]
        restitution: real  # Newton's coefficient e
        restitution_speed: (
            real  # separation speed after impact, ≥ 0 [m/s]: e × approach speed, or from ``sequence``
        )
        # Speed at which overlap is removed; if negative, minus the speed at which an open contact may close [m/s].
        recovery: real
        # Additional separation speed per normal impulse, compliance / h² [1/kg]; only with ``is_soft`` of the solvers.
        softness: real
        held_gap: real  # largest gap since the contact became active, at most 0 [m]
        lost_speed: real  # speed at which a lost part of the gap is restored within the step, ≥ 0 [m/s]
        missing_speed: real  # least separation speed by the correction of ``lost_gaps.py`` [m/s]
        correction: real  # its normal impulse [N·s]
        impulse: vec3  # on the first; before a solve the warm start, W [N·s]
        couple: vec3  # of rolling and spinning, on the first, likewise [N·m·s]
        is_new: wp.int32  # 1: the contact was not active in the last step, or its warm start is bad
        is_unsolved: wp.int32  # 1: ``accelerated.py`` changes its impulse before or after another solver

    @wp.struct
    class SolveResult:
        """Result of a solve."""

        count: wp.array(dtype=wp.int32)  # [env] rows
        slack: wp.array(dtype=real)  # [env] overlap that is not removed [m]
        step: wp.array(dtype=real)  # [env] step length h [s]
        residual: wp.array(dtype=real)  # [env] of ``cone.residual``, relative as in ``solver_common.py``
        iterations: wp.array(dtype=wp.int32)  # [env]
        converged: wp.array(dtype=wp.int32)  # [env] 1: the tolerance was reached
        solved_residual: wp.array(dtype=real)  # [env] that of rows that are not marked as unsolved
        was_cleared: wp.array(dtype=wp.int32)  # [env] 1: warm starts were cleared, see ``load_sharing.py``

    return RowStructs(Row=Row, Rows=wp.array2d(dtype=Row), SolveResult=SolveResult)


@functools.cache
def body_response_struct(real: type, has_joints: bool) -> Struct:
    """Returns the struct of the response of a body to impulses; with ``has_joints`` some bodies have joints."""
    vec3, mat33 = structs(real).vec3, structs(real).mat33

    @wp.struct
    class BodyResponse:
        """Response of a body: Δv = A P + B L, Δω = Bᵀ P + C L to an impulse P and an angular impulse L.

        For a free body A = 1/m and B = 0. For a body with a joint, A, B and C include the constraint.
        """

        linear: vec3  # velocity of the center of mass; before the solve: without contact, W [m/s]
        angular: vec3  # W [rad/s]
        inverse_inertia: mat33  # C, W [1/(kg·m²)]
        if has_joints:
            inverse_mass_matrix: mat33  # A, W [1/kg]
            inverse_mass_coupling: mat33  # B, W [1/(kg·m)]
        else:
            inverse_mass: real  # [1/kg]
            at_rest: wp.int32  # 1: it was at rest before the step

    return BodyResponse


@functools.cache
def velocity_change_struct(real: type) -> type:
    """Returns the struct of the velocity change of a body, for ``real``."""
    vec3 = structs(real).vec3

    @wp.struct
    class VelocityChange:
        """Velocity change of a body by impulses."""

        linear: vec3  # of the velocity of the center of mass, W [m/s]
        angular: vec3  # W [rad/s]
        speed_squared: real  # V², see ``solver_common.py`` [m²/s²]
        stop_impulse: vec3  # impulse that stops it, see ``rest_impulses.py``, W [N·s]
        stop_angular_impulse: vec3  # likewise, about its center of mass, W [N·m·s]
        is_stopped: wp.int32  # 1: contacts that stop it were found
        island: wp.int32  # its island, see ``islands.py``: the index of the first body in it
        next_member: wp.int32  # next body of its island; -1: none
        next_row: wp.int32  # of the first body of an island: end of its rows in the order of islands
        is_mobile: wp.int32  # 1: impulses move it
        first_row: wp.int32  # link to its first row in ``accelerated.py``; -1: none
        is_changed: wp.int32  # 1: ``accelerated.py`` changes impulses on it

    return VelocityChange


class SolveTypes(NamedTuple):
    """Types of the arguments of the kernels and functions of a solve."""

    Rows: Any  # array of rows [env, row]
    SolveResult: type  # number of rows, and result of a solve
    BodyResponse: Any  # array of responses [env, body]
    VelocityChange: Any  # array of velocity changes [env, body]


@functools.cache
def solve_types(real: type, has_joints: bool) -> SolveTypes:
    """Returns the types for ``real``; with ``has_joints`` some bodies have joints."""
    r = row_structs(real)
    return SolveTypes(
        Rows=r.Rows,
        SolveResult=r.SolveResult,
        BodyResponse=wp.array2d(dtype=body_response_struct(real, has_joints)),
        VelocityChange=wp.array2d(dtype=velocity_change_struct(real)),
    )
