"""Copies what was measured of environments to where a recording keeps it."""

import functools

import warp as wp
from warpcontact.kernels.types import Work, first_env, task_count

# Of a word, of which all values are made up [bytes].
WORD = 4


@functools.cache
def kernel() -> wp.Kernel:
    """Returns the kernel that copies the values of some environments, of frozen ones too; items: 1.

    Where they go is read when it runs, so that captured launches write one frame after the other.
    """

    @wp.kernel(module="unique", enable_backward=False)
    def copy_values(
        work: Work,
        source: wp.array3d(dtype=wp.int32),  # [env, item, word]
        places: wp.array(dtype=wp.uint64),  # [reading] address of the values of the first environment of all
        reading: int,
    ):
        items = source.shape[1]
        words = source.shape[2]
        row = items * words
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            begin = places[reading] + wp.uint64(env) * wp.uint64(WORD * row)
            target = wp.array(ptr=begin, shape=(row,), dtype=wp.int32)
            for item in range(items):
                for word in range(words):
                    target[item * words + word] = source[env, item, word]

    return copy_values


def words_of(values: wp.array) -> wp.array:
    """Returns a view [env, item, word] of the values [env] or [env, item] of any type."""
    size = wp.types.type_size_in_bytes(values.dtype)
    several = values.ndim > 1
    return wp.array(
        ptr=values.ptr,
        dtype=wp.int32,
        shape=(values.shape[0], values.shape[1] if several else 1, size // WORD),
        strides=(values.strides[0], values.strides[1] if several else size, WORD),
        device=values.device,
        copy=False,
    )
