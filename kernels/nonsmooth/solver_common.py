"""Initialization, acceleration, residuals and results shared by the solvers of a step.

The residual of a row is the violation of the contact law by its impulse P, relative to the larger of |P| and ρ V.
ρ is the effective mass at the contact [kg]. V is the largest relative velocity without contact, |q|, among the
contacts connected to it by bodies. So contacts of a light body next to a heavy one are as accurate as those of the
heavy one.
"""

import functools
from typing import NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel.warps import lane, lane_count
from warpcontact.kernels.nonsmooth import velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import structs


class Functions(NamedTuple):
    """Device functions that the solvers of a step share."""

    clear_change: wp.Function  # sets all velocity changes to zero
    separation_speed: wp.Function  # least separation speed of a row after the step [m/s]
    evaluate_row: wp.Function  # ``RowData`` of a row before a solve, whose impulse becomes 0 without mobility
    update_speed_scale: wp.Function  # raises V² of a body to that of a row, given the response of the body
    initialize_row: wp.Function  # likewise, and applies its warm start
    soft_velocity: wp.Function  # velocity of a row by its own compliance, W [m/s]
    spread_speed_scale: wp.Function  # assigns the same V to all bodies connected by contacts
    residual_scale: wp.Function  # (ρ V)² of a row between two bodies [N²·s²]
    nesterov_step: wp.Function  # next θ of Nesterov's method, and the factor for extrapolation
    apply_change: wp.Function  # adds the velocity changes to the velocities
    report_solve: wp.Function  # writes the result of a solve


@functools.cache
def functions(real: type, has_joints: bool, rolls: bool, is_soft: bool = False) -> Functions:
    """Returns the device functions for ``real``; with ``has_joints`` some bodies have joints.

    With ``rolls`` some contacts have rolling or spinning resistance, with ``is_soft`` some have a compliance.
    """
    t = structs(real)
    vec3 = t.vec3
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    f = velocity_update.functions(real, has_joints)
    apply_impulse_pair, response_trace, angular_response_trace = (
        f.apply_impulse_pair,
        f.response_trace,
        f.angular_response_trace,
    )
    between = velocity_update.relative_velocities(real, has_joints)
    velocity, spin = between.after, between.spin_after
    zero, half, one, three, four = (wp.constant(real(x)) for x in (0.0, 0.5, 1.0, 3.0, 4.0))
    # Velocity over that of the warm start: rounding error of the warm start.
    ROUNDING = wp.constant(real(4.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))
    TINY = wp.constant(real(float(np.finfo(wp.dtype_to_numpy(real)).tiny)))

    @wp.func
    def update_speed_scale(
        velocity_change: VelocityChange, env: int, body: int, speed_squared: real, response: real
    ):
        if body >= 0:
            before = velocity_change[env, body].speed_squared
            if response > zero:
                velocity_change[env, body].speed_squared = wp.max(before, speed_squared)
            elif before == zero:
                # A body without mobility connects no contacts.
                velocity_change[env, body].speed_squared = -one

    @wp.func
    def clear_change(velocity_change: VelocityChange, env: int):
        """Sets all velocity changes to zero."""
        for body in range(velocity_change.shape[1]):
            velocity_change[env, body].linear = vec3()
            velocity_change[env, body].angular = vec3()
            velocity_change[env, body].speed_squared = zero

    @wp.func
    def separation_speed(rows: Rows, env: int, row: int):
        """Returns the least separation speed of a row after the step; negative for an open contact [m/s]."""
        speed = rows[env, row].recovery
        if rows[env, row].restitution_speed > zero:
            speed = wp.max(rows[env, row].restitution_speed, speed)
        return speed

    @wp.struct
    class RowData:
        """A row before a solve."""

        free: vec3  # q, W [m/s]
        rho: real  # effective mass ρ; 0 without mobility [kg]
        trace: real  # of its block [1/kg]
        response_1: real  # part of the trace by the first body [1/kg]
        response_2: real  # likewise by the second body
        speed_squared: real  # V² of the row alone [m²/s²]
        size: real  # finite if q and the impulse are

    @wp.func
    def evaluate_row(rows: Rows, body_response: BodyResponse, env: int, row: int, tolerance: real):
        """Returns the ``RowData`` of a row. Without mobility its impulse and couple become 0."""
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        free = velocity(body_response, env, body_1, body_2, arm_1, arm_2)
        free -= separation_speed(rows, env, row) * rows[env, row].normal
        response_1 = response_trace(body_response, env, body_1, arm_1)
        response_2 = response_trace(body_response, env, body_2, arm_2)
        trace = response_1 + response_2
        rho = zero
        impulse = vec3()
        speed_squared = wp.length_sq(free)
        if trace > zero:
            rho = three / trace
            impulse = rows[env, row].impulse
            guess_rounding = ROUNDING / (three * tolerance) * trace
            speed_squared = wp.max(speed_squared, guess_rounding * guess_rounding * wp.length_sq(impulse))
        rows[env, row].impulse = impulse
        if wp.static(rolls):
            couple = vec3()
            turning_trace = angular_response_trace(body_response, env, body_1) + angular_response_trace(
                body_response, env, body_2
            )
            if turning_trace > zero and rho > zero:
                couple = rows[env, row].couple
                if rows[env, row].rolling + rows[env, row].spinning > zero:
                    turning = spin(body_response, env, body_1, body_2)
                    speed_squared = wp.max(speed_squared, trace / turning_trace * wp.length_sq(turning))
            rows[env, row].couple = couple
        data = RowData()
        data.free = free
        data.rho = rho
        data.trace = trace
        data.response_1 = response_1
        data.response_2 = response_2
        data.speed_squared = speed_squared
        data.size = wp.length_sq(free) + wp.length_sq(impulse)
        return data

    @wp.func
    def initialize_row(
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        env: int,
        row: int,
        tolerance: real,
    ):
        """Applies the warm start of a row, and returns its ``RowData``."""
        data = evaluate_row(rows, body_response, env, row, tolerance)
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        impulse = rows[env, row].impulse
        turn_1 = wp.cross(rows[env, row].arm_1, impulse)
        turn_2 = wp.cross(rows[env, row].arm_2, impulse)
        if wp.static(rolls):
            turn_1 += rows[env, row].couple
            turn_2 += rows[env, row].couple
        apply_impulse_pair(body_response, velocity_change, env, body_1, body_2, impulse, turn_1, -turn_2)
        update_speed_scale(velocity_change, env, body_1, data.speed_squared, data.response_1)
        update_speed_scale(velocity_change, env, body_2, data.speed_squared, data.response_2)
        return data

    @wp.func
    def soft_velocity(rows: Rows, env: int, row: int, impulse: vec3):
        """Returns the velocity of a row by its own compliance; 0 without ``is_soft``, W [m/s]."""
        if wp.static(not is_soft):
            return vec3()
        n = rows[env, row].normal
        return (rows[env, row].softness * wp.dot(impulse, n)) * n

    @wp.func
    def spread_speed_scale(rows: Rows, velocity_change: VelocityChange, env: int, count: int):
        """Assigns the same V to all bodies connected by contacts."""
        step = wp.int32(1)
        changed = wp.int32(1)
        while changed == 1:
            changed = wp.int32(0)
            row = wp.where(step > 0, 0, count - 1)
            for _ in range(count):
                body_1 = rows[env, row].body_1
                body_2 = rows[env, row].body_2
                row += step
                if body_1 >= 0 and body_2 >= 0:
                    speed_squared = velocity_change[env, body_1].speed_squared
                    speed_squared_2 = velocity_change[env, body_2].speed_squared
                    if speed_squared >= zero and speed_squared_2 >= zero and speed_squared != speed_squared_2:
                        changed = 1
                        speed_squared = wp.max(speed_squared, speed_squared_2)
                        velocity_change[env, body_1].speed_squared = speed_squared
                        velocity_change[env, body_2].speed_squared = speed_squared
            step = -step

    @wp.func
    def residual_scale(velocity_change: VelocityChange, env: int, body_1: int, body_2: int, rho: real):
        """Returns (ρ V)² of a row between two bodies [N²·s²]."""
        speed_squared = zero
        if body_1 >= 0:
            speed_squared = velocity_change[env, body_1].speed_squared
        if body_2 >= 0:
            speed_squared = wp.max(speed_squared, velocity_change[env, body_2].speed_squared)
        return wp.max(rho * rho * speed_squared, TINY)

    @wp.func
    def nesterov_step(theta: real):
        """Returns the next θ of Nesterov's method, and the factor on the last step for extrapolation."""
        after = half * theta * (wp.sqrt(theta * theta + four) - theta)
        return after, theta * (one - theta) / (theta * theta + after)

    @wp.func
    def apply_change(body_response: BodyResponse, velocity_change: VelocityChange, env: int):
        """Adds the velocity changes to the velocities; the lanes of a warp share the bodies."""
        for body in range(lane(), velocity_change.shape[1], lane_count()):
            body_response[env, body].linear = body_response[env, body].linear + velocity_change[env, body].linear
            body_response[env, body].angular = (
                body_response[env, body].angular + velocity_change[env, body].angular
            )

    @wp.func
    def report_solve(solve_result: SolveResult, env: int, residual: real, iterations: int, converged: int):
        """Writes the result of a solve."""
        solve_result.residual[env] = residual
        solve_result.iterations[env] = iterations
        solve_result.converged[env] = converged

    return Functions(
        clear_change=clear_change,
        separation_speed=separation_speed,
        evaluate_row=evaluate_row,
        update_speed_scale=update_speed_scale,
        initialize_row=initialize_row,
        soft_velocity=soft_velocity,
        spread_speed_scale=spread_speed_scale,
        residual_scale=residual_scale,
        nesterov_step=nesterov_step,
        apply_change=apply_change,
        report_solve=report_solve,
    )
