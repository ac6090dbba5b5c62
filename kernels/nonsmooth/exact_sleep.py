"""Steps that would change nothing, and are left out: to the last bit the result is the same.

A step is a function of the state, of what contacts remember and of parameters. Where the last steps changed none
of these the next does not either, until something is changed from outside. ``remember`` counts such steps.
"""

import functools

import warp as wp
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import ENV_ACTIVE, ENV_SLEEPING, LaunchRange, first_env, task_count


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that leaves environments at rest out of a step, but for their clocks; items: 1.

    All contacts are hard and with surfaces, and nothing else acts.
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
