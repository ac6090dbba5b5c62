"""SIMD bounds of several cached faces equal those evaluated one by one."""

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.lowlevel.simd import WIDTH, candidates_within
from warpcontact.kernels.types import structs


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_tied_faces_are_found_among_stored_faces_only(real, device):
    """Excludes the nearest face, for any start in a row of lists and any values in unused entries."""
    vec3, tell = structs(real).vec3, candidates_within(real)

    @wp.kernel(module="unique", enable_backward=False)
    def tell_all(
        distance: wp.array2d(dtype=real),
        slope: wp.array2d(dtype=vec3),
        row: wp.array2d(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        gone: wp.array(dtype=vec3),
        slack: real,
        nearest: real,
        those: wp.array2d(dtype=wp.int32),
    ):
        env, number = wp.tid()
        those[env, number] = tell(
            distance, slope, row, env, wp.static(WIDTH) * number, count[env], gone[env], slack, nearest, 5
        )

    rng = np.random.default_rng(2)
    envs, lists, kind = 500, 3, np.float32 if real is wp.float32 else np.float64
    faces = lists * WIDTH
    distance = rng.uniform(0.0, 1.0, (envs, faces)).astype(kind)
    slope = rng.normal(size=(envs, faces, 3)).astype(kind)
    row = rng.integers(0, 10, (envs, faces)).astype(np.int32)
    count = rng.integers(1, WIDTH + 4, envs).astype(np.int32)
    there = np.arange(faces) % WIDTH < count[:, None]
    distance[~there & (rng.random(there.shape) < 0.5)] = np.nan
    slope[~there] = np.inf
    gone = (0.3 * rng.normal(size=(envs, 3))).astype(kind)
    slack, nearest = kind(0.1), kind(0.5)

    those = wp.zeros((envs, lists), dtype=wp.int32, device=device)
    arrays = [
        wp.array(values, dtype=dtype, device=device)
        for values, dtype in [(distance, real), (slope, vec3), (row, wp.int32), (count, wp.int32), (gone, vec3)]
    ]
    wp.launch(tell_all, (envs, lists), [*arrays, slack, nearest, those], device=device)
    told = (those.numpy()[..., None] >> np.arange(32)) & 1 == 1
    assert not told[..., WIDTH:].any()
    with np.errstate(invalid="ignore"):
        least = distance + np.einsum("efk,ek->ef", slope, gone) - slack
    # No comparison depends on rounding.
    assert (np.abs(least[there] - nearest) > 16 * np.finfo(kind).eps).all()
    np.testing.assert_array_equal(told[..., :WIDTH].reshape(envs, faces), there & (least <= nearest) & (row != 5))
