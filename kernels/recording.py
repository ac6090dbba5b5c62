"""Takes frames of a recording where they are measured, so that nobody has to come by for them."""

import functools

import warp as wp
from warpcontact.kernels.types import Work, first_env, task_count


@wp.struct
class Row:
    """A reading: where it is measured and where its frames go, by addresses and distances in bytes.

    Of arrays Warp keeps distances in 32 bits, and frames may be farther apart.
    """

    source: wp.uint64  # address of environment 0
    of_env: wp.uint64  # from environment to environment
    of_item: wp.uint64  # from item to item
    result: wp.uint64  # address of environment 0 in frame 0
    of_frame: wp.uint64  # from frame to frame
    items: wp.int32
    words: wp.int32  # of an item: four bytes each, or numbers in float64 that are added up
    total: wp.int32  # whether they are, over the items


@functools.cache
def take() -> wp.Kernel:
    """Returns the kernel that takes a frame of all readings, and counts it; items: one. For the CPU."""

    @wp.func
    def copy(row: Row, frame: wp.uint64, env: wp.uint64):
        size = wp.uint64(4) * wp.uint64(row.words)
        first = row.source + env * row.of_env
        target = frame + env * wp.uint64(row.items) * size
        for item in range(row.items):
            source = wp.array(ptr=first + wp.uint64(item) * row.of_item, shape=(row.words,), dtype=wp.uint32)
            result = wp.array(ptr=target + wp.uint64(item) * size, shape=(row.words,), dtype=wp.uint32)
            for word in range(row.words):
                result[word] = source[word]

    @wp.func
    def add_up(row: Row, frame: wp.uint64, env: wp.uint64):
        first = row.source + env * row.of_env
        target = frame + env * wp.uint64(8) * wp.uint64(row.words)
        result = wp.array(ptr=target, shape=(row.words,), dtype=wp.float64)
        for word in range(row.words):
            total = wp.float64(0.0)
            for item in range(row.items):
                source = wp.array(ptr=first + wp.uint64(item) * row.of_item, shape=(row.words,), dtype=wp.float64)
                total += source[word]
            result[word] = total

    @wp.kernel(module="unique", enable_backward=False)
    def take_frame(
        work: Work,
        place: wp.array(dtype=wp.int32),  # number of the frame, and of rows
        rows: wp.array(dtype=Row),
    ):
        for number in range(place[1]):
            row = rows[number]
            frame = row.result + wp.uint64(place[0]) * row.of_frame
            for task in range(wp.tid(), task_count(work), work.threads):
                env = wp.uint64(first_env(work) + task)
                if row.total != 0:
                    add_up(row, frame, env)
                else:
                    copy(row, frame, env)
        place[0] = place[0] + 1

    return take_frame
