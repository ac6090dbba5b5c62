"""Capacity of neighbor lists: upper bounds on the number of neighbors of a particle."""

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array

#: Maximum number of particles for which the lists contain all pairs.
ALL_PAIRS_LIMIT = 32
# The densest packing of equal spheres has the fraction π/√18; compliant spheres overlap, hence the factor.
MAX_PACKING_FRACTION = np.pi / np.sqrt(18.0)
OVERLAP_FACTOR = 1.15
# Number of pair records of a particle: a fraction of its neighbors, plus a constant for short lists.
OWNED_FRACTION = 0.6
OWNED_EXTRA = 3


def max_neighbors(radius: Array, half_length: Array, skin: float) -> NDArray[np.int_]:
    """Returns an upper bound on the number of neighbors of each particle: the smallest particles that fit around it.

    Args:
        radius: Radii (…, n) [m].
        half_length: Half lengths of the axes (…, n), 0 for spheres [m].
        skin: Maximum gap of neighbors [m].
    """
    smallest = radius.min(axis=-1, keepdims=True)

    def volume(reach: Array) -> Array:
        return np.pi * reach**2 * (4.0 / 3.0 * reach + 2.0 * half_length)

    shell = volume(radius + 2.0 * smallest + skin) - volume(radius)
    bound = OVERLAP_FACTOR * MAX_PACKING_FRACTION * shell / (4.0 / 3.0 * np.pi * smallest**3)
    return np.minimum(np.ceil(bound).astype(np.int64) + 1, radius.shape[-1] - 1)


def owned_records(partners: NDArray[np.int_]) -> NDArray[np.int_]:
    """Returns the number of pair records of particles with lists for ``partners`` neighbors."""
    return np.minimum(np.ceil(OWNED_FRACTION * partners).astype(np.int64) + OWNED_EXTRA, partners)


def all_pair_lists(
    bodies: NDArray[np.int32], kinds: NDArray[np.int32], allowed: NDArray[np.int32]
) -> tuple[list[list[int]], list[list[int]]]:
    """Returns, for lists of all pairs, the neighbors whose records each particle owns, and its other neighbors."""
    count = len(bodies)
    touching = (bodies[:, None] != bodies) & (allowed[kinds[:, None], kinds] != 0)
    numbers = np.arange(count)
    odd = (numbers[:, None] + numbers) % 2 == 1
    owned_pairs = odd == (numbers[:, None] < numbers)
    return (
        [np.flatnonzero(row).tolist() for row in touching & owned_pairs],
        [np.flatnonzero(row).tolist() for row in touching & ~owned_pairs],
    )
