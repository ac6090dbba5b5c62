"""Arrays on a device: more bytes than a dimension of one can have."""

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.strides import RECORD

from warpcontact.arrays import Layout, per_env
from warpcontact.available import HOST, find_room


@wp.struct
class Pair:
    first: wp.array2d(dtype=wp.float32)
    second: wp.array2d(dtype=wp.vec3f)


@wp.kernel
def mark_last(pair: Pair, env: int, item: int):
    pair.first[env, item] = 4.0


@pytest.mark.slow
def test_memory_of_more_than_two_gibibytes_is_one_piece(device):
    """As 64 points in a million environments have on a GPU."""
    envs = 2**31 // (64 * RECORD) + 1
    room = find_room(HOST if device == "cpu" else device)
    if room is not None and room.size < 3 * 2**32:
        pytest.skip("takes 4 GiB, of which there is hardly that much")
    layout = Layout(wp.get_device(device))
    pair = layout.struct("points", Pair, per_env(64), records=True)
    layout.array("states", layout, "plain", wp.uint8, per_env(64 * RECORD))
    layout.allocate(envs)
    assert [need.size for need in layout.needs(envs)] == [envs * 64 * RECORD] * 2
    # What lies behind 2³¹ bytes is written and found.
    pair.second[envs - 1 : envs].fill_(wp.vec3f(1.0, 2.0, 3.0))
    wp.launch(mark_last, 1, [pair, envs - 1, 63], device=device)
    layout.plain[envs - 1 : envs].fill_(7)
    together, plain = (array.numpy().ravel() for array in layout.written().values())
    assert together.size == plain.size == envs * 64 * RECORD > 2**31
    last = together[-64 * RECORD :].view(np.float32).reshape(64, -1)
    np.testing.assert_array_equal(last[:, 1:4], np.tile([1.0, 2.0, 3.0], (64, 1)))
    assert (plain[-64 * RECORD :] == 7).all()
    assert last[63, 0] == 4.0
    assert not last[:63, 0].any()
    assert not together[: -64 * RECORD].any()


def test_bytes_have_no_dimension_that_is_longer_than_those_of_their_array(device):
    layout = Layout(wp.get_device(device))
    layout.array("contacts", layout, "rows", wp.vec3f, lambda envs: (envs, 3))
    layout.allocate(2)
    (rows,) = layout.written().values()
    assert rows.shape == (2, 3, 12)
    assert rows.numpy().ravel().size == 2 * 3 * 12
