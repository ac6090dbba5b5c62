"""Arrays on a device: more bytes than a dimension of one can have."""

import numpy as np
import warp as wp

from warpcontact.arrays import RECORD, Layout, per_env


@wp.struct
class Pair:
    first: wp.array2d(dtype=wp.float32)
    second: wp.array2d(dtype=wp.vec3f)


def test_memory_of_more_than_two_gibibytes_is_one_piece(device):
    """As 64 points in a million environments have on a GPU."""
    envs = 2**31 // (64 * RECORD) + 1
    layout = Layout(wp.get_device(device))
    pair = layout.struct("points", Pair, per_env(64), records=True)
    layout.array("states", layout, "plain", wp.uint8, per_env(64 * RECORD))
    layout.allocate(envs)
    assert [need.size for need in layout.needs(envs)] == [envs * 64 * RECORD] * 2
    # What lies behind 2³¹ bytes is written and found.
    pair.second[envs - 1 : envs].fill_(wp.vec3f(1.0, 2.0, 3.0))
    layout.plain[envs - 1 : envs].fill_(7)
    together, plain = (array.numpy().ravel() for array in layout.written().values())
    assert together.size == plain.size == envs * 64 * RECORD > 2**31
    last = together[-64 * RECORD :].view(np.float32).reshape(64, -1)
    np.testing.assert_array_equal(last[:, 1:4], np.tile([1.0, 2.0, 3.0], (64, 1)))
    assert (plain[-64 * RECORD :] == 7).all()
    assert not together[: -64 * RECORD].any()
