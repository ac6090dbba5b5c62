"""How many partners a shape of a pile may have: as many as there is room for around it."""

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array

#: Up to so many shapes the lists are those of all pairs.
ALL_PAIRS_LIMIT = 32
# No packing of equal spheres fills more of a large space than π/√18; soft ones overlap.
MAX_PACKING_FRACTION = np.pi / np.sqrt(18.0)
OVERLAP_FACTOR = 1.15
# Of the partners of a shape, what it may own, and some more: of few it may own most.
OWNED_FRACTION = 0.6
OWNED_EXTRA = 3


def max_neighbors(radius: Array, half_length: Array, skin: float) -> NDArray[np.int_]:
    """Returns how many of the smallest shapes have room around each.

    Args:
        radius: Radii (…, n) [m].
        half_length: Half lengths of their axes, 0 for spheres, in the same shape [m].
        skin: How far apart partners are at most [m].
    """
    smallest = radius.min(axis=-1, keepdims=True)

    def volume(reach: Array) -> Array:
        return np.pi * reach**2 * (4.0 / 3.0 * reach + 2.0 * half_length)

    shell = volume(radius + 2.0 * smallest + skin) - volume(radius)
    bound = OVERLAP_FACTOR * MAX_PACKING_FRACTION * shell / (4.0 / 3.0 * np.pi * smallest**3)
    return np.minimum(np.ceil(bound).astype(np.int64) + 1, radius.shape[-1] - 1)


def owned_records(partners: NDArray[np.int_]) -> NDArray[np.int_]:
    """Returns how many records there are for a shape with room for so many partners."""
    return np.minimum(np.ceil(OWNED_FRACTION * partners).astype(np.int64) + OWNED_EXTRA, partners)


def all_pair_lists(
    bodies: NDArray[np.int32], kinds: NDArray[np.int32], allowed: NDArray[np.int32]
) -> tuple[list[list[int]], list[list[int]]]:
    """Returns the partners that each shape owns, and its others, if it is every one that it may touch."""
    count = len(bodies)
    touching = (bodies[:, None] != bodies) & (allowed[kinds[:, None], kinds] != 0)
    numbers = np.arange(count)
    odd = (numbers[:, None] + numbers) % 2 == 1
    owned_pairs = odd == (numbers[:, None] < numbers)
    return (
        [np.flatnonzero(row).tolist() for row in touching & owned_pairs],
        [np.flatnonzero(row).tolist() for row in touching & ~owned_pairs],
    )
