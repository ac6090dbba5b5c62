"""Distances of points from shapes, or lower bounds if the distance exceeds a given value."""

import numpy as np
import pytest
import warp as wp
from convex_pairs import random_shapes
from warpcontact.kernels import shapes as S
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes.signed_distance import signed_distance, signed_distance_within


@pytest.mark.slow
def test_superellipsoid_distances_are_exact_below_the_requested_bound(device):
    """For points beyond the given value, any normal that proves it is accepted."""
    count, random = 2000, np.random.default_rng(3)
    sizes = random_shapes(S.Superellipsoid, count, random)
    x = random.uniform(-1.0, 1.0, (count, 3)) * sizes["semi_axes"]
    start = random.normal(size=(count, 3))
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    enough = random.uniform(-0.5, 0.5, count) * sizes["semi_axes"].min(axis=1)
    Of = coefficient_struct(S.Superellipsoid, wp.float64)
    of_place, within = signed_distance(S.Superellipsoid), signed_distance_within(S.Superellipsoid)

    @wp.kernel(module="unique")
    def ask(
        axes: wp.array(dtype=wp.vec3d),
        exponents: wp.array(dtype=wp.vec2d),
        x: wp.array(dtype=wp.vec3d),
        start: wp.array(dtype=wp.vec3d),
        enough: wp.array(dtype=wp.float64),
        gap: wp.array2d(dtype=wp.float64),
        plane: wp.array(dtype=wp.float64),
    ):
        i = wp.tid()
        p = Of()
        p.semi_axes = axes[i]
        p.exponents = exponents[i]
        exact = of_place(p, x[i])
        found = within(p, x[i], start[i], enough[i])
        gap[i, 0] = exact.gap
        gap[i, 1] = found.gap
        plane[i] = wp.dot(found.normal, x[i] - S.Superellipsoid.support(p, found.normal))

    gap, plane = (wp.zeros(shape, dtype=wp.float64, device=device) for shape in ((count, 2), count))
    inputs = [(sizes["semi_axes"], wp.vec3d), (sizes["exponents"], wp.vec2d), (x, wp.vec3d), (start, wp.vec3d)]
    arrays = [wp.array(values, dtype=kind, device=device) for values, kind in [*inputs, (enough, wp.float64)]]
    wp.launch(ask, count, arrays, [gap, plane], device=device)
    exact, found = gap.numpy().T
    near = exact < enough
    assert 500 < near.sum() < 1500
    np.testing.assert_array_equal(found[near], exact[near])
    assert (found[~near] >= enough[~near]).all()
    # Rounding of products with a point no farther than the semi-axes.
    assert (found <= exact + 1e-14).all()
    np.testing.assert_allclose(plane.numpy(), found, atol=1e-14)
