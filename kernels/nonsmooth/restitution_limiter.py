"""Limits restitution so that impacts add no energy.

Newton's law prescribes the speed at which a contact parts, for any impulse. The impulses of a step may then do
work W > 0 on the bodies: if friction reverses the slip, if contacts of different restitution are hit together
(Kane and Levinson 1985), or if the impulse that carries the weight of a body at rest acts while an impact launches
it. In the last case W is of the order of the step, so the reduction must vanish with the step.

``limit_restitution`` scales all restitution of an environment by the largest factor s found with W(s) ≤ 0. W(0) ≤
0 for any friction. Without friction and with the same contacts pressed, W is a convex quadratic of s, so its chord
between a point with W < 0 and one with W > 0 is zero at a point with W ≤ 0, near the root.
"""

import functools

import warp as wp
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.nonsmooth.velocity_update import relative_velocities
from warpcontact.kernels.types import ENV_ACTIVE, ENV_PAUSED, LaunchRange, first_env, structs, task_count

#: Maximum number of solves after the first.
MAX_ROUNDS = 4


@functools.cache
def kernel(real: type, has_joints: bool) -> wp.Kernel:
    """Returns the kernel that selects the restitution factor for the next solve; items: 1.

    It runs after each solve, with ``number`` 0 after the first, which has the factor 1. If that adds energy, up to
    three factors between the largest feasible and the smallest infeasible one are tried: a Newton step from 1,
    then zeros of the chord, or the middle if only 0 is feasible. The last solve has a feasible factor.
    """
    t = structs(real)
    State = t.State
    RestitutionLimit = record_structs(real).RestitutionLimit
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    f = relative_velocities(real, has_joints)
    velocity_before, velocity_after = f.before, f.after
    spin_before, spin_after = f.spin_before, f.spin_after
    last = wp.constant(MAX_ROUNDS - 1)
    # Work relative to the sum at all contacts: rounding error, and solver error per tolerance.
    rounding_gain = wp.constant(real(1.0e-4) if real is wp.float32 else real(1.0e-9))
    solver_gain = wp.constant(real(10.0))
    zero, half, one, two = (wp.constant(real(x)) for x in (0.0, 0.5, 1.0, 2.0))

    @wp.func
    def has_restitution(rows: Rows, env: int, count: int):
        found = wp.bool(False)
        for row in range(count):
            found = found or rows[env, row].restitution_speed > real(0.0)
        return found

    @wp.func
    def work_of(
        half_step_state: State,
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        env: int,
        count: int,
        tolerance: real,
    ):
        """Returns twice the work of all impulses, its rounding bound, and the estimate of its slope at factor 1."""
        work_done = real(0.0)
        size = real(0.0)
        slope = zero
        for row in range(count):
            body_1 = rows[env, row].body_1
            body_2 = rows[env, row].body_2
            arm_1 = rows[env, row].arm_1
            arm_2 = rows[env, row].arm_2
            u_before = velocity_before(half_step_state, env, body_1, body_2, arm_1, arm_2)
            u_after = velocity_after(body_response, env, body_1, body_2, arm_1, arm_2)
            spin_sum = spin_before(half_step_state, env, body_1, body_2)
            spin_sum += spin_after(body_response, env, body_1, body_2)
            impulse = rows[env, row].impulse
            couple = rows[env, row].couple
            work_done += wp.dot(impulse, u_before + u_after) + wp.dot(couple, spin_sum)
            if rows[env, row].recovery > rows[env, row].restitution_speed:
                # Removal of overlap may add energy.
                work_done -= rows[env, row].recovery * wp.dot(impulse, rows[env, row].normal)
            # At rest the work is smaller than that of a step without contact.
            body = wp.where(body_1 < 0, body_2, body_1)
            free = wp.sqrt(wp.max(velocity_change[env, body].speed_squared, real(0.0)))
            size += wp.length(impulse) * (wp.length(u_before) + wp.length(u_after) + free)
            # Exact for one contact without friction: W = ½ m (s² e² − 1) U⁻², P_n = m (1 + s e) U⁻, bounce s e U⁻.
            e = rows[env, row].restitution
            slope += (
                two * e / (one + e) * rows[env, row].restitution_speed * wp.dot(impulse, rows[env, row].normal)
            )
        return work_done, wp.max(rounding_gain, solver_gain * tolerance) * size, slope

    @unique_kernel()
    def limit_restitution(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        number: wp.int32,
        half_step_state: State,
        rows: Rows,
        body_response: BodyResponse,
        solve_result: SolveResult,
        velocity_change: VelocityChange,
        tolerance: real,
        restitution_limit: RestitutionLimit,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            restitution_limit.status[env] = ENV_PAUSED
            if status[env] != ENV_ACTIVE:
                continue
            if number == 0:
                restitution_limit.feasible_factor[env] = real(0.0)
            elif restitution_limit.factor[env] == real(1.0):
                continue
            count = solve_result.count[env]
            factor = restitution_limit.factor[env]
            if factor == real(1.0) and not has_restitution(rows, env, count):
                continue
            work_done, bound, slope = work_of(
                half_step_state, rows, body_response, velocity_change, env, count, tolerance
            )
            next_factor = half * factor
            if work_done > bound:
                restitution_limit.infeasible_factor[env] = factor
                restitution_limit.gained[env] = work_done
                if factor == one:
                    # Twice the Newton step, so that W < 0 there; not below ½.
                    next_factor = wp.max(one - two * work_done / wp.max(slope, work_done), half)
                # Illinois rule: halve the value of the retained end, which moves the next zero of the chord
                # towards it.
                restitution_limit.lost[env] = half * restitution_limit.lost[env]
            elif factor == one:
                continue
            else:
                restitution_limit.feasible_factor[env] = factor
                restitution_limit.lost[env] = wp.max(-work_done, zero)
            kept = restitution_limit.feasible_factor[env]
            if kept > zero:
                lost = restitution_limit.lost[env]
                next_factor = kept + (restitution_limit.infeasible_factor[env] - kept) * lost / (
                    lost + restitution_limit.gained[env]
                )
            if number == last:
                next_factor = kept
                if next_factor == factor:
                    continue
            restitution_limit.factor[env] = next_factor
            restitution_limit.status[env] = ENV_ACTIVE
            for row in range(count):
                rows[env, row].restitution_speed = rows[env, row].restitution_speed * (next_factor / factor)

    return limit_restitution
