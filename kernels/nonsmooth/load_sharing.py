"""Distribution of loads between the contacts of two bodies, where equilibrium does not determine it.

With more than three points between two bodies, or with guided bodies, several sets of impulses give the same motion, but
their friction cones do not admit the same loads: a pad whose load is at one point does not resist spin. Gauss–Seidel
loads the contacts that it solves first. Gradient steps from zero change impulses by what velocities require only, so
they lead to a solution near the one of least norm. The impulses are then carried over from step to step.

So the warm starts of two bodies with several contacts of similar normals are cleared if one of these contacts is new, or
violates the contact law by more than ``MAX_RESIDUAL`` although the last solve converged, as after an impact.
``START_ITERATIONS`` steps of ``accelerated.py`` then precede the first sweep and change these impulses only. Other pairs
keep their warm starts.

Solves of changing loads, such as impacts on a stack, change impulses unequally where the sum and the moments of a pair are all that
matters. So after a solve, the impulses of four or more loaded points with one normal become those of least norm, with the same force and
moment: normal impulses are then an affine function of the position. Tangential ones are changed only if all points stick. All
remain as they are where a point would pull or exceed its friction cone.
"""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import cone, solver_common, velocity_update
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


@functools.cache
def equalize_loads(real: type, has_joints: bool) -> wp.Kernel:
    """Returns the kernel that distributes the impulses of points with one normal equally; items: 1.

    It changes neither velocities nor the force and torque between two bodies. ``has_joints``: some bodies have joints.
    """
    Rows, SolveResult, _BodyResponse, _VelocityChange = solve_types(real, has_joints)
    vec3 = structs(real).vec3
    basis = cone.functions(real).basis
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
    # Fraction of the limit of friction below which a point sticks, and distance from a plane over the size.
    STICKS, IN_PLANE = wp.constant(real(0.999)), wp.constant(real(1.0e-6))
    # 1 − cosine of normals that are equal, and determinant of positions on a line over the square of the trace.
    PARALLEL, ON_LINE = wp.constant(real(1.0e-6)), wp.constant(real(1.0e-6))
    # Rounding of a tangential over a normal impulse, which contacts without friction have.
    ROUNDING = wp.constant(real(8.0 * structs(real).epsilon))
    # Largest change relative to the mean that is not made, so that impulses of bodies at rest stay bitwise identical.
    EVEN = wp.constant(real(max(1.0e-6, 64.0 * structs(real).epsilon)))

    @wp.func
    def arm_of(rows: Rows, env: int, row: int):
        """Returns the position of a row relative to the first of its bodies that is not the world."""
        if rows[env, row].body_1 >= 0:
            return rows[env, row].arm_1
        return rows[env, row].arm_2

    @wp.func
    def is_loaded(rows: Rows, env: int, row: int):
        """Returns whether a row pushes its bodies apart."""
        return wp.dot(rows[env, row].impulse, rows[env, row].normal) > zero

    @wp.func
    def end_of_points(rows: Rows, env: int, first: int, count: int):
        """Returns the end of the consecutive rows between the bodies of a row, with its normal."""
        end = first + 1
        while (
            end < count
            and rows[env, end].body_1 == rows[env, first].body_1
            and rows[env, end].body_2 == rows[env, first].body_2
            and wp.dot(rows[env, end].normal, rows[env, first].normal) > real(1.0) - PARALLEL
        ):
            end += 1
        return end

    @wp.struct
    class SharedLoad:
        """Impulses of least norm on loaded points with one normal, with the force and moment of the present ones."""

        center: vec3  # mean of the arms, W [m]
        normal: vec3  # W
        load: real  # mean normal impulse [N·s]
        slope: vec3  # of the normal impulse over the position, W [N·s/m]
        friction: vec3  # mean tangential impulse, W [N·s]
        twist: real  # tangential impulse per distance from the center [N·s/m]
        changes_friction: wp.bool

    @wp.func
    def impulse_of(shared: SharedLoad, rows: Rows, env: int, row: int):
        """Returns the impulse of a row."""
        arm = arm_of(rows, env, row) - shared.center
        impulse = (shared.load + wp.dot(shared.slope, arm)) * shared.normal
        if shared.changes_friction:
            return impulse + shared.friction + shared.twist * wp.cross(shared.normal, arm)
        present = rows[env, row].impulse
        return impulse + present - wp.dot(present, shared.normal) * shared.normal

    @wp.func
    def is_admissible(shared: SharedLoad, rows: Rows, env: int, first: int, end: int):
        """Returns whether the impulses of the loaded rows from ``first`` to ``end`` push, and are within their cones."""
        for row in range(first, end):
            if is_loaded(rows, env, row):
                impulse = impulse_of(shared, rows, env, row)
                along = wp.dot(impulse, shared.normal)
                limit = (rows[env, row].mu + ROUNDING) * along
                if along <= zero or wp.length_sq(impulse - along * shared.normal) > limit * limit:
                    return False
                # The limits of couples depend on the normal impulse of their row.
                if wp.length_sq(rows[env, row].couple) > zero:
                    return False
        return True

    @wp.func
    def equalize(rows: Rows, env: int, first: int, end: int):
        """Distributes the impulses of the loaded rows from ``first`` to ``end``."""
        shared = SharedLoad()
        shared.normal = rows[env, first].normal
        n = shared.normal
        number = zero
        for row in range(first, end):
            if is_loaded(rows, env, row):
                number += one
                shared.load += wp.dot(rows[env, row].impulse, n)
                shared.friction += rows[env, row].impulse
                shared.center += arm_of(rows, env, row)
        if number < real(4.0):
            return
        shared.load /= number
        shared.center /= number
        shared.friction = shared.friction / number - shared.load * n
        u_axis, v_axis = basis(n)
        uu = zero
        uv = zero
        vv = zero
        ww = zero
        u_moment = zero
        v_moment = zero
        twist = zero
        sticks = wp.bool(True)
        for row in range(first, end):
            if is_loaded(rows, env, row):
                arm = arm_of(rows, env, row) - shared.center
                u = wp.dot(arm, u_axis)
                v = wp.dot(arm, v_axis)
                impulse = rows[env, row].impulse
                along = wp.dot(impulse, n)
                uu += u * u
                uv += u * v
                vv += v * v
                ww += wp.dot(arm, n) * wp.dot(arm, n)
                u_moment += u * (along - shared.load)
                v_moment += v * (along - shared.load)
                twist += wp.dot(wp.cross(n, arm), impulse)
                limit = (STICKS * rows[env, row].mu + ROUNDING) * along
                sticks = sticks and wp.length_sq(impulse - along * n) <= limit * limit
        determinant = uu * vv - uv * uv
        if determinant <= ON_LINE * (uu + vv) * (uu + vv):
            return
        u_slope = (vv * u_moment - uv * v_moment) / determinant
        v_slope = (uu * v_moment - uv * u_moment) / determinant
        shared.slope = u_slope * u_axis + v_slope * v_axis
        largest = zero
        for row in range(first, end):
            if is_loaded(rows, env, row):
                along = wp.dot(rows[env, row].impulse, n)
                new = wp.dot(impulse_of(shared, rows, env, row), n)
                largest = wp.max(largest, wp.abs(new - along))
        if largest <= EVEN * shared.load:
            return
        # Tangential impulses in one plane, on points that do not slip.
        shared.twist = twist / (uu + vv)
        shared.changes_friction = sticks and ww <= IN_PLANE * IN_PLANE * (uu + vv)
        if shared.changes_friction and not is_admissible(shared, rows, env, first, end):
            shared.changes_friction = False
        if shared.changes_friction or is_admissible(shared, rows, env, first, end):
            for row in range(first, end):
                if is_loaded(rows, env, row):
                    rows[env, row].impulse = impulse_of(shared, rows, env, row)

    @unique_kernel()
    def equalize_loads_of_rows(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        rows: Rows,
        solve_result: SolveResult,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE or solve_result.converged[env] == 0:
                continue
            count = solve_result.count[env]
            first = wp.int32(0)
            while first < count:
                end = end_of_points(rows, env, first, count)
                if end - first > 3:
                    equalize(rows, env, first, end)
                first = end

    return equalize_loads_of_rows
