"""Projected Gauss–Seidel solver: contacts are solved exactly one after another, the others held fixed."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import cone, rest_impulses, solver_common, velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, Struct, first_env, structs, task_count

# States of a block: it is computed on first use, and recomputed with softening after some sweeps.
BLOCK_UNSET, BLOCK_EXACT, BLOCK_SOFTENED = 0, 1, 2
SOFTEN_AFTER = 50
# Softening relative to a third of the trace, for a singular block and for all blocks late in a solve. It shortens
# the update of a row without changing the solution; exact updates can cycle or diverge with strong friction.
SOFTENING, SOFTENING_LATE = 0.02, 0.3
# Fixed-point iterations for the direction of slip before the exact equation is solved.
MAX_SLIP_ITERATIONS = 4
# Number of sweeps without a smaller residual after which a residual of the size of rounding is accepted.
PATIENCE = 50


@functools.cache
def scratch(real: type, rolls: bool) -> Struct:
    """Returns the struct of solver data per row."""
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33

    @wp.struct
    class Scratch:
        block_state: wp.int32  # BLOCK_*: state of ``block``
        rho: real  # effective mass ρ at the contact, 3 over the trace of ``block`` [kg]
        free: vec3  # q, W [m/s]
        inverse: mat33  # of the block, W [kg]
        block: mat33  # w per impulse, (normal, two tangents) [1/kg]
        before: vec3  # impulse before the sweep, W [N·s]
        last_sweep: vec3  # impulse after the previous sweep, W [N·s]
        guess: vec3  # impulse from which a fallback starts, W [N·s]
        if rolls:
            couple_guess: vec3  # couple from which a fallback starts, W [N·m·s]
            turning: vec3  # relative angular velocity without contact, W [rad/s]

    return Scratch


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
            These are the warm start or, for bodies at rest, the impulses of ``rest_impulses.py``.

    The first sweep starts from the warm start in ``rows``. The solve ends after

    - a sweep in which all residuals are within the tolerance, so that no impulse changes,
    - ``PATIENCE`` sweeps without a smaller residual, if the residual is within rounding, or
    - ``iterations`` sweeps.

    In the last two cases a final sweep only evaluates residuals, because those of a sweep that changes impulses
    belong to several states. Far from convergence, a sweep changes impulses without evaluating residuals before.
    Between sweeps impulses are extrapolated with Nesterov's momentum, as in ``accelerated.py``.
    """
    t = structs(real)
    vec3 = t.vec3
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    Scratch = wp.array2d(dtype=scratch(real, rolls))
    c = cone.functions(real)
    basis, open_or_slipping_contact = c.basis, c.open_or_slipping_contact
    f = velocity_update.functions(real, has_joints)
    spin_after, relative_spin_change = (
        velocity_update.relative_velocities(real, has_joints).spin_after,
        f.relative_spin_change,
    )
    velocity_change_at, apply_impulse, apply_row_impulse = (
        f.velocity_change_at,
        f.apply_impulse,
        f.apply_row_impulse,
    )
    angular_response_trace, project_couple = f.angular_response_trace, f.project_couple
    block_of, invert_symmetric, project_onto_cone = f.block, f.invert_symmetric, f.project_onto_cone
    impulse_response, residual_squared = f.impulse_response, f.residual_squared
    if not has_joints:
        rest_functions = rest_impulses.functions(real, scratch(real, rolls))
        at_rest, solve_rest, zero_rest_velocities = (
            rest_functions.at_rest,
            rest_functions.solve_rest,
            rest_functions.zero_rest_velocities,
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
    block_unset, block_softened = wp.constant(BLOCK_UNSET), wp.constant(BLOCK_SOFTENED)
    softening, softening_late = wp.constant(real(SOFTENING)), wp.constant(real(SOFTENING_LATE))
    patience = wp.constant(PATIENCE)
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
    # Change of the direction of slip at which it has converged.
    DIRECTION_TOLERANCE = wp.constant(real(16.0 * float(rounding.eps)))
    # Squared velocity, relative to that of the impulse alone, below which a contact may stick.
    STICK_SPEED = wp.constant(real(0.1))

    @wp.func
    def save_guess(rows: Rows, scratch: Scratch, env: int, count: int):
        """Stores the warm start and initializes the solver data."""
        for row in range(count):
            impulse = rows[env, row].impulse
            scratch[env, row].block_state = block_unset
            scratch[env, row].before = impulse
            scratch[env, row].last_sweep = impulse
            if wp.static(has_fallback):
                scratch[env, row].guess = impulse
                if wp.static(rolls):
                    scratch[env, row].couple_guess = rows[env, row].couple

    @wp.func
    def slip_impulse(
        rows: Rows, body_response: BodyResponse, env: int, row: int, impulse: vec3, w: vec3, rho: real
    ):
        """Returns the impulse of a row that slides, and whether it was found.

        Fixed-point iteration over the slip direction, to which friction is opposite. Not found if the slip is so
        slow that the row may stick, if the row does not approach, if friction almost cancels the normal response,
        or if the direction does not converge.
        """
        n = rows[env, row].normal
        slip = w - wp.dot(w, n) * n
        speed_squared = wp.length_sq(slip)
        if rho * rho * speed_squared <= wp.length_sq(impulse):
            return impulse, 0
        mu = rows[env, row].mu
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        free = (
            w
            - impulse_response(body_response, env, body_1, arm_1, impulse)
            - impulse_response(body_response, env, body_2, arm_2, impulse)
        )
        if wp.static(is_soft):
            free -= soft_velocity(rows, env, row, impulse)
        previous_direction = slip / wp.sqrt(speed_squared)
        for _ in range(MAX_SLIP_ITERATIONS):
            along = n - mu * previous_direction
            response = impulse_response(body_response, env, body_1, arm_1, along) + impulse_response(
                body_response, env, body_2, arm_2, along
            )
            if wp.static(is_soft):
                response += soft_velocity(rows, env, row, along)
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
        rows: Rows,
        body_response: BodyResponse,
        scratch: Scratch,
        env: int,
        row: int,
        impulse: vec3,
        w: vec3,
        block_state: int,
    ):
        """Returns the impulse that solves a row alone, from its current impulse and velocity ``w``, W."""
        n = rows[env, row].normal
        mu = rows[env, row].mu
        across_1, across_2 = basis(n)
        if scratch[env, row].block_state != block_state:
            scratch[env, row].block_state = block_state
            rho = scratch[env, row].rho
            W = block_of(body_response, env, rows[env, row].body_1, rows[env, row].arm_1)
            W += block_of(body_response, env, rows[env, row].body_2, rows[env, row].arm_2)
            if wp.static(is_soft):
                W += rows[env, row].softness * wp.outer(n, n)
            inverse, invertible = invert_symmetric(W)
            if rho > zero and (block_state == block_softened or invertible == 0):
                added = wp.where(block_state == block_softened, softening_late, softening) / rho
                W += wp.diag(vec3(added, added, added))
                inverse, invertible = invert_symmetric(W)
            R = wp.matrix_from_cols(n, across_1, across_2)
            scratch[env, row].block = wp.transpose(R) * W * R
            scratch[env, row].inverse = inverse
        # Without slip, if the cone admits it.
        new = impulse - scratch[env, row].inverse * w
        along = wp.dot(new, n)
        if along >= zero and wp.length_sq(new) <= (one + mu * mu) * along * along:
            return new
        W = scratch[env, row].block
        local = vec3(wp.dot(impulse, n), wp.dot(impulse, across_1), wp.dot(impulse, across_2))
        b = vec3(wp.dot(w, n), wp.dot(w, across_1), wp.dot(w, across_2)) - W * local
        local = open_or_slipping_contact(W, b, mu)
        return local[0] * n + local[1] * across_1 + local[2] * across_2

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

            clear_change(velocity_change, env)
            finite = zero  # finite only if all terms are
            for row in range(count):
                free, rho, _trace, size = initialize_row(rows, body_response, velocity_change, env, row, tolerance)
                finite += size
                scratch[env, row].rho = rho
                scratch[env, row].free = free
                if wp.static(rolls):
                    turning = spin_after(body_response, env, rows[env, row].body_1, rows[env, row].body_2)
                    scratch[env, row].turning = turning
            if not wp.isfinite(finite):
                report_solve(solve_result, env, finite, 0, 0)
                continue
            spread_speed_scale(rows, velocity_change, env, count)

            target = tolerance * tolerance
            worst = zero
            smallest_residual = LARGEST
            theta = one
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
                save_guess(rows, scratch, env, count)
            rest_tolerance = zero
            if wp.static(not has_joints):
                # Resting bodies stay at rest, except for impulses of the last step that would now push them back.
                if at_rest(body_response, velocity_change, env) == 1:
                    rest_tolerance = REST_TOLERANCE * REST_TOLERANCE
            # unchecked: this sweep changes all rows without evaluating their residuals before.
            # final_sweep: this sweep only evaluates.
            # rest_tried: ``solve_rest`` has run, or is not tried any more.
            # rest_solved: ``solve_rest`` has changed the impulses, so the next sweep starts.
            # rest_sweeps: 1 after that; equal to ``sweeps`` if no other sweep changed impulses.
            # guess_saved: the impulses before the first sweep are stored, and the data of the rows initialized.
            unchecked = wp.int32(0)
            block_state = wp.int32(BLOCK_EXACT)
            while True:
                worst = zero
                uphill = zero
                changes = unchecked
                rest_solved = wp.int32(0)
                for row in range(count):
                    body_1 = rows[env, row].body_1
                    body_2 = rows[env, row].body_2
                    arm_1 = rows[env, row].arm_1
                    arm_2 = rows[env, row].arm_2
                    n = rows[env, row].normal
                    mu = rows[env, row].mu
                    rho = scratch[env, row].rho
                    impulse = rows[env, row].impulse
                    scale = wp.max(
                        residual_scale(velocity_change, env, body_1, body_2, rho), wp.length_sq(impulse)
                    )
                    w = scratch[env, row].free + velocity_change_at(velocity_change, env, body_1, arm_1)
                    w -= velocity_change_at(velocity_change, env, body_2, arm_2)
                    if wp.static(is_soft):
                        w += soft_velocity(rows, env, row, impulse)
                    residual = zero  # squared and relative
                    if unchecked == 0:
                        residual = residual_squared(impulse, w, n, mu, rho) / scale
                        worst = wp.max(worst, residual)
                    if wp.static(not has_joints):
                        if rest_tried == 0 and residual > rest_tolerance:
                            # Before any change.
                            rest_tried = 1
                            if rho * rho * wp.length_sq(w) < STICK_SPEED * wp.length_sq(impulse):
                                rest_solved = solve_rest(rows, body_response, velocity_change, scratch, env, count)
                            if rest_solved == 1:
                                break
                    if guess_saved == 0 and residual > target:
                        guess_saved = 1
                        save_guess(rows, scratch, env, count)
                    if unchecked == 1 or (
                        final_sweep == 0
                        and (
                            residual > target
                            or (changes > 0 and residual > KEEP_FRACTION * KEEP_FRACTION * target)
                        )
                    ):
                        changes += 1
                        slips = wp.int32(0)
                        new = impulse
                        if sweeps == 0:
                            new, slips = slip_impulse(rows, body_response, env, row, impulse, w, rho)
                        if slips == 0:
                            new = exact_impulse(rows, body_response, scratch, env, row, impulse, w, block_state)
                        if rho > zero:
                            gradient = scratch[env, row].before - new
                            uphill += wp.dot(gradient, new - scratch[env, row].last_sweep) / rho
                        step = new - impulse
                        if unchecked == 1:
                            worst = wp.max(worst, wp.length_sq(step) / scale)
                        rows[env, row].impulse = new
                        apply_row_impulse(rows, body_response, velocity_change, env, row, step)
                        impulse = new
                    if wp.static(rolls):
                        trace = angular_response_trace(body_response, env, body_1) + angular_response_trace(
                            body_response, env, body_2
                        )
                        if trace > zero:
                            turning = scratch[env, row].turning + relative_spin_change(
                                velocity_change, env, body_1, body_2
                            )
                            normal_impulse = wp.max(wp.dot(impulse, n), zero)
                            couple = rows[env, row].couple
                            new = project_couple(
                                couple - three / trace * turning,
                                n,
                                rows[env, row].rolling * normal_impulse,
                                rows[env, row].spinning * normal_impulse,
                            )
                            step = new - couple
                            # As an impulse: divided by the arm at which force and couple have the same mobility.
                            residual = rho * trace / three * wp.length_sq(step) / scale
                            worst = wp.max(worst, residual)
                            if final_sweep == 0 and (
                                residual > target
                                or (changes > 0 and residual > KEEP_FRACTION * KEEP_FRACTION * target)
                            ):
                                changes += 1
                                rows[env, row].couple = new
                                apply_impulse(body_response, velocity_change, env, body_1, vec3(), step)
                                apply_impulse(body_response, velocity_change, env, body_2, vec3(), -step)
                if rest_solved == 1:
                    sweeps += 1
                    rest_sweeps = wp.int32(1)
                    final_sweep = wp.where(sweeps >= iterations, 1, 0)
                    continue
                rest_tried = 1
                if changes == 0:
                    break
                sweeps += 1
                if sweeps == SOFTEN_AFTER:
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

                # A sweep is a descent step. Restart the momentum if it leads uphill.
                if uphill > zero:
                    theta = one
                theta, beta = nesterov_step(theta)
                for row in range(count):
                    last_sweep = rows[env, row].impulse
                    new = last_sweep
                    if beta > zero:
                        n = rows[env, row].normal
                        new = project_onto_cone(
                            last_sweep + beta * (last_sweep - scratch[env, row].last_sweep), n, rows[env, row].mu
                        )
                        rows[env, row].impulse = new
                        step = new - last_sweep
                        apply_row_impulse(rows, body_response, velocity_change, env, row, step)
                    scratch[env, row].before = new
                    scratch[env, row].last_sweep = last_sweep

            apply_change(body_response, velocity_change, env)
            if wp.static(not has_joints):
                if worst <= target and rest_sweeps == sweeps:
                    zero_rest_velocities(rows, body_response, velocity_change, env, count, rest_sweeps)
            if wp.static(has_fallback):
                if worst > target:
                    for row in range(count):
                        rows[env, row].impulse = scratch[env, row].guess
                        if wp.static(rolls):
                            rows[env, row].couple = scratch[env, row].couple_guess
            report_solve(solve_result, env, wp.sqrt(worst), sweeps, wp.where(worst <= target, 1, 0))

    return gauss_seidel
