"""Distribution of loads between the contacts of two bodies, where equilibrium does not determine it.

With more than three points between two bodies, or with guided bodies, several sets of impulses give the same motion, but
their friction cones do not admit the same loads: a pad whose load is at one point does not resist spin. Gauss–Seidel
loads the contacts that it solves first. Gradient steps from zero change impulses by what velocities require only, so
they lead to a solution near the one of least norm. The impulses are then carried over from step to step.

So if a contact is new between two bodies with several contacts, the warm starts of all contacts of that pair are cleared,
and ``START_ITERATIONS`` steps of ``accelerated.py`` precede the first sweep. Other pairs keep their warm starts.
"""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth.rows import row_structs
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, first_env, structs, task_count

#: Accelerated steps before the first sweep. Of the loads of four points in a plane, 5 steps leave differences of 2 %, 20
#: steps of 0.1 %.
START_ITERATIONS = 20


@functools.cache
def clear_changed_pairs(real: type) -> wp.Kernel:
    """Returns the kernel that clears the warm starts of pairs of bodies with several contacts, one of them new; items: 1."""
    r = row_structs(real)
    vec3 = structs(real).vec3

    @wp.func
    def same_pair(rows: r.Rows, env: int, row: int, other_row: int):
        """Returns whether two rows are between the same bodies."""
        same = rows[env, row].body_1 == rows[env, other_row].body_1
        same = same and rows[env, row].body_2 == rows[env, other_row].body_2
        opposite = rows[env, row].body_1 == rows[env, other_row].body_2
        opposite = opposite and rows[env, row].body_2 == rows[env, other_row].body_1
        return same or opposite

    @unique_kernel()
    def clear_pairs(
        launch: LaunchRange, status: wp.array(dtype=wp.int32), rows: r.Rows, solve_result: r.SolveResult
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            cleared = wp.int32(0)
            count = solve_result.count[env]
            for row in range(count):
                if rows[env, row].is_new == 0:
                    continue
                for other_row in range(count):
                    if other_row != row and same_pair(rows, env, row, other_row):
                        cleared = 1
                        rows[env, other_row].impulse = vec3()
                        rows[env, other_row].couple = vec3()
            solve_result.was_cleared[env] = cleared

    return clear_pairs
