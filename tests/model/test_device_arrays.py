"""Device arrays with a dimension of more than 2 GiB."""

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.lowlevel.static_strides import RECORD

from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.system.resources import HOST, available_memory


@wp.struct
class Pair:
    first: wp.array2d(dtype=wp.float32)
    second: wp.array2d(dtype=wp.vec3f)


@wp.kernel
def mark_last(pair: Pair, env: int, item: int):
    pair.first[env, item] = 4.0


@pytest.mark.slow
def test_allocation_above_two_gibibytes_is_contiguous(device):
    """As for 64 points in a million environments on a GPU."""
    envs = 2**31 // (64 * RECORD) + 1
    room = available_memory(HOST if device == "cpu" else device)
    if room is not None and room.size < 3 * 2**32:
        pytest.skip("takes 4 GiB, of which there is hardly that much")
    layout = AllocationPlan(wp.get_device(device))
    pair = layout.struct("points", Pair, per_env(64), records=True)
    layout.array("states", layout, "plain", wp.uint8, per_env(64 * RECORD), transient=True)
    layout.allocate(envs)
    assert [need.size for need in layout.memory_items(envs)] == [envs * 64 * RECORD] * 2
    # Elements beyond 2³¹ bytes are written and read.
    pair.second[envs - 1 : envs].fill_(wp.vec3f(1.0, 2.0, 3.0))
    wp.launch(mark_last, 1, [pair, envs - 1, 63], device=device)
    layout.plain[envs - 1 : envs].fill_(7)
    together, plain = (written.memory.numpy().ravel() for written in layout.step_memory().values())
    assert together.size == plain.size == envs * 64 * RECORD > 2**31
    last = together[-64 * RECORD :].view(np.float32).reshape(64, -1)
    np.testing.assert_array_equal(last[:, 1:4], np.tile([1.0, 2.0, 3.0], (64, 1)))
    assert (plain[-64 * RECORD :] == 7).all()
    assert last[63, 0] == 4.0
    assert not last[:63, 0].any()
    assert not together[: -64 * RECORD].any()


def test_array_memory_has_no_dimension_longer_than_the_array(device):
    layout = AllocationPlan(wp.get_device(device))
    layout.array("contacts", layout, "rows", wp.vec3f, lambda envs: (envs, 3))
    layout.allocate(2)
    (rows,) = layout.step_memory().values()
    assert rows.memory.shape == (2, 3, 12)
    assert rows.content()["rows"].size == 2 * 3 * 12


@wp.struct
class Inner:
    number: wp.int32
    where: wp.vec3d


@wp.struct
class Several:
    factor: wp.array2d(dtype=wp.float64)
    index: wp.array2d(dtype=wp.int32)
    inner: wp.array2d(dtype=Inner)
    cached: wp.array2d(dtype=wp.int32)


RANGES = {"index": (0, [3, 4, 5]), "inner.number": (-1, 1)}


@pytest.mark.parametrize("records", [True, False])
def test_saved_arrays_are_restored_and_transient_arrays_are_zero(records, device):
    layout = AllocationPlan(wp.get_device(device))
    several = layout.struct("x", Several, per_env(3), records=records, transient=("cached",), ranges=RANGES)
    layout.allocate(2)
    several.factor.assign(np.arange(6.0).reshape(2, 3))
    several.index.assign(np.arange(1, 7, dtype=np.int32).reshape(2, 3))
    several.cached.fill_(7)
    saved = {
        name: content.copy()
        for memory in layout.step_memory().values()
        for name, content in memory.content().items()
    }
    assert list(saved) == ["factor", "index", "inner"]
    memory = next(memory for memory in layout.step_memory().values() if "index" in memory.saved)
    with pytest.raises(ValueError, match=r"index\[1, 0\] must be from 0 to 3, got 4"):
        memory.checked("index", saved["index"])
    with pytest.raises(ValueError, match="index must be 24 bytes, got 20 bytes as uint8"):
        memory.checked("index", saved["index"][4:])
    saved["index"] = np.array([3, 4, 5, 0, 1, 2], np.int32).view(np.uint8)
    for memory in layout.step_memory().values():
        memory.restore({name: memory.checked(name, saved[name]) for name in memory.saved})
    assert several.factor.numpy().tolist() == [[0, 1, 2], [3, 4, 5]]
    assert several.index.numpy().tolist() == [[3, 4, 5], [0, 1, 2]]
    assert not several.cached.numpy().any()


def test_saved_integer_arrays_require_a_range(device):
    layout = AllocationPlan(wp.get_device(device))
    with pytest.raises(TypeError, match="index: integers that checkpoints store must have a range"):
        layout.struct("x", Several, per_env(3))
    with pytest.raises(TypeError, match=r"inner\.number: integers that checkpoints store must have a range"):
        layout.struct("x", Several, per_env(3), transient=("cached",), ranges={"index": (0, 1)})
    layout.struct("x", Several, per_env(3), transient=True)
