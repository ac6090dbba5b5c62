"""Accelerated projected gradients: all contacts at once, with Nesterov's momentum.

The step of H. Mazhar, T. Heyn, D. Negrut, A. Tasora, "Using Nesterov's method to accelerate multibody dynamics
with friction and contact", ACM Transactions on Graphics 34, 2015, on De Saxcé's cone: the slip lifts the normal
velocity anew in every iteration, so that what it converges to keeps Coulomb's law and does not part while it
slides. The momentum starts again where it leads uphill: B. O'Donoghue, E. Candès, "Adaptive restart for
accelerated gradient schemes", Foundations of Computational Mathematics 15, 2015.
"""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, INLINED, Work, structs
from warpcontact.kernels.unilateral import begin, impulses, relative
from warpcontact.kernels.unilateral.rows import row_structs

# Iterations that may pass without a smaller residual where that is of the size of rounding.
PATIENCE = 100


@functools.cache
def scratch(real: type, rolls: bool) -> type:
    """Returns the struct of what a solve keeps of a row; declare it [env, row], as records.

    Of couples there is what they are over an arm, so that they count as impulses do, and of angular velocities
    what they are times that arm.
    """
    vec3 = structs(real).vec3

    @wp.struct
    class Scratch:
        rho: wp.array2d(dtype=real)  # [kg]
        scale: wp.array2d(dtype=real)  # (ρ V)², see ``begin`` [N²·s²]
        free: wp.array2d(dtype=vec3)  # q, W [m/s]
        before: wp.array2d(dtype=vec3)  # impulse of the iteration before, W [N·s]
        trial: wp.array2d(dtype=vec3)  # where momentum leads, W [N·s]
        moved: wp.array2d(dtype=vec3)  # w, W [m/s]
        moved_before: wp.array2d(dtype=vec3)  # that of the iteration before
        moved_trial: wp.array2d(dtype=vec3)  # that where momentum leads
        best: wp.array2d(dtype=vec3)  # impulse of the least residual, W [N·s]
        if rolls:
            arm: wp.array2d(dtype=real)  # at which a force turns as easily as it pushes [m]
            turning_free: wp.array2d(dtype=vec3)
            couple_before: wp.array2d(dtype=vec3)
            couple_trial: wp.array2d(dtype=vec3)
            turned: wp.array2d(dtype=vec3)
            turned_before: wp.array2d(dtype=vec3)
            turned_trial: wp.array2d(dtype=vec3)
            couple_best: wp.array2d(dtype=vec3)

    return Scratch


@functools.cache
def kernel(real: type, moves: bool, rolls: bool, after: bool = False) -> wp.Kernel:
    """Returns the solver of a step; items: one per environment.

    Args:
        real: Precision.
        moves: Whether not all bodies are free.
        rolls: Whether any contact opposes rolling or spinning.
        after: Whether it comes after another solver, in the environments where that did not converge: with its
            ``change`` taken back, and counting on from its iterations.

    It starts from the guess in ``rows`` and stops at the tolerance, where rounding lets the residual fall no more,
    or after some iterations; then the best of them is what it leaves.
    """
    t = structs(real)
    vec3 = t.vec3
    r = row_structs(real)
    Rows, Moving, Outcome = r.Rows, r.Moving, r.Outcome
    Change, Scratch = impulses.change_struct(real), scratch(real, rolls)
    f = impulses.functions(real, moves)
    spin, changed_at, push = relative.functions(real).spin, f.changed_at, f.push
    turning_ease, in_cone, in_discs = f.turning_ease, f.in_cone, f.in_discs
    off_squared, pressing = f.off_squared, f.pressing
    first = begin.functions(real, moves, rolls)
    begin_row, spread, scale_of = first.begin, first.spread, first.scale
    zero, half, one, four = (wp.constant(real(x)) for x in (0.0, 0.5, 1.0, 4.0))
    # A step that was too long becomes this part of the longest that goes down; others grow.
    SHORTER, LONGER = wp.constant(real(0.9)), wp.constant(real(1.005))
    rounding = np.finfo(wp.dtype_to_numpy(real))
    # What rounding may leave of a residual.
    ROUNDING = wp.constant(real(4.0 * float(rounding.eps)))
    LARGEST = wp.constant(real(float(rounding.max)))

    @wp.kernel(module="unique", enable_backward=False, module_options=INLINED)
    def accelerated(
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
            done = wp.int32(0)
            if wp.static(after):
                if outcome.converged[env] == 1:
                    continue
                done = outcome.iterations[env]
                for body in range(change.linear.shape[1]):
                    moving.linear[env, body] = moving.linear[env, body] - change.linear[env, body]
                    moving.angular[env, body] = moving.angular[env, body] - change.angular[env, body]
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
                free, rho, trace, size = begin_row(rows, moving, change, env, row, tolerance)
                finite += size
                scratch.rho[env, row] = rho
                scratch.free[env, row] = free
                scratch.before[env, row] = rows.impulse[env, row]
                if wp.static(rolls):
                    one_body = rows.body_1[env, row]
                    other = rows.body_2[env, row]
                    turning_trace = turning_ease(moving, env, one_body) + turning_ease(moving, env, other)
                    arm = zero
                    if turning_trace > zero and rho > zero:
                        arm = wp.sqrt(trace / turning_trace)
                        scratch.couple_before[env, row] = rows.couple[env, row] / arm
                    scratch.arm[env, row] = arm
                    scratch.turning_free[env, row] = arm * spin(moving.angular, env, one_body, other)
            if not wp.isfinite(finite):
                outcome.residual[env] = finite
                outcome.iterations[env] = 0
                outcome.converged[env] = 0
                continue
            spread(rows, change, env, count)
            for row in range(count):
                scratch.scale[env, row] = scale_of(rows, change, env, row, scratch.rho[env, row])

            goal = tolerance * tolerance
            length = one  # of a step, over rho
            theta = one
            beta = zero
            worst = zero
            least = LARGEST
            waited = wp.int32(0)
            steps = wp.int32(0)
            while True:
                # Where we are: the residual, and how the way here bent the velocities.
                worst = zero
                bent = zero
                gone = zero
                uphill = zero
                for row in range(count):
                    one_body = rows.body_1[env, row]
                    other = rows.body_2[env, row]
                    n = rows.normal[env, row]
                    mu = rows.mu[env, row]
                    rho = scratch.rho[env, row]
                    impulse = rows.impulse[env, row]
                    w = scratch.free[env, row] + changed_at(change, env, one_body, rows.arm_1[env, row])
                    w -= changed_at(change, env, other, rows.arm_2[env, row])
                    scratch.moved[env, row] = w
                    scale = wp.max(scratch.scale[env, row], wp.length_sq(impulse))
                    worst = wp.max(worst, off_squared(impulse, w, n, mu, rho) / scale)
                    step = impulse - scratch.trial[env, row]
                    trial_w = scratch.moved_trial[env, row]
                    if rho > zero and steps > 0:
                        bent += wp.dot(step, w - trial_w)
                        gone += wp.length_sq(step) / rho
                        w_n = wp.dot(trial_w, n)
                        lifted = trial_w + mu * wp.length(trial_w - w_n * n) * n
                        uphill += wp.dot(lifted, impulse - scratch.before[env, row])
                    if wp.static(rolls):
                        arm = scratch.arm[env, row]
                        if arm > zero:
                            turning = scratch.turning_free[env, row] + arm * spin(
                                change.angular, env, one_body, other
                            )
                            scratch.turned[env, row] = turning
                            couple = rows.couple[env, row] / arm
                            pressed = wp.max(wp.dot(impulse, n), zero) / arm
                            rolling = rows.rolling[env, row]
                            spinning = rows.spinning[env, row]
                            law = in_discs(couple - rho * turning, n, rolling * pressed, spinning * pressed)
                            worst = wp.max(worst, wp.length_sq(law - couple) / scale)
                            if steps > 0:
                                step = couple - scratch.couple_trial[env, row]
                                trial_turning = scratch.turned_trial[env, row]
                                bent += wp.dot(step, turning - trial_turning)
                                gone += wp.length_sq(step) / rho
                                along = wp.dot(trial_turning, n)
                                lift = rolling * wp.length(trial_turning - along * n) + spinning * wp.abs(along)
                                moved_on = impulse - scratch.before[env, row]
                                uphill += lift / arm * wp.dot(moved_on, n)
                                uphill += wp.dot(trial_turning, couple - scratch.couple_before[env, row])
                if worst <= goal:
                    break
                waited += 1
                if worst < least:
                    least = worst
                    waited = 0
                    for row in range(count):
                        scratch.best[env, row] = rows.impulse[env, row]
                        if wp.static(rolls):
                            scratch.couple_best[env, row] = rows.couple[env, row]
                if steps >= iterations or (waited >= PATIENCE and least < ROUNDING * ROUNDING):
                    break

                if bent * length > gone:
                    length = SHORTER * gone / bent
                else:
                    length *= LONGER
                if uphill > zero:
                    theta = one
                theta_next = half * theta * (wp.sqrt(theta * theta + four) - theta)
                beta = theta * (one - theta) / (theta * theta + theta_next)
                theta = theta_next
                for row in range(count):
                    rho = scratch.rho[env, row]
                    if rho > zero:
                        one_body = rows.body_1[env, row]
                        other = rows.body_2[env, row]
                        n = rows.normal[env, row]
                        mu = rows.mu[env, row]
                        impulse = rows.impulse[env, row]
                        w = scratch.moved[env, row]
                        trial = impulse
                        trial_w = w
                        if beta > zero:
                            trial += beta * (impulse - scratch.before[env, row])
                            trial_w += beta * (w - scratch.moved_before[env, row])
                        scratch.before[env, row] = impulse
                        scratch.moved_before[env, row] = w
                        scratch.trial[env, row] = trial
                        scratch.moved_trial[env, row] = trial_w
                        w_n = wp.dot(trial_w, n)
                        lift = mu * wp.length(trial_w - w_n * n)
                        new = trial - length * rho * (trial_w + lift * n)
                        turn_step = vec3()
                        if wp.static(rolls):
                            arm = scratch.arm[env, row]
                            if arm > zero:
                                couple = rows.couple[env, row] / arm
                                turning = scratch.turned[env, row]
                                trial = couple
                                trial_turning = turning
                                if beta > zero:
                                    trial += beta * (couple - scratch.couple_before[env, row])
                                    trial_turning += beta * (turning - scratch.turned_before[env, row])
                                scratch.couple_before[env, row] = couple
                                scratch.turned_before[env, row] = turning
                                scratch.couple_trial[env, row] = trial
                                scratch.turned_trial[env, row] = trial_turning
                                rolling = rows.rolling[env, row] / arm
                                spinning = rows.spinning[env, row] / arm
                                along = wp.dot(trial_turning, n)
                                lift = rolling * wp.length(trial_turning - along * n) + spinning * wp.abs(along)
                                new -= length * rho * lift * n
                                new_couple = trial - length * rho * trial_turning
                                pressed = pressing(new, new_couple, n, mu, rolling, spinning)
                                new_couple = arm * in_discs(new_couple, n, rolling * pressed, spinning * pressed)
                                new = in_discs(new, n, mu * pressed, zero) + pressed * n
                                turn_step = new_couple - rows.couple[env, row]
                                rows.couple[env, row] = new_couple
                            else:
                                new = in_cone(new, n, mu)
                        else:
                            new = in_cone(new, n, mu)
                        step = new - impulse
                        rows.impulse[env, row] = new
                        push(moving, change, env, one_body, step, wp.cross(rows.arm_1[env, row], step) + turn_step)
                        push(moving, change, env, other, -step, -wp.cross(rows.arm_2[env, row], step) - turn_step)
                steps += 1

            if worst > least:
                # Back to the best.
                worst = least
                for row in range(count):
                    step = scratch.best[env, row] - rows.impulse[env, row]
                    turn_step = vec3()
                    rows.impulse[env, row] = scratch.best[env, row]
                    if wp.static(rolls):
                        turn_step = scratch.couple_best[env, row] - rows.couple[env, row]
                        rows.couple[env, row] = scratch.couple_best[env, row]
                    one_body = rows.body_1[env, row]
                    other = rows.body_2[env, row]
                    push(moving, change, env, one_body, step, wp.cross(rows.arm_1[env, row], step) + turn_step)
                    push(moving, change, env, other, -step, -wp.cross(rows.arm_2[env, row], step) - turn_step)

            for body in range(change.linear.shape[1]):
                moving.linear[env, body] = moving.linear[env, body] + change.linear[env, body]
                moving.angular[env, body] = moving.angular[env, body] + change.angular[env, body]
            outcome.residual[env] = wp.sqrt(worst)
            outcome.iterations[env] = done + steps
            outcome.converged[env] = wp.where(worst <= goal, 1, 0)

    return accelerated
