"""Which pairs of colliders may touch, found without a list of all pairs there are."""

from collections.abc import Hashable, Iterator, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.int64]


def piles_of(keys: Sequence[Hashable | None], most: int) -> Numbers:
    """Returns the number of the pile that each item is in (n,); −1: none.

    Args:
        keys: Items with the same one are alike; those with ``None`` are in no pile.
        most: More than so many that are alike are a pile; they are numbered as they come.
    """
    alike: dict[Hashable, list[int]] = {}
    for i, key in enumerate(keys):
        if key is not None:
            alike.setdefault(key, []).append(i)
    piles = np.full(len(keys), -1, dtype=np.int64)
    for number, members in enumerate(members for members in alike.values() if len(members) > most):
        piles[members] = number
    return piles


def within(piles: Numbers, pairs: Numbers) -> list[Numbers]:
    """Returns those of some pairs (n, 2) of which both are in the same pile, for each pile."""
    first, second = piles[pairs[:, 0]], piles[pairs[:, 1]]
    inside = np.flatnonzero((first == second) & (first >= 0))
    inside = inside[np.argsort(first[inside], kind="stable")]
    ends = np.searchsorted(first[inside], np.arange(piles.max(initial=-1) + 2))
    return [pairs[inside[start:end]] for start, end in pairwise(ends)]


def loose(
    bodies: Numbers, moves: npt.NDArray[np.bool_], piles: Numbers, apart: Numbers
) -> Iterator[tuple[int, int]]:
    """Iterates over the pairs that may touch but for those within a pile, in order; memory grows with n only.

    Args:
        bodies: What carries each collider (n,): two on the same do not touch.
        moves: Whether that moves (n,): of two that touch one does.
        piles: Number of its pile (n,), −1: none.
        apart: Pairs that are kept apart (m, 2), the lower number first, ordered.
    """
    starts = np.searchsorted(apart[:, 0], np.arange(len(bodies) + 1))
    for i in range(len(bodies)):
        after = slice(i + 1, None)
        touch = bodies[after] != bodies[i]
        if not moves[i]:
            touch &= moves[after]
        if piles[i] >= 0:
            touch &= piles[after] != piles[i]
        touch[apart[starts[i] : starts[i + 1], 1] - (i + 1)] = False
        for j in np.flatnonzero(touch).tolist():
            yield i, i + 1 + j
