"""Lists of the tasks of a GPU warp that have work, so that all its lanes are busy although most tasks have none.

A warp examines ``TASKS_PER_LANE`` tasks per lane, lists those with work, and then distributes them over its lanes.
"""

import warp as wp
from warpcontact.kernels.lowlevel.warps import LANES, nth_set_bit, popcount

#: Number of tasks of a warp per lane.
TASKS_PER_LANE = wp.constant(4)


@wp.struct
class TaskList:
    """The tasks of a warp that have work."""

    first: wp.int32  # first task of the warp
    count: wp.int32
    lanes: wp.vec4i  # lanes whose tasks have work, as bits: tasks 0 to 31, 32 to 63, …


def thread_count(tasks: int) -> int:
    """Returns the number of GPU threads of a launch that lists its tasks."""
    return -(-tasks // (LANES * TASKS_PER_LANE)) * LANES


@wp.func
def listed_task(tasks: TaskList, number: int):
    """Returns task ``number`` of a list."""
    task = tasks.first
    rest = number
    for part in range(wp.static(TASKS_PER_LANE - 1)):
        listed = popcount(tasks.lanes[part])
        if rest < listed:
            return task + nth_set_bit(tasks.lanes[part], rest)
        rest -= listed
        task += wp.static(LANES)
    return task + nth_set_bit(tasks.lanes[wp.static(TASKS_PER_LANE - 1)], rest)
