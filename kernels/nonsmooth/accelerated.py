"""Accelerated projected gradients: all contacts simultaneously, with Nesterov's momentum.

H. Mazhar, T. Heyn, D. Negrut, A. Tasora, "Using Nesterov's method to accelerate multibody dynamics with friction
and contact", ACM Transactions on Graphics 34, 2015, applied to De Saxcé's velocity: μ times the slip speed is
added to the normal velocity in every iteration. So the limit satisfies Coulomb's law, without separation in slip.
Momentum restarts where it leads uphill: B. O'Donoghue, E. Candès, "Adaptive restart for accelerated gradient
schemes", Foundations of Computational Mathematics 15, 2015.
"""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import solver_common, velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, Struct, first_env, structs, task_count

# Number of iterations without a smaller residual after which a residual of the size of rounding is accepted.
PATIENCE = 100


@functools.cache
def scratch(real: type, rolls: bool) -> Struct:
    """Returns the struct of solver data per row.

    Couples are divided by an arm, and angular velocities multiplied by it, so that they have the units of impulses
    and velocities.
    """
    vec3 = structs(real).vec3

    @wp.struct
    class Scratch:
        row: wp.int32  # its index among the rows of the environment
        rho: real  # effective mass ρ at the contact, 3 over the trace of its block [kg]
        free: vec3  # q, W [m/s]
        previous: vec3  # impulse of the previous iteration, W [N·s]
        trial: vec3  # extrapolated impulse, W [N·s]
        velocity: vec3  # w, W [m/s]
        velocity_before: vec3  # w of the previous iteration
        velocity_trial: vec3  # w at the extrapolated impulse
        best: vec3  # impulse with the smallest residual, W [N·s]
        if rolls:
            arm: real  # arm at which force and couple have the same mobility [m]
            turning_free: vec3
            couple_before: vec3
            couple_trial: vec3
            spin: vec3
            spin_before: vec3
            spin_trial: vec3
            couple_best: vec3

    return Scratch


@functools.cache
def kernel(
    real: type,
    has_joints: bool,
    rolls: bool,
    is_soft: bool = False,
    is_fallback: bool = False,
    is_start: bool = False,
) -> wp.Kernel:
    """Returns the solver of a step; items: one per environment.

    Args:
        real: Precision.
        has_joints: Whether some bodies have joints.
        rolls: Whether any contact has rolling or spinning resistance.
        is_soft: Whether any contact has a compliance.
        is_fallback: Whether it runs after another solver that did not converge. It then solves the rows that are
            marked as unsolved, reverts the ``velocity_change`` of their bodies and continues the iteration count.
        is_start: Whether it runs before another solver, where ``load_sharing.py`` cleared warm starts. It then changes
            the impulses of the marked rows, with those of others held fixed, and nothing else. The last iterate is the
            warm start of that solver.

    Starts from the warm start in ``rows``. Stops at the tolerance, when rounding prevents a smaller residual, or
    after ``iterations`` iterations; then it returns the iterate with the smallest residual.
    """
    t = structs(real)
    vec3 = t.vec3
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    Scratch = wp.array2d(dtype=scratch(real, rolls))
    f = velocity_update.functions(real, has_joints)
    spin_after, relative_spin_change = (
        velocity_update.relative_velocities(real, has_joints).spin_after,
        f.relative_spin_change,
    )
    velocity_change_at, apply_row_wrench = f.velocity_change_at, f.apply_row_wrench
    angular_response_trace, project_onto_cone, project_couple = (
        f.angular_response_trace,
        f.project_onto_cone,
        f.project_couple,
    )
    de_saxce_velocity, residual_squared, projected_normal = (
        f.de_saxce_velocity,
        f.residual_squared,
        f.projected_normal,
    )
    common = solver_common.functions(real, has_joints, rolls, is_soft)
    clear_change, initialize_row, spread_speed_scale, residual_scale = (
        common.clear_change,
        common.initialize_row,
        common.spread_speed_scale,
        common.residual_scale,
    )
    nesterov_step, apply_change, report_solve = common.nesterov_step, common.apply_change, common.report_solve
    soft_velocity = common.soft_velocity
    zero, one, three = (wp.constant(real(x)) for x in (0.0, 1.0, 3.0))
    # A step that was too long is reset to this fraction of the longest descending one; others grow.
    STEP_REDUCTION, STEP_GROWTH = wp.constant(real(0.9)), wp.constant(real(1.005))
    rounding = np.finfo(wp.dtype_to_numpy(real))
    # Rounding error of a residual.
    ROUNDING = wp.constant(real(4.0 * float(rounding.eps)))
    LARGEST = wp.constant(real(float(rounding.max)))

    @wp.func
    def revert_body(body_response: BodyResponse, velocity_change: VelocityChange, env: int, body: int):
        """Reverts the velocity change of a body."""
        if body >= 0:
            body_response[env, body].linear = body_response[env, body].linear - velocity_change[env, body].linear
            body_response[env, body].angular = (
                body_response[env, body].angular - velocity_change[env, body].angular
            )
            velocity_change[env, body].linear = vec3()
            velocity_change[env, body].angular = vec3()
            velocity_change[env, body].speed_squared = zero

    @wp.func
    def revert_unsolved(
        rows: Rows, body_response: BodyResponse, velocity_change: VelocityChange, env: int, count: int
    ):
        """Reverts the velocity changes of bodies with unsolved rows; those of others are kept, and set to zero."""
        for row in range(count):
            if rows[env, row].is_unsolved == 1:
                revert_body(body_response, velocity_change, env, rows[env, row].body_1)
                revert_body(body_response, velocity_change, env, rows[env, row].body_2)
        for body in range(velocity_change.shape[1]):
            velocity_change[env, body].linear = vec3()
            velocity_change[env, body].angular = vec3()

    @unique_kernel()
    def accelerated(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        rows: Rows,
        body_response: BodyResponse,
        solve_result: SolveResult,
        tolerance: real,
        iterations: int,
        scratch: Scratch,
        velocity_change: VelocityChange,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            earlier_iterations = wp.int32(0)
            if wp.static(is_start):
                if solve_result.was_cleared[env] == 0:
                    continue
            if wp.static(is_fallback):
                if solve_result.converged[env] == 1:
                    continue
                earlier_iterations = solve_result.iterations[env]
                revert_unsolved(rows, body_response, velocity_change, env, solve_result.count[env])
            count = solve_result.count[env]
            if count == 0:
                if wp.static(not is_start):
                    report_solve(solve_result, env, zero, 0, 1)
                continue

            if wp.static(not is_fallback):
                clear_change(velocity_change, env)
            solved_rows = wp.int32(0)
            finite = zero  # finite only if all terms are
            for row in range(count):
                if wp.static(is_fallback):
                    if rows[env, row].is_unsolved == 0:
                        continue
                free, rho, trace, size = initialize_row(rows, body_response, velocity_change, env, row, tolerance)
                finite += size
                if wp.static(is_start):
                    if rows[env, row].is_unsolved == 0:
                        continue
                index = solved_rows
                solved_rows += 1
                if wp.static(is_soft):
                    if rho > zero:
                        # Steps must be short enough for the softest direction.
                        rho = three / (trace + three * rows[env, row].softness)
                scratch[env, index].row = row
                scratch[env, index].rho = rho
                scratch[env, index].free = free
                scratch[env, index].previous = rows[env, row].impulse
                if wp.static(rolls):
                    body_1 = rows[env, row].body_1
                    body_2 = rows[env, row].body_2
                    turning_trace = angular_response_trace(body_response, env, body_1) + angular_response_trace(
                        body_response, env, body_2
                    )
                    arm = zero
                    if turning_trace > zero and rho > zero:
                        arm = wp.sqrt(trace / turning_trace)
                        scratch[env, index].couple_before = rows[env, row].couple / arm
                    scratch[env, index].arm = arm
                    scratch[env, index].turning_free = arm * spin_after(body_response, env, body_1, body_2)
            if not wp.isfinite(finite):
                if wp.static(not is_start):
                    report_solve(solve_result, env, finite, 0, 0)
                continue
            spread_speed_scale(rows, velocity_change, env, count)

            target = tolerance * tolerance
            length = one  # step length relative to rho
            theta = one
            beta = zero
            worst = zero
            smallest_residual = LARGEST
            stalled = wp.int32(0)
            steps = wp.int32(0)
            while True:
                # Residual at the current iterate, and curvature along the last step.
                worst = zero
                curvature = zero
                step_norm = zero
                uphill = zero
                for index in range(solved_rows):
                    row = scratch[env, index].row
                    body_1 = rows[env, row].body_1
                    body_2 = rows[env, row].body_2
                    n = rows[env, row].normal
                    mu = rows[env, row].mu
                    rho = scratch[env, index].rho
                    impulse = rows[env, row].impulse
                    w = scratch[env, index].free + velocity_change_at(
                        velocity_change, env, body_1, rows[env, row].arm_1
                    )
                    w -= velocity_change_at(velocity_change, env, body_2, rows[env, row].arm_2)
                    if wp.static(is_soft):
                        w += soft_velocity(rows, env, row, impulse)
                    scratch[env, index].velocity = w
                    scale = wp.max(
                        residual_scale(velocity_change, env, body_1, body_2, rho), wp.length_sq(impulse)
                    )
                    worst = wp.max(worst, residual_squared(impulse, w, n, mu, rho) / scale)
                    step = impulse - scratch[env, index].trial
                    trial_w = scratch[env, index].velocity_trial
                    if rho > zero and steps > 0:
                        curvature += wp.dot(step, w - trial_w)
                        step_norm += wp.length_sq(step) / rho
                        uphill += wp.dot(de_saxce_velocity(trial_w, n, mu), impulse - scratch[env, index].previous)
                    if wp.static(rolls):
                        arm = scratch[env, index].arm
                        if arm > zero:
                            turning = scratch[env, index].turning_free + arm * relative_spin_change(
                                velocity_change, env, body_1, body_2
                            )
                            scratch[env, index].spin = turning
                            couple = rows[env, row].couple / arm
                            normal = wp.max(wp.dot(impulse, n), zero) / arm
                            rolling = rows[env, row].rolling
                            spinning = rows[env, row].spinning
                            projected = project_couple(
                                couple - rho * turning, n, rolling * normal, spinning * normal
                            )
                            worst = wp.max(worst, wp.length_sq(projected - couple) / scale)
                            if steps > 0:
                                step = couple - scratch[env, index].couple_trial
                                trial_turning = scratch[env, index].spin_trial
                                curvature += wp.dot(step, turning - trial_turning)
                                step_norm += wp.length_sq(step) / rho
                                along = wp.dot(trial_turning, n)
                                lift = rolling * wp.length(trial_turning - along * n) + spinning * wp.abs(along)
                                impulse_step = impulse - scratch[env, index].previous
                                uphill += lift / arm * wp.dot(impulse_step, n)
                                uphill += wp.dot(trial_turning, couple - scratch[env, index].couple_before)
                if worst <= target:
                    break
                stalled += 1
                if worst < smallest_residual:
                    smallest_residual = worst
                    stalled = 0
                    for index in range(solved_rows):
                        row = scratch[env, index].row
                        scratch[env, index].best = rows[env, row].impulse
                        if wp.static(rolls):
                            scratch[env, index].couple_best = rows[env, row].couple
                if steps >= iterations or (stalled >= PATIENCE and smallest_residual < ROUNDING * ROUNDING):
                    break

                if curvature * length > step_norm:
                    length = STEP_REDUCTION * step_norm / curvature
                else:
                    length *= STEP_GROWTH
                if uphill > zero:
                    theta = one
                theta, beta = nesterov_step(theta)
                for index in range(solved_rows):
                    row = scratch[env, index].row
                    rho = scratch[env, index].rho
                    if rho > zero:
                        n = rows[env, row].normal
                        mu = rows[env, row].mu
                        impulse = rows[env, row].impulse
                        w = scratch[env, index].velocity
                        trial = impulse
                        trial_w = w
                        if beta > zero:
                            trial += beta * (impulse - scratch[env, index].previous)
                            trial_w += beta * (w - scratch[env, index].velocity_before)
                        scratch[env, index].previous = impulse
                        scratch[env, index].velocity_before = w
                        scratch[env, index].trial = trial
                        scratch[env, index].velocity_trial = trial_w
                        new = trial - length * rho * de_saxce_velocity(trial_w, n, mu)
                        couple_step = vec3()
                        if wp.static(rolls):
                            arm = scratch[env, index].arm
                            if arm > zero:
                                couple = rows[env, row].couple / arm
                                turning = scratch[env, index].spin
                                trial = couple
                                trial_turning = turning
                                if beta > zero:
                                    trial += beta * (couple - scratch[env, index].couple_before)
                                    trial_turning += beta * (turning - scratch[env, index].spin_before)
                                scratch[env, index].couple_before = couple
                                scratch[env, index].spin_before = turning
                                scratch[env, index].couple_trial = trial
                                scratch[env, index].spin_trial = trial_turning
                                rolling = rows[env, row].rolling / arm
                                spinning = rows[env, row].spinning / arm
                                along = wp.dot(trial_turning, n)
                                lift = rolling * wp.length(trial_turning - along * n) + spinning * wp.abs(along)
                                new -= length * rho * lift * n
                                new_couple = trial - length * rho * trial_turning
                                normal = projected_normal(new, new_couple, n, mu, rolling, spinning)
                                new_couple = arm * project_couple(
                                    new_couple, n, rolling * normal, spinning * normal
                                )
                                new = project_couple(new, n, mu * normal, zero) + normal * n
                                couple_step = new_couple - rows[env, row].couple
                                rows[env, row].couple = new_couple
                            else:
                                new = project_onto_cone(new, n, mu)
                        else:
                            new = project_onto_cone(new, n, mu)
                        step = new - impulse
                        rows[env, row].impulse = new
                        apply_row_wrench(rows, body_response, velocity_change, env, row, step, couple_step)
                steps += 1

            if wp.static(is_start):
                continue
            if worst > smallest_residual:
                # Return to the best iterate.
                worst = smallest_residual
                for index in range(solved_rows):
                    row = scratch[env, index].row
                    step = scratch[env, index].best - rows[env, row].impulse
                    couple_step = vec3()
                    rows[env, row].impulse = scratch[env, index].best
                    if wp.static(rolls):
                        couple_step = scratch[env, index].couple_best - rows[env, row].couple
                        rows[env, row].couple = scratch[env, index].couple_best
                    apply_row_wrench(rows, body_response, velocity_change, env, row, step, couple_step)

            apply_change(body_response, velocity_change, env)
            residual = wp.sqrt(worst)
            if wp.static(is_fallback):
                residual = wp.max(residual, solve_result.solved_residual[env])
            report_solve(solve_result, env, residual, earlier_iterations + steps, wp.where(worst <= target, 1, 0))

    return accelerated
