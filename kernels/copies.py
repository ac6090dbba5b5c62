"""Copies what was measured of environments to where a recording keeps it."""

import functools
from math import prod

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
        source: wp.uint64,  # address of the values of the first environment of all
        to_next_env: wp.uint64,  # from there [bytes]
        to_next_piece: wp.uint64,  # within an environment [bytes]
        pieces: int,
        words: int,  # of a piece, one behind the other
        places: wp.array(dtype=wp.uint64),  # [reading] as ``source``, of where they go, without gaps
        reading: int,
    ):
        length = wp.uint64(WORD * words)
        for task in range(wp.tid(), task_count(work), work.threads):
            env = wp.uint64(first_env(work) + task)
            begin = source + env * to_next_env
            target = places[reading] + env * wp.uint64(pieces) * length
            for _ in range(pieces):
                # Arrays without strides, which the compiler copies in blocks.
                values = wp.array(ptr=begin, shape=(words,), dtype=wp.int32)
                copied = wp.array(ptr=target, shape=(words,), dtype=wp.int32)
                for word in range(words):
                    copied[word] = values[word]
                begin += to_next_piece
                target += length

    return copy_values


def inputs(values: wp.array, places: wp.array, reading: int) -> list[object]:
    """Returns what the kernel is told of values [env] or [env, item] of any type."""
    size = wp.types.type_size_in_bytes(values.dtype)
    pieces, apart = prod(values.shape[1:]), values.strides[-1] if values.ndim > 1 else size
    if apart == size:
        pieces, size = 1, pieces * size
    return [values.ptr, values.strides[0], apart, pieces, size // WORD, places, reading]
