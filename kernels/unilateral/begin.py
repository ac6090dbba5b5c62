"""How solves begin, go on and end, and by what residuals are measured: common to the solvers of a step.

The residual of a row is how far its impulse P is from its law, over the larger of |P| and ρ V: ρ is the mass that
the contact feels, and V the largest relative velocity without contact, |q|, of the contacts that bodies connect
with it. So a light body beside a heavy one, or on it, is looked at as closely as the heavy one.
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp
from warpcontact.kernels.types import structs
from warpcontact.kernels.unilateral import impulses, relative
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs


@functools.cache
def functions(real: type, moves: bool, rolls: bool) -> SimpleNamespace:
    """Returns the device functions for ``real``; with ``moves`` not all bodies are free.

    With ``rolls`` some contacts oppose rolling or spinning.
    """
    t = structs(real)
    vec3 = t.vec3
    Rows, Outcome = row_structs(real).Rows, row_structs(real).Outcome
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    Change = wp.array2d(dtype=impulses.change_struct(real))
    f = impulses.functions(real, moves)
    push_both, ease, turning_ease = f.push_both, f.ease, f.turning_ease
    between = relative.functions(real, moves)
    velocity, spin = between.after, between.spin_after
    zero, half, one, three, four = (wp.constant(real(x)) for x in (0.0, 0.5, 1.0, 3.0, 4.0))
    # Of a velocity over that of the guess: what rounding of the guess may leave.
    ROUNDING = wp.constant(real(4.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))
    LEAST = wp.constant(real(float(np.finfo(wp.dtype_to_numpy(real)).tiny)))

    @wp.func
    def hasten(change: Change, env: int, body: int, squared: real, ease_of_it: real):
        if body >= 0:
            before = change[env, body].speed_squared
            if ease_of_it > zero:
                change[env, body].speed_squared = wp.max(before, squared)
            elif before == zero:
                # What does not move connects nothing.
                change[env, body].speed_squared = -one

    @wp.func
    def clear(change: Change, env: int):
        """Nothing has changed."""
        for body in range(change.shape[1]):
            change[env, body].linear = vec3()
            change[env, body].angular = vec3()
            change[env, body].speed_squared = zero

    @wp.func
    def begin(rows: Rows, moving: Moving, change: Change, env: int, row: int, tolerance: real):
        """Gives bodies the guess of a row. Returns q, ρ, the trace of its block, and what is finite if both are.

        Where nothing moves ρ is 0, and so is what the row may carry.
        """
        one_body = rows[env, row].body_1
        other = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        free = velocity(moving, env, one_body, other, arm_1, arm_2)
        free -= wp.max(rows[env, row].bounce, rows[env, row].recovery) * rows[env, row].normal
        one_ease = ease(moving, env, one_body, arm_1)
        other_ease = ease(moving, env, other, arm_2)
        trace = one_ease + other_ease
        rho = zero
        impulse = vec3()
        squared = wp.length_sq(free)
        if trace > zero:
            rho = three / trace
            impulse = rows[env, row].impulse
            noise = ROUNDING / (three * tolerance) * trace
            squared = wp.max(squared, noise * noise * wp.length_sq(impulse))
        rows[env, row].impulse = impulse
        turn_1 = wp.cross(arm_1, impulse)
        turn_2 = wp.cross(arm_2, impulse)
        if wp.static(rolls):
            couple = vec3()
            turning_trace = turning_ease(moving, env, one_body) + turning_ease(moving, env, other)
            if turning_trace > zero and rho > zero:
                couple = rows[env, row].couple
                if rows[env, row].rolling + rows[env, row].spinning > zero:
                    turning = spin(moving, env, one_body, other)
                    squared = wp.max(squared, trace / turning_trace * wp.length_sq(turning))
            rows[env, row].couple = couple
            turn_1 += couple
            turn_2 += couple
        push_both(moving, change, env, one_body, other, impulse, turn_1, -turn_2)
        hasten(change, env, one_body, squared, one_ease)
        hasten(change, env, other, squared, other_ease)
        return free, rho, trace, wp.length_sq(free) + wp.length_sq(impulse)

    @wp.func
    def spread(rows: Rows, change: Change, env: int, count: int):
        """Lets bodies that are connected by contacts have the same V."""
        step = wp.int32(1)
        changed = wp.int32(1)
        while changed == 1:
            changed = wp.int32(0)
            row = wp.where(step > 0, 0, count - 1)
            for _ in range(count):
                one_body = rows[env, row].body_1
                other = rows[env, row].body_2
                row += step
                if one_body >= 0 and other >= 0:
                    squared = change[env, one_body].speed_squared
                    other_squared = change[env, other].speed_squared
                    if squared >= zero and other_squared >= zero and squared != other_squared:
                        changed = 1
                        squared = wp.max(squared, other_squared)
                        change[env, one_body].speed_squared = squared
                        change[env, other].speed_squared = squared
            step = -step

    @wp.func
    def scale(change: Change, env: int, one_body: int, other: int, rho: real):
        """(ρ V)² of a row between two bodies [N²·s²]."""
        squared = zero
        if one_body >= 0:
            squared = change[env, one_body].speed_squared
        if other >= 0:
            squared = wp.max(squared, change[env, other].speed_squared)
        return wp.max(rho * rho * squared, LEAST)

    @wp.func
    def momentum(theta: real):
        """Nesterov's: the next θ, and the share of the last step by which impulses go on."""
        after = half * theta * (wp.sqrt(theta * theta + four) - theta)
        return after, theta * (one - theta) / (theta * theta + after)

    @wp.func
    def take(moving: Moving, change: Change, env: int):
        """Adds what has changed to the velocities."""
        for body in range(change.shape[1]):
            moving[env, body].linear = moving[env, body].linear + change[env, body].linear
            moving[env, body].angular = moving[env, body].angular + change[env, body].angular

    @wp.func
    def report(outcome: Outcome, env: int, residual: real, iterations: int, converged: int):
        """Says how a solve went."""
        outcome.residual[env] = residual
        outcome.iterations[env] = iterations
        outcome.converged[env] = converged

    return SimpleNamespace(
        clear=clear, begin=begin, spread=spread, scale=scale, momentum=momentum, take=take, report=report
    )
