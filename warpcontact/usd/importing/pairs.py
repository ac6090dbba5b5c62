"""Selects the pairs of colliders that can be in contact; memory is linear in the number of colliders."""

from collections.abc import Hashable, Iterator, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.int64]


def group_particles(keys: Sequence[Hashable | None], min_count: int) -> Numbers:
    """Returns the index of the particle contact of each item (n,); −1: none.

    Args:
        keys: Items with equal keys belong together; those with ``None`` to no particle contact.
        min_count: A group needs more than this number of items. Groups are numbered by their first item.
    """
    alike: dict[Hashable, list[int]] = {}
    for i, key in enumerate(keys):
        if key is not None:
            alike.setdefault(key, []).append(i)
    groups = np.full(len(keys), -1, dtype=np.int64)
    for number, members in enumerate(members for members in alike.values() if len(members) > min_count):
        groups[members] = number
    return groups


def pairs_within_groups(groups: Numbers, pairs: Numbers) -> list[Numbers]:
    """Returns, for each particle contact, those of the pairs (n, 2) whose items both belong to it."""
    first, second = groups[pairs[:, 0]], groups[pairs[:, 1]]
    same_group = np.flatnonzero((first == second) & (first >= 0))
    same_group = same_group[np.argsort(first[same_group], kind="stable")]
    ends = np.searchsorted(first[same_group], np.arange(groups.max(initial=-1) + 2))
    return [pairs[same_group[start:end]] for start, end in pairwise(ends)]


def other_pairs(
    bodies: Numbers, moves: npt.NDArray[np.bool_], groups: Numbers, excluded: Numbers
) -> Iterator[tuple[int, int]]:
    """Iterates over the pairs of colliders that can be in contact, except those within a particle contact, in order.

    Args:
        bodies: Index of the carrier of each collider (n,); colliders of the same carrier are not paired.
        moves: Whether forces move the carrier (n,); at least one of a pair must move.
        groups: Index of the particle contact (n,); −1: none.
        excluded: Index pairs without contact (m, 2), each with the lower index first, sorted.
    """
    starts = np.searchsorted(excluded[:, 0], np.arange(len(bodies) + 1))
    for i in range(len(bodies)):
        after = slice(i + 1, None)
        may_touch = bodies[after] != bodies[i]
        if not moves[i]:
            may_touch &= moves[after]
        if groups[i] >= 0:
            may_touch &= groups[after] != groups[i]
        may_touch[excluded[starts[i] : starts[i + 1], 1] - (i + 1)] = False
        for j in np.flatnonzero(may_touch).tolist():
            yield i, i + 1 + j
