"""Distribution of loads between the contacts of two bodies, where equilibrium does not determine it.

With more than three points between two bodies, or with guided bodies, several sets of impulses give the same motion, but
their friction cones do not admit the same loads: a pad whose load is at one point does not resist spin. Gauss–Seidel
loads the contacts that it solves first. Gradient steps from zero change impulses by what velocities require only, so
they lead to a solution near the one of least norm. The impulses are then carried over from step to step.

So the warm starts of two bodies with several contacts of similar normals are cleared if one of these contacts is new, or
violates the contact law by more than ``MAX_RESIDUAL`` although the last solve converged, as after an impact.
``START_ITERATIONS`` steps of ``accelerated.py`` then precede the first sweep and change these impulses only. Other pairs
keep their warm starts.
"""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import solver_common, velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, first_env, structs, task_count

#: Accelerated steps before the first sweep. 5 steps leave differences of 2 % between the loads of four points in a plane, 20
#: steps 0.1 %.
START_ITERATIONS = 20
#: Residual of the warm start, relative to that without impulses, above which it is cleared.
MAX_RESIDUAL = 0.5


@functools.cache
def clear_warm_starts(real: type, has_joints: bool, rolls: bool, is_soft: bool = False) -> wp.Kernel:
    """Returns the kernel that clears warm starts of pairs of bodies whose loads are shared again; items: 1.

    With ``has_joints`` some bodies have joints, with ``rolls`` some contacts have rolling or spinning resistance, with
    ``is_soft`` some have a compliance.
    """
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    vec3 = structs(real).vec3
    common = solver_common.functions(real, has_joints, rolls, is_soft)
    clear_change, initialize_row, soft_velocity, spread_speed_scale, residual_scale, separation_speed = (
        common.clear_change,
        common.initialize_row,
        common.soft_velocity,
        common.spread_speed_scale,
        common.residual_scale,
        common.separation_speed,
    )
    f = velocity_update.functions(real, has_joints)
    velocity_change_at, residual_squared, response_trace = (
        f.velocity_change_at,
        f.residual_squared,
        f.response_trace,
    )
    velocity_after = velocity_update.relative_velocities(real, has_joints).after
    zero, three = wp.constant(real(0.0)), wp.constant(real(3.0))
    SAME_SIDE = wp.constant(real(0.5))
    LARGEST = wp.constant(real(MAX_RESIDUAL * MAX_RESIDUAL))

    @wp.func
    def share_load(rows: Rows, env: int, row: int, other_row: int):
        """Returns whether two rows are between the same bodies, with normals less than 60° apart."""
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        along = wp.dot(rows[env, row].normal, rows[env, other_row].normal)
        if body_1 == rows[env, other_row].body_1 and body_2 == rows[env, other_row].body_2:
            return along > SAME_SIDE
        if body_1 == rows[env, other_row].body_2 and body_2 == rows[env, other_row].body_1:
            return along < -SAME_SIDE
        return False

    @wp.func
    def violates(rows: Rows, body_response: BodyResponse, velocity_change: VelocityChange, env: int, row: int):
        """Returns whether the warm start of a row violates the contact law by more than ``MAX_RESIDUAL``."""
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        trace = response_trace(body_response, env, body_1, arm_1) + response_trace(
            body_response, env, body_2, arm_2
        )
        if trace <= zero:
            return False
        n = rows[env, row].normal
        w = velocity_after(body_response, env, body_1, body_2, arm_1, arm_2)
        w += velocity_change_at(velocity_change, env, body_1, arm_1)
        w -= velocity_change_at(velocity_change, env, body_2, arm_2)
        w -= separation_speed(rows, env, row) * n
        if wp.static(is_soft):
            w += soft_velocity(rows, env, row, rows[env, row].impulse)
        rho = three / trace
        residual = residual_squared(rows[env, row].impulse, w, n, rows[env, row].mu, rho)
        return residual > LARGEST * residual_scale(velocity_change, env, body_1, body_2, rho)

    @unique_kernel()
    def clear_pairs(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        rows: Rows,
        body_response: BodyResponse,
        solve_result: SolveResult,
        velocity_change: VelocityChange,
        tolerance: real,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            count = solve_result.count[env]
            clear_change(velocity_change, env)
            for row in range(count):
                initialize_row(rows, body_response, velocity_change, env, row, tolerance)
            spread_speed_scale(rows, velocity_change, env, count)
            for row in range(count):
                # Impulses of a solve that did not converge are improved in the next step.
                if rows[env, row].is_new == 0 and solve_result.converged[env] == 1:
                    if violates(rows, body_response, velocity_change, env, row):
                        rows[env, row].is_new = 1
            cleared = wp.int32(0)
            for row in range(count):
                rows[env, row].is_unsolved = 0
            for row in range(count):
                if rows[env, row].is_new == 0:
                    continue
                for other_row in range(count):
                    if other_row != row and share_load(rows, env, row, other_row):
                        cleared = 1
                        rows[env, other_row].is_unsolved = 1
                        rows[env, other_row].impulse = vec3()
                        rows[env, other_row].couple = vec3()
            solve_result.was_cleared[env] = cleared

    return clear_pairs
