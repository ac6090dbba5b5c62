"""Quick and release builds of a kernel give bitwise identical results, and have one identifier each."""

import numpy as np
import warp as wp
from warp._src.context import ModuleBuilder, ModuleHasher
from warpcontact.kernels.lowlevel.unique_kernel import QUICK_OPTIONS, RELEASE_OPTIONS
from warpcontact.kernels.shapes import narrow_phase
from warpcontact.kernels.shapes.revolution import Cylinder
from warpcontact.kernels.shapes.rounded_box import RoundedBox

from warpcontact.system import kernel_builds


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


def test_identifier_of_a_kernel_of_shapes_is_the_same_after_its_code_was_generated():
    """Otherwise its release build, which is generated after the quick one, is refused."""
    kernel = narrow_phase.kernel(Cylinder, RoundedBox, wp.float64, False, False)
    module = kernel.module
    dim = kernel_builds._BLOCK_DIM
    before = module.get_module_hash(dim)
    options = module.resolved_options[dim]
    ModuleBuilder(module, options, hasher=module.hashers[dim]).codegen("cpu")
    assert ModuleHasher([kernel], options).get_hash() == before
