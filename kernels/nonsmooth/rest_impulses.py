"""Direct solution of resting contact: impulses that stop all bodies, if friction can hold every contact.

Iterations converge slowly if several contacts share a load. If nothing slides, the impulse that each body needs is
known: it cancels the velocity of the body. The contacts with one other body or with the world provide it,
distributed with the least change or in proportion to their load, and the opposite impulse is added to the other
body. One pass from the last bodies to the first solves the problem. The sums are exact to rounding, so following
steps change nothing; the error of an iteration would grow from step to step.
"""

import functools
from typing import NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels.nonsmooth import velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import structs


class Functions(NamedTuple):
    """Device functions of bodies that come to rest."""

    #: ``(body_response, velocity_change, env, island)``: whether all bodies of an island were at rest before the step.
    at_rest: wp.Function
    #: ``(body_response, velocity_change, scratch, env, island, first, end)``: stops all bodies of an island, the rows
    #: of which are ``first`` to ``end`` of ``scratch``. Returns 1 on success, and 0 if it changed nothing. In each pair
    #: of bodies in contact, the one with the larger index must be supported by the other one only; their contacts must be
    #: consecutive rows and not collinear. ``last_impulse`` of ``scratch`` is overwritten.
    solve_rest: wp.Function
    #: ``(body_response, velocity_change, scratch, env, island, first, end, solved)``: removes, after a solve, rounding
    #: errors of the velocity of stopped bodies and of bodies that were at rest.
    zero_rest_velocities: wp.Function


@functools.cache
def functions(real: type, Scratch: type) -> Functions:
    """Returns the device functions for ``real``; all bodies must be free. ``Scratch`` is the struct of a row."""
    vec3, mat33 = structs(real).vec3, structs(real).mat33
    _, _, BodyResponse, VelocityChange = solve_types(real, False)
    Scratches = wp.array2d(dtype=Scratch)
    f = velocity_update.functions(real, False)
    invert_symmetric, apply_impulse_pair = f.invert_symmetric, f.apply_impulse_pair
    # Velocity over that without contact: rounding error of impulses.
    ROUNDING = wp.constant(real(16.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))
    ROUNDED_UP = wp.constant(real(1.0 + 4.0 * float(np.finfo(wp.dtype_to_numpy(real)).eps)))
    zero, one, three = (wp.constant(real(x)) for x in (0.0, 1.0, 3.0))

    @wp.func
    def at_rest(body_response: BodyResponse, velocity_change: VelocityChange, env: int, island: int):
        body = wp.int32(island)
        while body >= 0:
            if velocity_change[env, body].speed_squared != zero and body_response[env, body].at_rest == 0:
                return 0
            body = velocity_change[env, body].next_member
        return 1

    @wp.func
    def load_weight(rows: Scratches, env: int, row: int, by_load: int):
        """Returns the weight of a row in the distribution of the impulse of its body."""
        if rows[env, row].is_open == 1:
            # An open contact carries no load.
            return zero
        return wp.where(by_load == 1, wp.dot(rows[env, row].impulse, rows[env, row].normal), one)

    @wp.func
    def distribute(
        rows: Scratches,
        velocity_change: VelocityChange,
        env: int,
        first: int,
        last: int,
        body: int,
        by_load: int,
    ):
        """Writes the impulses of rows that stop ``body`` to ``last_impulse``; returns whether they are in their cones.

        Also returns the angular impulse of the added impulses on the other body, about its center of mass.
        """
        total = zero
        centroid = vec3()
        for row in range(first, last):
            fraction = load_weight(rows, env, row, by_load)
            total += fraction
            centroid += fraction * wp.where(
                rows[env, row].body_1 == body, rows[env, row].arm_1, rows[env, row].arm_2
            )
        angular_impulse = vec3()
        if total <= zero:
            return 0, angular_impulse
        centroid /= total
        over = one / total
        second_moment = mat33()
        for row in range(first, last):
            arm = wp.where(rows[env, row].body_1 == body, rows[env, row].arm_1, rows[env, row].arm_2) - centroid
            distance_squared = wp.length_sq(arm)
            fraction = over * load_weight(rows, env, row, by_load)
            second_moment += fraction * (
                wp.diag(vec3(distance_squared, distance_squared, distance_squared)) - wp.outer(arm, arm)
            )
        inverse, invertible = invert_symmetric(second_moment)
        if invertible == 0:
            return 0, angular_impulse
        impulse = velocity_change[env, body].stop_impulse
        rotation = inverse * (velocity_change[env, body].stop_angular_impulse - wp.cross(centroid, impulse))
        for row in range(first, last):
            arm = rows[env, row].arm_1
            arm_on_other = rows[env, row].arm_2
            sign = one
            if rows[env, row].body_1 != body:
                arm = rows[env, row].arm_2
                arm_on_other = rows[env, row].arm_1
                sign = -one
            added = over * load_weight(rows, env, row, by_load) * (impulse + wp.cross(rotation, arm - centroid))
            new = rows[env, row].impulse + sign * added
            along = wp.dot(new, rows[env, row].normal)
            limit = ROUNDED_UP * rows[env, row].mu * along
            within_cone = along >= zero and wp.length_sq(new - along * rows[env, row].normal) <= limit * limit
            if not within_cone:
                return 0, angular_impulse
            rows[env, row].last_impulse = new
            angular_impulse += wp.cross(arm_on_other, added)
        return 1, angular_impulse

    @wp.func
    def stop_body(
        rows: Scratches,
        velocity_change: VelocityChange,
        env: int,
        first: int,
        last: int,
        body: int,
        other_body: int,
    ):
        """Stops ``body`` by its rows and adds the opposite load to the other body; returns whether it succeeded.

        First with equal weights, the least change; if that fails, in proportion to load, because an unloaded
        contact has no friction.
        """
        if velocity_change[env, body].is_stopped == 1:
            return 0
        solved, angular_impulse = distribute(rows, velocity_change, env, first, last, body, 0)
        if solved == 0:
            solved, angular_impulse = distribute(rows, velocity_change, env, first, last, body, 1)
        if solved == 0:
            return 0
        velocity_change[env, body].is_stopped = 1
        if other_body >= 0:
            if velocity_change[env, other_body].is_stopped == 1:
                return 0
            velocity_change[env, other_body].stop_impulse = (
                velocity_change[env, other_body].stop_impulse + velocity_change[env, body].stop_impulse
            )
            velocity_change[env, other_body].stop_angular_impulse = (
                velocity_change[env, other_body].stop_angular_impulse + angular_impulse
            )
        return 1

    @wp.func
    def propagate_loads(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        rows: Scratches,
        env: int,
        island: int,
        first_row: int,
        end_row: int,
    ):
        member = wp.int32(island)
        while member >= 0:
            inertia, invertible = invert_symmetric(body_response[env, member].inverse_inertia)
            velocity_change[env, member].is_stopped = 0
            if invertible == 0:
                # Without an inverse inertia the body cannot be stopped.
                return 0
            mass = one / body_response[env, member].inverse_mass
            velocity_change[env, member].stop_impulse = -mass * (
                body_response[env, member].linear + velocity_change[env, member].linear
            )
            velocity_change[env, member].stop_angular_impulse = -(
                inertia * (body_response[env, member].angular + velocity_change[env, member].angular)
            )
            member = velocity_change[env, member].next_member
        last = wp.int32(end_row)
        while last > first_row:
            body_1 = rows[env, last - 1].body_1
            body_2 = rows[env, last - 1].body_2
            first = last - 1
            while first > first_row:
                if rows[env, first - 1].body_1 != body_1 or rows[env, first - 1].body_2 != body_2:
                    break
                first -= 1
            body = wp.max(body_1, body_2)
            if body < 0:
                return 0
            if stop_body(rows, velocity_change, env, first, last, body, wp.min(body_1, body_2)) == 0:
                return 0
            last = first
        for row in range(first_row, end_row):
            other_body = wp.min(rows[env, row].body_1, rows[env, row].body_2)
            if other_body >= 0:
                if velocity_change[env, other_body].is_stopped == 0:
                    return 0
        return 1

    @wp.func
    def solve_rest(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        rows: Scratches,
        env: int,
        island: int,
        first: int,
        end: int,
    ):
        solved = propagate_loads(body_response, velocity_change, rows, env, island, first, end)
        if solved == 1:
            for row in range(first, end):
                new = rows[env, row].last_impulse
                step = new - rows[env, row].impulse
                rows[env, row].impulse = new
                apply_impulse_pair(
                    body_response, velocity_change, env, rows[env, row].body_1, rows[env, row].body_2, step,
                    wp.cross(rows[env, row].arm_1, step), -wp.cross(rows[env, row].arm_2, step),
                )  # fmt: skip
        return solved

    @wp.func
    def fastest_squared(body_response: BodyResponse, env: int, body: int, arm: vec3):
        """Returns the squared speed of a body: of its center of mass or of its rotation, the larger one.

        The rotation counts at ``arm`` or, if larger, at the radius of gyration, because a contact at the center is
        not sensitive to rotation.
        """
        C = body_response[env, body].inverse_inertia
        trace = C[0, 0] + C[1, 1] + C[2, 2]
        reach_squared = wp.length_sq(arm)
        if trace > zero:
            reach_squared = wp.max(reach_squared, three * body_response[env, body].inverse_mass / trace)
        angular_impulse = wp.length_sq(body_response[env, body].angular) * reach_squared
        return wp.max(wp.length_sq(body_response[env, body].linear), angular_impulse)

    @wp.func
    def is_resting(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        rows: Scratches,
        env: int,
        island: int,
        first: int,
        end: int,
    ):
        """Returns whether all bodies of an island were at rest and move by rounding errors only."""
        if at_rest(body_response, velocity_change, env, island) == 0:
            return 0
        for row in range(first, end):
            one_body = rows[env, row].body_1
            other_body = rows[env, row].body_2
            smallest_speed_squared = real(wp.inf)
            fastest = zero
            if one_body >= 0:
                smallest_speed_squared = velocity_change[env, one_body].speed_squared
                fastest = fastest_squared(body_response, env, one_body, rows[env, row].arm_1)
            if other_body >= 0:
                smallest_speed_squared = wp.min(
                    smallest_speed_squared, velocity_change[env, other_body].speed_squared
                )
                fastest = wp.max(fastest, fastest_squared(body_response, env, other_body, rows[env, row].arm_2))
            if fastest > ROUNDING * ROUNDING * smallest_speed_squared:
                return 0
        return 1

    @wp.func
    def zero_rest_velocities(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        rows: Scratches,
        env: int,
        island: int,
        first: int,
        end: int,
        solved: int,
    ):
        at_rest_now = solved
        if at_rest_now == 0:
            at_rest_now = is_resting(body_response, velocity_change, rows, env, island, first, end)
        if at_rest_now == 1:
            body = wp.int32(island)
            while body >= 0:
                if velocity_change[env, body].speed_squared != zero:
                    body_response[env, body].linear = vec3()
                    body_response[env, body].angular = vec3()
                body = velocity_change[env, body].next_member

    return Functions(at_rest=at_rest, solve_rest=solve_rest, zero_rest_velocities=zero_rest_velocities)
