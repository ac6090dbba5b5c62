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
from warpcontact.kernels.types import ENV_ACTIVE, Work, first_env, structs, task_count
from warpcontact.kernels.unilateral import begin, impulses, relative
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs
from warpcontact.kernels.unique import unique_kernel

# Iterations that may pass without a smaller residual where that is of the size of rounding.
PATIENCE = 100


@functools.cache
def scratch(real: type, rolls: bool) -> type:
    """Returns the struct of what a solve keeps of a row.

    Of couples there is what they are over an arm, so that they count as impulses do, and of angular velocities
    what they are times that arm.
    """
    vec3 = structs(real).vec3

    @wp.struct
    class Scratch:
        rho: real  # [kg]
        free: vec3  # q, W [m/s]
        before: vec3  # impulse of the iteration before, W [N·s]
        trial: vec3  # where momentum leads, W [N·s]
        moved: vec3  # w, W [m/s]
        moved_before: vec3  # that of the iteration before
        moved_trial: vec3  # that where momentum leads
        best: vec3  # impulse of the least residual, W [N·s]
        if rolls:
            arm: real  # at which a force turns as easily as it pushes [m]
            turning_free: vec3
            couple_before: vec3
            couple_trial: vec3
            turned: vec3
            turned_before: vec3
            turned_trial: vec3
            couple_best: vec3

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
    Rows, Outcome = r.Rows, r.Outcome
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    Change = wp.array2d(dtype=impulses.change_struct(real))
    Scratch = wp.array2d(dtype=scratch(real, rolls))
    f = impulses.functions(real, moves)
    spin_after, spin_changed = relative.functions(real, moves).spin_after, f.spin_changed
    changed_at, push_both = f.changed_at, f.push_both
    turning_ease, in_cone, in_discs = f.turning_ease, f.in_cone, f.in_discs
    lifted, off_squared, pressing = f.lifted, f.off_squared, f.pressing
    first = begin.functions(real, moves, rolls)
    clear, begin_row, spread, scale_of = first.clear, first.begin, first.spread, first.scale
    momentum, take, report = first.momentum, first.take, first.report
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
    # A step that was too long becomes this part of the longest that goes down; others grow.
    SHORTER, LONGER = wp.constant(real(0.9)), wp.constant(real(1.005))
    rounding = np.finfo(wp.dtype_to_numpy(real))
    # What rounding may leave of a residual.
    ROUNDING = wp.constant(real(4.0 * float(rounding.eps)))
    LARGEST = wp.constant(real(float(rounding.max)))

    @unique_kernel()
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
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] != ENV_ACTIVE:
                continue
            done = wp.int32(0)
            if wp.static(after):
                if outcome.converged[env] == 1:
                    continue
                done = outcome.iterations[env]
                for body in range(change.shape[1]):
                    moving[env, body].linear = moving[env, body].linear - change[env, body].linear
                    moving[env, body].angular = moving[env, body].angular - change[env, body].angular
            count = outcome.count[env]
            if count == 0:
                report(outcome, env, zero, 0, 1)
                continue

            clear(change, env)
            finite = zero  # only if all terms are
            for row in range(count):
                free, rho, trace, size = begin_row(rows, moving, change, env, row, tolerance)
                finite += size
                scratch[env, row].rho = rho
                scratch[env, row].free = free
                scratch[env, row].before = rows[env, row].impulse
                if wp.static(rolls):
                    one_body = rows[env, row].body_1
                    other = rows[env, row].body_2
                    turning_trace = turning_ease(moving, env, one_body) + turning_ease(moving, env, other)
                    arm = zero
                    if turning_trace > zero and rho > zero:
                        arm = wp.sqrt(trace / turning_trace)
                        scratch[env, row].couple_before = rows[env, row].couple / arm
                    scratch[env, row].arm = arm
                    scratch[env, row].turning_free = arm * spin_after(moving, env, one_body, other)
            if not wp.isfinite(finite):
                report(outcome, env, finite, 0, 0)
                continue
            spread(rows, change, env, count)

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
                    one_body = rows[env, row].body_1
                    other = rows[env, row].body_2
                    n = rows[env, row].normal
                    mu = rows[env, row].mu
                    rho = scratch[env, row].rho
                    impulse = rows[env, row].impulse
                    w = scratch[env, row].free + changed_at(change, env, one_body, rows[env, row].arm_1)
                    w -= changed_at(change, env, other, rows[env, row].arm_2)
                    scratch[env, row].moved = w
                    scale = wp.max(scale_of(change, env, one_body, other, rho), wp.length_sq(impulse))
                    worst = wp.max(worst, off_squared(impulse, w, n, mu, rho) / scale)
                    step = impulse - scratch[env, row].trial
                    trial_w = scratch[env, row].moved_trial
                    if rho > zero and steps > 0:
                        bent += wp.dot(step, w - trial_w)
                        gone += wp.length_sq(step) / rho
                        uphill += wp.dot(lifted(trial_w, n, mu), impulse - scratch[env, row].before)
                    if wp.static(rolls):
                        arm = scratch[env, row].arm
                        if arm > zero:
                            turning = scratch[env, row].turning_free + arm * spin_changed(
                                change, env, one_body, other
                            )
                            scratch[env, row].turned = turning
                            couple = rows[env, row].couple / arm
                            pressed = wp.max(wp.dot(impulse, n), zero) / arm
                            rolling = rows[env, row].rolling
                            spinning = rows[env, row].spinning
                            law = in_discs(couple - rho * turning, n, rolling * pressed, spinning * pressed)
                            worst = wp.max(worst, wp.length_sq(law - couple) / scale)
                            if steps > 0:
                                step = couple - scratch[env, row].couple_trial
                                trial_turning = scratch[env, row].turned_trial
                                bent += wp.dot(step, turning - trial_turning)
                                gone += wp.length_sq(step) / rho
                                along = wp.dot(trial_turning, n)
                                lift = rolling * wp.length(trial_turning - along * n) + spinning * wp.abs(along)
                                moved_on = impulse - scratch[env, row].before
                                uphill += lift / arm * wp.dot(moved_on, n)
                                uphill += wp.dot(trial_turning, couple - scratch[env, row].couple_before)
                if worst <= goal:
                    break
                waited += 1
                if worst < least:
                    least = worst
                    waited = 0
                    for row in range(count):
                        scratch[env, row].best = rows[env, row].impulse
                        if wp.static(rolls):
                            scratch[env, row].couple_best = rows[env, row].couple
                if steps >= iterations or (waited >= PATIENCE and least < ROUNDING * ROUNDING):
                    break

                if bent * length > gone:
                    length = SHORTER * gone / bent
                else:
                    length *= LONGER
                if uphill > zero:
                    theta = one
                theta, beta = momentum(theta)
                for row in range(count):
                    rho = scratch[env, row].rho
                    if rho > zero:
                        one_body = rows[env, row].body_1
                        other = rows[env, row].body_2
                        n = rows[env, row].normal
                        mu = rows[env, row].mu
                        impulse = rows[env, row].impulse
                        w = scratch[env, row].moved
                        trial = impulse
                        trial_w = w
                        if beta > zero:
                            trial += beta * (impulse - scratch[env, row].before)
                            trial_w += beta * (w - scratch[env, row].moved_before)
                        scratch[env, row].before = impulse
                        scratch[env, row].moved_before = w
                        scratch[env, row].trial = trial
                        scratch[env, row].moved_trial = trial_w
                        new = trial - length * rho * lifted(trial_w, n, mu)
                        turn_step = vec3()
                        if wp.static(rolls):
                            arm = scratch[env, row].arm
                            if arm > zero:
                                couple = rows[env, row].couple / arm
                                turning = scratch[env, row].turned
                                trial = couple
                                trial_turning = turning
                                if beta > zero:
                                    trial += beta * (couple - scratch[env, row].couple_before)
                                    trial_turning += beta * (turning - scratch[env, row].turned_before)
                                scratch[env, row].couple_before = couple
                                scratch[env, row].turned_before = turning
                                scratch[env, row].couple_trial = trial
                                scratch[env, row].turned_trial = trial_turning
                                rolling = rows[env, row].rolling / arm
                                spinning = rows[env, row].spinning / arm
                                along = wp.dot(trial_turning, n)
                                lift = rolling * wp.length(trial_turning - along * n) + spinning * wp.abs(along)
                                new -= length * rho * lift * n
                                new_couple = trial - length * rho * trial_turning
                                pressed = pressing(new, new_couple, n, mu, rolling, spinning)
                                new_couple = arm * in_discs(new_couple, n, rolling * pressed, spinning * pressed)
                                new = in_discs(new, n, mu * pressed, zero) + pressed * n
                                turn_step = new_couple - rows[env, row].couple
                                rows[env, row].couple = new_couple
                            else:
                                new = in_cone(new, n, mu)
                        else:
                            new = in_cone(new, n, mu)
                        step = new - impulse
                        rows[env, row].impulse = new
                        turn_1 = wp.cross(rows[env, row].arm_1, step) + turn_step
                        turn_2 = -wp.cross(rows[env, row].arm_2, step) - turn_step
                        push_both(moving, change, env, one_body, other, step, turn_1, turn_2)
                steps += 1

            if worst > least:
                # Back to the best.
                worst = least
                for row in range(count):
                    step = scratch[env, row].best - rows[env, row].impulse
                    turn_step = vec3()
                    rows[env, row].impulse = scratch[env, row].best
                    if wp.static(rolls):
                        turn_step = scratch[env, row].couple_best - rows[env, row].couple
                        rows[env, row].couple = scratch[env, row].couple_best
                    one_body = rows[env, row].body_1
                    other = rows[env, row].body_2
                    turn_1 = wp.cross(rows[env, row].arm_1, step) + turn_step
                    turn_2 = -wp.cross(rows[env, row].arm_2, step) - turn_step
                    push_both(moving, change, env, one_body, other, step, turn_1, turn_2)

            take(moving, change, env)
            report(outcome, env, wp.sqrt(worst), done + steps, wp.where(worst <= goal, 1, 0))

    return accelerated
