"""What stands: the impulses that stop all bodies at once, where friction can hold every contact.

Several feet share a load, and sweeps from one to the next take long to agree. Yet where nothing slides it is known
what each body needs: the impulse that takes its velocity away. It comes from the contacts with one other body or
with the world, is shared among them with the least change, or as they are loaded, and the other body needs as much
more. So impulses pass from the last bodies on to the first, and there is nothing to repeat. Their sum is right to
rounding: in the next steps nothing is left to do, where sweeps would leave what grows from step to step.
"""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp
from warpcontact.kernels.types import structs
from warpcontact.kernels.unilateral import impulses
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs


@functools.cache
def functions(real: type, Scratch: type) -> SimpleNamespace:
    """Returns the device functions for ``real``, where all bodies are free.

    ``at_rest(moving, change, env)``: whether nothing that touches anything moved before the step.

    ``stand(rows, moving, change, scratch, env, count)`` lets all bodies stand that touch anything. It returns 1 if
    they can, and else 0, with nothing changed: of two bodies that touch, the one with the larger number has to
    stand on the other, and on nothing else; their contacts have to lie side by side in the rows, and not in a
    line.
    ``Scratch`` is the struct of a row, of which it overwrites ``before`` and ``swept`` by the impulse.

    ``settle(rows, moving, change, env, count, stands)`` takes, after a solve, what rounding leaves of the velocity
    of bodies that stand, and of those that were at rest: what is at rest stays there.
    """
    vec3, mat33 = structs(real).vec3, structs(real).mat33
    Rows = row_structs(real).Rows
    Moving = wp.array2d(dtype=moving_struct(real, False))
    Change = wp.array2d(dtype=impulses.change_struct(real))
    Scratches = wp.array2d(dtype=Scratch)
    f = impulses.functions(real, False)
    inverse_of, push = f.inverse_of, f.push
    # Of a velocity over that without contact: what rounding of impulses leaves.
    ROUNDING = wp.constant(real(16.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))
    ROUNDED_UP = wp.constant(real(1.0 + 4.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))
    zero, one, three = (wp.constant(real(x)) for x in (0.0, 1.0, 3.0))

    @wp.func
    def at_rest(moving: Moving, change: Change, env: int):
        for body in range(change.shape[1]):
            if change[env, body].speed_squared != zero and moving[env, body].still == 0:
                return 0
        return 1

    @wp.func
    def weight(rows: Rows, env: int, row: int, by_load: int):
        """How much of what its body needs a row takes, beside others."""
        return wp.where(by_load == 1, wp.dot(rows[env, row].impulse, rows[env, row].normal), one)

    @wp.func
    def spread_out(
        rows: Rows,
        change: Change,
        scratch: Scratches,
        env: int,
        first: int,
        last: int,
        body: int,
        by_load: int,
    ):
        """Puts what rows carry to stop ``body`` into ``before``; returns whether they can, and the couple.

        That is the one of the added impulses on the other body, about its centre of mass.
        """
        total = zero
        middle = vec3()
        for row in range(first, last):
            part = weight(rows, env, row, by_load)
            total += part
            middle += part * wp.where(rows[env, row].body_1 == body, rows[env, row].arm_1, rows[env, row].arm_2)
        turning = vec3()
        if total <= zero:
            return 0, turning
        middle /= total
        over = one / total
        spread = mat33()
        for row in range(first, last):
            arm = wp.where(rows[env, row].body_1 == body, rows[env, row].arm_1, rows[env, row].arm_2) - middle
            size = wp.length_sq(arm)
            part = over * weight(rows, env, row, by_load)
            spread += part * (wp.diag(vec3(size, size, size)) - wp.outer(arm, arm))
        inverse, invertible = inverse_of(spread)
        if invertible == 0:
            return 0, turning
        impulse = change[env, body].needs
        turn = inverse * (change[env, body].needs_turning - wp.cross(middle, impulse))
        for row in range(first, last):
            arm = rows[env, row].arm_1
            arm_of_other = rows[env, row].arm_2
            sign = one
            if rows[env, row].body_1 != body:
                arm = rows[env, row].arm_2
                arm_of_other = rows[env, row].arm_1
                sign = -one
            added = over * weight(rows, env, row, by_load) * (impulse + wp.cross(turn, arm - middle))
            new = rows[env, row].impulse + sign * added
            along = wp.dot(new, rows[env, row].normal)
            limit = ROUNDED_UP * rows[env, row].mu * along
            holds = along >= zero and wp.length_sq(new - along * rows[env, row].normal) <= limit * limit
            if not holds:
                return 0, turning
            scratch[env, row].before = new
            turning += wp.cross(arm_of_other, added)
        return 1, turning

    @wp.func
    def share(
        rows: Rows, change: Change, scratch: Scratches, env: int, first: int, last: int, body: int, other: int
    ):
        """Lets rows stop ``body``; returns whether they can. The other body needs as much more.

        Evenly, which is the least change; else each as it is loaded, since what carries nothing has no friction.
        """
        if change[env, body].held == 1:
            return 0
        stands, turning = spread_out(rows, change, scratch, env, first, last, body, 0)
        if stands == 0:
            stands, turning = spread_out(rows, change, scratch, env, first, last, body, 1)
        if stands == 0:
            return 0
        change[env, body].held = 1
        if other >= 0:
            if change[env, other].held == 1:
                return 0
            change[env, other].needs = change[env, other].needs + change[env, body].needs
            change[env, other].needs_turning = change[env, other].needs_turning + turning
        return 1

    @wp.func
    def carry(rows: Rows, moving: Moving, change: Change, scratch: Scratches, env: int, count: int):
        for body in range(change.shape[1]):
            inertia, invertible = inverse_of(moving[env, body].by_torque)
            change[env, body].held = 0
            if invertible == 0:
                # What has none does not stand.
                return 0
            mass = one / moving[env, body].inverse_mass
            change[env, body].needs = -mass * (moving[env, body].linear + change[env, body].linear)
            change[env, body].needs_turning = -(inertia * (moving[env, body].angular + change[env, body].angular))
        last = count
        while last > 0:
            body_1 = rows[env, last - 1].body_1
            body_2 = rows[env, last - 1].body_2
            first = last - 1
            while first > 0:
                if rows[env, first - 1].body_1 != body_1 or rows[env, first - 1].body_2 != body_2:
                    break
                first -= 1
            body = wp.max(body_1, body_2)
            if body < 0:
                return 0
            if share(rows, change, scratch, env, first, last, body, wp.min(body_1, body_2)) == 0:
                return 0
            last = first
        for row in range(count):
            other = wp.min(rows[env, row].body_1, rows[env, row].body_2)
            if other >= 0:  # noqa: SIM102  Warp would look at both sides
                if change[env, other].held == 0:
                    return 0
        return 1

    @wp.func
    def stand(rows: Rows, moving: Moving, change: Change, scratch: Scratches, env: int, count: int):
        stands = carry(rows, moving, change, scratch, env, count)
        for row in range(count):
            if stands == 1:
                new = scratch[env, row].before
                step = new - rows[env, row].impulse
                rows[env, row].impulse = new
                push(moving, change, env, rows[env, row].body_1, step, wp.cross(rows[env, row].arm_1, step))
                push(moving, change, env, rows[env, row].body_2, -step, -wp.cross(rows[env, row].arm_2, step))
            scratch[env, row].before = rows[env, row].impulse
            scratch[env, row].swept = rows[env, row].impulse
        return stands

    @wp.func
    def fastest_squared(moving: Moving, env: int, body: int, arm: vec3):
        """Square of the larger speed of a body: of its centre of mass, or of what turns around that.

        The latter at ``arm`` or, if that is shorter, at the radius of gyration: a contact at the centre sees no
        turning.
        """
        C = moving[env, body].by_torque
        trace = C[0, 0] + C[1, 1] + C[2, 2]
        reach_squared = wp.length_sq(arm)
        if trace > zero:
            reach_squared = wp.max(reach_squared, three * moving[env, body].inverse_mass / trace)
        turning = wp.length_sq(moving[env, body].angular) * reach_squared
        return wp.max(wp.length_sq(moving[env, body].linear), turning)

    @wp.func
    def rests(rows: Rows, moving: Moving, change: Change, env: int, count: int):
        """Whether all bodies that touch anything were at rest, and move by what rounding leaves."""
        if at_rest(moving, change, env) == 0:
            return 0
        for row in range(count):
            one_body = rows[env, row].body_1
            other = rows[env, row].body_2
            least = real(wp.inf)
            fastest = zero
            if one_body >= 0:
                least = change[env, one_body].speed_squared
                fastest = fastest_squared(moving, env, one_body, rows[env, row].arm_1)
            if other >= 0:
                least = wp.min(least, change[env, other].speed_squared)
                fastest = wp.max(fastest, fastest_squared(moving, env, other, rows[env, row].arm_2))
            if fastest > ROUNDING * ROUNDING * least:
                return 0
        return 1

    @wp.func
    def settle(rows: Rows, moving: Moving, change: Change, env: int, count: int, stands: int):
        still = stands
        if still == 0:
            still = rests(rows, moving, change, env, count)
        if still == 1:
            for body in range(change.shape[1]):
                if change[env, body].speed_squared != zero:
                    moving[env, body].linear = vec3()
                    moving[env, body].angular = vec3()

    return SimpleNamespace(at_rest=at_rest, stand=stand, settle=settle)
