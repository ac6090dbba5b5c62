"""Accelerated projected gradients: all contacts simultaneously, with Nesterov's momentum.

On a GPU the lanes of a warp share the rows and the bodies of an environment. Velocity changes are summed over the rows of each
body in their order, so that results do not depend on the order of the lanes.

H. Mazhar, T. Heyn, D. Negrut, A. Tasora, "Using Nesterov's method to accelerate multibody dynamics with friction
and contact", ACM Transactions on Graphics 34, 2015, applied to De Saxcé's velocity: μ times the slip speed is
added to the normal velocity in every iteration. So the limit satisfies Coulomb's law, without separation in slip.
Momentum restarts where it leads uphill: B. O'Donoghue, E. Candès, "Adaptive restart for accelerated gradient
schemes", Foundations of Computational Mathematics 15, 2015.
"""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel import warps
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.lowlevel.warps import lane, lane_count, sync
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
        next_1: wp.int32  # link to the next row of the first body, see ``list_rows``
        next_2: wp.int32  # likewise of the second body
        speed_squared: real  # V² of the row alone, see ``solver_common.py`` [m²/s²]
        response_1: real  # trace of the block of the first body [1/kg]
        response_2: real  # likewise of the second body
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
    """Returns the solver of a step; items: one per environment, with the threads of a warp on a GPU.

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
    velocity_change_at, apply_impulse = f.velocity_change_at, f.apply_impulse
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
    evaluate_row, update_speed_scale, spread_speed_scale, residual_scale = (
        common.evaluate_row,
        common.update_speed_scale,
        common.spread_speed_scale,
        common.residual_scale,
    )
    nesterov_step, apply_change, report_solve = common.nesterov_step, common.apply_change, common.report_solve
    sum_over_lanes, max_over_lanes = warps.reductions(real)
    soft_velocity = common.soft_velocity
    zero, one, three = (wp.constant(real(x)) for x in (0.0, 1.0, 3.0))
    # A step that was too long is reset to this fraction of the longest descending one; others grow.
    STEP_REDUCTION, STEP_GROWTH = wp.constant(real(0.9)), wp.constant(real(1.005))
    rounding = np.finfo(wp.dtype_to_numpy(real))
    # Rounding error of a residual.
    ROUNDING = wp.constant(real(4.0 * float(rounding.eps)))
    LARGEST = wp.constant(real(float(rounding.max)))
    end_of_list = wp.constant(-1)

    @wp.func
    def is_fixed(rows: Rows, env: int, row: int):
        """Returns whether the impulse of a row is held fixed."""
        if wp.static(is_start or is_fallback):
            return rows[env, row].is_unsolved == 0
        return False

    @wp.func
    def list_rows(rows: Rows, velocity_change: VelocityChange, scratch: Scratch, env: int, count: int):
        """Links the rows of each body, in their order; a fallback has its unsolved rows only.

        A link is 2 × row, plus 1 if the body is the second one of the row.
        """
        for body in range(velocity_change.shape[1]):
            velocity_change[env, body].first_row = end_of_list
            velocity_change[env, body].is_changed = 0
        for reverse in range(count):
            row = count - 1 - reverse
            if wp.static(is_fallback):
                if rows[env, row].is_unsolved == 0:
                    continue
            changes = not is_fixed(rows, env, row)
            body_1 = rows[env, row].body_1
            body_2 = rows[env, row].body_2
            if body_1 >= 0:
                scratch[env, row].next_1 = velocity_change[env, body_1].first_row
                velocity_change[env, body_1].first_row = 2 * row
                if changes:
                    velocity_change[env, body_1].is_changed = 1
            if body_2 >= 0:
                scratch[env, row].next_2 = velocity_change[env, body_2].first_row
                velocity_change[env, body_2].first_row = 2 * row + 1
                if changes:
                    velocity_change[env, body_2].is_changed = 1

    @wp.func
    def clear_bodies(body_response: BodyResponse, velocity_change: VelocityChange, env: int):
        """Sets velocity changes to zero. A fallback first reverts those of its bodies."""
        for body in range(lane(), velocity_change.shape[1], lane_count()):
            if wp.static(is_fallback):
                if velocity_change[env, body].first_row != end_of_list:
                    body_response[env, body].linear = (
                        body_response[env, body].linear - velocity_change[env, body].linear
                    )
                    body_response[env, body].angular = (
                        body_response[env, body].angular - velocity_change[env, body].angular
                    )
                    velocity_change[env, body].speed_squared = zero
            else:
                velocity_change[env, body].speed_squared = zero
            velocity_change[env, body].linear = vec3()
            velocity_change[env, body].angular = vec3()

    @wp.func
    def change_velocities(
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratch,
        env: int,
        skipped: int,
    ):
        """Sets the velocity changes of bodies to those by the impulses of their rows.

        Bodies with ``is_changed`` = ``skipped`` are skipped.
        """
        for body in range(lane(), velocity_change.shape[1], lane_count()):
            if velocity_change[env, body].is_changed == skipped:
                continue
            impulse = vec3()
            turning = vec3()
            link = velocity_change[env, body].first_row
            while link != end_of_list:
                row = link // 2
                one_impulse = rows[env, row].impulse
                if link % 2 == 0:
                    impulse += one_impulse
                    turning += wp.cross(rows[env, row].arm_1, one_impulse)
                    if wp.static(rolls):
                        turning += rows[env, row].couple
                    link = scratch[env, row].next_1
                else:
                    impulse -= one_impulse
                    turning -= wp.cross(rows[env, row].arm_2, one_impulse)
                    if wp.static(rolls):
                        turning -= rows[env, row].couple
                    link = scratch[env, row].next_2
            velocity_change[env, body].linear = vec3()
            velocity_change[env, body].angular = vec3()
            apply_impulse(body_response, velocity_change, env, body, impulse, turning)

    @wp.func
    def initialize(
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratch,
        env: int,
        count: int,
        tolerance: real,
    ):
        """Initializes the rows, and applies the warm start. Returns a number that is finite if all data are."""
        if lane() == 0:
            list_rows(rows, velocity_change, scratch, env, count)
        sync()
        clear_bodies(body_response, velocity_change, env)
        sync()
        finite = zero
        for row in range(lane(), count, lane_count()):
            if wp.static(is_fallback):
                if rows[env, row].is_unsolved == 0:
                    continue
            one = evaluate_row(rows, body_response, env, row, tolerance)
            finite += one.size
            rho = one.rho
            if wp.static(is_soft):
                if rho > zero:
                    # Steps must be short enough for the softest direction.
                    rho = three / (one.trace + three * rows[env, row].softness)
            scratch[env, row].rho = rho
            scratch[env, row].free = one.free
            scratch[env, row].speed_squared = one.speed_squared
            scratch[env, row].response_1 = one.response_1
            scratch[env, row].response_2 = one.response_2
            scratch[env, row].previous = rows[env, row].impulse
            if wp.static(rolls):
                body_1 = rows[env, row].body_1
                body_2 = rows[env, row].body_2
                turning_trace = angular_response_trace(body_response, env, body_1) + angular_response_trace(
                    body_response, env, body_2
                )
                arm = zero
                if turning_trace > zero and rho > zero:
                    arm = wp.sqrt(one.trace / turning_trace)
                    scratch[env, row].couple_before = rows[env, row].couple / arm
                scratch[env, row].arm = arm
                scratch[env, row].turning_free = arm * spin_after(body_response, env, body_1, body_2)
        finite = sum_over_lanes(finite)
        sync()
        change_velocities(rows, body_response, velocity_change, scratch, env, -1)
        if lane() == 0:
            for row in range(count):
                if wp.static(is_fallback):
                    if rows[env, row].is_unsolved == 0:
                        continue
                speed_squared = scratch[env, row].speed_squared
                update_speed_scale(
                    velocity_change, env, rows[env, row].body_1, speed_squared, scratch[env, row].response_1
                )
                update_speed_scale(
                    velocity_change, env, rows[env, row].body_2, speed_squared, scratch[env, row].response_2
                )
            spread_speed_scale(rows, velocity_change, env, count)
        sync()
        return finite

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
        for task in range(wp.tid() // lane_count(), task_count(launch), launch.threads // lane_count()):
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
            count = solve_result.count[env]
            if count == 0:
                if wp.static(not is_start):
                    report_solve(solve_result, env, zero, 0, 1)
                continue
            finite = initialize(rows, body_response, velocity_change, scratch, env, count, tolerance)
            if not wp.isfinite(finite):
                if wp.static(not is_start):
                    report_solve(solve_result, env, finite, 0, 0)
                continue

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
                for row in range(lane(), count, lane_count()):
                    if is_fixed(rows, env, row):
                        continue
                    body_1 = rows[env, row].body_1
                    body_2 = rows[env, row].body_2
                    n = rows[env, row].normal
                    mu = rows[env, row].mu
                    rho = scratch[env, row].rho
                    impulse = rows[env, row].impulse
                    w = scratch[env, row].free + velocity_change_at(
                        velocity_change, env, body_1, rows[env, row].arm_1
                    )
                    w -= velocity_change_at(velocity_change, env, body_2, rows[env, row].arm_2)
                    if wp.static(is_soft):
                        w += soft_velocity(rows, env, row, impulse)
                    scratch[env, row].velocity = w
                    scale = wp.max(
                        residual_scale(velocity_change, env, body_1, body_2, rho), wp.length_sq(impulse)
                    )
                    worst = wp.max(worst, residual_squared(impulse, w, n, mu, rho) / scale)
                    step = impulse - scratch[env, row].trial
                    trial_w = scratch[env, row].velocity_trial
                    if rho > zero and steps > 0:
                        curvature += wp.dot(step, w - trial_w)
                        step_norm += wp.length_sq(step) / rho
                        uphill += wp.dot(de_saxce_velocity(trial_w, n, mu), impulse - scratch[env, row].previous)
                    if wp.static(rolls):
                        arm = scratch[env, row].arm
                        if arm > zero:
                            turning = scratch[env, row].turning_free + arm * relative_spin_change(
                                velocity_change, env, body_1, body_2
                            )
                            scratch[env, row].spin = turning
                            couple = rows[env, row].couple / arm
                            normal = wp.max(wp.dot(impulse, n), zero) / arm
                            rolling = rows[env, row].rolling
                            spinning = rows[env, row].spinning
                            projected = project_couple(
                                couple - rho * turning, n, rolling * normal, spinning * normal
                            )
                            worst = wp.max(worst, wp.length_sq(projected - couple) / scale)
                            if steps > 0:
                                step = couple - scratch[env, row].couple_trial
                                trial_turning = scratch[env, row].spin_trial
                                curvature += wp.dot(step, turning - trial_turning)
                                step_norm += wp.length_sq(step) / rho
                                along = wp.dot(trial_turning, n)
                                lift = rolling * wp.length(trial_turning - along * n) + spinning * wp.abs(along)
                                impulse_step = impulse - scratch[env, row].previous
                                uphill += lift / arm * wp.dot(impulse_step, n)
                                uphill += wp.dot(trial_turning, couple - scratch[env, row].couple_before)
                worst = max_over_lanes(worst)
                if worst <= target:
                    break
                stalled += 1
                if worst < smallest_residual:
                    smallest_residual = worst
                    stalled = 0
                    for row in range(lane(), count, lane_count()):
                        if is_fixed(rows, env, row):
                            continue
                        scratch[env, row].best = rows[env, row].impulse
                        if wp.static(rolls):
                            scratch[env, row].couple_best = rows[env, row].couple
                if steps >= iterations or (stalled >= PATIENCE and smallest_residual < ROUNDING * ROUNDING):
                    break

                curvature = sum_over_lanes(curvature)
                step_norm = sum_over_lanes(step_norm)
                uphill = sum_over_lanes(uphill)
                if curvature * length > step_norm:
                    length = STEP_REDUCTION * step_norm / curvature
                else:
                    length *= STEP_GROWTH
                if uphill > zero:
                    theta = one
                theta, beta = nesterov_step(theta)
                for row in range(lane(), count, lane_count()):
                    if is_fixed(rows, env, row):
                        continue
                    rho = scratch[env, row].rho
                    if rho > zero:
                        n = rows[env, row].normal
                        mu = rows[env, row].mu
                        impulse = rows[env, row].impulse
                        w = scratch[env, row].velocity
                        trial = impulse
                        trial_w = w
                        if beta > zero:
                            trial += beta * (impulse - scratch[env, row].previous)
                            trial_w += beta * (w - scratch[env, row].velocity_before)
                        scratch[env, row].previous = impulse
                        scratch[env, row].velocity_before = w
                        scratch[env, row].trial = trial
                        scratch[env, row].velocity_trial = trial_w
                        new = trial - length * rho * de_saxce_velocity(trial_w, n, mu)
                        if wp.static(rolls):
                            arm = scratch[env, row].arm
                            if arm > zero:
                                couple = rows[env, row].couple / arm
                                turning = scratch[env, row].spin
                                trial = couple
                                trial_turning = turning
                                if beta > zero:
                                    trial += beta * (couple - scratch[env, row].couple_before)
                                    trial_turning += beta * (turning - scratch[env, row].spin_before)
                                scratch[env, row].couple_before = couple
                                scratch[env, row].spin_before = turning
                                scratch[env, row].couple_trial = trial
                                scratch[env, row].spin_trial = trial_turning
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
                                rows[env, row].couple = new_couple
                            else:
                                new = project_onto_cone(new, n, mu)
                        else:
                            new = project_onto_cone(new, n, mu)
                        rows[env, row].impulse = new
                sync()
                change_velocities(rows, body_response, velocity_change, scratch, env, 0)
                sync()
                steps += 1

            if wp.static(is_start):
                continue
            if worst > smallest_residual:
                # Return to the best iterate.
                worst = smallest_residual
                for row in range(lane(), count, lane_count()):
                    if is_fixed(rows, env, row):
                        continue
                    rows[env, row].impulse = scratch[env, row].best
                    if wp.static(rolls):
                        rows[env, row].couple = scratch[env, row].couple_best
                sync()
                change_velocities(rows, body_response, velocity_change, scratch, env, 0)

            apply_change(body_response, velocity_change, env)
            residual = wp.sqrt(worst)
            if wp.static(is_fallback):
                residual = wp.max(residual, solve_result.solved_residual[env])
            if lane() == 0:
                report_solve(
                    solve_result, env, residual, earlier_iterations + steps, wp.where(worst <= target, 1, 0)
                )

    return accelerated
