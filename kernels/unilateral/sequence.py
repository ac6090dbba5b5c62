"""Impacts one after the other: the speeds at which the closed contacts of a step part.

The pair of bodies that approaches fastest collides first: its contacts are solved together, without friction, by
Newton's law with the velocities so far, and so on until no contact approaches. ``bounce`` of each contact that was
hit is its normal velocity after the sequence. The solvers reach it with friction and forces. So an impact travels
through bodies that touch, as in Newton's cradle; with simultaneous impacts, ``bounce`` follows from the velocities
before the step alone (Smith et al., Reflections on simultaneous impact, ACM Transactions on Graphics 31, 2012).
"""

import functools

import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, Work, first_env, structs, task_count
from warpcontact.kernels.unilateral import begin, impulses, relative
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs
from warpcontact.kernels.unique import unique_kernel

#: Largest number of impacts in a step, per closed contact; what still approaches then does not bounce.
IMPACTS = 50
# Largest number of sweeps over the contacts of one impact.
SWEEPS = 200
# Approach speeds that agree to this share are equal: of these the first contact comes first.
TIE = 1.0e-3


@functools.cache
def scratch(real: type) -> type:
    """Returns the struct of a row of the sequence."""

    @wp.struct
    class Hit:
        ease: real  # normal velocity over the normal impulse [1/kg]
        target: real  # speed at which it is to part after the present impact [m/s]
        impulse: real  # normal impulse of the present impact [N·s]
        hit: wp.int32  # 1: some impact pressed it

    return Hit


@functools.cache
def kernel(real: type, moves: bool) -> wp.Kernel:
    """Returns the kernel that sets ``bounce`` of all rows by impacts one after the other; items: 1.

    With ``moves`` not all bodies are free.
    """
    State = structs(real).State
    r = row_structs(real)
    Rows, Outcome = r.Rows, r.Outcome
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    Change = wp.array2d(dtype=impulses.change_struct(real))
    Hits = wp.array2d(dtype=scratch(real))
    before = relative.functions(real, moves).before
    f = impulses.functions(real, moves)
    changed_at, eased, push_both = f.changed_at, f.eased, f.push_both
    clear = begin.functions(real, moves, False).clear
    zero = wp.constant(real(0.0))
    impacts, sweeps = wp.constant(IMPACTS), wp.constant(SWEEPS)
    faster, exact = wp.constant(real(1.0 + TIE)), wp.constant(real(0.1))

    @wp.func
    def parting(middle: State, rows: Rows, change: Change, env: int, row: int):
        """Normal relative velocity so far, positive where bodies part."""
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        u = before(middle, env, body_1, body_2, arm_1, arm_2) + changed_at(change, env, body_1, arm_1)
        return wp.dot(u - changed_at(change, env, body_2, arm_2), rows[env, row].normal)

    @wp.func
    def joins(rows: Rows, env: int, row: int, body_1: int, body_2: int):
        """Whether a row is between two bodies."""
        first = rows[env, row].body_1
        second = rows[env, row].body_2
        return (first == body_1 and second == body_2) or (first == body_2 and second == body_1)

    @wp.func
    def start(rows: Rows, moving: Moving, hits: Hits, env: int, count: int):
        """Prepares all rows; returns whether any has restitution."""
        elastic = wp.bool(False)
        for row in range(count):
            n = rows[env, row].normal
            moved = eased(moving, env, rows[env, row].body_1, rows[env, row].arm_1, n)
            moved += eased(moving, env, rows[env, row].body_2, rows[env, row].arm_2, n)
            hits[env, row].ease = wp.dot(moved, n)
            hits[env, row].hit = 0
            elastic = elastic or rows[env, row].restitution > zero
        return elastic

    @wp.func
    def fastest(middle: State, rows: Rows, change: Change, hits: Hits, env: int, count: int):
        """The row that approaches fastest, and how fast; of equal ones the first."""
        found = wp.int32(-1)
        speed = zero
        for row in range(count):
            if hits[env, row].ease > zero:
                approach = -parting(middle, rows, change, env, row)
                if approach > speed * faster:
                    found = row
                    speed = approach
        return found, speed

    @wp.func
    def collide(
        middle: State,
        rows: Rows,
        moving: Moving,
        change: Change,
        hits: Hits,
        env: int,
        count: int,
        body_1: int,
        body_2: int,
        small: real,
    ):
        """One impact of two bodies, by projected Gauss–Seidel over their contacts."""
        for row in range(count):
            if joins(rows, env, row, body_1, body_2):
                approach = wp.max(-parting(middle, rows, change, env, row), zero)
                hits[env, row].target = rows[env, row].restitution * approach
                hits[env, row].impulse = zero
        for _ in range(sweeps):
            worst = zero
            for row in range(count):
                if hits[env, row].ease > zero and joins(rows, env, row, body_1, body_2):
                    impulse = hits[env, row].impulse
                    lacking = hits[env, row].target - parting(middle, rows, change, env, row)
                    new = wp.max(impulse + lacking / hits[env, row].ease, zero)
                    hits[env, row].impulse = new
                    step = (new - impulse) * rows[env, row].normal
                    turn_1 = wp.cross(rows[env, row].arm_1, step)
                    turn_2 = -wp.cross(rows[env, row].arm_2, step)
                    push_both(
                        moving, change, env, rows[env, row].body_1, rows[env, row].body_2, step, turn_1, turn_2
                    )
                    worst = wp.max(worst, wp.abs(new - impulse) * hits[env, row].ease)
            if worst <= small:
                break
        for row in range(count):
            if joins(rows, env, row, body_1, body_2) and hits[env, row].impulse > zero:
                hits[env, row].hit = 1

    @unique_kernel()
    def sequence_impacts(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        middle: State,
        rows: Rows,
        moving: Moving,
        outcome: Outcome,
        tolerance: real,
        hits: Hits,
        change: Change,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] != ENV_ACTIVE:
                continue
            count = outcome.count[env]
            if not start(rows, moving, hits, env, count):
                continue
            clear(change, env)
            row, speed = fastest(middle, rows, change, hits, env, count)
            # Below what gravity brings in a step by the tolerance, what approaches is at rest.
            small = tolerance * wp.max(speed, outcome.slack[env] / step[env, 0])
            left = impacts * count
            while left > 0 and speed > small:
                collide(
                    middle, rows, moving, change, hits, env, count, rows[env, row].body_1, rows[env, row].body_2,
                    exact * small,
                )  # fmt: skip
                row, speed = fastest(middle, rows, change, hits, env, count)
                left -= 1
            for number in range(count):
                bounce = zero
                if hits[env, number].hit == 1:
                    bounce = wp.max(parting(middle, rows, change, env, number), zero)
                rows[env, number].bounce = bounce

    return sequence_impacts
