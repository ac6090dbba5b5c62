"""Projected Gauss–Seidel solver: contacts are solved exactly one after another, the others held fixed.

Each island, a set of bodies that contacts connect, is solved by itself. The first sweeps are combined, see ``anderson.py``;
later ones are extrapolated with momentum.
"""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import (
    anderson,
    island_rows,
    islands,
    rest_impulses,
    row_solution,
    solver_common,
    velocity_update,
)
from warpcontact.kernels.nonsmooth.island_rows import BLOCK_EXACT, scratch
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, first_env, task_count

# Number of sweeps after which blocks of rows are softened, and sweeps are extrapolated with Nesterov's momentum, as in
# ``accelerated.py``, which converges faster in tall stacks.
MOMENTUM_AFTER = 50
# Number of sweeps without a smaller residual after which a residual of the size of rounding is accepted.
PATIENCE = 50


@functools.cache
def kernel(
    real: type, has_joints: bool, rolls: bool, is_soft: bool = False, has_fallback: bool = False
) -> wp.Kernel:
    """Returns the solver of a step; items: one per environment.

    Args:
        real: Precision.
        has_joints: Whether some bodies have joints.
        rolls: Whether any contact has rolling or spinning resistance.
        is_soft: Whether any contact has a compliance.
        has_fallback: Whether another solver runs if this one fails. It then starts from the impulses before the
            first sweep, because the result of unconverged sweeps with heavy bodies on light ones converges slowly.
            These are the warm start or, for bodies at rest, the impulses of ``rest_impulses.py``. Other islands keep
            their solution.

    The first sweep starts from the warm start in ``rows``. The solve of an island ends after

    - a sweep in which all residuals are within the tolerance, so that no impulse changes,
    - ``PATIENCE`` sweeps without a smaller residual, if the residual is within rounding, or
    - ``iterations`` sweeps.

    In the last two cases a final sweep only evaluates residuals, because those of a sweep that changes impulses
    belong to several states. Far from convergence, a sweep changes impulses without evaluating residuals before.
    The number of iterations and the residual of an environment are the largest ones of its islands.
    """
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    RowScratch = scratch(real, rolls)
    Scratch = wp.array2d(dtype=RowScratch)
    f = velocity_update.functions(real, has_joints)
    velocity_change_at, residual_squared, project_onto_cone = (
        f.velocity_change_at,
        f.residual_squared,
        f.project_onto_cone,
    )
    project_couple = f.project_couple
    of_rows = island_rows.functions(real, has_joints, rolls, is_soft)
    initialize, initialize_scale, save_guess, apply_step, apply_couple_step, update_couple = of_rows
    soft_velocity, slip_impulse, exact_impulse = row_solution.functions(real, has_joints, rolls, is_soft)
    if not has_joints:
        at_rest, solve_rest, zero_rest_velocities = rest_impulses.functions(real, RowScratch)
    common = solver_common.functions(real, has_joints, rolls, is_soft)
    nesterov_step, report_solve = common.nesterov_step, common.report_solve
    island_of_row = islands.functions(real, has_joints, RowScratch).island_of_row
    Products, Gram, Differences = anderson.types(real)
    record_step, extrapolated, record_couple_step, extrapolated_couple = anderson.functions(
        real, RowScratch, rolls
    )
    combination = anderson.combination(real)
    history, max_growth = wp.constant(anderson.HISTORY), wp.constant(real(anderson.MAX_GROWTH))
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
    block_softened = wp.constant(island_rows.BLOCK_SOFTENED)
    patience, idle = wp.constant(PATIENCE), wp.constant(island_rows.IDLE)
    rounding = np.finfo(wp.dtype_to_numpy(real))
    # Rounding error of a residual.
    ROUNDING = wp.constant(real(4.0 * float(rounding.eps)))
    LARGEST = wp.constant(real(float(rounding.max)))
    # Squared residual over tolerance above which the next sweep skips the evaluation before changes.
    UNCHECKED_ABOVE = wp.constant(real(4.0))
    # Fraction of the tolerance below which a row is not changed.
    KEEP_FRACTION = wp.constant(real(0.1))
    # Residual of the size of rounding above which the impulses on resting bodies are recomputed.
    REST_TOLERANCE = wp.constant(real(8.0 * float(rounding.eps)))
    # Squared velocity, relative to that of the impulse alone, below which a contact may stick.
    STICK_SPEED = wp.constant(real(0.1))

    @wp.func
    def solve_island(
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratch,
        env: int,
        island: int,
        first: int,
        end: int,
        tolerance: real,
        iterations: int,
    ):
        """Solves an island, the rows of which are ``first`` to ``end`` of ``scratch``; returns residual² and sweeps."""
        initialize_scale(velocity_change, scratch, env, island, first, end)
        target = tolerance * tolerance
        worst = zero
        smallest_residual = LARGEST
        stalled = wp.int32(0)
        final_sweep = wp.where(iterations <= 0, 1, 0)
        sweeps = wp.int32(0)
        rest_tried = final_sweep
        if wp.static(is_soft):
            # Impulses that stop the bodies would also have to deform the contacts.
            rest_tried = wp.int32(1)
        rest_sweeps = wp.int32(0)
        guess_saved = wp.int32(0)
        if wp.static(rolls):
            guess_saved = wp.int32(1)
            save_guess(rows, scratch, env, first, end)
        rest_tolerance = zero
        if wp.static(not has_joints):
            # Resting bodies stay at rest, except for impulses of the last step that would now push them back.
            if at_rest(body_response, velocity_change, env, island) == 1:
                rest_tolerance = REST_TOLERANCE * REST_TOLERANCE
        # unchecked: this sweep changes all rows without evaluating their residuals before.
        # final_sweep: this sweep only evaluates.
        # rest_tried: ``solve_rest`` has run, or is not tried any more.
        # rest_solved: ``solve_rest`` has changed the impulses, so the next sweep starts.
        # rest_sweeps: 1 after that; equal to ``sweeps`` if no other sweep changed impulses.
        # guess_saved: the impulses before the first sweep are stored, and the data of the rows initialized.
        # differences: number of stored differences of sweeps; -1: not even one sweep is stored.
        # slot: place of the next difference.
        unchecked = wp.int32(0)
        block_state = wp.int32(BLOCK_EXACT)
        gram = Gram()
        last_norm = LARGEST
        theta = one
        differences = wp.int32(-1)
        slot = wp.int32(0)
        while True:
            worst = zero
            changes = unchecked
            rest_solved = wp.int32(0)
            column = Products()
            products = Products()
            norm = zero
            uphill = zero
            for index in range(first, end):
                body_1 = scratch[env, index].body_1
                body_2 = scratch[env, index].body_2
                n = scratch[env, index].normal
                rho = scratch[env, index].rho
                impulse = scratch[env, index].impulse
                w = scratch[env, index].free + velocity_change_at(
                    velocity_change, env, body_1, scratch[env, index].arm_1
                )
                w -= velocity_change_at(velocity_change, env, body_2, scratch[env, index].arm_2)
                if wp.static(is_soft):
                    w += soft_velocity(scratch, env, index, impulse)
                impulse_squared = wp.length_sq(impulse)
                new = impulse
                # An open contact that separates satisfies its law.
                if impulse_squared > zero or wp.dot(w, n) < zero:
                    mu = scratch[env, index].mu
                    scale = wp.max(scratch[env, index].scale, impulse_squared)
                    residual = zero  # squared and relative
                    if unchecked == 0:
                        residual = residual_squared(impulse, w, n, mu, rho) / scale
                        worst = wp.max(worst, residual)
                    if wp.static(not has_joints):
                        if rest_tried == 0 and residual > rest_tolerance:
                            # Before any change.
                            rest_tried = 1
                            if rho * rho * wp.length_sq(w) < STICK_SPEED * impulse_squared:
                                rest_solved = solve_rest(
                                    body_response, velocity_change, scratch, env, island, first, end
                                )
                            if rest_solved == 1:
                                break
                    if guess_saved == 0 and residual > target:
                        guess_saved = 1
                        save_guess(rows, scratch, env, first, end)
                    if unchecked == 1 or (
                        final_sweep == 0
                        and (
                            residual > target
                            or (changes > 0 and residual > KEEP_FRACTION * KEEP_FRACTION * target)
                        )
                    ):
                        changes += 1
                        slips = wp.int32(0)
                        if sweeps == 0:
                            new, slips = slip_impulse(scratch, body_response, env, index, impulse, w, rho)
                        if slips == 0:
                            new = exact_impulse(body_response, scratch, env, index, impulse, w, block_state)
                        step = new - impulse
                        if unchecked == 1:
                            worst = wp.max(worst, wp.length_sq(step) / scale)
                        scratch[env, index].impulse = new
                        scratch[env, index].idle_sweeps = 0
                        apply_step(body_response, velocity_change, scratch, env, index, step)
                couple_is_zero = True
                if wp.static(rolls):
                    scale = wp.max(scratch[env, index].scale, impulse_squared)
                    least_residual = LARGEST
                    if final_sweep == 0:
                        least_residual = wp.where(changes > 0, KEEP_FRACTION * KEEP_FRACTION * target, target)
                    couple = rows[env, scratch[env, index].row].couple
                    couple_residual, changed = update_couple(
                        rows, body_response, velocity_change, scratch, env, index, scale, least_residual
                    )
                    worst = wp.max(worst, couple_residual)
                    changes += changed
                    new_couple = rows[env, scratch[env, index].row].couple
                    couple_is_zero = wp.length_sq(new_couple) == zero
                    if not couple_is_zero:
                        scratch[env, index].idle_sweeps = 0
                if guess_saved == 1 and scratch[env, index].idle_sweeps < idle:
                    if sweeps >= MOMENTUM_AFTER:
                        last_change = new - scratch[env, index].last_impulse
                        uphill += scratch[env, index].weight * wp.dot(impulse - new, last_change)
                        scratch[env, index].last_step = last_change
                        scratch[env, index].last_impulse = new
                    else:
                        to_difference, to_step, step_norm = record_step(
                            scratch, env, index, new - impulse, new, slot
                        )
                        column += to_difference
                        products += to_step
                        norm += step_norm
                        if wp.static(rolls):
                            to_difference, to_step, step_norm = record_couple_step(
                                scratch, env, index, new_couple - couple, new_couple, slot
                            )
                            column += to_difference
                            products += to_step
                            norm += step_norm
                    if wp.length_sq(new) == zero and couple_is_zero:
                        idle_sweeps = scratch[env, index].idle_sweeps + 1
                        scratch[env, index].idle_sweeps = idle_sweeps
                        if idle_sweeps == idle:
                            scratch[env, index].step_differences = Differences()
                            scratch[env, index].impulse_differences = Differences()
                            if wp.static(rolls):
                                scratch[env, index].couple_step_differences = Differences()
                                scratch[env, index].couple_differences = Differences()
            if rest_solved == 1:
                sweeps += 1
                rest_sweeps = wp.int32(1)
                final_sweep = wp.where(sweeps >= iterations, 1, 0)
                continue
            rest_tried = 1
            if changes == 0:
                break
            sweeps += 1
            if sweeps == MOMENTUM_AFTER:
                block_state = block_softened
            stalled += 1
            if worst < smallest_residual:
                smallest_residual = worst
                stalled = 0
            if sweeps >= iterations or (stalled >= patience and worst < ROUNDING * ROUNDING):
                final_sweep = 1
                unchecked = 0
                continue
            unchecked = wp.where(worst > UNCHECKED_ABOVE * target, 1, 0)

            if sweeps > MOMENTUM_AFTER:
                # A sweep is a descent step. Restart the momentum if it leads uphill.
                if uphill > zero:
                    theta = one
                theta, beta = nesterov_step(theta)
                if beta > zero:
                    for index in range(first, end):
                        if scratch[env, index].idle_sweeps < idle:
                            impulse = scratch[env, index].impulse
                            new = project_onto_cone(
                                impulse + beta * scratch[env, index].last_step,
                                scratch[env, index].normal,
                                scratch[env, index].mu,
                            )
                            scratch[env, index].impulse = new
                            apply_step(body_response, velocity_change, scratch, env, index, new - impulse)
                continue

            if norm > max_growth * last_norm:
                differences = -1
            last_norm = norm
            differences += 1
            if differences == 0:
                # The next difference is the first one.
                slot = 0
                continue
            differences = wp.min(differences, history)
            for i in range(history):
                gram[i, slot] = column[i]
                gram[slot, i] = column[i]
            coefficients = combination(gram, products, differences)
            slot = wp.where(slot + 1 < history, slot + 1, 0)
            for index in range(first, end):
                if scratch[env, index].idle_sweeps < idle:
                    impulse = scratch[env, index].impulse
                    new = project_onto_cone(
                        extrapolated(scratch, env, index, coefficients),
                        scratch[env, index].normal,
                        scratch[env, index].mu,
                    )
                    scratch[env, index].impulse = new
                    apply_step(body_response, velocity_change, scratch, env, index, new - impulse)
                    if wp.static(rolls):
                        row = scratch[env, index].row
                        normal_impulse = wp.dot(new, scratch[env, index].normal)
                        couple = rows[env, row].couple
                        new_couple = project_couple(
                            extrapolated_couple(scratch, env, index, couple, coefficients),
                            scratch[env, index].normal,
                            rows[env, row].rolling * normal_impulse,
                            rows[env, row].spinning * normal_impulse,
                        )
                        rows[env, row].couple = new_couple
                        apply_couple_step(body_response, velocity_change, scratch, env, index, new_couple - couple)

        body = wp.int32(island)
        while body >= 0:
            body_response[env, body].linear = body_response[env, body].linear + velocity_change[env, body].linear
            body_response[env, body].angular = (
                body_response[env, body].angular + velocity_change[env, body].angular
            )
            body = velocity_change[env, body].next_member
        if wp.static(not has_joints):
            if worst <= target and rest_sweeps == sweeps:
                zero_rest_velocities(body_response, velocity_change, scratch, env, island, first, end, rest_sweeps)
        for index in range(first, end):
            row = scratch[env, index].row
            rows[env, row].impulse = scratch[env, index].impulse
            if wp.static(has_fallback):
                if worst <= target:
                    rows[env, row].is_unsolved = 0
                else:
                    rows[env, row].impulse = scratch[env, index].guess
                    if wp.static(rolls):
                        rows[env, row].couple = scratch[env, index].couple_guess
        return worst, sweeps

    @unique_kernel()
    def gauss_seidel(
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
            count = solve_result.count[env]
            if count == 0:
                report_solve(solve_result, env, zero, 0, 1)
                continue
            finite = initialize(rows, body_response, velocity_change, scratch, env, count, tolerance)
            if not wp.isfinite(finite):
                report_solve(solve_result, env, finite, 0, 0)
                continue
            target = tolerance * tolerance
            worst = zero
            worst_solved = zero
            sweeps = wp.int32(0)
            first = wp.int32(0)
            while first < count:
                island = island_of_row(
                    velocity_change, env, scratch[env, first].body_1, scratch[env, first].body_2
                )
                end = velocity_change[env, island].next_row
                island_worst, island_sweeps = solve_island(
                    rows, body_response, velocity_change, scratch, env, island, first, end, tolerance, iterations
                )
                worst = wp.max(worst, island_worst)
                if island_worst <= target:
                    worst_solved = wp.max(worst_solved, island_worst)
                sweeps = wp.max(sweeps, island_sweeps)
                first = end
            if wp.static(has_fallback):
                solve_result.solved_residual[env] = wp.sqrt(worst_solved)
            report_solve(solve_result, env, wp.sqrt(worst), sweeps, wp.where(worst <= target, 1, 0))

    return gauss_seidel
