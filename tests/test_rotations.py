"""Rotations on the host."""

import numpy as np
import pytest

from warpcontact.frames import placed, shortest_rotations


@pytest.mark.parametrize("start", np.eye(3), ids=("x", "y", "z"))
def test_shortest_rotations_reach_every_direction_and_turn_about_no_other_axis(start):
    directions = np.random.default_rng(0).normal(size=(5, 10, 3))
    directions[0, :3] = start, -start, -start + 1e-7 * np.roll(start, 1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    rotations = shortest_rotations(start, directions)
    reached = placed(np.broadcast_to(start, (5, 10, 1, 3)), np.zeros((5, 10, 3)), rotations)[..., 0, :]
    # Near the opposite direction 1 + dot, of 1e-14, has two digits: then its square is what rounding leaves.
    np.testing.assert_allclose(reached, directions, atol=1e-6)
    np.testing.assert_allclose(reached.reshape(-1, 3)[3:], directions.reshape(-1, 3)[3:], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(rotations[..., :3] @ start, 0.0, atol=1e-12)
    # The angle is that between both, not the way round.
    cosines = directions @ start
    np.testing.assert_allclose(2.0 * rotations[..., 3] ** 2 - 1.0, cosines, atol=1e-12)
    assert (rotations[..., 3] >= 0.0).all()


def test_one_direction_has_one_rotation():
    np.testing.assert_array_equal(shortest_rotations((1.0, 0.0, 0.0), np.array([-1.0, 0.0, 0.0])), [0, 1, 0, 0])
    np.testing.assert_array_equal(shortest_rotations((1.0, 0.0, 0.0), np.array([1.0, 0.0, 0.0])), [0, 0, 0, 1])
