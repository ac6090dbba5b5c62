"""Keeps impacts from bringing energy.

Newton's law says with what speed a contact parts, whatever impulse that takes. Where friction turns the slip
round, or contacts of different restitution are hit together, it may do more work than there was (Kane and Levinson
1985). With no restitution it cannot, whatever the friction; so there is a part of it that does not.
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
    """Returns the kernel that looks for a large part of the restitution that brings no energy; items: 1.

    It comes after each solve, ``number`` 0 after the first, with the whole restitution. Where that brings energy,
    the interval between what is known to bring some and none is halved and the environment solved again; the last
    time with what brings none, which is nothing at the least.
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

    @wp.func
    def bounces(rows: Rows, env: int, count: int):
        found = wp.bool(False)
        for row in range(count):
            found = found or rows[env, row].bounce > real(0.0)
        return found

    @wp.func
    def gains(middle: State, rows: Rows, moving: Moving, change: Change, env: int, count: int, tolerance: real):
        """Whether all impulses together do work."""
        work_done = real(0.0)
        size = real(0.0)
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
        return work_done > wp.max(slight, unsolved * tolerance) * size

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
            if gains(middle, rows, moving, change, env, count, tolerance):
                restraint.gains[env] = part
            elif part == real(1.0):
                continue
            else:
                restraint.kept[env] = part
            next_part = real(0.5) * (restraint.kept[env] + restraint.gains[env])
            if number == last:
                next_part = restraint.kept[env]
                if next_part == part:
                    continue
            restraint.part[env] = next_part
            restraint.status[env] = ENV_ACTIVE
            for row in range(count):
                rows[env, row].bounce = rows[env, row].bounce * (next_part / part)

    return restrain_impacts
