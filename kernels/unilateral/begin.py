"""How solves begin, and by what their residuals are measured: common to the solvers of a step.

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
from warpcontact.kernels.unilateral.rows import row_structs


@functools.cache
def functions(real: type, moves: bool, rolls: bool) -> SimpleNamespace:
    """Returns the device functions for ``real``; with ``moves`` not all bodies are free.

    With ``rolls`` some contacts oppose rolling or spinning.
    """
    t = structs(real)
    vec3 = t.vec3
    r = row_structs(real)
    Rows, Moving = r.Rows, r.Moving
    Change = impulses.change_struct(real)
    f = impulses.functions(real, moves)
    push, ease, turning_ease = f.push, f.ease, f.turning_ease
    between = relative.functions(real)
    velocity, spin = between.after, between.spin
    zero, one, three = (wp.constant(real(x)) for x in (0.0, 1.0, 3.0))
    # Of a velocity over that of the guess: what rounding of the guess may leave.
    ROUNDING = wp.constant(real(4.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))
    LEAST = wp.constant(real(float(np.finfo(wp.dtype_to_numpy(real)).tiny)))

    @wp.func
    def hasten(change: Change, env: int, body: int, squared: real, ease_of_it: real):
        if body >= 0:
            before = change.speed_squared[env, body]
            if ease_of_it > zero:
                change.speed_squared[env, body] = wp.max(before, squared)
            elif before == zero:
                # What does not move connects nothing.
                change.speed_squared[env, body] = -one

    @wp.func
    def begin(rows: Rows, moving: Moving, change: Change, env: int, row: int, tolerance: real):
        """Gives bodies the guess of a row. Returns q, ρ, the trace of its block, and what is finite if both are.

        Where nothing moves ρ is 0, and so is what the row may carry.
        """
        one_body = rows.body_1[env, row]
        other = rows.body_2[env, row]
        arm_1 = rows.arm_1[env, row]
        arm_2 = rows.arm_2[env, row]
        free = velocity(moving, env, one_body, other, arm_1, arm_2)
        free -= wp.max(rows.bounce[env, row], rows.recovery[env, row]) * rows.normal[env, row]
        one_ease = ease(moving, env, one_body, arm_1)
        other_ease = ease(moving, env, other, arm_2)
        trace = one_ease + other_ease
        rho = zero
        impulse = vec3()
        squared = wp.length_sq(free)
        if trace > zero:
            rho = three / trace
            impulse = rows.impulse[env, row]
            noise = ROUNDING / (tolerance * rho)
            squared = wp.max(squared, noise * noise * wp.length_sq(impulse))
        rows.impulse[env, row] = impulse
        turn_1 = wp.cross(arm_1, impulse)
        turn_2 = wp.cross(arm_2, impulse)
        if wp.static(rolls):
            couple = vec3()
            turning_trace = turning_ease(moving, env, one_body) + turning_ease(moving, env, other)
            if turning_trace > zero and rho > zero:
                couple = rows.couple[env, row]
                if rows.rolling[env, row] + rows.spinning[env, row] > zero:
                    turning = spin(moving.angular, env, one_body, other)
                    squared = wp.max(squared, trace / turning_trace * wp.length_sq(turning))
            rows.couple[env, row] = couple
            turn_1 += couple
            turn_2 += couple
        push(moving, change, env, one_body, impulse, turn_1)
        push(moving, change, env, other, -impulse, -turn_2)
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
                one_body = rows.body_1[env, row]
                other = rows.body_2[env, row]
                row += step
                if one_body >= 0 and other >= 0:
                    squared = change.speed_squared[env, one_body]
                    other_squared = change.speed_squared[env, other]
                    if squared >= zero and other_squared >= zero and squared != other_squared:
                        changed = 1
                        squared = wp.max(squared, other_squared)
                        change.speed_squared[env, one_body] = squared
                        change.speed_squared[env, other] = squared
            step = -step

    @wp.func
    def scale(rows: Rows, change: Change, env: int, row: int, rho: real):
        """(ρ V)² of a row."""
        squared = zero
        one_body = rows.body_1[env, row]
        other = rows.body_2[env, row]
        if one_body >= 0:
            squared = change.speed_squared[env, one_body]
        if other >= 0:
            squared = wp.max(squared, change.speed_squared[env, other])
        return wp.max(rho * rho * squared, LEAST)

    return SimpleNamespace(begin=begin, spread=spread, scale=scale)
