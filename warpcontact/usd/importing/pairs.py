"""Which pairs of colliders may touch, found without a list of all pairs there are."""

from collections.abc import Hashable, Iterator, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.int64]


def group_particles(keys: Sequence[Hashable | None], min_count: int) -> Numbers:
    """Returns the number of the pile that each item is in (n,); −1: none.

    Args:
        keys: Items with the same one are alike; those with ``None`` are in no pile.
        min_count: More than so many that are alike are a pile; they are numbered as they come.
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
    """Returns those of some pairs (n, 2) of which both are in the same pile, for each pile."""
    first, second = groups[pairs[:, 0]], groups[pairs[:, 1]]
    same_group = np.flatnonzero((first == second) & (first >= 0))
    same_group = same_group[np.argsort(first[same_group], kind="stable")]
    ends = np.searchsorted(first[same_group], np.arange(groups.max(initial=-1) + 2))
    return [pairs[same_group[start:end]] for start, end in pairwise(ends)]


def other_pairs(
    bodies: Numbers, moves: npt.NDArray[np.bool_], groups: Numbers, excluded: Numbers
) -> Iterator[tuple[int, int]]:
    """Iterates over the pairs that may touch but for those within a pile, in order; memory grows with n only.

    Args:
        bodies: What carries each collider (n,): two on the same do not touch.
        moves: Whether that moves (n,): of two that touch one does.
        groups: Number of its pile (n,), −1: none.
        excluded: Pairs that are kept apart (m, 2), the lower number first, ordered.
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
