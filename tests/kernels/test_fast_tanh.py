"""The hyperbolic tangent of friction models against NumPy in float64."""

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.friction.base import fast_tanh


@pytest.mark.parametrize(("real", "units"), [(np.float32, 3.0), (np.float64, 4.0)], ids=["float32", "float64"])
def test_fast_tanh_matches_hyperbolic_tangent_to_rounding(real, units, device):
    """Within three units in the last place in float32, as stated by Cephes; in float64 it is the library function."""
    kind = wp.dtype_from_numpy(real)

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(x: wp.array(dtype=kind), y: wp.array(dtype=kind)):
        y[wp.tid()] = fast_tanh(x[wp.tid()])

    size = np.geomspace(1.0e-30, 200.0, 200_001)
    # Includes both sides of the end of the polynomial.
    values = np.concatenate([size, -size, np.linspace(0.6, 0.65, 20_001), [0.0, np.inf, -np.inf]]).astype(real)
    x = wp.array(values, dtype=kind, device=device)
    y = wp.zeros_like(x)
    wp.launch(evaluate, len(values), [x, y], device=device)
    exact = np.tanh(values.astype(np.float64))
    error = np.abs(y.numpy() - exact) / np.spacing(np.maximum(np.abs(exact), np.finfo(real).tiny).astype(real))
    assert error.max() <= units


def test_fast_tanh_of_nan_is_nan(device):
    """NaN must propagate, so that a failed contact is detected."""

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(x: wp.array(dtype=wp.float32), y: wp.array(dtype=wp.float32)):
        y[wp.tid()] = fast_tanh(x[wp.tid()])

    x = wp.array([np.nan], dtype=wp.float32, device=device)
    y = wp.zeros_like(x)
    wp.launch(evaluate, 1, [x, y], device=device)
    assert np.isnan(y.numpy()[0])
