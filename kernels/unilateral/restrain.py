"""Limits restitution so that impacts add no energy.

Newton's law prescribes the speed at which a contact parts, for any impulse. The impulses of a step may then do work
W > 0 on the bodies: if friction reverses the slip, if contacts of different restitution are hit together
(Kane and Levinson 1985), or if the impulse that carries the weight of a body at rest acts while an impact launches it.
In the last case W is of the order of the step, so the reduction must vanish with the step.

``restrain_impacts`` scales all restitution of an environment by the largest factor s found with W(s) ≤ 0. W(0) ≤ 0 for
any friction. Without friction and with the same contacts pressed, W is a convex quadratic of s, so its chord between a
point with W < 0 and one with W > 0 is zero at a point with W ≤ 0, near the root.
"""

import functools

import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, ENV_WAITING, Work, first_env, structs, task_count
from warpcontact.kernels.unilateral import impulses, relative
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs
from warpcontact.kernels.unique import unique_kernel

#: Solves after the first, at most.
ROUNDS = 4


@functools.cache
def kernel(real: type, moves: bool) -> wp.Kernel:
    """Returns the kernel that chooses the factor of the restitution for the next solve; items: 1.

    It runs after each solve, with ``number`` 0 after the first, which has the factor 1. If that adds energy, three
    factors between the largest found to add none and the smallest found to add some are tried: a Newton step from 1,
    then zeros of the chord, or the middle if only 0 adds none. The last solve has a factor that adds none.
    """
    t = structs(real)
    State = t.State
    r, records = row_structs(real), record_structs(real)
    Rows, Outcome, Restraint = r.Rows, r.Outcome, records.Restraint
    Change = wp.array2d(dtype=impulses.change_struct(real))
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    f = relative.functions(real, moves)
    velocity_before, velocity_after = f.before, f.after
    spin_before, spin_after = f.spin_before, f.spin_after
    last = wp.constant(ROUNDS - 1)
    # Of the work at all contacts: what rounding may bring; and what a solve may, over its tolerance.
    slight = wp.constant(real(1.0e-4) if real is wp.float32 else real(1.0e-9))
    unsolved = wp.constant(real(10.0))
    zero, half, one, two = (wp.constant(real(x)) for x in (0.0, 0.5, 1.0, 2.0))

    @wp.func
    def bounces(rows: Rows, env: int, count: int):
        found = wp.bool(False)
        for row in range(count):
            found = found or rows[env, row].bounce > real(0.0)
        return found

    @wp.func
    def work_of(middle: State, rows: Rows, moving: Moving, change: Change, env: int, count: int, tolerance: real):
        """Returns twice the work of all impulses, its rounding bound, and the estimate of its slope at factor 1."""
        work_done = real(0.0)
        size = real(0.0)
        slope = zero
        for row in range(count):
            body_1 = rows[env, row].body_1
            body_2 = rows[env, row].body_2
            arm_1 = rows[env, row].arm_1
            arm_2 = rows[env, row].arm_2
            u_before = velocity_before(middle, env, body_1, body_2, arm_1, arm_2)
            u_after = velocity_after(moving, env, body_1, body_2, arm_1, arm_2)
            turned = spin_before(middle, env, body_1, body_2)
            turned += spin_after(moving, env, body_1, body_2)
            impulse = rows[env, row].impulse
            couple = rows[env, row].couple
            work_done += wp.dot(impulse, u_before + u_after) + wp.dot(couple, turned)
            if rows[env, row].recovery > rows[env, row].bounce:
                # What takes overlap back may bring energy.
                work_done -= rows[env, row].recovery * wp.dot(impulse, rows[env, row].normal)
            # At rest there is less than what a step without contact would bring.
            body = wp.where(body_1 < 0, body_2, body_1)
            free = wp.sqrt(wp.max(change[env, body].speed_squared, real(0.0)))
            size += wp.length(impulse) * (wp.length(u_before) + wp.length(u_after) + free)
            # Exact for one contact without friction: W = ½ m (s² e² − 1) U⁻², P_n = m (1 + s e) U⁻, bounce s e U⁻.
            e = rows[env, row].restitution
            slope += two * e / (one + e) * rows[env, row].bounce * wp.dot(impulse, rows[env, row].normal)
        return work_done, wp.max(slight, unsolved * tolerance) * size, slope

    @unique_kernel()
    def restrain_impacts(
        work: Work,
        status: wp.array(dtype=wp.int32),
        number: wp.int32,
        middle: State,
        rows: Rows,
        moving: Moving,
        outcome: Outcome,
        change: Change,
        tolerance: real,
        restraint: Restraint,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            restraint.status[env] = ENV_WAITING
            if status[env] != ENV_ACTIVE:
                continue
            if number == 0:
                restraint.kept[env] = real(0.0)
            elif restraint.part[env] == real(1.0):
                continue
            count = outcome.count[env]
            part = restraint.part[env]
            if part == real(1.0) and not bounces(rows, env, count):
                continue
            work_done, bound, slope = work_of(middle, rows, moving, change, env, count, tolerance)
            next_part = half * part
            if work_done > bound:
                restraint.gains[env] = part
                restraint.gained[env] = work_done
                if part == one:
                    # Twice the Newton step, so that W < 0 there; not below ½.
                    next_part = wp.max(one - two * work_done / wp.max(slope, work_done), half)
                # Illinois rule: the end that stays counts half, so that the next chord is zero nearer to it.
                restraint.lost[env] = half * restraint.lost[env]
            elif part == one:
                continue
            else:
                restraint.kept[env] = part
                restraint.lost[env] = wp.max(-work_done, zero)
            kept = restraint.kept[env]
            if kept > zero:
                lost = restraint.lost[env]
                next_part = kept + (restraint.gains[env] - kept) * lost / (lost + restraint.gained[env])
            if number == last:
                next_part = kept
                if next_part == part:
                    continue
            restraint.part[env] = next_part
            restraint.status[env] = ENV_ACTIVE
            for row in range(count):
                rows[env, row].bounce = rows[env, row].bounce * (next_part / part)

    return restrain_impacts
