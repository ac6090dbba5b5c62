"""Many random pairs of all combinations of convex shapes: all are solved, and all results are correct."""

import itertools

import pytest
from convex_pairs import check, random_pairs, solved

import warpcontact as wc

SHAPES = [shape for shape in wc.shapes.CATALOGUE if shape.convex and shape is not wc.shapes.Plane]
COMBINATIONS = list(itertools.combinations_with_replacement(SHAPES, 2))


@pytest.mark.slow
@pytest.mark.parametrize("pair", COMBINATIONS, ids=lambda pair: "-".join(shape.__name__ for shape in pair))
def test_many_random_convex_pairs_match_brute_force(pair, times, device):
    """20 000, or 100 000 with --thorough."""
    A, B = pair
    for seed in range(times):
        shapes = random_pairs(A, B, 20_000, seed=100 + seed)
        check(A, B, shapes, solved(A, B, *shapes, device=device), count=500, best=4, rounds=20)
