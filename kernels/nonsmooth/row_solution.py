"""Solution of one row of an island, with the impulses of the others held fixed."""

import functools
from typing import NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels.nonsmooth import cone, velocity_update
from warpcontact.kernels.nonsmooth.island_rows import BLOCK_SOFTENED, scratch
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import structs

# Softening relative to a third of the trace, for a singular block and for all blocks late in a solve. It shortens
# the update of a row without changing the solution; exact updates can cycle or diverge with strong friction.
SOFTENING, SOFTENING_LATE = 0.02, 0.3
# Fixed-point iterations for the direction of slip before the exact equation is solved.
MAX_SLIP_ITERATIONS = 4


class Functions(NamedTuple):
    """Device functions that solve one row, from its current impulse and velocity, W."""

    #: ``(scratch, env, index, impulse)``: velocity of a row by its own compliance.
    soft_velocity: wp.Function
    #: ``(scratch, body_response, env, index, impulse, w, rho)``: impulse of a row that slides, and whether it was found.
    slip_impulse: wp.Function
    #: ``(body_response, scratch, env, index, impulse, w, block_state)``: impulse that solves the row alone.
    exact_impulse: wp.Function


@functools.cache
def functions(real: type, has_joints: bool, rolls: bool, is_soft: bool = False) -> Functions:
    """Returns the device functions for ``real``; the options are those of ``gauss_seidel.kernel``."""
    vec3 = structs(real).vec3
    BodyResponse = solve_types(real, has_joints).BodyResponse
    Scratch = wp.array2d(dtype=scratch(real, rolls))
    c = cone.functions(real)
    basis, open_or_slipping_contact = c.basis, c.open_or_slipping_contact
    f = velocity_update.functions(real, has_joints)
    block_of, invert_symmetric, impulse_response = f.block, f.invert_symmetric, f.impulse_response
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
    block_softened = wp.constant(BLOCK_SOFTENED)
    softening, softening_late = wp.constant(real(SOFTENING)), wp.constant(real(SOFTENING_LATE))
    # Change of the direction of slip at which it has converged.
    DIRECTION_TOLERANCE = wp.constant(real(16.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))

    @wp.func
    def soft_velocity(scratch: Scratch, env: int, index: int, impulse: vec3):
        """Returns the velocity of a row by its own compliance, W [m/s]."""
        n = scratch[env, index].normal
        return (scratch[env, index].softness * wp.dot(impulse, n)) * n

    @wp.func
    def slip_impulse(
        scratch: Scratch, body_response: BodyResponse, env: int, index: int, impulse: vec3, w: vec3, rho: real
    ):
        """Returns the impulse of a row that slides, and whether it was found.

        Fixed-point iteration over the slip direction, to which friction is opposite. Not found if the slip is so
        slow that the row may stick, if the row does not approach, if friction almost cancels the normal response,
        or if the direction does not converge.
        """
        n = scratch[env, index].normal
        slip = w - wp.dot(w, n) * n
        speed_squared = wp.length_sq(slip)
        if rho * rho * speed_squared <= wp.length_sq(impulse):
            return impulse, 0
        mu = scratch[env, index].mu
        body_1 = scratch[env, index].body_1
        body_2 = scratch[env, index].body_2
        arm_1 = scratch[env, index].arm_1
        arm_2 = scratch[env, index].arm_2
        free = (
            w
            - impulse_response(body_response, env, body_1, arm_1, impulse)
            - impulse_response(body_response, env, body_2, arm_2, impulse)
        )
        if wp.static(is_soft):
            free -= soft_velocity(scratch, env, index, impulse)
        previous_direction = slip / wp.sqrt(speed_squared)
        for _ in range(MAX_SLIP_ITERATIONS):
            along = n - mu * previous_direction
            response = impulse_response(body_response, env, body_1, arm_1, along) + impulse_response(
                body_response, env, body_2, arm_2, along
            )
            if wp.static(is_soft):
                response += soft_velocity(scratch, env, index, along)
            normal_response = wp.dot(response, n)
            approach_speed = -wp.dot(free, n)
            if rho * normal_response <= softening or approach_speed <= zero:
                return impulse, 0
            normal_impulse = approach_speed / normal_response
            slip = free + normal_impulse * response
            slip -= wp.dot(slip, n) * n
            speed = wp.length(slip)
            if speed <= zero:
                return impulse, 0
            direction = slip / speed
            change_squared = wp.length_sq(direction - previous_direction)
            previous_direction = direction
            if change_squared <= DIRECTION_TOLERANCE * DIRECTION_TOLERANCE:
                return normal_impulse * along, 1
        return impulse, 0

    @wp.func
    def exact_impulse(
        body_response: BodyResponse,
        scratch: Scratch,
        env: int,
        index: int,
        impulse: vec3,
        w: vec3,
        block_state: int,
    ):
        """Returns the impulse that solves a row alone, from its current impulse and velocity ``w``, W."""
        n = scratch[env, index].normal
        mu = scratch[env, index].mu
        across_1, across_2 = basis(n)
        if scratch[env, index].block_state != block_state:
            scratch[env, index].block_state = block_state
            rho = scratch[env, index].rho
            W = block_of(body_response, env, scratch[env, index].body_1, scratch[env, index].arm_1)
            W += block_of(body_response, env, scratch[env, index].body_2, scratch[env, index].arm_2)
            if wp.static(is_soft):
                W += scratch[env, index].softness * wp.outer(n, n)
            inverse, invertible = invert_symmetric(W)
            if rho > zero and (block_state == block_softened or invertible == 0):
                added = wp.where(block_state == block_softened, softening_late, softening) / rho
                W += wp.diag(vec3(added, added, added))
                inverse, invertible = invert_symmetric(W)
            R = wp.matrix_from_cols(n, across_1, across_2)
            scratch[env, index].block = wp.transpose(R) * W * R
            scratch[env, index].inverse = inverse
        # Without slip, if the cone admits it.
        new = impulse - scratch[env, index].inverse * w
        along = wp.dot(new, n)
        if along >= zero and wp.length_sq(new) <= (one + mu * mu) * along * along:
            return new
        W = scratch[env, index].block
        local = vec3(wp.dot(impulse, n), wp.dot(impulse, across_1), wp.dot(impulse, across_2))
        b = vec3(wp.dot(w, n), wp.dot(w, across_1), wp.dot(w, across_2)) - W * local
        local = open_or_slipping_contact(W, b, mu)
        return local[0] * n + local[1] * across_1 + local[2] * across_2

    return Functions(soft_velocity=soft_velocity, slip_impulse=slip_impulse, exact_impulse=exact_impulse)
