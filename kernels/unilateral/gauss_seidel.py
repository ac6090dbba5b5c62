"""Projected Gauss–Seidel: one contact after the other is solved exactly, with what the others do held."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, INLINED, Work, structs
from warpcontact.kernels.unilateral import cone, impulses
from warpcontact.kernels.unilateral.rows import row_structs

# What a row has ready.
RAW = 0
SINGULAR = 1  # its block, which has no inverse
REGULAR = 2  # its block and the inverse

# Sweeps that may pass without a smaller residual where that is of the size of rounding.
PATIENCE = 8


@functools.cache
def scratch(real: type, rolls: bool) -> type:
    """Returns the struct of what a solve keeps of a row; declare it [env, row], as records."""
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33

    @wp.struct
    class Scratch:
        ready: wp.array2d(dtype=wp.int32)  # RAW, …
        rho: wp.array2d(dtype=real)  # [kg]
        free: wp.array2d(dtype=vec3)  # q, W [m/s]
        inverse: wp.array2d(dtype=mat33)  # of the block, W [kg]
        block: wp.array2d(dtype=mat33)  # (normal, two tangents) [1/kg]
        if rolls:
            turning: wp.array2d(dtype=vec3)  # relative angular velocity without contact, W [rad/s]

    return Scratch


@functools.cache
def kernel(real: type, moves: bool, rolls: bool) -> wp.Kernel:
    """Returns the solver of a step; items: one per environment.

    Args:
        real: Precision.
        moves: Whether not all bodies are free.
        rolls: Whether any contact opposes rolling or spinning.

    It starts from the guess in ``rows`` and stops at the tolerance, where rounding lets the residual fall no more, or
    after some sweeps, forwards and backwards in turn. A sweep begins with looking alone: where every row keeps its
    law nothing is changed, and the solve is over. What is found in one that changes something belongs to many states,
    so that the last sweep always looks alone.
    """
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33
    r = row_structs(real)
    Rows, Moving, Outcome = r.Rows, r.Moving, r.Outcome
    Change, Scratch = impulses.change_struct(real), scratch(real, rolls)
    c = cone.functions(real)
    basis, one_contact = c.basis, c.one_contact
    f = impulses.functions(real, moves)
    at, changed_at, push, ease, turning_ease = f.at, f.changed_at, f.push, f.ease, f.turning_ease
    block_of, inverse_of, off_squared = f.block, f.inverse_of, f.off_squared
    zero, one, half, three = (wp.constant(real(x)) for x in (0.0, 1.0, 0.5, 3.0))
    raw, singular, regular = wp.constant(RAW), wp.constant(SINGULAR), wp.constant(REGULAR)
    patience = wp.constant(PATIENCE)
    rounding = float(np.finfo(wp.dtype_to_numpy(real)).eps)
    ROUNDING = wp.constant(real(1000.0 * rounding))
    # Part of the tolerance below which a row is left as it is.
    KEPT = wp.constant(real(0.1))

    @wp.func
    def relative(moving: Moving, env: int, one_body: int, other: int, arm_1: vec3, arm_2: vec3):
        """Relative velocity without contact."""
        velocity = vec3()
        if one_body >= 0:
            velocity = at(moving.linear[env, one_body], moving.angular[env, one_body], arm_1)
        if other >= 0:
            velocity -= at(moving.linear[env, other], moving.angular[env, other], arm_2)
        return velocity

    @wp.func
    def spin(angular: wp.array2d(dtype=vec3), env: int, one_body: int, other: int):
        """Relative angular velocity."""
        difference = vec3()
        if one_body >= 0:
            difference = angular[env, one_body]
        if other >= 0:
            difference -= angular[env, other]
        return difference

    @wp.func
    def in_discs(couple: vec3, n: vec3, rolling: real, spinning: real):
        """The couple nearest to ``couple`` that is no larger than the limits, across the normal and along it."""
        along = wp.dot(couple, n)
        across = couple - along * n
        size = wp.length(across)
        if size > rolling:
            across = (rolling / size) * across
        return across + wp.clamp(along, -spinning, spinning) * n

    @wp.kernel(module="unique", enable_backward=False, module_options=INLINED)
    def gauss_seidel(
        work: Work,
        status: wp.array(dtype=wp.int32),
        rows: Rows,
        moving: Moving,
        outcome: Outcome,
        tolerance: real,
        iterations: int,
        scratch: Scratch,
        change: Change,
    ):
        for task in range(wp.tid(), work.tasks, work.threads):
            env = work.first + task
            if status[env] != ENV_ACTIVE:
                continue
            count = outcome.count[env]
            if count == 0:
                outcome.residual[env] = zero
                outcome.iterations[env] = 0
                outcome.converged[env] = 1
                continue

            for body in range(change.linear.shape[1]):
                change.linear[env, body] = vec3()
                change.angular[env, body] = vec3()
            scale = zero
            for row in range(count):
                one_body = rows.body_1[env, row]
                other = rows.body_2[env, row]
                arm_1 = rows.arm_1[env, row]
                arm_2 = rows.arm_2[env, row]
                free = relative(moving, env, one_body, other, arm_1, arm_2)
                free -= rows.bounce[env, row] * rows.normal[env, row]
                trace = ease(moving, env, one_body, arm_1) + ease(moving, env, other, arm_2)
                rho = zero
                if trace > zero:
                    rho = three / trace
                scale = wp.max(scale, rho * rho * wp.length_sq(free))
                scratch.ready[env, row] = raw
                scratch.rho[env, row] = rho
                scratch.free[env, row] = free
                impulse = rows.impulse[env, row]
                turn_1 = wp.cross(arm_1, impulse)
                turn_2 = wp.cross(arm_2, impulse)
                if wp.static(rolls):
                    turning = spin(moving.angular, env, one_body, other)
                    scratch.turning[env, row] = turning
                    trace = turning_ease(moving, env, one_body) + turning_ease(moving, env, other)
                    if trace > zero:
                        scale = wp.max(scale, rho * three / trace * wp.length_sq(turning))
                    couple = rows.couple[env, row]
                    turn_1 += couple
                    turn_2 += couple
                push(moving, change, env, one_body, impulse, turn_1)
                push(moving, change, env, other, -impulse, -turn_2)
            if scale == zero:
                scale = one

            goal = tolerance * tolerance * scale
            worst = zero
            least = scale
            waited = int(0)
            last = wp.where(iterations <= 0, 1, 0)
            sweeps = int(0)
            while True:
                worst = zero
                changes = int(0)
                for place in range(count):
                    row = place
                    if (sweeps & 1) == 1:
                        row = count - 1 - place
                    one_body = rows.body_1[env, row]
                    other = rows.body_2[env, row]
                    arm_1 = rows.arm_1[env, row]
                    arm_2 = rows.arm_2[env, row]
                    n = rows.normal[env, row]
                    mu = rows.mu[env, row]
                    rho = scratch.rho[env, row]
                    impulse = rows.impulse[env, row]
                    w = scratch.free[env, row] + changed_at(change, env, one_body, arm_1)
                    w -= changed_at(change, env, other, arm_2)
                    off = off_squared(impulse, w, n, mu, rho)
                    worst = wp.max(worst, off)
                    if last == 0 and (off > goal or (changes > 0 and off > KEPT * KEPT * goal)):
                        changes += 1
                        ready = scratch.ready[env, row]
                        if ready == raw:
                            W = block_of(moving, env, one_body, arm_1) + block_of(moving, env, other, arm_2)
                            across_1, across_2 = basis(n)
                            R = wp.matrix_from_cols(n, across_1, across_2)
                            scratch.block[env, row] = wp.transpose(R) * W * R
                            inverse, invertible = inverse_of(W)
                            scratch.inverse[env, row] = inverse
                            ready = singular + invertible
                            scratch.ready[env, row] = ready
                        new = vec3()
                        sticks = int(0)
                        if ready == regular:
                            # Without slip, if the cone allows.
                            new = impulse - scratch.inverse[env, row] * w
                            along = wp.dot(new, n)
                            if along >= zero and wp.length_sq(new) <= (one + mu * mu) * along * along:
                                sticks = 1
                        if sticks == 0:
                            across_1, across_2 = basis(n)
                            W = scratch.block[env, row]
                            local = vec3(wp.dot(impulse, n), wp.dot(impulse, across_1), wp.dot(impulse, across_2))
                            b = vec3(wp.dot(w, n), wp.dot(w, across_1), wp.dot(w, across_2)) - W * local
                            local = one_contact(W, b, mu)
                            new = local[0] * n + local[1] * across_1 + local[2] * across_2
                        step = new - impulse
                        rows.impulse[env, row] = new
                        push(moving, change, env, one_body, step, wp.cross(arm_1, step))
                        push(moving, change, env, other, -step, -wp.cross(arm_2, step))
                        impulse = new
                    if wp.static(rolls):
                        trace = turning_ease(moving, env, one_body) + turning_ease(moving, env, other)
                        if trace > zero:
                            turning = scratch.turning[env, row] + spin(change.angular, env, one_body, other)
                            pressed = wp.max(wp.dot(impulse, n), zero)
                            couple = rows.couple[env, row]
                            new = in_discs(
                                couple - three / trace * turning,
                                n,
                                rows.rolling[env, row] * pressed,
                                rows.spinning[env, row] * pressed,
                            )
                            step = new - couple
                            # As an impulse: over the arm at which both move a body as easily.
                            off = rho * trace / three * wp.length_sq(step)
                            worst = wp.max(worst, off)
                            if last == 0 and (off > goal or (changes > 0 and off > KEPT * KEPT * goal)):
                                changes += 1
                                rows.couple[env, row] = new
                                push(moving, change, env, one_body, vec3(), step)
                                push(moving, change, env, other, vec3(), -step)
                if changes == 0:
                    break
                sweeps += 1
                waited += 1
                if worst < least:
                    least = worst
                    waited = 0
                if sweeps == iterations or (waited >= patience and worst < ROUNDING * ROUNDING * scale):
                    last = 1

            for body in range(change.linear.shape[1]):
                moving.linear[env, body] = moving.linear[env, body] + change.linear[env, body]
                moving.angular[env, body] = moving.angular[env, body] + change.angular[env, body]
            outcome.residual[env] = wp.sqrt(worst / scale)
            outcome.iterations[env] = sweeps
            outcome.converged[env] = wp.where(worst <= goal, 1, 0)

    return gauss_seidel


def defaults(real):
    return (1e-5 if real is wp.float32 else 1e-10), 200
