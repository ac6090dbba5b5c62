"""Quick and release builds of a kernel give bitwise identical results."""

import numpy as np
import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import QUICK_OPTIONS, RELEASE_OPTIONS


@wp.func
def power(x: float, exponent: float):
    return wp.pow(x, exponent)


def powers(values: wp.array(dtype=float), results: wp.array2d(dtype=float)):
    i = wp.tid()
    x = values[i]
    # Constant exponents, visible directly and after inlining.
    results[0, i] = wp.pow(x, 2.0)
    results[1, i] = wp.pow(x, 0.5)
    results[2, i] = power(x, -1.0)
    results[3, i] = power(x, 2.0)
    results[4, i] = wp.pow(2.0, x)
    results[5, i] = wp.sin(x) * wp.cos(x) + wp.exp(x) / (1.0 + wp.tanh(x))


def test_results_do_not_depend_on_the_build():
    values = np.random.default_rng(1).uniform(1e-3, 10.0, 20000).astype(np.float32)
    found = []
    for options in (QUICK_OPTIONS, RELEASE_OPTIONS):
        kernel = wp.kernel(powers, module="unique", enable_backward=False, module_options=dict(options))
        results = wp.zeros((6, len(values)), dtype=float, device="cpu")
        wp.launch(kernel, len(values), [wp.array(values, device="cpu"), results], device="cpu")
        found.append(results.numpy())
    np.testing.assert_array_equal(*found)
    np.testing.assert_allclose(found[0][0], values.astype(float) ** 2, rtol=2e-7)
