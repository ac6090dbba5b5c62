"""Skips steps that would not change the state; results are bitwise identical to taking them.

A step is a function of state, contact history and parameters. If the last steps changed none of these, the next
step does not either, until the user changes something. ``save_impulses.py`` counts such steps.
"""

import functools

import warp as wp
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, ENV_SLEEPING, LaunchRange, first_env, task_count


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that excludes sleeping environments from a step, except for their clocks; items: 1.

    Requires that all contacts are nonsmooth contacts with surfaces, and that there are no other force elements.
    """
    StepStatistics = record_structs(real).StepStatistics

    @unique_kernel()
    def skip_sleeping(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        statistics: StepStatistics,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] == ENV_ACTIVE and statistics.unchanged_steps[env] == 2:
                time[env] = time[env] + step[env, 0]
                status[env] = ENV_SLEEPING

    return skip_sleeping
