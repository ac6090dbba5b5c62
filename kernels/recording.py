"""Takes frames of a recording where they are measured, so that nobody has to come by for them.

Frames are given by where the first is in memory and how much one takes: of an array of all of them Warp would keep
that in 32 bits.
"""

import functools

import warp as wp
from warpcontact.kernels.types import Work, first_env, task_count


@functools.cache
def take() -> wp.Kernel:
    """Returns the kernel that copies words of four bytes, whatever they say, into a frame; items: one."""

    @wp.kernel(module="unique", enable_backward=False)
    def take_frame(
        work: Work,
        number: wp.array(dtype=wp.int32),  # [0] of the frame
        source: wp.array3d(dtype=wp.uint32),  # [env, item, word]
        first: wp.uint64,  # address of the first frame [env, item, word]
        size: wp.uint64,  # from frame to frame [bytes]
    ):
        shape = (source.shape[0], source.shape[1], source.shape[2])
        frame = wp.array(ptr=first + wp.uint64(number[0]) * size, shape=shape, dtype=wp.uint32)
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            for item in range(source.shape[1]):
                for word in range(source.shape[2]):
                    frame[env, item, word] = source[env, item, word]

    return take_frame


@functools.cache
def take_total() -> wp.Kernel:
    """Returns the kernel that sums over items, from the first to the last, into a frame; items: one."""

    @wp.kernel(module="unique", enable_backward=False)
    def take_total_frame(
        work: Work,
        number: wp.array(dtype=wp.int32),  # [0] of the frame
        source: wp.array3d(dtype=wp.float64),  # [env, item, axis]
        first: wp.uint64,  # address of the first frame [env, axis]
        size: wp.uint64,  # from frame to frame [bytes]
    ):
        shape = (source.shape[0], source.shape[2])
        frame = wp.array(ptr=first + wp.uint64(number[0]) * size, shape=shape, dtype=wp.float64)
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            for axis in range(source.shape[2]):
                total = wp.float64(0.0)
                for item in range(source.shape[1]):
                    total += source[env, item, axis]
                frame[env, axis] = total

    return take_total_frame


@functools.cache
def count() -> wp.Kernel:
    """Returns the kernel that goes to the next frame."""

    @wp.kernel(module="unique", enable_backward=False)
    def count_frame(number: wp.array(dtype=wp.int32)):
        number[0] = number[0] + 1

    return count_frame
