"""SIMD bounds of several cached faces equal those evaluated one by one."""

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.lowlevel.simd import WIDTH, candidates_within
from warpcontact.kernels.types import structs


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_tied_faces_are_found_among_stored_faces_only(real, device):
    """Excludes the nearest face, for any start in a row of lists and any values in unused entries."""
    vec3, find = structs(real).vec3, candidates_within(real)

    @wp.kernel(module="unique", enable_backward=False)
    def find_all(
        distance: wp.array2d(dtype=real),
        slope: wp.array2d(dtype=vec3),
        row: wp.array2d(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        moved: wp.array(dtype=vec3),
        slack: real,
        nearest: real,
        masks: wp.array2d(dtype=wp.int32),
    ):
        env, number = wp.tid()
        masks[env, number] = find(
            distance, slope, row, env, wp.static(WIDTH) * number, count[env], moved[env], slack, nearest, 5
        )

    rng = np.random.default_rng(2)
    envs, lists, kind = 500, 3, np.float32 if real is wp.float32 else np.float64
    faces = lists * WIDTH
    distance = rng.uniform(0.0, 1.0, (envs, faces)).astype(kind)
    slope = rng.normal(size=(envs, faces, 3)).astype(kind)
    row = rng.integers(0, 10, (envs, faces)).astype(np.int32)
    count = rng.integers(1, WIDTH + 4, envs).astype(np.int32)
    is_stored = np.arange(faces) % WIDTH < count[:, None]
    distance[~is_stored & (rng.random(is_stored.shape) < 0.5)] = np.nan
    slope[~is_stored] = np.inf
    moved = (0.3 * rng.normal(size=(envs, 3))).astype(kind)
    slack, nearest = kind(0.1), kind(0.5)

    masks = wp.zeros((envs, lists), dtype=wp.int32, device=device)
    arrays = [
        wp.array(values, dtype=dtype, device=device)
        for values, dtype in [(distance, real), (slope, vec3), (row, wp.int32), (count, wp.int32), (moved, vec3)]
    ]
    wp.launch(find_all, (envs, lists), [*arrays, slack, nearest, masks], device=device)
    selected = (masks.numpy()[..., None] >> np.arange(32)) & 1 == 1
    assert not selected[..., WIDTH:].any()
    with np.errstate(invalid="ignore"):
        least = distance + np.einsum("efk,ek->ef", slope, moved) - slack
    # No comparison depends on rounding.
    assert (np.abs(least[is_stored] - nearest) > 16 * np.finfo(kind).eps).all()
    np.testing.assert_array_equal(
        selected[..., :WIDTH].reshape(envs, faces), is_stored & (least <= nearest) & (row != 5)
    )
