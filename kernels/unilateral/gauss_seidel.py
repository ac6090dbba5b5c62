"""Projected Gauss–Seidel: one contact after the other is solved exactly, with what the others do held."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, INLINED, Work, structs
from warpcontact.kernels.unilateral import begin, cone, impulses, relative
from warpcontact.kernels.unilateral.rows import row_structs

# Stages of a solve: the block of a row is made where it is first needed, and made anew, softer, after some sweeps.
RAW, EXACT, SOFTENED = 0, 1, 2
LATE = 50
# How much softer, over a third of its trace: a block without an inverse, and any block late. A row then goes less
# far from where it was, to the same solution; exact steps may go in circles, or grow, where friction is strong.
SOFT, SOFTER = 0.02, 0.3
# Sweeps that may pass without a smaller residual where that is of the size of rounding.
PATIENCE = 50


@functools.cache
def scratch(real: type, rolls: bool) -> type:
    """Returns the struct of what a solve keeps of a row; declare it [env, row], as records."""
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33

    @wp.struct
    class Scratch:
        stage: wp.array2d(dtype=wp.int32)  # of the solve that the block is of
        rho: wp.array2d(dtype=real)  # [kg]
        scale: wp.array2d(dtype=real)  # (ρ V)², see ``begin`` [N²·s²]
        free: wp.array2d(dtype=vec3)  # q, W [m/s]
        inverse: wp.array2d(dtype=mat33)  # of the block, W [kg]
        block: wp.array2d(dtype=mat33)  # w over an impulse, (normal, two tangents) [1/kg]
        before: wp.array2d(dtype=vec3)  # impulse before the sweep, W [N·s]
        swept: wp.array2d(dtype=vec3)  # impulse after the sweep before, W [N·s]
        guess: wp.array2d(dtype=vec3)  # impulse before the solve, W [N·s]
        if rolls:
            couple_guess: wp.array2d(dtype=vec3)  # likewise [N·m·s]
            turning: wp.array2d(dtype=vec3)  # relative angular velocity without contact, W [rad/s]

    return Scratch


@functools.cache
def kernel(real: type, moves: bool, rolls: bool, before: bool = False) -> wp.Kernel:
    """Returns the solver of a step; items: one per environment.

    Args:
        real: Precision.
        moves: Whether not all bodies are free.
        rolls: Whether any contact opposes rolling or spinning.
        before: Whether another solver comes after it where it does not converge: from the same guess, since what
            sweeps leave, of heavy bodies on light ones, is slow to go.

    It starts from the guess in ``rows`` and stops at the tolerance, where rounding lets the residual fall no
    more, or after some sweeps. Near the end a sweep looks first: where every row keeps its law nothing is
    changed, and the solve is over. What a sweep finds that changes something belongs to many states, so that
    the last looks alone. Between sweeps impulses go on with Nesterov's momentum, as in ``accelerated``.
    """
    t = structs(real)
    vec3 = t.vec3
    r = row_structs(real)
    Rows, Moving, Outcome = r.Rows, r.Moving, r.Outcome
    Change, Scratch = impulses.change_struct(real), scratch(real, rolls)
    c = cone.functions(real)
    basis, one_contact = c.basis, c.one_contact
    f = impulses.functions(real, moves)
    spin = relative.functions(real).spin
    changed_at, push, turning_ease, in_discs = f.changed_at, f.push, f.turning_ease, f.in_discs
    block_of, inverse_of, in_cone, off_squared = f.block, f.inverse_of, f.in_cone, f.off_squared
    first = begin.functions(real, moves, rolls)
    begin_row, spread, scale_of = first.begin, first.spread, first.scale
    zero, half, one, three, four = (wp.constant(real(x)) for x in (0.0, 0.5, 1.0, 3.0, 4.0))
    raw, softened = wp.constant(RAW), wp.constant(SOFTENED)
    soft, softer = wp.constant(real(SOFT)), wp.constant(real(SOFTER))
    patience = wp.constant(PATIENCE)
    rounding = np.finfo(wp.dtype_to_numpy(real))
    # What rounding may leave of a residual.
    ROUNDING = wp.constant(real(4.0 * float(rounding.eps)))
    LARGEST = wp.constant(real(float(rounding.max)))
    # Residual over the tolerance, squared, from which the next sweep does not look first.
    ROUGH = wp.constant(real(4.0))
    # Part of the tolerance below which a row is left as it is.
    KEPT = wp.constant(real(0.1))

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
                change.speed_squared[env, body] = zero
            finite = zero  # only if all terms are
            for row in range(count):
                free, rho, _trace, size = begin_row(rows, moving, change, env, row, tolerance)
                finite += size
                impulse = rows.impulse[env, row]
                scratch.stage[env, row] = raw
                scratch.rho[env, row] = rho
                scratch.free[env, row] = free
                scratch.before[env, row] = impulse
                scratch.swept[env, row] = impulse
                if wp.static(before):
                    scratch.guess[env, row] = impulse
                    if wp.static(rolls):
                        scratch.couple_guess[env, row] = rows.couple[env, row]
                if wp.static(rolls):
                    turning = spin(moving.angular, env, rows.body_1[env, row], rows.body_2[env, row])
                    scratch.turning[env, row] = turning
            if not wp.isfinite(finite):
                outcome.residual[env] = finite
                outcome.iterations[env] = 0
                outcome.converged[env] = 0
                continue
            spread(rows, change, env, count)
            for row in range(count):
                scratch.scale[env, row] = scale_of(rows, change, env, row, scratch.rho[env, row])

            goal = tolerance * tolerance
            worst = zero
            least = LARGEST
            theta = one
            waited = wp.int32(0)
            last = wp.where(iterations <= 0, 1, 0)
            sweeps = wp.int32(0)
            rough = wp.int32(0)
            stage = wp.int32(EXACT)
            while True:
                worst = zero
                uphill = zero
                changes = rough
                for row in range(count):
                    one_body = rows.body_1[env, row]
                    other = rows.body_2[env, row]
                    arm_1 = rows.arm_1[env, row]
                    arm_2 = rows.arm_2[env, row]
                    n = rows.normal[env, row]
                    mu = rows.mu[env, row]
                    rho = scratch.rho[env, row]
                    impulse = rows.impulse[env, row]
                    scale = wp.max(scratch.scale[env, row], wp.length_sq(impulse))
                    w = scratch.free[env, row] + changed_at(change, env, one_body, arm_1)
                    w -= changed_at(change, env, other, arm_2)
                    off = zero
                    if rough == 0:
                        off = off_squared(impulse, w, n, mu, rho) / scale
                        worst = wp.max(worst, off)
                    if rough == 1 or (last == 0 and (off > goal or (changes > 0 and off > KEPT * KEPT * goal))):
                        changes += 1
                        if scratch.stage[env, row] != stage:
                            scratch.stage[env, row] = stage
                            W = block_of(moving, env, one_body, arm_1) + block_of(moving, env, other, arm_2)
                            inverse, invertible = inverse_of(W)
                            if rho > zero and (stage == softened or invertible == 0):
                                more = wp.where(stage == softened, softer, soft) / rho
                                W += wp.diag(vec3(more, more, more))
                                inverse, invertible = inverse_of(W)
                            across_1, across_2 = basis(n)
                            R = wp.matrix_from_cols(n, across_1, across_2)
                            scratch.block[env, row] = wp.transpose(R) * W * R
                            scratch.inverse[env, row] = inverse
                        # Without slip, if the cone allows.
                        sticks = wp.int32(0)
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
                        if rho > zero:
                            back = scratch.before[env, row] - new
                            uphill += wp.dot(back, new - scratch.swept[env, row]) / rho
                        step = new - impulse
                        if rough == 1:
                            worst = wp.max(worst, wp.length_sq(step) / scale)
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
                            off = rho * trace / three * wp.length_sq(step) / scale
                            worst = wp.max(worst, off)
                            if last == 0 and (off > goal or (changes > 0 and off > KEPT * KEPT * goal)):
                                changes += 1
                                rows.couple[env, row] = new
                                push(moving, change, env, one_body, vec3(), step)
                                push(moving, change, env, other, vec3(), -step)
                if changes == 0:
                    break
                sweeps += 1
                if sweeps == LATE:
                    stage = softened
                waited += 1
                if worst < least:
                    least = worst
                    waited = 0
                if sweeps >= iterations or (waited >= patience and worst < ROUNDING * ROUNDING):
                    last = 1
                    rough = 0
                    continue
                rough = wp.where(worst > ROUGH * goal, 1, 0)

                # A sweep is a step down a hill. Its momentum leads on, and starts again where it leads uphill.
                if uphill > zero:
                    theta = one
                theta_next = half * theta * (wp.sqrt(theta * theta + four) - theta)
                beta = theta * (one - theta) / (theta * theta + theta_next)
                theta = theta_next
                for row in range(count):
                    swept = rows.impulse[env, row]
                    new = swept
                    if beta > zero:
                        n = rows.normal[env, row]
                        new = in_cone(swept + beta * (swept - scratch.swept[env, row]), n, rows.mu[env, row])
                        rows.impulse[env, row] = new
                        step = new - swept
                        one_body = rows.body_1[env, row]
                        other = rows.body_2[env, row]
                        push(moving, change, env, one_body, step, wp.cross(rows.arm_1[env, row], step))
                        push(moving, change, env, other, -step, -wp.cross(rows.arm_2[env, row], step))
                    scratch.before[env, row] = new
                    scratch.swept[env, row] = swept

            for body in range(change.linear.shape[1]):
                moving.linear[env, body] = moving.linear[env, body] + change.linear[env, body]
                moving.angular[env, body] = moving.angular[env, body] + change.angular[env, body]
            if wp.static(before):  # noqa: SIM102  Warp would evaluate both sides
                if worst > goal:
                    for row in range(count):
                        rows.impulse[env, row] = scratch.guess[env, row]
                        if wp.static(rolls):
                            rows.couple[env, row] = scratch.couple_guess[env, row]
            outcome.residual[env] = wp.sqrt(worst)
            outcome.iterations[env] = sweeps
            outcome.converged[env] = wp.where(worst <= goal, 1, 0)

    return gauss_seidel
